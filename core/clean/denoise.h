/* Noise taken off points, along their normals.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_DENOISE_H
#define WHITTLE_CORE_CLEAN_DENOISE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

struct denoise_result {
    vec3 *point;    /* n: where each point moves to; owned */
    uint8_t *stray; /* n: 1 = no surface is near enough to move it to, and it stayed; at most half of
                       them; owned */
    size_t stray_count;
    double noise; /* standard deviation of the points from the surface, as estimated; in units of the points */
};

/* What is known of the points, so that it isn't looked for. */
enum { DENOISE_NEAR = 15 };
struct denoise_known {
    const uint32_t *near; /* n rows of DENOISE_NEAR: the nearest others of each point, nearest first, of points that
                             are equally far the lower index; NULL = not known; borrowed */
    bool is_shell;        /* they are a thick shell (core/clean/shell.h); false = not known */
};

/* Moves n distinct points to the surface that they seem to have been measured from, each along its normal alone; edges
 * stay.  Points without noise hardly move, fewer than DENOISE_MIN_POINTS not at all.  The points should be free of
 * outliers, and in an order that keeps near ones near.  The same for any number of threads.  O(n k), k at most 63,
 * and O(n log n) for the neighbours.  On success *result is the caller's, for denoise_done.
 * STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status denoise_smooth(const vec3 *point, size_t n, const struct denoise_known *known, unsigned threads,
                           struct denoise_result *result) MUST_CHECK;

enum { DENOISE_MIN_POINTS = 32 };

/* Accepts NULL and a zeroed result. */
void denoise_done(struct denoise_result *result);

#endif
