/* Vectors of four doubles, as the compilers' extension has them, and functions that are compiled for each processor.
 *
 * Processors with such vectors get functions of their own; on others the compiler makes two vectors of two.  Both do
 * the same operations in the same order (and none is fused), so the results are the same.  A file that includes this is
 * compiled with -Wno-psabi (Makefile): its vectors are passed between functions that are inlined.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_LANES_H
#define WHITTLE_CORE_LANES_H

#include <math.h>
#include <stdint.h>

#include "core/processor.h"

enum { LANES = 4 };
typedef double lanes __attribute__((vector_size(32)));
typedef int64_t lanes_mask __attribute__((vector_size(32)));
typedef double lanes_half __attribute__((vector_size(16)));
typedef int64_t lanes_half_mask __attribute__((vector_size(16)));
typedef double lanes_loose __attribute__((vector_size(32), aligned(8), may_alias)); /* in memory */

INLINE lanes lanes_all(double x) { return (lanes){x, x, x, x}; }
INLINE lanes lanes_load(const double *p) { return *(const lanes_loose *)p; }
INLINE void lanes_store(double *p, lanes x) { *(lanes_loose *)p = x; }
INLINE lanes lanes_where(lanes_mask m, lanes x) { return (lanes)(m & (lanes_mask)x); }
INLINE lanes lanes_pick(lanes_mask m, lanes a, lanes b) { return (lanes)((m & (lanes_mask)a) | (~m & (lanes_mask)b)); }
INLINE lanes lanes_positive(lanes x) { return lanes_where(x > 0, x); }
INLINE lanes lanes_lower(lanes a, lanes b) { return lanes_pick(a < b, a, b); }
INLINE lanes lanes_magnitude(lanes x) { return (lanes)((lanes_mask)x & INT64_MAX); }
INLINE lanes lanes_root(lanes x) { return (lanes){sqrt(x[0]), sqrt(x[1]), sqrt(x[2]), sqrt(x[3])}; }

#endif
