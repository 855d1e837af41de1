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

/* Where the nearest points needn't be exact: a point that is found over `far` times its own length away may be farther
 * than the true one by so large a share of the distance. */
struct knn_slack {
    const float *length; /* of each point, such as the distance to its neighbours; borrowed */
    double far, share;
};

/* The same with some slack.  From far off all points of a scan are about as near, so telling which are nearest takes
 * looking at very many, as many as the query is spacings away on a surface. */
enum status knn_search_nearly(const struct knn *knn, const struct knn_slack *slack, const vec3 *queries, size_t m,
                              unsigned k, unsigned threads, uint32_t *id, double *distance_sq) MUST_CHECK;

/* Accepts NULL. */
void knn_free(struct knn *knn);

#endif
