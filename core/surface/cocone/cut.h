/* In or out, for every cell at once: the cut that agrees best with the oriented points.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_CUT_H
#define WHITTLE_CORE_SURFACE_COCONE_CUT_H

#include "core/base/progress.h"
#include "core/surface/cocone/creases.h"
#include "core/surface/cocone/orient.h"

/* Costs are whole numbers of parts: so many are the vote of a cell that is certain to a point. */
enum { COCONE_CUT_UNIT = 256 };

/* What a labelling costs.  The cost of a labelling is the sum of |vote| over the cells that are
 * labelled against their vote and of the prices of the facets between an inner and an outer cell.  A cut changes them,
 * but not by how much one labelling is dearer than another. */
struct cocone_cost {
    int32_t (*price)[4]; /* cell_count: of each half facet, for its cell outside and the other one inside; owned */
    int32_t *vote;       /* cell_count: > 0 out, < 0 in; owned */
};

/* What votes and prices come from.  All borrowed. */
struct cocone_voters {
    const struct cocone_star *star;
    const double *support;            /* n or NULL, see struct reconstruct_input */
    const struct cocone_frame *frame; /* with oriented normals */
    const struct cocone_lies *lies;
    const struct creases *creases; /* of the points */
};

/* Whether all three edges of the facet are as short as the support radii of their ends allow: |ab| <= 1.2 (rho_a +
 * rho_b).  True where support is NULL. */
bool cocone_cut_supported(const vec3 *point, const double *support, const uint32_t facet[3]);

/* The costs with each of count frames and lies of the voters.  O(cells).  STATUS_NO_MEMORY, and then whoever calls
 * gives what is there to cocone_cost_done. */
enum status cocone_cut_costs(const struct cocone_voters *voters, int count, unsigned threads,
                             struct cocone_cost cost[]) MUST_CHECK;

/* Accepts zeroed costs. */
void cocone_cost_done(struct cocone_cost *cost);

/* A cut by the costs of the voters' first frame; borrows both.  STATUS_NO_MEMORY. */
struct cocone_cut;
enum status cocone_cut_new(const struct cocone_voters *voters, struct cocone_cost *cost,
                           struct cocone_cut **cut) MUST_CHECK;

/* Accepts NULL. */
void cocone_cut_free(struct cocone_cut *cut);

/* inside[c] = 1 for the cells inside; infinite cells are outside always.  STATUS_CANCELLED. */
enum status cocone_cut_label(struct cocone_cut *cut, const struct progress *progress, uint8_t *inside) MUST_CHECK;

/* Takes the votes of count vertices (listed without repeats) out of the costs, by = -1, or puts them in as the frame
 * and the lies are now, by = 1: what there is to do before and after they are turned.  Time for what changes alone, and
 * so for cocone_cut_label after it. */
void cocone_cut_change(struct cocone_cut *cut, const uint32_t *vertex, size_t count, int by);

#endif
