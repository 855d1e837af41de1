/* Points of balls, and nearest points for queries far from all of them, by tight boxes of points that follow each
 * other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KNN_BOXES_H
#define WHITTLE_CORE_SPATIAL_KNN_BOXES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

struct knn_boxes;

/* Boxes of n points (1 <= n < 2^31), which are borrowed; the nearer to each other points are that follow each other,
 * the fewer a query looks at.  *boxes is the caller's, to be given to knn_boxes_free.  O(n), 4 bytes for each point.
 * STATUS_NO_MEMORY. */
enum status knn_boxes_new(const vec3 *points, size_t n, struct knn_boxes **boxes) MUST_CHECK;

/* The k nearest points, nearest first; of points that are equally far, the lower id.  Returns how many there are, k
 * unless there are fewer points.  bound_sq: the k-th squared distance isn't more, or INFINITY.  slack: NULL = none. */
unsigned knn_boxes_nearest(const struct knn_boxes *boxes, vec3 query, unsigned k, const struct knn_slack *slack,
                           double bound_sq, uint32_t *id, double *distance_sq);

/* Where points are put: arrays, and how many there are. */
struct knn_gathered {
    double *x, *y, *z;
    uint32_t *id;
    unsigned count;
};

enum { KNN_BOXES_ROOM = 16 /* points for which there is room beyond the most */ };

/* The points that are nearer to the centre than the radius, in no particular order; where there are more than most,
 * count is over most, and what was put is of no use.  False, and likewise, where too many boxes lie in the way. */
bool knn_boxes_within(const struct knn_boxes *boxes, vec3 centre, double radius, unsigned most,
                      struct knn_gathered *gathered);

/* Accepts NULL. */
void knn_boxes_free(struct knn_boxes *boxes);

#endif
