/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/shapes.h"

#include <stdbool.h>
#include <stdlib.h>

uint64_t random_next(uint64_t *state) {
    uint64_t z = *state += 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    return z ^ z >> 31;
}

double random_unit(uint64_t *state) { return (double)(random_next(state) >> 11) * 0x1p-53; }

vec3 *shape_sphere(size_t n, double radius) {
    vec3 *point = malloc(n * sizeof *point);
    double turn = M_PI * (3 - sqrt(5));
    for (size_t i = 0; point && i < n; i++) {
        double z = 1 - (2 * (double)i + 1) / (double)n, r = sqrt(1 - z * z), angle = turn * (double)i;
        point[i] = vec3_scale((vec3){r * cos(angle), r * sin(angle), z}, radius);
    }
    return point;
}

vec3 *shape_height_field(size_t side, double (*f)(double x, double y)) {
    vec3 *point = malloc(side * side * sizeof *point);
    for (size_t i = 0; point && i < side * side; i++) {
        double x = (double)(i % side) / (double)(side - 1), y = (double)(i / side) / (double)(side - 1);
        point[i] = (vec3){x, y, f(x, y)};
    }
    return point;
}

double height_plane(double x, double y) { return 0.3 * x - 0.2 * y; }

double height_saddle(double x, double y) { return 0.5 * ((x - 0.5) * (x - 0.5) - (y - 0.5) * (y - 0.5)); }

vec3 *shape_cylinder(size_t around, size_t along) {
    vec3 *point = malloc(around * along * sizeof *point);
    double step = 2 * M_PI / (double)around;
    for (size_t i = 0; point && i < around * along; i++) {
        double angle = step * (double)(i % around);
        point[i] = (vec3){cos(angle), sin(angle), step * (double)(i / around)};
    }
    return point;
}

vec3 *shape_cube(size_t side, double shift, size_t *n) {
    vec3 *point = malloc(6 * side * side * sizeof *point);
    uint64_t random = 5;
    *n = 0;
    for (size_t i = 0; point && i < side * side * side; i++) {
        size_t at[3] = {i % side, i / side % side, i / side / side};
        double place[3];
        int ends = 0;
        for (int k = 0; k < 3; k++) {
            bool is_end = at[k] == 0 || at[k] == side - 1;
            place[k] = (double)at[k] + (is_end ? 0 : shift * (2 * random_unit(&random) - 1));
            ends += is_end;
        }
        double length = (double)side;
        if (ends) point[(*n)++] = (vec3){place[0] / length, place[1] / length, place[2] / length};
    }
    return point;
}
