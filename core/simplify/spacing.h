/* Rankings whose first points lie no nearer to each other than a spacing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_SPACING_H
#define WHITTLE_CORE_SIMPLIFY_SPACING_H

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

#endif
