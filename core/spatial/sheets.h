/* The sheets of surface that meet at a point: one on a face, two along a crease, three in a corner.
 *
 * A plane fitted to all neighbours of a point on a crease lies askew to both faces, and one beside a crease is tilted
 * by what lies beyond it.  So planes through the point and two of its neighbours are tried for what most of the
 * neighbours lie on, and again for the rest: Fischler and Bolles, Random sample consensus (1981), with all pairs in
 * place of random ones.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_SHEETS_H
#define WHITTLE_CORE_SPATIAL_SHEETS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/neighbourhood.h"

enum { SHEETS_MOST = 3 };

#define SHEETS_STEEPEST 0.3 /* sine between a sheet and the direction to a neighbour on it */

struct sheets {
    unsigned count;               /* 0: it can't be told */
    float normal[SHEETS_MOST][3]; /* unit, on the side of the point's own normal */
};

/* The sheets at points that have others than their fitted normal tells. */
struct creases {
    uint32_t *of;      /* n: index of a point's sheets, or NONE (UINT32_MAX); owned */
    struct sheets *at; /* owned */
    size_t several;    /* points on several sheets */
    size_t on_lines;   /* of these, those that have two neighbours like it */
};

/* Finds the sheets of n points with their fitted normals (unit, of either sign).  Where the neighbours are about that
 * normal's plane there are none, nor are there any on a noisy cloud.  O(n) for a smooth surface, and O(k^3) more for
 * each point where it isn't, with k neighbours, about 3 us.  The same for any number of threads.  STATUS_NO_MEMORY:
 * then *creases is untouched. */
enum status creases_find(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                         unsigned threads, struct creases *creases) MUST_CHECK;

/* Accepts zeroed creases. */
void creases_done(struct creases *creases);

/* The sheets at a point, or NULL where there are none, as there are nowhere where creases is NULL or zeroed. */
static inline const struct sheets *creases_at(const struct creases *creases, uint32_t p) {
    return creases && creases->of && creases->of[p] != UINT32_MAX ? &creases->at[creases->of[p]] : NULL;
}

/* Whether the surface of n points has creases to speak of: lines over twice as long, more or less, as the root of its
 * area, and hardly any points that look like a crease's beside them.  Those of a cube are five times as long; where
 * bodies are round, or points too few to tell, such points are scattered. */
static inline bool creases_matter(const struct creases *creases, size_t n) {
    static const double LINED = 0.85; /* of the points that look like a crease's */
    return creases && (double)creases->on_lines > fmax(2 * sqrt((double)n), LINED * (double)creases->several);
}

static inline vec3 sheets_normal(const struct sheets *sheets, unsigned k) {
    return (vec3){(double)sheets->normal[k][0], (double)sheets->normal[k][1], (double)sheets->normal[k][2]};
}

/* Whether a direction (unit) is along one of the sheets, of which there is one at least. */
static inline bool sheets_hold(const struct sheets *sheets, vec3 direction) {
    for (unsigned k = 0; k < sheets->count; k++)
        if (fabs(vec3_dot(direction, sheets_normal(sheets, k))) < SHEETS_STEEPEST) return true;
    return false;
}

/* The largest cosine between a normal (of either sign) and those of the sheets. */
static inline double sheets_agreement(const struct sheets *sheets, vec3 normal) {
    double most = 0;
    for (unsigned k = 0; k < sheets->count; k++) most = fmax(most, fabs(vec3_dot(normal, sheets_normal(sheets, k))));
    return most;
}

#endif
