/* Where a mesh passes through itself.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_INTERSECT_H
#define WHITTLE_CORE_MESH_INTERSECT_H

#include <stdbool.h>

#include "core/mesh/mesh.h"

/* Counts the pairs of triangles that have more in common than the corners and edges that they share: exactly, whatever
 * the rounding.  Corners at the same place are the same, so copies of a vertex where two parts touch are no
 * intersection; of a triangle without area only its edges' neighbours count.  O(triangles log triangles) where
 * triangles are about as large as their neighbours, 1 to 2 us for each; the same for any number of threads (0 = all
 * processors).  At most 100 bytes for each triangle.  STATUS_NO_MEMORY, and then *pairs is untouched. */
enum status mesh_count_intersections(const struct mesh *mesh, unsigned threads, size_t *pairs) MUST_CHECK;

/* What intersects what on a mesh whose triangles change, one by one. */
struct intersections;

/* Makes new, with the mesh borrowed.  As long as there are that many triangles, their corners may change.
 * STATUS_NO_MEMORY, and then *found is untouched. */
enum status intersections_new(const struct mesh *mesh, unsigned threads, struct intersections **found) MUST_CHECK;

/* Accepts NULL. */
void intersections_free(struct intersections *found);

/* A triangle's corners aren't where they were any more. */
void intersections_update(struct intersections *found, uint32_t triangle);

/* Sets *pair to new memory, with the *count pairs of triangles that intersect, each once, with the lower id first, in
 * order.  STATUS_NO_MEMORY, and then both are untouched. */
enum status intersections_list(const struct intersections *found, unsigned threads, uint32_t (**pair)[2],
                               size_t *count) MUST_CHECK;

/* The same anew, of *pair and *count as they were before the triangles with touched[t] != 0 were changed: only these
 * are looked for.  One thread.  STATUS_NO_MEMORY, and then *pair, which is still to be freed, says nothing. */
enum status intersections_list_again(const struct intersections *found, const uint8_t *touched, uint32_t (**pair)[2],
                                     size_t *count) MUST_CHECK;

/* The triangles that one with these corners would intersect, but for the n of `without`, which aren't looked at:
 * returns how many they are, or most + 1, where they are more, and sets other[] to as many, unless that is NULL.  A
 * triangle of the mesh intersects itself. */
size_t intersections_of(const struct intersections *found, const vec3 corner[3], const uint32_t *without, size_t n,
                        uint32_t *other, size_t most);

/* How many of n triangles of the mesh one with these corners would intersect. */
size_t intersections_among(const struct intersections *found, const vec3 corner[3], const uint32_t *triangle, size_t n);

/* Whether two triangles intersect. */
bool triangles_intersect(const vec3 a[3], const vec3 b[3]);

#endif
