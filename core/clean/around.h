/* What the neighbours of a point weigh, several at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_AROUND_H
#define WHITTLE_CORE_CLEAN_AROUND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/math/sym3.h"
#include "core/math/vec3.h"

enum { AROUND_MOST = 64, AROUND_FEW = 4 };

/* Neighbours relative to the point, which may be one of them; what is beyond the n that there are means nothing. */
struct around {
    unsigned n;
    double x[AROUND_MOST], y[AROUND_MOST], z[AROUND_MOST];
    double near[AROUND_MOST]; /* weights: 1 at the point, 0 at the rim */
};

/* Sets `near`; rim_sq: the squared distance where weights end. */
void around_weigh(struct around *around, double rim_sq);

/* weight[i] = near, less the more a neighbour is over the plane through `mean`: a fourth of it where that squared is
 * scale_sq. */
void around_plane(const struct around *around, vec3 mean, vec3 normal, double scale_sq, double weight[AROUND_MOST]);

/* The same by how far neighbours are along the normal from so much off the point. */
void around_level(const struct around *around, vec3 normal, double height, double scale_sq, double weight[AROUND_MOST]);

/* Sums over the neighbours of each of n <= AROUND_FEW points, in their order, times weights. */
struct around_sums {
    double total; /* of the weights */
    vec3 sum;
    sym3 moment;
};
void around_sum_up(const struct around *around, const double *const *weight, unsigned n, struct around_sums *sums);

/* A point of many and its n >= 1 neighbours. */
struct around_place {
    const vec3 *point, *normal; /* of all; normal isn't read by around_gather */
    const uint32_t *near;       /* n */
    unsigned n;
    size_t p;
    double rim_sq;   /* the squared distance where weights end */
    double angle_sq; /* between normals: weights are a fourth where the square of their difference is that */
};

/* Its neighbours, and the point itself as the last of them where `itself`, with `near` set. */
void around_gather(const struct around_place *place, bool itself, struct around *around);

/* The sum of the neighbours' normals, turned to the side of the point's own, times weights. */
vec3 around_turned(const struct around_place *place);

/* Sums of the weights, and of these times the heights of the neighbours from half-way between their two planes and
 * times their squares; weights are a fourth where the square of the height is height_sq, which may be INFINITY. */
struct around_heights {
    double total, sum, sum_sq;
};
struct around_heights around_heights(const struct around_place *place, double height_sq);

#endif
