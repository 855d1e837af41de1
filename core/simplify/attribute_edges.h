/* Edges of colours and other attributes as features.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_ATTRIBUTE_EDGES_H
#define WHITTLE_CORE_SIMPLIFY_ATTRIBUTE_EDGES_H

#include "core/simplify/quadric.h"

/* What a step by the whole range of an attribute of weight 1 is worth as a geometric error: a fraction of the diagonal.
 */
#define ATTRIBUTE_EDGE_HEIGHT 0.1

/* Adds to each point's quadric what moving it across an edge of an attribute costs.  value[p], one for each point, is
 * the attribute, its range scaled to 1; NaN where there is none.  The edge at a point is how far the values around it
 * are off the linear function that fits them best (rms), so a ramp, which interpolation reproduces, is none.  A
 * distance d from the point, along that function's gradient, costs what a geometric error of weight *
 * ATTRIBUTE_EDGE_HEIGHT * edge * d / spacing does; across it, which is along the edge, half of that.  O(n k). */
void attribute_edges_add(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood,
                         const float *value, double weight, const struct quadric_options *options,
                         struct packed_quadric *quadrics);

#endif
