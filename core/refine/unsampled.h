/* What a flip is worth where there is no data.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_UNSAMPLED_H
#define WHITTLE_CORE_REFINE_UNSAMPLED_H

#include "core/refine/fit.h"

/* The area that a unit of the samples' weight stands for, on the mesh as it is.  O(triangles). */
double fit_unsampled_unit_area(const struct fit *fit, double total_weight);

/* What the flip of h gains beside the distances of the region's samples, in the same units; weight = the samples', made
 * = the two triangles that it makes.  0 where there are samples enough to decide. */
double fit_unsampled_gain(const struct fit *fit, const struct fit_region *region, double weight, uint32_t h,
                          const struct surface *made);

#endif
