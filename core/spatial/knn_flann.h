/* FLANN's exact kd-tree (KDTREE_SINGLE) in double precision, one query at a time.  For knn_pieces.c alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KNN_FLANN_H
#define WHITTLE_CORE_SPATIAL_KNN_FLANN_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

struct knn_flann;

/* A tree over n (1 <= n < 2^31) of the points, which are copied; the values of the items are their ids, indices into
 * points.  *tree is the caller's, to be given to knn_flann_free.  O(n log n).  STATUS_NO_MEMORY. */
enum status knn_flann_new(const vec3 *points, const uint64_t *item, size_t n, struct knn_flann **tree) MUST_CHECK;

/* The k nearest of the tree's points and of the *count <= k that are there already, nearest first; of points that are
 * equally far, the lower id.  *count becomes how many there are, k unless there are fewer points.  slack: NULL = none.
 * *visits: so many nodes may be looked at, of which it takes those off that were; 0 = that weren't enough, and what was
 * found are some points but not the nearest.  STATUS_NO_MEMORY. */
enum status knn_flann_nearest(const struct knn_flann *tree, vec3 query, unsigned k, const struct knn_slack *slack,
                              uint32_t *id, double *distance_sq, unsigned *count, unsigned *visits) MUST_CHECK;

/* Adds the points that are nearer to the centre than the radius to the *count that are there already, in no particular
 * order; where that makes more than most, *count is over most and id of no use.  STATUS_NO_MEMORY. */
enum status knn_flann_within(const struct knn_flann *tree, vec3 centre, double radius, unsigned most, uint32_t *id,
                             unsigned *count) MUST_CHECK;

/* Accepts NULL. */
void knn_flann_free(struct knn_flann *tree);

#ifdef __cplusplus
}
#endif

#endif
