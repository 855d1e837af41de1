/* Where the surface is known to be: the dense points, and the middles of the triangles between neighbours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_SAMPLES_H
#define WHITTLE_CORE_REFINE_SAMPLES_H

#include "core/cloud/cloud.h"
#include "core/refine/refine.h"

struct sample {
    vec3 place;
    float weight; /* about the area that it stands for: mean 1 without middles, about 0.7 for each point with them */
    float reach;  /* how far around it its tangent plane stands for the surface */
};

struct samples {
    size_t n, points;      /* of them all; of the points, which come first and keep their ids */
    unsigned parts;        /* of each triangle that have a middle */
    struct sample *sample; /* n; owned */
    vec3 *normal;          /* n, unit, of either sign; owned */
    uint32_t *middle;      /* points + 1: those of the triangles of point p are middle[p] .. middle[p + 1) - 1; owned */
};

/* The point that a sample is, or NONE for a middle. */
static inline uint32_t samples_point(const struct samples *samples, uint32_t sample) {
    return sample < samples->points ? sample : NONE;
}

enum { SAMPLES_QUARTERS = 4 }; /* that the middles of its edges divide a triangle into */

/* How much of a triangle's weight its corners have when it is in so many parts (0, 1 or SAMPLES_QUARTERS); the middles
 * of these have the rest.  The more places tell of its inside, the less its corners count; where points lie anywhere,
 * middles only keep the mesh from bending between few points. */
static inline double samples_point_share(const struct refine_input *input, unsigned parts) {
    if (parts == 0) return 1;
    return input->anywhere ? 0.97 : parts == SAMPLES_QUARTERS ? 0.1 : 0.25;
}

/* Takes the points, and of each triangle of the local Delaunay triangles the middles of so many parts: 0 (points
 * alone), 1 (the whole) or SAMPLES_QUARTERS.  The local Delaunay triangles are those of the input, found where there
 * are none yet; input->neighbours must be there then.  O(n k^2), k neighbours each.  STATUS_NO_MEMORY. */
enum status samples_init(struct samples *samples, const struct refine_input *input, unsigned parts,
                         unsigned threads) MUST_CHECK;
void samples_done(struct samples *samples);

#endif
