/* Sums and products of doubles without an error: a number, and what rounding has taken off it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_EXACT_H
#define WHITTLE_CORE_MATH_EXACT_H

#include <math.h>

/* a + b = *sum + *rest, exactly. */
static inline void exact_sum(double a, double b, double *sum, double *rest) {
    double s = a + b, virtual = s - a;
    *rest = (a - (s - virtual)) + (b - virtual);
    *sum = s;
}

/* a * b = *product + *rest, exactly. */
static inline void exact_product(double a, double b, double *product, double *rest) {
    *product = a * b;
    *rest = fma(a, b, -*product);
}

/* sqrt(a^2 + b^2), rounded to the nearest (but where it is almost a tie); of any finite a and b, since what is scaled
 * by a power of two doesn't overflow.  The same on all processors, unlike hypot of the C library, whose last bit
 * differs. */
static inline double exact_hypotenuse(double a, double b) {
    int exponent;
    double largest = fmax(fabs(a), fabs(b)), aa, bb, sum, rest_a, rest_b, rest, square, off;
    if (!(largest > 0)) return largest;
    frexp(largest, &exponent);
    a = ldexp(a, -exponent), b = ldexp(b, -exponent);
    exact_product(a, a, &aa, &rest_a);
    exact_product(b, b, &bb, &rest_b);
    exact_sum(aa, bb, &sum, &rest);
    double root = sqrt(sum);
    exact_product(root, root, &square, &off);
    return ldexp(root + ((sum - square) - off + (rest + rest_a + rest_b)) / (2 * root), exponent);
}

#endif
