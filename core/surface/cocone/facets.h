/* Candidate facets by the literal rules: which facets might be surface, before one is chosen of each pair of sheets.
 * Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_FACETS_H
#define WHITTLE_CORE_SURFACE_COCONE_FACETS_H

#include "core/surface/cocone/frame.h"

/* A facet has an id; both of its half facets lead to it. */
struct cocone_facets {
    size_t count;
    uint32_t *half;        /* count: the half facet in the cell with the smaller id; owned */
    uint32_t (*vertex)[3]; /* count; owned */
    uint8_t *alive;        /* count: 1 until the facet is deleted; owned */
    uint32_t *of_half;     /* 4 * cell_count: id or NONE; owned */
    uint32_t *begin;       /* n + 1: where the facets at each vertex begin; owned */
    uint32_t *around;      /* 3 * count; owned */
    uint8_t *flat;         /* n: 1 = the Voronoi cell is long and thin, so its normal can be trusted; owned */
};

/* Finds the flat points (Dey, Goswami, section 3) and the facets whose dual edges meet the cocones of all of their flat
 * vertices, of which there is one at least.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_facets_find(const struct cocone_star *star, const struct cocone_frame *frame,
                               struct cocone_facets *facets) MUST_CHECK;

/* Accepts zeroed facets. */
void cocone_facets_done(struct cocone_facets *facets);

/* Whether a facet has the vertex. */
bool cocone_facets_has(const struct cocone_facets *facets, uint32_t facet, uint32_t vertex);

/* The vertex of a facet that is neither a nor b. */
uint32_t cocone_facets_apex(const struct cocone_facets *facets, uint32_t facet, uint32_t a, uint32_t b);

/* Cosine of the angle between the normals of two facets at the edge (a, b): 1 where one continues the other, -1 where
 * it is folded back onto it. */
double cocone_facets_cosine(const struct cocone_star *star, const struct cocone_facets *facets, uint32_t f, uint32_t g,
                            uint32_t a, uint32_t b);

#endif
