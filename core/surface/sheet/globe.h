/* Whether points are of a globe, whose meridians and parallels are as even from its middle as a scanner's rays are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_GLOBE_H
#define WHITTLE_CORE_SURFACE_SHEET_GLOBE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* *is: n points, in any frame, are about as far from one *middle all over, and wide as seen from there, and the place
 * is near it: then they are a globe's or a part of one, and nobody saw them from there.  By 4096 of them at most,
 * evenly along their order.  Some ten thousandths of a second.  STATUS_NO_MEMORY. */
enum status globe_is_around(const vec3 *point, size_t n, vec3 place, vec3 *middle, bool *is) MUST_CHECK;

/* *is: n points bend around the origin of their coordinates, as those of a region do that are told from the middle of
 * the earth.  Not of what is wider than some 66 degrees on either side.  STATUS_NO_MEMORY. */
enum status globe_is_map(const vec3 *point, size_t n, vec3 origin, bool *is) MUST_CHECK;

#endif
