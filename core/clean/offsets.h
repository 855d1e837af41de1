/* How far points lie off the planes of their neighbours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_OFFSETS_H
#define WHITTLE_CORE_CLEAN_OFFSETS_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

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

/* What planes are fitted to: the neighbours of each of n points. */
struct planes;

/* Looks for the neighbours of n distinct points, over which knn is; more than OFFSETS_K.  Points and knn are borrowed,
 * and points should be in an order that keeps near ones near.  O(n log n).  *planes is the caller's, for planes_free.
 * STATUS_NO_MEMORY. */
enum status planes_new(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                       struct planes **planes) MUST_CHECK;

/* The OFFSETS_K nearest others of a point, nearest first: of all, or of those that were trusted last. */
const uint32_t *planes_near(const struct planes *planes, size_t p);

/* Finds the neighbours anew among those with trusted[p] != 0, more than OFFSETS_K, for planes_near.
 * O(log n) for each whose neighbours change.  STATUS_NO_MEMORY, STATUS_LIMIT: as planes_measure's. */
enum status planes_trust(struct planes *planes, const uint8_t *trusted, unsigned threads) MUST_CHECK;

/* Measures all points, of which those with trusted[p] != 0 make planes and neighbours; more than OFFSETS_K have to be.
 * Planes are those of least squares, fitted again and again without who lies off them, so that of two layers the
 * sharper or fuller one counts.  Whatever else was trusted before, *offsets are the same, and for any number of
 * threads; but what hasn't changed since isn't measured again.  O(n log n).  *offsets belongs to the planes, and holds
 * until the next call.  STATUS_NO_MEMORY, STATUS_LIMIT: then planes are of no more use. */
enum status planes_measure(struct planes *planes, const uint8_t *trusted, unsigned threads,
                           const struct offsets **offsets) MUST_CHECK;

/* Accepts NULL. */
void planes_free(struct planes *planes);

#endif
