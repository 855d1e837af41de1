/* Queries that lie near each other, answered together from one gathering of points around them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_KNN_GROUP_H
#define WHITTLE_CORE_KNN_GROUP_H

#include "core/knn_pieces.h"

enum { KNN_GROUP_POINTS = 128 };

/* All points within a ball.  Some 8 KB, for the stack. */
struct knn_group {
    double x[KNN_GROUP_POINTS], y[KNN_GROUP_POINTS], z[KNN_GROUP_POINTS];
    uint32_t id[KNN_GROUP_POINTS];
    unsigned count;
    vec3 centre;
    double radius;
};

/* How many of the next queries, at most n, make up a group: those not farther from the first than a width. */
unsigned knn_group_length(const vec3 *query, size_t n, double width);

/* Gathers the points of the trees (`point` is what they were made of) for n queries, whose k-th neighbours are expected
 * to be about `usual` away.  *gathered is false where there are too many of them.  STATUS_NO_MEMORY. */
enum status knn_group_gather(struct knn_group *group, const struct knn_pieces *pieces, const vec3 *point,
                             const vec3 *query, unsigned n, double usual, bool *gathered) MUST_CHECK;

/* The k nearest points of a query, as knn_pieces_nearest would have them; false, and nothing written, where the ball
 * doesn't hold them for sure, or where two of them are equally far.  usual: about as far as the k-th will be. */
bool knn_group_nearest(const struct knn_group *group, vec3 query, unsigned k, double usual, uint32_t *id,
                       double *distance_sq);

#endif
