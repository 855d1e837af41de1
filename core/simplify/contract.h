/* The simplifier: contraction of virtual edges, in the order of their quadric error (Lee, Jong section 4.4, steps 2 to
 * 6; reference/contract.c is that by the letter).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_CONTRACT_H
#define WHITTLE_CORE_SIMPLIFY_CONTRACT_H

#include "core/base/progress.h"
#include "core/simplify/adjacency.h"
#include "core/simplify/contraction.h"
#include "core/simplify/quadric.h"

struct contract_options {
    unsigned threads; /* 0 = all processors */
    size_t least;     /* points from which on the ranking isn't asked for: 1 or 0 for the whole of it */
};

/* Contracts the near->n >= 1 points along the edges of near, which is taken, with placement at one of the two ends. The
 * quadrics are working memory and hold nothing of use afterwards.  The same result for any number of threads.  About
 * O(n k).  STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status contract(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                     const struct contract_options *options, const struct progress *progress,
                     struct contraction *out) MUST_CHECK;

#endif
