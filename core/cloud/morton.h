/* The points as the stages see them: distinct, in a frame of their own, along a space-filling curve.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_MORTON_H
#define WHITTLE_CORE_CLOUD_MORTON_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Coordinates of this size and over would overflow in the frame's arithmetic. */
#define ORDER_LARGEST 1e300

/* point[i] = (input - centre) / scale, scale = the diagonal of the bounding box (1 where that is 0), so coordinates lie
 * within -0.5 .. 0.5 and lengths are fractions of the diagonal.
 *
 * Where a few points lie so far off that the box says nothing of the others (a stray at 0, 0, 0 beside a scan in UTM;
 * core/cloud/most.h), centre and scale are those of most points: they lie within about -1 .. 1, and the strays at up to
 * 1e9. */
struct ordered_points {
    size_t count;       /* distinct points */
    vec3 *point;        /* count, in Morton order; owned */
    uint32_t *original; /* for each its id in the input; the lowest one of duplicates; owned */
    uint32_t *distinct; /* for each input point (n of them) which of these it is; owned */
    vec3 centre, box_min, box_max;
    double scale;
    double diagonal; /* of the bounding box (1 where that is 0): scale, unless strays spoil it */
    size_t strays;   /* points of the input that spoil the box: farther than 64 times as far off as most */
};

/* A place of the input in the frame. */
static inline vec3 order_in_frame(const struct ordered_points *frame, vec3 p) {
    vec3 d = vec3_sub(p, frame->centre);
    return (vec3){d.x / frame->scale, d.y / frame->scale, d.z / frame->scale};
}

/* Sorts and removes exact duplicates (-0 equals 0).  Depends on the set of positions alone, but for which id stands for
 * duplicates.  1 <= n < UINT32_MAX, all finite and below
 * ORDER_LARGEST in size.  O(n).  STATUS_NO_MEMORY. */
enum status order_points(const vec3 *position, size_t n, unsigned threads, struct ordered_points *out) MUST_CHECK;

/* The same of a part of a cloud, in the frame and along the curve of the whole: what is told of those (box, diagonal,
 * centre, scale) is taken from `whole`, so that points of two parts stand to each other in each as they do in the
 * whole.
 */
enum status order_points_of(const struct ordered_points *whole, const vec3 *position, size_t n, unsigned threads,
                            struct ordered_points *out) MUST_CHECK;

/* Fills what is told of the frame of a cloud in this box: centre, diagonal, scale.  No strays spoil it. */
void order_frame_of(vec3 box_min, vec3 box_max, struct ordered_points *whole);

/* Accepts zeroed points. */
void ordered_points_done(struct ordered_points *points);

#endif
