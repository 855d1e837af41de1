/* A closed mesh with fewer vertices, of the same topology.
 *
 * Garland, Heckbert: Surface simplification using quadric error metrics (1997): edges are collapsed, the cheapest
 * first.  Here one end of an edge takes the place of both, so vertices stay a subset of those that there were.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_DECIMATE_H
#define WHITTLE_CORE_MESH_DECIMATE_H

#include "core/base/status.h"
#include "core/mesh/mesh.h"

/* Collapses edges until `count` vertices are left, or none can be collapsed any more: each collapse keeps the topology
 * and turns no triangle by more than about 75 degrees; vertices of a border, and where several fans meet, stay.  Unused
 * vertices go, whatever the count.  Sources and tags follow.  One thread; O(n log n).  STATUS_NO_MEMORY: then the mesh
 * is as it was. */
enum status mesh_decimate(struct mesh *mesh, size_t count) MUST_CHECK;

#endif
