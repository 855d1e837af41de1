/* Which triangle each sample belongs to before anything has changed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_ASSIGN_H
#define WHITTLE_CORE_REFINE_ASSIGN_H

#include "core/refine/fit.h"

/* triangle[i], distance_sq[i] = where sample i belongs, and how far off it is: the nearest triangle, or one downhill of
 * which there is none where that is near.  Both are for fit->samples.n.  Only fit->mesh, samples, half-edges and
 * threads are looked at; the lists are empty, and have room for all triangles.  STATUS_NO_MEMORY. */
enum status fit_assign(const struct fit *fit, uint32_t *triangle, float *distance_sq) MUST_CHECK;

/* Fills the lists, and sets the costs, by what fit_assign has found.  STATUS_NO_MEMORY. */
enum status fit_fill(struct fit *fit, const uint32_t *triangle, const float *distance_sq) MUST_CHECK;

#endif
