/* Flips of single cells that bring lost points back and make the surface a manifold.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_REPAIR_H
#define WHITTLE_CORE_SURFACE_COCONE_REPAIR_H

#include "core/surface/cocone/cut.h"

/* Flips labels (inside, see cocone_cut_label) of finite cells as long as that takes defects away; among equals the flip
 * that costs least.  *flips counts the cells.  O(cells) and then a few microseconds for each defect.
 * STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cocone_repair(const struct cocone_star *star, const struct cocone_cost *cost,
                          const struct progress *progress, unsigned threads, uint8_t *inside, size_t *flips) MUST_CHECK;

/* Repairs of single places, to see what would come of a change. */
struct cocone_repair;

enum { COCONE_REPAIR_TRIAL_CELLS = 64 };

/* What a change of some cells leads to. */
struct cocone_repair_trial {
    uint32_t cell[COCONE_REPAIR_TRIAL_CELLS]; /* to be flipped, all of them */
    size_t count;                             /* 0: it takes more than there is room for */
    int defects;                              /* how many more there are then, at all vertices of the cells */
    int lost;                                 /* how many more of them are lost */
    int euler;                                /* how much larger V - E + F is then; a shell is 2, a handle -2 */
    int64_t cost;                             /* what that adds to the cost of the labelling */
};

/* Borrows all, inside as well, which it changes.  *repair is the caller's, to be given to cocone_repair_free.
 * STATUS_NO_MEMORY. */
enum status cocone_repair_new(const struct cocone_star *star, const struct cocone_cost *cost, uint8_t *inside,
                              struct cocone_repair **repair) MUST_CHECK;

/* Accepts NULL. */
void cocone_repair_free(struct cocone_repair *repair);

/* Whether there is time for more trials: all of them together may take about as long as a reconstruction. */
bool cocone_repair_may_try(const struct cocone_repair *repair);

/* Flips the seeds (at least one, finite, all of one label), which are held from then on, and mends what gets defects by
 * that: by flipping cells of that label as far as possible, then others too.  Tells what came out, and puts everything
 * back.  Microseconds in easy cases, a millisecond at most. */
void cocone_repair_try(struct cocone_repair *repair, const uint32_t *seed, size_t count,
                       struct cocone_repair_trial *trial);

/* To be told when somebody else has flipped a trial's cells. */
void cocone_repair_forget(struct cocone_repair *repair, const struct cocone_repair_trial *trial);

#endif
