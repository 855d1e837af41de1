/* Which points are joined by virtual edges while points are contracted: lists in one pool.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_ADJACENCY_H
#define WHITTLE_CORE_ADJACENCY_H

#include "core/neighbourhood.h"

enum { ADJACENCY_MAX = 24 }; /* nearest neighbours that a merged point keeps */

/* One end's view of a virtual edge. */
struct link {
    uint32_t id; /* the other end */
    float cost;  /* of contracting the edge; NAN = not known (any more) */
};

/* Links of p: list[start[p]] .. list[start[p] + degree[p] - 1], ascending ids, no p. */
struct adjacency {
    size_t n;
    size_t *start;     /* n; owned */
    uint8_t *degree;   /* n; owned */
    struct link *list; /* capacity; owned */
    size_t used, capacity;
};

/* The symmetric closure of the neighbourhoods: q is joined to p where either has the other; at most 255 for a point,
 * and the first ones where there are more; all
 * costs unknown.  O(n k).  STATUS_NO_MEMORY. */
enum status adjacency_from(const struct neighbourhood *neighbourhood, struct adjacency *out) MUST_CHECK;

/* Makes room at the end of the pool for `entries` more, by moving the lists of the live points together or by growing
 * it.  STATUS_NO_MEMORY. */
enum status adjacency_reserve(struct adjacency *adjacency, const uint32_t *live, size_t live_count,
                              size_t entries) MUST_CHECK;

/* Accepts a zeroed adjacency. */
void adjacency_done(struct adjacency *adjacency);

#endif
