/* Sorting of a few ids.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_RANK_SORT_H
#define WHITTLE_CORE_SIMPLIFY_RANK_SORT_H

#include <stdint.h>

/* Puts n ids (below 2^31, or NONE) in ascending order, without those that are there already and without NONE; returns
 * how many are left.  O(n^2), for lists of up to some sixty. */
unsigned rank_sort_ids(uint32_t *id, unsigned n);

#endif
