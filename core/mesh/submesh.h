/* A mesh without some of its triangles.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_SUBMESH_H
#define WHITTLE_CORE_MESH_SUBMESH_H

#include "core/mesh/halfedge.h"

/* Takes the triangles with out[t] != 0 out of the mesh (he: its half-edges, no vertex of it knotted), which has sources
 * and tags.  The others stay in their order; vertices are numbered as triangles come to them.  Each fan of triangles
 * that is left at a vertex gets a vertex of its own, so the mesh stays a manifold.  *mesh is untouched on failure, and
 * he no longer of it afterwards.  O(triangles).  STATUS_NO_MEMORY. */
enum status submesh_without(struct mesh *mesh, const struct halfedge *he, const uint8_t *out) MUST_CHECK;

#endif
