/* Which triangles of a mesh span holes of the points that it was made from.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_HOLES_H
#define WHITTLE_CORE_SURFACE_COCONE_HOLES_H

#include "core/mesh/halfedge.h"
#include "core/surface/reconstruct.h"

/* hole[t] = 1 for the triangles of the mesh (he: its half-edges) that span a hole of the original points, else 0.
 * sites: how many points mesh->source is of; none whose triangles would all be holes' is without one that isn't.  The
 * same for any number of threads.  O((dense->n + triangles) log dense->n).  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status cocone_holes_find(const struct mesh *mesh, const struct halfedge *he, const struct reconstruct_dense *dense,
                              size_t sites, unsigned threads, uint8_t *hole) MUST_CHECK;

#endif
