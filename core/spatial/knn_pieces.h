/* FLANN's trees of pieces of space, as one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KNN_PIECES_H
#define WHITTLE_CORE_SPATIAL_KNN_PIECES_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

struct knn_pieces;

/* Nodes that a query of few points looks at in the trees.  Beside the points they are some ten; from as far off as
 * scans have holes, up to a thousand. */
enum { KNN_VISITS = 128 };

/* Trees over n points (1 <= n < 2^31), which are borrowed, on up to `threads` threads (0 = all processors).  *pieces is
 * the caller's, to be given to knn_pieces_free.  O(n log n).  STATUS_NO_MEMORY. */
enum status knn_pieces_new(const vec3 *points, size_t n, unsigned threads, struct knn_pieces **pieces) MUST_CHECK;

/* The k nearest points, nearest first; of points that are equally far, the lower id.  *count is how many there are, k
 * unless there are fewer points.  slack, *visits: as knn_flann_nearest has them.  STATUS_NO_MEMORY. */
enum status knn_pieces_nearest(const struct knn_pieces *pieces, vec3 query, unsigned k, const struct knn_slack *slack,
                               uint32_t *id, double *distance_sq, unsigned *count, unsigned *visits) MUST_CHECK;

/* The points that are nearer to the centre than the radius, in no particular order, and how many; where there are more
 * than most, *count is over most and id of no use.  STATUS_NO_MEMORY. */
enum status knn_pieces_within(const struct knn_pieces *pieces, vec3 centre, double radius, unsigned most, uint32_t *id,
                              unsigned *count) MUST_CHECK;

/* Accepts NULL. */
void knn_pieces_free(struct knn_pieces *pieces);

#endif
