/* Where most points of a sample lie: the box that strays don't spoil.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_MOST_H
#define WHITTLE_CORE_CLOUD_MOST_H

#include <stdbool.h>
#include <stddef.h>

#include "core/math/vec3.h"

enum { MOST_SAMPLES = 256, MOST_FEWEST = 16 };

/* A box of all points is spoilt where it is over so many times as large as that of most of them.  No scan is: between
 * the size of a building and a millimetre there are four powers of ten, but a stray is one point, and they are many. */
#define MOST_SPOILT 1000.0

/* One of so many of the points, on either side along each axis, isn't of most of them. */
enum { MOST_OUTERMOST = 16 };

/* The box of n <= MOST_SAMPLES points, the outermost (MOST_OUTERMOST) left out.  Points that
 * are equal to the one before count once.  False, with nothing told, where fewer than MOST_FEWEST are left or their box
 * has no extent.  Moves points of the sample.  O(n log n). */
bool most_of(vec3 *sample, size_t n, vec3 *least, vec3 *most);

#endif
