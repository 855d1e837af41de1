/* The simplifier: contraction of virtual edges, in the order of their quadric error.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CONTRACT_H
#define WHITTLE_CORE_CONTRACT_H

#include "core/adjacency.h"
#include "core/progress.h"
#include "core/quadric.h"

/* The order of removal, from all points to one, or to a few.  It doesn't depend on how many points are wanted, so it
 * ranks them: order[n - 1] is the most important point, and order[n - k] .. order[n - 1] is the simplified cloud of k
 * points, unless fewer than were to be left. */
struct contraction {
    size_t n;
    uint32_t *order; /* n: removed first .. removed last, then those that are left, ascending; owned */
    uint32_t *into;  /* n: the point that each one was contracted into; NONE for those that are left; owned */
    float *error;    /* n: largest sqrt(E / weight) of the contractions up to and including order[i]: a length in the
                        normalised frame; infinite of those that are left; owned */
};

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

/* How many points are left when nothing with an error over max_error (normalised) is contracted.  Of a whole ranking.
 */
size_t contraction_count_for_error(const struct contraction *contraction, double max_error);

/* representative[p] = the one of the k survivors that p was contracted into, itself for survivors.  O(n). */
void contraction_representatives(const struct contraction *contraction, size_t k, uint32_t *representative);

/* Accepts a zeroed contraction. */
void contraction_done(struct contraction *contraction);

#endif
