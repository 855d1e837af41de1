/* How far points are apart across the lines that a scanner has taken them in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_SCAN_LINES_H
#define WHITTLE_CORE_SURFACE_SHEET_SCAN_LINES_H

#include <stdbool.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/neighbourhood.h"

/* reach: of each point of the neighbourhoods, the distance to its sixth neighbour.  Where all that is near a point lies
 * on one line, as with a rotating scanner whose lines are much farther apart than its points, the reach becomes that
 * among points as far apart along the lines as across.  Nothing changes where hardly any point's neighbours are on a
 * line.  *found = so many were.  O(n).  The same for any number of threads.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status scan_lines_reach(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads, float *reach,
                             size_t *found) MUST_CHECK;

/* Whether the points are those of curves alone: what is near a point is on one line, as near points are and as what is
 * left of them is, however few that are.  Lines of a scanner aren't: thinned to so few, their points have others
 * across. Points that are as few as that are no curves.  O(n), and next to nothing where hardly any point's neighbours
 * are on a line.  The same for any number of threads.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status scan_lines_are_curves(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads,
                                  bool *curves) MUST_CHECK;

#endif
