/* Rankings whose first points lie no nearer to each other than a spacing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_SPACING_H
#define WHITTLE_CORE_SIMPLIFY_SPACING_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/simplify/contraction.h"

/* Reorders a whole ranking of the n points (position, in the units of spacing; borrowed) so that its last *fits points
 * are all at least `spacing` (> 0) apart from each other, and every other point is nearer than that to one of them: a
 * point is among them unless one that ranks higher is too near.  Those that aren't come first in the order and were
 * contracted into that one; both parts keep their order.  Distances are compared as doubles, squared.  O(n) on average.
 * STATUS_NO_MEMORY leaves the ranking as it was. */
enum status spacing_apply(struct contraction *contraction, const vec3 *position, double spacing,
                          size_t *fits) MUST_CHECK;

/* Points, by their places in a list of positions, as they come: those that are too near to one of them show. */
struct spacing_grid {
    const vec3 *position; /* borrowed */
    vec3 origin;
    double width, spacing_sq;
    size_t mask;    /* of the table */
    uint32_t *head; /* of each place in the table: the point that came last there; owned */
    uint32_t *next; /* of each point: the one that came before it; owned */
};

/* For points whose places are below `most`, all of them between two corners.  STATUS_NO_MEMORY: to be done with then,
 * too. */
enum status spacing_grid_init(struct spacing_grid *grid, const vec3 *position, size_t most, vec3 low, vec3 high,
                              double spacing) MUST_CHECK;

/* A point of the grid that is nearer to p than the spacing: the nearest one, of equals the lowest; NONE: there is none.
 */
uint32_t spacing_grid_near(const struct spacing_grid *grid, vec3 p);

/* position[q], which isn't there yet, is one of them from now on. */
void spacing_grid_insert(struct spacing_grid *grid, uint32_t q);

/* Accepts a zeroed one. */
void spacing_grid_done(struct spacing_grid *grid);

#endif
