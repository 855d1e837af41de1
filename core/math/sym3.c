/* Cyclic Jacobi: each rotation zeroes one off-diagonal element; five to six sweeps reach rounding.
 *
 * Golub, Van Loan: Matrix Computations, section 8.5.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/math/sym3.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "core/math/simd.h"

enum { MAX_SWEEPS = 12 };
static const double APART = 1e-3; /* (middle - least) (largest - least), of the trace squared */

/* Rotates in the plane (p, q) of the symmetric matrix a so that a[p][q] becomes 0, and v's columns with it. */
static void rotate(double a[3][3], double v[3][3], int p, int q) {
    if (a[p][q] == 0) return;
    double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
    double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
    double c = 1 / sqrt(t * t + 1), s = t * c;
    int r = 3 - p - q;
    double apr = a[p][r], aqr = a[q][r], apq = a[p][q];
    a[p][p] -= t * apq;
    a[q][q] += t * apq;
    a[p][q] = a[q][p] = 0;
    a[p][r] = a[r][p] = c * apr - s * aqr;
    a[q][r] = a[r][q] = s * apr + c * aqr;
    for (int i = 0; i < 3; i++) {
        double vp = v[i][p], vq = v[i][q];
        v[i][p] = c * vp - s * vq;
        v[i][q] = s * vp + c * vq;
    }
}

static void order_ascending(const double value[3], int order[3]) {
    order[0] = 0, order[1] = 1, order[2] = 2;
    for (int i = 1; i < 3; i++)
        for (int j = i; j > 0 && value[order[j]] < value[order[j - 1]]; j--) {
            int swap = order[j];
            order[j] = order[j - 1];
            order[j - 1] = swap;
        }
}

FOR_EACH_PROCESSOR(void, sym3_eigen)
(sym3 m, double value[3], vec3 vector[3]) {
    double a[3][3] = {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}};
    double v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    double scale = fabs(m.xx) + fabs(m.yy) + fabs(m.zz);
    for (int sweep = 0; sweep < MAX_SWEEPS; sweep++) {
        if (fabs(a[0][1]) + fabs(a[0][2]) + fabs(a[1][2]) <= 1e-18 * scale) break;
        rotate(a, v, 0, 1);
        rotate(a, v, 0, 2);
        rotate(a, v, 1, 2);
    }
    double diagonal[3] = {a[0][0], a[1][1], a[2][2]};
    int order[3];
    order_ascending(diagonal, order);
    for (int i = 0; i < 3; i++) {
        value[i] = diagonal[order[i]];
        vector[i] = (vec3){v[0][order[i]], v[1][order[i]], v[2][order[i]]};
    }
    vector[2] = vec3_cross(vector[0], vector[1]);
}

enum { MAX_STEPS = 16 };

/* The smallest roots of some x^3 - x^2 + minors x - determinant, all of whose roots are in 0 .. 1 and sum to 1:
 * Newton's steps from 0 on never pass them, for the polynomials are concave there.  Not found where it is near a double
 * root. */
INLINE f64v least_roots(f64v minors, f64v determinant, i64v *found) {
    f64v x = f64_all(0);
    i64v open = i64_all(-1);
    *found = i64_all(0);
    for (int step = 0; step < MAX_STEPS && i64_any(open); step++) {
        f64v f = ((x - 1) * x + minors) * x - determinant, slope = (3 * x - 2) * x + minors;
        f64v next = x - f / slope;
        open &= f64_is_positive(slope);
        i64v arrived = open & f64_at_least(f64_all(1e-16), f64_abs(next - x));
        x = f64_pick(open, next, x);
        *found |= arrived;
        open &= ~arrived;
    }
    return x;
}

/* Any two rows of m - value span the plane across the vector: the longest of their cross products is its direction. */
static int direction_across(sym3 m, double value, vec3 *direction) {
    vec3 x = {m.xx - value, m.xy, m.xz}, y = {m.xy, m.yy - value, m.yz}, z = {m.xz, m.yz, m.zz - value};
    vec3 across[3] = {vec3_cross(x, y), vec3_cross(y, z), vec3_cross(z, x)};
    int longest = 0;
    double length_sq[3];
    for (int i = 0; i < 3; i++) {
        length_sq[i] = vec3_length_sq(across[i]);
        if (length_sq[i] > length_sq[longest]) longest = i;
    }
    if (!(length_sq[longest] > APART * APART)) return 0;
    *direction = vec3_scale(across[longest], 1 / sqrt(length_sq[longest]));
    return 1;
}

static double minors_of(sym3 m) {
    return m.xx * m.yy - m.xy * m.xy + m.xx * m.zz - m.xz * m.xz + m.yy * m.zz - m.yz * m.yz;
}

static double determinant_of(sym3 m) {
    return m.xx * (m.yy * m.zz - m.yz * m.yz) - m.xy * (m.xy * m.zz - m.yz * m.xz) + m.xz * (m.xy * m.yz - m.yy * m.xz);
}

static void least_by_rotations(sym3 m, double *value, vec3 *vector) {
    double values[3];
    vec3 axis[3];
    sym3_eigen(m, values, axis);
    *value = values[0];
    *vector = axis[0];
}

FOR_EACH_PROCESSOR(void, sym3_least)
(const sym3 *m, unsigned n, double *value, vec3 *vector) {
    sym3 unit[SYM3_FEW];
    double trace[SYM3_FEW], minors[SYM3_FEW] = {0}, determinant[SYM3_FEW] = {0}, root[SYM3_FEW];
    int64_t found[SYM3_FEW];
    assert(n <= SYM3_FEW);
    for (unsigned i = 0; i < n; i++) {
        trace[i] = sym3_trace(m[i]);
        bool divides = trace[i] > 0 && isfinite(1 / trace[i]);
        unit[i] = sym3_scale(m[i], divides ? 1 / trace[i] : 0); /* no root is found of zeros */
        minors[i] = minors_of(unit[i]), determinant[i] = determinant_of(unit[i]);
    }
    for (unsigned i = 0; i < n; i += F64_LANES) {
        i64v mask;
        f64_store(&root[i], least_roots(f64_load(&minors[i]), f64_load(&determinant[i]), &mask));
        memcpy(&found[i], &mask, sizeof mask);
    }
    for (unsigned i = 0; i < n; i++) {
        value[i] = root[i] * trace[i];
        if (!found[i] || !direction_across(unit[i], root[i], &vector[i]))
            least_by_rotations(m[i], &value[i], &vector[i]);
    }
}
