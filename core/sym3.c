/* Cyclic Jacobi: each rotation zeroes one off-diagonal element; five to six sweeps reach rounding.
 *
 * Golub, Van Loan: Matrix Computations, section 8.5.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/sym3.h"

enum { MAX_SWEEPS = 12 };

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

void sym3_eigen(sym3 m, double value[3], vec3 vector[3]) {
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
