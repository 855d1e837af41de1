/* Vertices that are worth little where they are, taken out and put in where the mesh is farthest off.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_REALLOCATE_H
#define WHITTLE_CORE_REFINE_REALLOCATE_H

#include "core/refine/fit.h"

/* One pass: takes out the vertices whose loss costs least (each collapsed into a neighbour) and puts them on edges
 * where they gain most, pair by pair, as long as a pair gains.  The counts of vertices and triangles stay.
 * *reallocations += their number.  STATUS_NO_MEMORY. */
enum status fit_reallocate(struct fit *fit, size_t *reallocations) MUST_CHECK;

#endif
