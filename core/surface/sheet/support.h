/* Which triangles of a mesh no original point speaks for: what a scan hasn't seen.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_SUPPORT_H
#define WHITTLE_CORE_SURFACE_SHEET_SUPPORT_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"
#include "core/spatial/knn.h"
#include "core/spatial/neighbourhood.h"

/* Fills reach[i] for each of the n points of the index: the distance to its sixth neighbour, and at least the median of
 * those.  *median is that.  O(n).  The same for any number of threads.  STATUS_NO_MEMORY. */
enum status sheet_reach(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, float *reach,
                        float *median) MUST_CHECK;

/* The same from neighbours that were found before, nearest first.  Where there are fewer than six it is the last one's;
 * on scan lines it is that among points as far apart along them as across (scan_lines.h). */
enum status sheet_reach_in(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads, float *reach,
                           float *median) MUST_CHECK;

/* stray[i] = 1 for the points whose reach is very much larger than that of the neighbour it goes to, else 0: they are
 * no part of the surface there.  Where density varies, however much, reaches of neighbours are alike. */
void sheet_find_strays(const struct neighbourhood *neighbours, const float *reach, unsigned threads, uint8_t *stray);

/* inner[i] = the middle one of the reaches of a point and its neighbours: one on a border, which has neighbours on one
 * side alone, has about that of those inside. */
void sheet_inner_reach(const struct neighbourhood *neighbours, const float *reach, unsigned threads, float *inner);

/* The original points that triangles are judged by.  All borrowed. */
struct sheet_points {
    const struct knn *knn;
    const float *reach; /* sheet_reach */
    float median;
    const uint8_t *stray;       /* sheet_find_strays; NULL = there are none */
    const vec3 *point, *normal; /* of unit length, either sign; NULL = not known: then nothing is beside a sheet */
    const float *inner;         /* sheet_inner_reach, where normals are known */
};

/* From where on a place is far from the points: over so many times the reach of the nearest one; where points are
 * sparse over so many medians of it, unless that is less than points there are apart (`apart` reaches; 0 = as far as
 * no place amid evenly spread points is).  And, where normals are known and
 * it isn't 0, over so many times the inner reach along the nearest one's plane: a triangle of few points may lie off a
 * curved surface, but where it is beside all points there is a gap.  A triangle is out when more than `share` of its
 * places, 0 to 1, are far: what is mostly near covers points that nothing else may cover. */
struct sheet_limit {
    double times, medians, beside, share, apart;
};

/* out[t] = 1 for the triangles with a place, or more of them than the limit's share, that is far from all original
 * points, else 0; of those with of[t] = 1 alone, unless that is NULL.  Places are those of a grid that is finer than
 * the reach, up to a few dozen in a triangle.  The same for any number of threads.  O(triangles log points).
 * STATUS_NO_MEMORY, STATUS_CANCELLED (stage "support"). */
enum status sheet_unsupported(const struct mesh *mesh, const struct sheet_points *points, struct sheet_limit limit,
                              const uint8_t *of, unsigned threads, const struct progress *progress,
                              uint8_t *out) MUST_CHECK;

/* share[t] = the part of a triangle, 0 to 1, that is far, by a few places of each; by_medians[t]: that by the same
 * limit but for its medians, from the same search. */
enum status sheet_far_share(const struct mesh *mesh, const struct sheet_points *points, struct sheet_limit limit,
                            double medians, unsigned threads, float *share, float *by_medians) MUST_CHECK;

#endif
