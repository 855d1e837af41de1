/* Queries that lie near each other, answered together from one gathering of points around them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KNN_GROUP_H
#define WHITTLE_CORE_SPATIAL_KNN_GROUP_H

#include "core/spatial/knn_boxes.h"
#include "core/spatial/knn_pieces.h"

enum { KNN_GROUP_POINTS = 512, KNN_GROUP_ROOM = KNN_GROUP_POINTS + KNN_BOXES_ROOM };

/* All points within a ball.  Some 14 KB, for the stack. */
struct knn_group {
    double x[KNN_GROUP_ROOM], y[KNN_GROUP_ROOM], z[KNN_GROUP_ROOM];
    uint32_t id[KNN_GROUP_ROOM];
    unsigned count;
    vec3 centre;
    double radius;
};

/* How many of the next queries, at most n, make up a group: those not farther from the first than a width. */
size_t knn_group_length(const vec3 *query, size_t n, double width);

/* Where a group is gathered from: the boxes, and the trees where these are of no use. */
struct knn_group_from {
    const struct knn_boxes *boxes;
    const struct knn_pieces *pieces;
    const vec3 *point; /* what both are of */
    unsigned loose;    /* so many gatherings don't ask the boxes: too many lay in the way of one before */
};

/* Gathers the points that are within `room` of any of n queries, and some more.  *gathered is false where there are
 * more than `most`, which is at most KNN_GROUP_POINTS.  STATUS_NO_MEMORY. */
enum status knn_group_gather(struct knn_group *group, struct knn_group_from *from, const vec3 *query, size_t n,
                             double room, unsigned most, bool *gathered) MUST_CHECK;

/* The same from the points of `wide`; false where it doesn't hold all of them for sure. */
bool knn_group_narrow(const struct knn_group *wide, const vec3 *query, size_t n, double room, struct knn_group *group);

/* The k nearest points of a query, as knn_pieces_nearest would have them; false, and nothing written, where the ball
 * doesn't hold them for sure, or where two of them are equally far.  usual: about as far as the k-th will be. */
bool knn_group_nearest(const struct knn_group *group, vec3 query, unsigned k, double usual, uint32_t *id,
                       double *distance_sq);

#endif
