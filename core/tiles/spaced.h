/* Kept points that lie no nearer to each other than a spacing, of a cloud that doesn't fit into memory: a point is kept
 * unless a more important one that is kept is too near, as core/simplify/spacing.h does it in memory.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_SPACED_H
#define WHITTLE_CORE_TILES_SPACED_H

#include "core/tiles/ranks.h"

struct spaced {
    size_t count, left;    /* points that are kept: the first of them are of those that were left */
    uint32_t *place, *id;  /* of these their places in the ranking; of the others their numbers in the input; owned */
    size_t first_not_kept; /* of those that were left, in the ranking */
    bool is_all;           /* no other point has room between these */
};

/* position: of the ranks->left_count points that are left, in the order of their importance, borrowed.  At most `most`
 * points are kept, and once all that are left have been looked at, no more than `enough` of the others are needed to
 * make so many; where SIZE_MAX are enough and there are more than most, STATUS_NO_MEMORY.  room: how many points that
 * have gone memory may hold at a time; the result doesn't depend on it.  STATUS_IO, STATUS_CANCELLED. */
enum status spaced_keep(const struct ranks *ranks, const vec3 *position, size_t enough, size_t most, size_t room,
                        unsigned threads, struct spaced *spaced) MUST_CHECK;

/* Accepts a zeroed one. */
void spaced_done(struct spaced *spaced);

#endif
