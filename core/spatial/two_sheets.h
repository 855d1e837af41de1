/* Whether points are on both sides of a thin plate, which a few neighbours of each don't tell as they are on one side.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_TWO_SHEETS_H
#define WHITTLE_CORE_SPATIAL_TWO_SHEETS_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

/* From this share on most of the points are on both sides of something: plates one to two times as thick as
 * points at random are apart on either side have .4 to .8, scans of terrain, rooms and woods and statues at most .01.
 */
#define TWO_SHEETS_MOSTLY 0.25

/* *share of the places looked at, some of the n points over which knn is, around which there are two heights that
 * alternate: not so those on either side of a step.  0 of few points.  O(log n).  The same for any number of threads.
 * STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status two_sheets_share(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                             double *share) MUST_CHECK;

#endif
