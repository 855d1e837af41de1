/* Vectors of eight floats, as the compilers' extension has them.
 *
 * Processors with such vectors get functions of their own (processor.h); on others the compiler makes two vectors of
 * four of each.  Both do the same operations in the same order (and none is fused), so the results are the same.  A
 * file that includes this is compiled with -Wno-psabi (Makefile): its vectors are passed between functions that are
 * inlined.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_LANES8_H
#define WHITTLE_CORE_LANES8_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "core/processor.h"

enum { LANES = 8 };
typedef float lanes __attribute__((vector_size(32)));
typedef int32_t mask __attribute__((vector_size(32)));

INLINE lanes pick(mask m, lanes a, lanes b) { return (lanes)((m & (mask)a) | (~m & (mask)b)); }
INLINE lanes where(mask m, lanes a) { return (lanes)(m & (mask)a); }
INLINE lanes magnitude(lanes a) { return (lanes)((mask)a & INT32_MAX); }
INLINE lanes all(float x) { return (lanes){x, x, x, x, x, x, x, x}; }

/* Loops, which GCC knows to be one instruction as long as it doesn't unroll them. */
INLINE lanes lower(lanes a, lanes b) {
#pragma GCC unroll 1
    for (int k = 0; k < LANES; k++) a[k] = a[k] < b[k] ? a[k] : b[k];
    return a;
}

INLINE lanes higher(lanes a, lanes b) {
#pragma GCC unroll 1
    for (int k = 0; k < LANES; k++) a[k] = a[k] > b[k] ? a[k] : b[k];
    return a;
}

INLINE lanes positive(lanes a) {
#pragma GCC unroll 1
    for (int k = 0; k < LANES; k++) a[k] = a[k] > 0 ? a[k] : 0;
    return a;
}

INLINE lanes load(const float *p) {
    lanes x;
    memcpy(&x, p, sizeof x);
    return x;
}

/* x[which[0]], x[which[1]], ...; all of which in 0 .. 7. */
INLINE lanes shuffled(lanes x, mask which) {
#ifdef __clang__ /* which has no such builtin */
    lanes y = x;
    for (int k = 0; k < LANES; k++) y[k] = x[which[k]];
    return y;
#else
    return __builtin_shuffle(x, which);
#endif
}

/* Eight floats in memory, to be written. */
typedef float loose __attribute__((vector_size(32), aligned(4), may_alias));
INLINE loose *at(float *p) { return (loose *)p; }

INLINE lanes root(lanes x) {
    return (lanes){sqrtf(x[0]), sqrtf(x[1]), sqrtf(x[2]), sqrtf(x[3]),
                   sqrtf(x[4]), sqrtf(x[5]), sqrtf(x[6]), sqrtf(x[7])};
}

INLINE double total(lanes x) {
    double low = ((double)x[0] + (double)x[1]) + ((double)x[2] + (double)x[3]);
    double high = ((double)x[4] + (double)x[5]) + ((double)x[6] + (double)x[7]);
    return low + high;
}

#endif
