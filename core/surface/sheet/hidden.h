/* Whether points can have been seen from one place.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_HIDDEN_H
#define WHITTLE_CORE_SURFACE_SHEET_HIDDEN_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* *share of n points (distinct, in any frame) that are far behind others as seen from a place: next to the ways to them
 * are three others or more that are nearer by over six times as much as those ways are apart, as steep as slopes are
 * seldom.  Of what was scanned from the place .00 to .10, steps and wrong matches; of a solid's skin .2 to .5, wherever
 * outside of it the place is.  By 16 384 of the points at most.  Some hundredths of a second.  STATUS_NO_MEMORY. */
enum status hidden_share(const vec3 *point, size_t n, vec3 place, unsigned threads, double *share) MUST_CHECK;

#endif
