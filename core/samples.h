/* Where the surface is known to be: the dense points, and the middles of the triangles between neighbours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SAMPLES_H
#define WHITTLE_CORE_SAMPLES_H

#include "core/refine.h"

struct sample {
    vec3 place;
    float weight; /* about the area that it stands for: mean 1 without middles, about 0.7 for each point with them */
    float reach;  /* how far around it its tangent plane stands for the surface */
};

struct samples {
    size_t n;
    struct sample *sample; /* n; each point is followed by the middles of its triangles; owned */
    uint32_t *point;       /* n: the point that a sample is, or NONE for a middle; owned */
    vec3 *normal;          /* n, unit, of either sign; owned */
};

/* Takes the points, and with middles also the middle of each triangle of the umbrellas; input->hood must be there then.
 * O(n k^2), k neighbours each.  STATUS_NO_MEMORY. */
enum status samples_init(struct samples *samples, const struct refine_input *input, bool middles,
                         unsigned threads) MUST_CHECK;
void samples_done(struct samples *samples);

#endif
