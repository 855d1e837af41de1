/* The triangles that the points around each point see between them: a surface through all points, as far as it can be
 * told by looking at neighbours alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_LOCAL_DELAUNAY_H
#define WHITTLE_CORE_REFINE_LOCAL_DELAUNAY_H

#include <assert.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/neighbourhood.h"
#include "core/spatial/sheets.h"

enum { LOCAL_DELAUNAY_RIBS = 12 }; /* the most that a point has; six are usual */

/* The triangles of each point in the order of their angle, between ribs, the edges to its neighbours.
 *
 * Triangle i of point p is p, rib[p][i] and the rib after it (the first after the last).  Between some ribs there is no
 * triangle.
 * Each triangle counts at one of its corners alone, the lowest that has it. */
struct local_delaunay {
    size_t n;
    uint32_t (*rib)[LOCAL_DELAUNAY_RIBS]; /* n: ids in the order of their angle around the normal, then NONE; owned */
    uint16_t *closed; /* n: bit i where there is a triangle after rib i; above, how many ribs; owned */
    uint32_t *votes;  /* n: two bits for each rib, see local_delaunay_votes; owned */
};

/* normal[i] is a unit vector of either sign.  A point beside a crease (creases may be NULL) doesn't look behind it, and
 * no triangle is askew to the sheets at its corners.  O(n k^2), k neighbours each, in practice O(n k).
 * STATUS_NO_MEMORY. */
enum status local_delaunay_find(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                                const struct creases *creases, unsigned threads, struct local_delaunay *out) MUST_CHECK;

/* How many of its corners have triangle i of p; 0 where it isn't one, or counts at another corner. */
static inline unsigned local_delaunay_votes(const struct local_delaunay *local_delaunay, size_t p, unsigned i) {
    return local_delaunay->votes[p] >> 2 * i & 3;
}

/* The triangles that count at p and that so many of their corners have, 1 to 3: bit 2 i for triangle i. */
static inline uint32_t local_delaunay_triangles(const struct local_delaunay *local_delaunay, size_t p,
                                                unsigned least_votes) {
    static_assert(LOCAL_DELAUNAY_RIBS <= 16, "two bits each");
    uint32_t ones = local_delaunay->votes[p], twos = ones >> 1;
    return (least_votes == 1 ? ones | twos : least_votes == 2 ? twos : ones & twos) & 0x55555555;
}

/* How many ribs p has. */
static inline unsigned local_delaunay_ribs(const struct local_delaunay *local_delaunay, size_t p) {
    return local_delaunay->closed[p] >> LOCAL_DELAUNAY_RIBS;
}

/* The rib after rib i of p. */
static inline uint32_t local_delaunay_after(const struct local_delaunay *local_delaunay, size_t p, unsigned i) {
    return local_delaunay->rib[p][i + 1 < local_delaunay_ribs(local_delaunay, p) ? i + 1 : 0];
}

/* Accepts zeroed local Delaunay triangles. */
void local_delaunay_done(struct local_delaunay *local_delaunay);

#endif
