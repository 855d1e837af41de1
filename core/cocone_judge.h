/* Which of two labellings is nearer to the original points, place by place.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_JUDGE_H
#define WHITTLE_CORE_COCONE_JUDGE_H

#include "core/cocone.h"
#include "core/cocone_star.h"

/* Compares two labellings (see cocone_cut_label) where they differ: each connected group of cells with different
 * labels is decided by itself.  Where other is the better one of the two inside takes its labels; *taken counts the
 * cells.  Infinite cells have to be outside in both.  O(cells), and a few microseconds for each original point that is
 * near a difference.  STATUS_NO_MEMORY. */
enum status cocone_judge(const struct cocone_star *star, const struct cocone_dense *dense, unsigned threads,
                         const uint8_t *other, uint8_t *inside, size_t *taken) MUST_CHECK;

#endif
