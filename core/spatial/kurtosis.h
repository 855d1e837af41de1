/* How points lie about the plane fitted to them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_KURTOSIS_H
#define WHITTLE_CORE_SPATIAL_KURTOSIS_H

#include <stdint.h>

#include "core/math/vec3.h"

/* Kurtosis of the heights of the points id[0 .. k-1] over the plane: 1 where there are two, as on both sides of a thin
 * wall, 1.8 where they fill a slab evenly, and 2.3 to 3 where they are noise.  Infinite where all are 0. */
double kurtosis_of_heights(const vec3 *point, const uint32_t *id, unsigned k);

/* Neighbours of a point that tell, itself among them. */
enum { KURTOSIS_K = 64 };

#endif
