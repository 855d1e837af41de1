/* Edge flips that bring the mesh nearer to the points (Hoppe and others 1993: edge swaps).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_FLIP_H
#define WHITTLE_CORE_REFINE_FLIP_H

#include "core/refine/fit.h"

/* Flips edges whose triangles are touched, the most rewarding first, until no flip gains or `rounds` are over; the
 * triangles that are left touched are those of the last round.  *flips += their number.  STATUS_NO_MEMORY. */
enum status fit_flip(struct fit *fit, size_t rounds, size_t *flips) MUST_CHECK;

#endif
