/* How points lie over the plane fitted to them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_HEIGHTS_H
#define WHITTLE_CORE_SPATIAL_HEIGHTS_H

#include <stdint.h>

#include "core/math/vec3.h"

/* Neighbours of a point that tell, itself among them, and the most that are taken. */
enum { HEIGHTS_K = 64 };

/* Kurtosis of the heights of the points id[0 .. k-1]: 1 where there are two, as on both sides of a thin wall, 1.8 where
 * they fill a slab evenly, and 2.3 to 3 where they are noise.  Infinite where all are 0.  k from 1 to HEIGHTS_K. */
double heights_kurtosis(const vec3 *point, const uint32_t *id, unsigned k);

/* Root mean square of the heights of the points id[0 .. k-1].  k from 1 to HEIGHTS_K. */
double heights_rms(const vec3 *point, const uint32_t *id, unsigned k);

/* How much of what the heights differ by is told by nothing beside them: half the mean square of what a point and the
 * one beside it along the plane differ by, for the variance of all (Matheron 1963: the nugget and the sill).  About 1
 * where they are noise, and less where they have a shape that is wider than the points are apart.  1 where all are 0.
 * k from 1 to HEIGHTS_K; O(k^2). */
double heights_nugget(const vec3 *point, const uint32_t *id, unsigned k);

#endif
