/* FLANN's exact kd-tree (KDTREE_SINGLE) in double precision, one query at a time.  For knn.c alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_KNN_FLANN_H
#define WHITTLE_CORE_KNN_FLANN_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#include "core/status.h"
#include "core/vec3.h"

struct knn_flann;

/* A tree over n points (1 <= n < 2^31), which are borrowed.  *tree is the caller's, to be given to knn_flann_free.
 * O(n log n).  STATUS_NO_MEMORY. */
enum status knn_flann_new(const vec3 *points, size_t n, struct knn_flann **tree) MUST_CHECK;

/* The k nearest points, nearest first; of points that are equally far, the lower index (but which of those that are as
 * far as the k-th are in is up to the tree).
 * Returns how many there are in *count, k unless the tree has fewer.  STATUS_NO_MEMORY. */
enum status knn_flann_nearest(const struct knn_flann *tree, vec3 query, unsigned k, uint32_t *id, double *distance_sq,
                              unsigned *count) MUST_CHECK;

/* The points that are nearer to the centre than the radius, in no particular order, and how many; where there are more
 * than most, *count is over most and id of no use.  STATUS_NO_MEMORY. */
enum status knn_flann_within(const struct knn_flann *tree, vec3 centre, double radius, unsigned most, uint32_t *id,
                             unsigned *count) MUST_CHECK;

/* Accepts NULL. */
void knn_flann_free(struct knn_flann *tree);

#ifdef __cplusplus
}
#endif

#endif
