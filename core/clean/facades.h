/* Points of walls that were seen from above: far apart, but no strays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_FACADES_H
#define WHITTLE_CORE_CLEAN_FACADES_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Of n distinct points, of which those with outlier[p] != 0 stand off, sets that to 0 for those that stand between what
 * is above and what is below them beside them in the plan, as roofs and the ground are; *spared of them are.  Where z
 * isn't up, or most of the points lie over others, as those of a solid or a room do, none is.  O(n log n) where there
 * are outliers.  The same for any number of threads.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status facades_spare(const vec3 *point, size_t n, unsigned threads, uint8_t *outlier, size_t *spared) MUST_CHECK;

/* Below this many points it can't be told what they are of, and none is spared. */
enum { FACADES_MIN_POINTS = 1000 };

#endif
