/* Directions from a point to its neighbours, and planes that many of them lie on.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_DIRECTIONS_H
#define WHITTLE_CORE_SPATIAL_DIRECTIONS_H

#include <stdbool.h>
#include <stdint.h>

#include "core/math/vec3.h"

enum { DIRECTIONS_MOST = 24 /* each has a bit */ };

/* Of unit length; set by directions_set, and read. */
struct directions {
    unsigned n;
    vec3 to[DIRECTIONS_MOST];
    double x[DIRECTIONS_MOST], y[DIRECTIONS_MOST], z[DIRECTIONS_MOST]; /* the same; 0 beyond them */
};

/* From `to`, of which there are n. */
void directions_set(struct directions *directions);

/* Those that lie about on a plane through the point: the sine between is less than DIRECTIONS_ON. */
#define DIRECTIONS_ON 0.22
uint32_t directions_near_plane(const struct directions *directions, vec3 normal);

/* Of the planes through the point and two of `left`, which have to be DIRECTIONS_APART (the angle's sine), the one with
 * most of them on it, then most of all; false where there are fewer than two of them. */
#define DIRECTIONS_APART 0.3
bool directions_find_plane(const struct directions *directions, uint32_t left, vec3 *normal, uint32_t *on);

#endif
