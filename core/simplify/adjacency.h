/* Which points are joined by virtual edges (Lee, Jong section 4.4): lists in one pool.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_ADJACENCY_H
#define WHITTLE_CORE_SIMPLIFY_ADJACENCY_H

#include "core/spatial/neighbourhood.h"

/* Neighbours of p: list[start[p]] .. list[start[p] + degree[p] - 1], no p.  32 bits are enough for the
 * pool: clouds whose lists don't fit wouldn't fit into memory either. */
struct adjacency {
    size_t n;
    uint32_t *start; /* n; owned */
    uint8_t *degree; /* n; owned */
    uint32_t *list;  /* capacity; owned */
    size_t capacity; /* < 2^32 */
};

/* The symmetric closure of the neighbourhoods: q is joined to p where either has the other; at most 255 for a point,
 * its own neighbours, and after them those of the others with the lowest ids, ascending.  The same for any number of
 * threads.  O(n k).  STATUS_NO_MEMORY, also where there would be 2^32 entries or more. */
enum status adjacency_from(const struct neighbourhood *neighbourhood, unsigned threads,
                           struct adjacency *out) MUST_CHECK;

/* Accepts a zeroed adjacency. */
void adjacency_done(struct adjacency *adjacency);

#endif
