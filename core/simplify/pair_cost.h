/* What contracting pairs of points costs, E_p + E_q at either end (Lee, Jong section 4.4), some pairs at a time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_PAIR_COST_H
#define WHITTLE_CORE_SIMPLIFY_PAIR_COST_H

#include <stdbool.h>

#include "core/base/prefetch.h"
#include "core/simplify/quadric.h"

enum { PAIR_COST_ROOM = 3 };

/* Points with their quadrics, each about its own point. */
struct pair_field {
    const vec3 *point;
    const struct packed_quadric *quadric;
    bool untouched;     /* b and c of all quadrics are 0: what they are a part of is left out */
    double length_bias; /* of the cost: this x squared length, so that flat regions contract their short edges first */
};

/* Prefetches what costs of a point's pairs are worked out from, which is worth it where that is some hundred pairs
 * later. */
static inline void pair_fetch(const struct pair_field *field, uint32_t p) {
    const struct packed_quadric *at = &field->quadric[p];
    prefetch(at->a);
    prefetch(&at->weight);
    prefetch(&field->point[p]);
}

/* cost[i] of contracting p[i] and q[i], of n pairs: E_p + E_q at the end where it is less, and the length's part.  All
 * three arrays have PAIR_COST_ROOM more entries than n, which are written. */
void pair_costs(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, float *cost);

/* E_p + E_q of contracting them with p[i] staying, and with q[i] staying; room as above. */
void pair_errors(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, double *p_stays, double *q_stays);

#endif
