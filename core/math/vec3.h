/* Vectors in space, by value.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_VEC3_H
#define WHITTLE_CORE_MATH_VEC3_H

#include <math.h>
#include <stdbool.h>

typedef struct vec3 {
    double x, y, z;
} vec3;

static inline vec3 vec3_add(vec3 a, vec3 b) { return (vec3){a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline vec3 vec3_sub(vec3 a, vec3 b) { return (vec3){a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline vec3 vec3_scale(vec3 a, double s) { return (vec3){a.x * s, a.y * s, a.z * s}; }
/* Of numbers alone: fmin and fmax, which know what to do with a NaN, are calls. */
static inline vec3 vec3_min(vec3 a, vec3 b) {
    return (vec3){a.x < b.x ? a.x : b.x, a.y < b.y ? a.y : b.y, a.z < b.z ? a.z : b.z};
}
static inline vec3 vec3_max(vec3 a, vec3 b) {
    return (vec3){a.x > b.x ? a.x : b.x, a.y > b.y ? a.y : b.y, a.z > b.z ? a.z : b.z};
}
static inline double vec3_dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
static inline vec3 vec3_cross(vec3 a, vec3 b) {
    return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline double vec3_length_sq(vec3 a) { return vec3_dot(a, a); }
static inline double vec3_length(vec3 a) { return sqrt(vec3_dot(a, a)); }
static inline double vec3_distance_sq(vec3 a, vec3 b) { return vec3_length_sq(vec3_sub(a, b)); }
static inline double vec3_distance(vec3 a, vec3 b) { return vec3_length(vec3_sub(a, b)); }
static inline vec3 vec3_lerp(vec3 a, vec3 b, double t) { return vec3_add(a, vec3_scale(vec3_sub(b, a), t)); }

/* a / |a|; the zero vector stays the zero vector. */
static inline vec3 vec3_unit(vec3 a) {
    double length = vec3_length(a);
    return length > 0 ? vec3_scale(a, 1 / length) : a;
}

/* Twice the area vector of the triangle abc: normal by the right-hand rule, length 2 x area. */
static inline vec3 vec3_triangle_normal(vec3 a, vec3 b, vec3 c) { return vec3_cross(vec3_sub(b, a), vec3_sub(c, a)); }

static inline bool vec3_is_finite(vec3 a) { return isfinite(a.x) && isfinite(a.y) && isfinite(a.z); }
static inline bool vec3_equal(vec3 a, vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

/* Two unit vectors that span the plane normal to the unit vector n, right-handed: u x v = n. */
static inline void vec3_basis(vec3 n, vec3 *u, vec3 *v) {
    vec3 axis = fabs(n.x) <= fabs(n.y) && fabs(n.x) <= fabs(n.z) ? (vec3){1, 0, 0}
                : fabs(n.y) <= fabs(n.z)                         ? (vec3){0, 1, 0}
                                                                 : (vec3){0, 0, 1};
    *u = vec3_unit(vec3_cross(axis, n));
    *v = vec3_cross(n, *u);
}

#endif
