/* The rim of a height field: what joins the outermost points where the scan just ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_RIM_H
#define WHITTLE_CORE_SURFACE_SHEET_RIM_H

#include "core/mesh/halfedge.h"
#include "core/surface/sheet/support.h"

/* Marks slivers along the borders of a height field, out[t] = 1: triangles that are so long and narrow in the plane
 * that points of a sheet would lie in them, and that in space are far from all points at the middle of a side, such as
 * one from a tree to the next where the scan was cut off; likewise slivers that are nearly upright and hardly near
 * points there, such as one from a hill to the next.  Triangles that are marked already count as gone, and one that
 * alone holds its point stays.  he: half-edges of the mesh, whose vertices are feet in the plane; feet: the original
 * points there with their reach; place[v]: where a vertex is in space; knn: over the original points there. O(triangles
 * + slivers log points).  STATUS_NO_MEMORY. */
enum status rim_mark_slivers(const struct mesh *mesh, const struct halfedge *he, const struct sheet_points *feet,
                             const vec3 *place, const struct knn *knn, uint8_t *out) MUST_CHECK;

#endif
