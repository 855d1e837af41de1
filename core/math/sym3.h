/* Symmetric 3 x 3 matrices, by value: covariances and the quadratic part of quadrics.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_SYM3_H
#define WHITTLE_CORE_MATH_SYM3_H

#include "core/math/vec3.h"

typedef struct sym3 {
    double xx, xy, xz, yy, yz, zz;
} sym3;

static inline sym3 sym3_add(sym3 a, sym3 b) {
    return (sym3){a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz};
}
static inline sym3 sym3_scale(sym3 a, double s) {
    return (sym3){a.xx * s, a.xy * s, a.xz * s, a.yy * s, a.yz * s, a.zz * s};
}
/* v v^T */
static inline sym3 sym3_outer(vec3 v) {
    return (sym3){v.x * v.x, v.x * v.y, v.x * v.z, v.y * v.y, v.y * v.z, v.z * v.z};
}
static inline vec3 sym3_mul(sym3 a, vec3 v) {
    return (vec3){a.xx * v.x + a.xy * v.y + a.xz * v.z, a.xy * v.x + a.yy * v.y + a.yz * v.z,
                  a.xz * v.x + a.yz * v.y + a.zz * v.z};
}
static inline double sym3_trace(sym3 a) { return a.xx + a.yy + a.zz; }

/* Eigenvalues in ascending order and unit eigenvectors, right-handed, by cyclic Jacobi rotations: exact to rounding
 * also where eigenvalues coincide.  value and vector hold 3 each. */
void sym3_eigen(sym3 a, double value[3], vec3 vector[3]);

/* The smallest eigenvalues alone, and their eigenvectors, of n matrices without negative ones, SYM3_FEW at most;
 * several times as fast where that eigenvalue stands apart from the others, the same where it doesn't.  Each one's
 * don't depend on its company. */
enum { SYM3_FEW = 4 };
void sym3_least(const sym3 *m, unsigned n, double *value, vec3 *vector);

#endif
