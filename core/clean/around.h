/* What the neighbours of a point weigh, several at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_AROUND_H
#define WHITTLE_CORE_CLEAN_AROUND_H

#include "core/math/sym3.h"
#include "core/math/vec3.h"

enum { AROUND_MOST = 64, AROUND_FEW = 4 };

/* Neighbours relative to the point, which may be one of them; what is beyond the n that there are means nothing. */
struct around {
    unsigned n;
    double x[AROUND_MOST], y[AROUND_MOST], z[AROUND_MOST];
    double normal_x[AROUND_MOST], normal_y[AROUND_MOST], normal_z[AROUND_MOST];
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

/* By their own normals, turned to the side of `normal`, the point's: weight[i] = near, less the more the two differ, a
 * fourth of it where the square of that is angle_sq; turned[i] = the same, negative where the neighbour's was turned;
 * height[i] = the neighbour from half-way between their two planes. */
struct around_looks {
    double weight[AROUND_MOST], turned[AROUND_MOST], height[AROUND_MOST];
};
void around_look(const struct around *around, vec3 normal, double angle_sq, struct around_looks *looks);

#endif
