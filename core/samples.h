/* Where the surface is known to be: the dense points, and the middles of short edges between them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SAMPLES_H
#define WHITTLE_CORE_SAMPLES_H

#include "core/refine.h"

struct samples {
    size_t n;
    vec3 *place;    /* n; the first input->n are the dense points; owned */
    vec3 *normal;   /* n, unit, of either sign; owned */
    float *reach;   /* n: how far around a sample its tangent plane stands for the surface; owned */
    double *weight; /* n: in proportion to the area that each stands for; those of the points sum up to about 1 each;
                       owned */
};

/* Takes the points, and with middles also the middle of each pair of neighbours that has no other point in the ball
 * over it (a Gabriel edge).  O(n k^2), k neighbours each.  STATUS_NO_MEMORY. */
enum status samples_init(struct samples *samples, const struct refine_input *input, bool middles,
                         unsigned threads) MUST_CHECK;
void samples_done(struct samples *samples);

#endif
