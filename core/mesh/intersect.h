/* Where a mesh passes through itself.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_INTERSECT_H
#define WHITTLE_CORE_MESH_INTERSECT_H

#include "core/mesh/mesh.h"

/* Counts the pairs of triangles that have more in common than the corners and edges that they share: exactly, whatever
 * the rounding.  Corners at the same place are the same, so copies of a vertex where two parts touch are no
 * intersection; of a triangle without area only its edges' neighbours count.  O(triangles log triangles) where
 * triangles are about as large as their neighbours, 1 to 2 us for each; the same for any number of threads (0 = all
 * processors).  At most 100 bytes for each triangle.  STATUS_NO_MEMORY, and then *pairs is untouched. */
enum status mesh_count_intersections(const struct mesh *mesh, unsigned threads, size_t *pairs) MUST_CHECK;

#endif
