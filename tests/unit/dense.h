/* Dense points that a mesh is fitted to, for tests.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_DENSE_H
#define WHITTLE_TESTS_DENSE_H

#include "core/refine/refine.h"

struct dense {
    size_t n;
    vec3 *point, *normal;
    float *spacing;
};

/* n points, all zero. */
struct dense dense_new(size_t n);
void dense_done(struct dense *dense);

/* The height field z = f over the unit square, side x side points. */
struct dense dense_field(size_t side, double (*f)(double x, double y));
double dense_flat(double x, double y);

/* Borrows the points; no neighbourhood. */
struct refine_input dense_input(const struct dense *dense);
struct neighbourhood dense_neighbourhood(const struct dense *dense);

#endif
