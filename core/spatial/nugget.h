/* How much of what heights differ by is told by nothing beside them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_NUGGET_H
#define WHITTLE_CORE_SPATIAL_NUGGET_H

#include <stdint.h>

#include "core/math/vec3.h"

/* Of heights over the plane fitted to the points id[0 .. k-1]: half the mean square of what a point and the one beside
 * it along the plane differ by, for the variance of all (Matheron 1963: the nugget and the sill).  About 1 where they
 * are noise, and less where they have a shape that is wider than the points are apart.  1 where all are 0.
 * k <= NUGGET_K; O(k^2). */
enum { NUGGET_K = 64 };
double nugget_of_heights(const vec3 *point, const uint32_t *id, unsigned k);

#endif
