/* The place that rays come from, to what their directions tell, where it is known about.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_CENTRE_H
#define WHITTLE_CORE_SURFACE_SHEET_CENTRE_H

#include <stddef.h>
#include <stdint.h>

#include "core/math/vec3.h"

/* Some of the points of a scan, each between two others of which its ray is midway. */
enum { CENTRE_TRIPLES = 4096 };
struct centre_triples {
    const vec3 *point;
    size_t count;
    uint32_t of[CENTRE_TRIPLES][3]; /* the one between is the second */
};

/* Up to `most` of points begin .. end - 1 in their order, evenly, each between those beside it; they are added. */
void centre_take(struct centre_triples *triples, size_t begin, size_t end, size_t most);

/* Adds one. */
void centre_add(struct centre_triples *triples, uint32_t first, uint32_t between, uint32_t last);

/* How unevenly the rays from a place to the points follow each other, from 0 to 1. */
double centre_unevenness(const struct centre_triples *triples, vec3 place);

/* The same of each of n triples by itself; uneven has room for a multiple of RAYS_ROOM. */
void centre_unevenness_each(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double *uneven);

/* How unevenly the points themselves do. */
double centre_unevenness_of_points(const struct centre_triples *triples);

/* Moves a place to where the rays from it follow each other most evenly, nearby; returns how unevenly.  An approach
 * comes from as far as some hundredths of the points' extent, in some steps; the other is exact.  Never farther from
 * the points than eight times their extent.  A microsecond for each triple, and a hundredth of a second. */
double centre_approach(const struct centre_triples *triples, vec3 *place);
double centre_refine(const struct centre_triples *triples, vec3 *place);

#endif
