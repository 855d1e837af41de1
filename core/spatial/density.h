/* How evenly points lie on a surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_DENSITY_H
#define WHITTLE_CORE_SPATIAL_DENSITY_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

/* *change = by how much the area that holds 16 points differs from the next one's, as the median of the logarithms of
 * their quotients, of 1024 places at most: .15 to .27 where points are at random, .03 to .14 where a surface crosses
 * the lines of a grid, however near to each other some of these points are, and .07 to .15 of points that were put
 * evenly.  Points have to be distinct, in an order that keeps near ones near; 0 for fewer than 64.  STATUS_NO_MEMORY,
 * STATUS_LIMIT. */
enum status density_change(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                           double *change) MUST_CHECK;

#endif
