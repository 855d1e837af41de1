/* Points where a surface crosses the lines of a grid, as marching cubes and its like put them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_ON_GRID_LINES_H
#define WHITTLE_CORE_CLOUD_ON_GRID_LINES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Whether nearly all of n < 2^32 points have two coordinates, or three, that many other points have exactly: those of
 * planes of the grid, which has to be along the axes.  Points anywhere on faces along the axes share one, on the edges
 * of such faces two.  0 threads = all processors.  O(n), 16 bytes for each point.  STATUS_NO_MEMORY. */
enum status on_grid_lines(const vec3 *point, size_t n, unsigned threads, bool *are) MUST_CHECK;

#endif
