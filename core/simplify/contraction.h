/* What contraction (Lee, Jong section 4.4) makes: a ranking of all points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_CONTRACTION_H
#define WHITTLE_CORE_SIMPLIFY_CONTRACTION_H

#include <stddef.h>
#include <stdint.h>

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

/* How many points are left when nothing with an error over max_error (normalised) is contracted.  Of a whole ranking.
 */
size_t contraction_count_for_error(const struct contraction *contraction, double max_error);

/* representative[p] = the one of the k survivors that p was contracted into, itself for survivors.  O(n). */
void contraction_representatives(const struct contraction *contraction, size_t k, uint32_t *representative);

/* Accepts a zeroed contraction. */
void contraction_done(struct contraction *contraction);

#endif
