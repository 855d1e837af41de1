/* Point sets with known answers, for tests.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_SHAPES_H
#define WHITTLE_TESTS_SHAPES_H

#include <stddef.h>
#include <stdint.h>

#include "core/math/vec3.h"

/* A small generator (splitmix64), so that tests see the same numbers everywhere. */
uint64_t random_next(uint64_t *state);
double random_unit(uint64_t *state); /* 0 <= x < 1 */

/* n points spread evenly over the unit sphere (golden spiral); returns new memory. */
vec3 *shape_sphere(size_t n, double radius);

/* side x side points of the grid z = f(x, y), x and y in 0 .. 1; returns new memory. */
vec3 *shape_height_field(size_t side, double (*f)(double x, double y));

/* Heights for it. */
double height_plane(double x, double y);
double height_saddle(double x, double y); /* principal curvatures +1 and -1 at (0.5, 0.5) */

/* A unit cylinder about z: around x along points, spacing equal in both directions; returns new memory. */
vec3 *shape_cylinder(size_t around, size_t along);

/* The points of a grid of side^3 that are on the faces of the cube, which has nearly length 1; moved by up to `shift`
 * of a step along the axes that leave them there.  Returns new memory, with *n points. */
vec3 *shape_cube(size_t side, double shift, size_t *n);

#endif
