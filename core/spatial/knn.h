/* Nearest neighbours, exact, by FLANN's single kd-trees in double precision.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KNN_H
#define WHITTLE_CORE_SPATIAL_KNN_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

struct knn;

enum { KNN_MAX_K = 64 };

/* Builds an index over n points (1 <= n < 2^31), which are borrowed and must outlive it unchanged, on up to `threads`
 * threads (0 = all processors).  Points in space-filling order make it several times as fast as those in no order.
 * *knn is the caller's, to be given to knn_free.  O(n log n).  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status knn_new(const vec3 *points, size_t n, unsigned threads, struct knn **knn, struct error *error) MUST_CHECK;

/* The k nearest points of each of m queries, nearest first, of points that are equally far the lower index:
 * id[q * k + i] and distance_sq[q * k + i] (squared Euclidean, double).  A query that is itself a point finds itself at
 * distance 0.  Where there are fewer than k points the rest is NONE (UINT32_MAX) and infinity.  k <= KNN_MAX_K.
 * Queries that lie in space-filling order are twice as fast as random ones.  Deterministic for any number of threads
 * (0 = all processors). */
enum status knn_search(const struct knn *knn, const vec3 *queries, size_t m, unsigned k, unsigned threads, uint32_t *id,
                       double *distance_sq) MUST_CHECK;

/* The nearest point of each of m queries, as knn_search has it, but of a query that is over 4096 times as far from what
 * is found as points are apart there (spacing, one for each point) one that may be farther than the nearest by 1/2000.
 * From far off all points of a scan are about as near, so telling which is nearest takes looking at very many; no query
 * within the box of an ordinary scan is that far. */
enum status knn_nearest(const struct knn *knn, const float *spacing, const vec3 *queries, size_t m, unsigned threads,
                        uint32_t *id, double *distance_sq) MUST_CHECK;

/* Accepts NULL. */
void knn_free(struct knn *knn);

#endif
