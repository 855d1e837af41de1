/* The frame at each point: poles, normal, and how far the medial axis is.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_FRAME_H
#define WHITTLE_CORE_COCONE_FRAME_H

#include "core/cocone_star.h"

/* sin(pi / 8): the cocone at a point is the complement of the double cone of 3 pi / 8 around its normal. */
#define COCONE_FRAME_SIN 0.38268343236508977

struct cocone_frame {
    vec3 *normal; /* n unit vectors, on the side of the positive pole; owned */
    double
        *above; /* n: distance of the farthest Voronoi vertex on the normal's side; INFINITY for hull vertices; owned */
    double *below; /* n: and on the other side; 0 where there is none; owned */
    uint8_t *hull; /* n: 1 = vertex of the convex hull; owned */
};

/* Normals from the poles (Amenta, Bern; Dey, Goswami section 2), or, where dense is not NULL, the given unit vectors
 * with the poles' sign.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_frame_build(const struct cocone_star *star, const vec3 *dense, unsigned threads,
                               struct cocone_frame *frame) MUST_CHECK;

/* Accepts a zeroed frame. */
void cocone_frame_done(struct cocone_frame *frame);

/* Cosine between a cell's dual direction and the normal at its vertex; 0 where the direction is zero. */
double cocone_frame_cosine(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                           uint32_t vertex);

/* Whether the dual edge of the facet (the Voronoi edge between its two circumcentres) meets the cocone of the vertex.
 */
bool cocone_frame_accepts(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t half,
                          uint32_t vertex);

#endif
