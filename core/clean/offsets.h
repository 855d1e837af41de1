/* How far points lie off the planes of their neighbours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_OFFSETS_H
#define WHITTLE_CORE_CLEAN_OFFSETS_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

enum { OFFSETS_K = 16 };

/* Of each of n points, against the tangent planes of its OFFSETS_K nearest trusted neighbours; all owned. */
struct offsets {
    float *second, *third, *quarter; /* the second, third and fifth least distance to one of these planes: a point of a
                                        surface lies near some of them at an edge too */
    float *usual;                    /* what `quarter` is where the neighbours are nearest to each other's planes: that
                                        which a quarter of them stay below */
    float *rough;                    /* the same where they are far from them: that which a quarter of them exceed */
    float *radius;                   /* distance to the last of the neighbours */
    float *sparsity; /* mean distance to the eight nearest, over that of neighbours: which a quarter exceed */
};

/* Measures n distinct points, of which those with trusted[p] != 0 make planes and neighbours; more than OFFSETS_K have
 * to be.  Planes are those of least squares, fitted again and again without who lies off them, so that of two layers
 * the sharper or fuller one counts.  Points should be in an order that keeps near ones near.  The same for any number
 * of threads.  O(n log n).  On success *offsets is the caller's, for offsets_done.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status offsets_find(const vec3 *point, size_t n, const uint8_t *trusted, unsigned threads,
                         struct offsets *offsets) MUST_CHECK;

/* Accepts a zeroed one. */
void offsets_done(struct offsets *offsets);

#endif
