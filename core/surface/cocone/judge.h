/* Which of two labellings is nearer to the original points, place by place.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_JUDGE_H
#define WHITTLE_CORE_SURFACE_COCONE_JUDGE_H

#include "core/surface/cocone/star.h"
#include "core/surface/reconstruct.h"

/* Another labelling (see cocone_cut_label), and how to look at it. */
struct cocone_proposal {
    const uint8_t *inside;
    const uint32_t *group; /* of each finite cell, for those that differ: which of the changes it belongs to, < groups;
                              NULL = each connected group of cells with different labels is a change by itself */
    uint32_t groups;
    double patience; /* a change is the better one that is less than this many times as far from the points */
    double matters;  /* and that is nearer by this part of the size of the facets that differ */
};

/* Compares inside with the proposal where they differ; each change is decided by itself.  Where the proposal is the
 * better one of the two inside takes its labels; *taken counts the cells.  Infinite cells have to be outside in both.
 * O(cells), and a few microseconds for each original point that is near a difference.  STATUS_NO_MEMORY. */
enum status cocone_judge(const struct cocone_star *star, const struct reconstruct_dense *dense, unsigned threads,
                         const struct cocone_proposal *proposal, uint8_t *inside, size_t *taken) MUST_CHECK;

#endif
