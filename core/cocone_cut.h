/* In or out, for every cell at once: the cut that agrees best with the oriented points.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_CUT_H
#define WHITTLE_CORE_COCONE_CUT_H

#include "core/cocone_orient.h"
#include "core/progress.h"

/* Costs are whole numbers of parts: so many are the vote of a cell that is certain to a point. */
enum { COCONE_CUT_UNIT = 256 };

/* What a labelling costs.  The cost of a labelling is the sum of |vote| over the cells that are
 * labelled against their vote and of the prices of the facets between an inner and an outer cell. */
struct cocone_cost {
    int32_t (*price)[4]; /* cell_count: of each half facet, for its cell outside and the other one inside; owned */
    int32_t *vote;       /* cell_count: > 0 out, < 0 in; owned */
};

/* Whether all three edges of the facet are as short as the support radii of their ends allow: |ab| <= 1.2 (rho_a +
 * rho_b).  True where support is NULL. */
bool cocone_cut_supported(const vec3 *point, const double *support, const uint32_t facet[3]);

/* The costs, for a frame with oriented normals.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_cut_costs(const struct cocone_star *star, const struct cocone_frame *frame,
                             const struct cocone_lies *lies, const double *support, unsigned threads,
                             struct cocone_cost *cost) MUST_CHECK;

/* inside[c] = 1 for the cells inside; infinite cells are outside always.  STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cocone_cut_label(const struct cocone_star *star, const struct cocone_cost *cost,
                             const struct progress *progress, uint8_t *inside) MUST_CHECK;

/* Accepts zeroed costs. */
void cocone_cut_done(struct cocone_cost *cost);

#endif
