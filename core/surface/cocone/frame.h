/* The frame at each point: its normal, and the poles on both sides.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_FRAME_H
#define WHITTLE_CORE_SURFACE_COCONE_FRAME_H

#include "core/surface/cocone/star.h"

/* sin(pi / 8): the cocone at a point is the complement of the double cone of 3 pi / 8 around its normal. */
#define COCONE_FRAME_SIN 0.38268343236508977

/* There are two, with normals that are given and with those of the poles. */
enum { COCONE_FRAMES = 2 };

/* Sides of a point: that to which its normal points is 0, the other one 1. */
struct cocone_frame {
    vec3 *normal;        /* n unit vectors, on the side of the positive pole; owned */
    uint32_t (*pole)[2]; /* n: on each side the finite cell whose Voronoi vertex is highest over the tangent plane; NONE
                            where there is none; owned */
    uint8_t *hull;       /* n: bit k = an infinite cell is on side k; owned */
};

/* Builds count frames at once: the first with the given unit vectors where dense is not NULL, with the poles' sign, the
 * others with normals from the poles (Amenta, Bern; Dey, Goswami section 2).  O(cells).  STATUS_NO_MEMORY, and then
 * whoever calls gives what is there to cocone_frame_done. */
enum status cocone_frame_build(const struct cocone_star *star, const vec3 *dense, unsigned threads,
                               struct cocone_frame frame[], int count) MUST_CHECK;

/* Accepts a zeroed frame. */
void cocone_frame_done(struct cocone_frame *frame);

/* Turns a normal around, and the sides with it. */
void cocone_frame_turn(struct cocone_frame *frame, uint32_t vertex);

/* Cosine between a cell's dual direction and the normal at its vertex; 0 where the direction is zero. */
double cocone_frame_cosine(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                           uint32_t vertex);

/* Whether the dual edge of the facet (the Voronoi edge between its two circumcentres) meets the cocone of the vertex.
 */
bool cocone_frame_accepts(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t half,
                          uint32_t vertex);

#endif
