/* How evenly rays from a place to points follow each other, of several at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_RAYS_H
#define WHITTLE_CORE_SURFACE_SHEET_RAYS_H

#include <stddef.h>
#include <stdint.h>

#include "core/math/sym3.h"

enum { RAYS_ROOM = 4 /* arrays of results have room for a multiple of this */ };

struct step {
    vec3 from, to;
};

/* square[i] = squared sine of the angle between the rays from a place to both ends of a step; 0 or no number where they
 * have no length. */
void rays_sines(const struct step *step, size_t n, vec3 place, float *square);

/* square[i] = that of the second difference of the directions to three points, by half of what the outer ones are
 * apart. */
void rays_turned(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double *square);

/* What a triple adds to the equations of least squares of these, x / (x + limit_sq) of each square: the derivative's
 * rows times each other, and times the difference. */
struct rays_terms {
    sym3 row[3];
    vec3 gradient;
};
void rays_equations(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double limit_sq,
                    struct rays_terms *terms);

/* Of RAYS_TOGETHER points and those near each, RAYS_NEAR in all and itself first: which of the nearest ones, as seen
 * from a place, has another one the most exactly opposite, and that; both are 0 where there are none.  at: the x of
 * each point itself, then of each one's first neighbour, and so on; then the y, then the z. */
enum { RAYS_NEAR = 24, RAYS_TOGETHER = 8, RAYS_BLOCK = 3 * RAYS_NEAR * RAYS_TOGETHER };
void rays_between(const float at[RAYS_BLOCK], vec3 from, int32_t one[RAYS_TOGETHER], int32_t opposite[RAYS_TOGETHER]);

#endif
