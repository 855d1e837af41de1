/* Numbers of some ranks among few.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_FEW_H
#define WHITTLE_CORE_MATH_FEW_H

#include <stddef.h>

enum { FEW_MOST = 32 };

/* found[i] = the one that rank[i] of n finite values come before in their order, 1 <= n <= FEW_MOST, rank[i] < n. */
void few_of_ranks(const float *value, size_t n, const size_t *rank, size_t ranks, float *found);

#endif
