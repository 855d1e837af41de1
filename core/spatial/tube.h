/* How points lie around a line.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_TUBE_H
#define WHITTLE_CORE_SPATIAL_TUBE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

/* Standard deviation of the distances of the points id[0 .. k-1] from the line along which they spread most, by their
 * mean: 0 on a round bar, .11 on a square one, .35 where they fill it evenly, and .4 to .65 on other surfaces and in
 * noise.  Infinite where all are on the line. */
double tube_unevenness(const vec3 *point, const uint32_t *id, unsigned k);

/* Amplitude of the part of these distances that comes back four times around, by their mean, from the middle of the
 * circle that fits the points best across the line: 0 on a round bar, .15 on a square one; at random .02 and .11. */
double tube_squareness(const vec3 *point, const uint32_t *id, unsigned k);

/* *share of n points, as far as 64 or 32 of those nearest to one tell, is on bars so thin that these are all around
 * them: uneven by less than TUBE_UNEVENNESS_MOST.  0 for fewer than 64.  Bodies of thin bars have .2 to .9; statues,
 * scans, leaves, noise, and bars that were seen from one side, hardly any, and few models .1.  Points should be in an
 * order that keeps near ones near; at most 1024 are looked at.  *round: whether these bars are round ones.
 * STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status tube_share(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share,
                       bool *round) MUST_CHECK;

#define TUBE_UNEVENNESS_MOST 0.25
#define TUBE_MANY 0.2 /* of the points: so many are on the bars of a body */

#endif
