/* Medians and other quantiles of many numbers.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_QUANTILE_H
#define WHITTLE_CORE_MATH_QUANTILE_H

#include <stddef.h>

#include "core/base/status.h"

/* The element of rank floor(share (n - 1)) of n >= 1 finite values, 0 <= share <= 1; may reorder them.  O(n) on
 * average. */
float quantile_of(float *value, size_t n, double share);

/* Up to four of them. */
void quantiles_of(float *value, size_t n, const double *share, size_t shares, float *found);

/* The median of n >= 1 values, and the median absolute deviation from it.  Values are left as they are; of very many,
 * an even choice is looked at.  STATUS_NO_MEMORY. */
enum status quantile_spread(const float *value, size_t n, double *median, double *mad) MUST_CHECK;

#endif
