/* From the shape operator of points to the quadrics that they start with: for a cloud in memory and for a part of one
 * that is larger.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_POINT_QUADRICS_H
#define WHITTLE_CORE_SIMPLIFY_POINT_QUADRICS_H

#include "core/params.h"
#include "core/simplify/quadric.h"

struct point_quadrics {
    const struct params *params; /* dso, dso_exponent, area_weight, line_quadric */
    const vec3 *point, *normal;
    const struct neighbourhood *neighbourhood;
    const float *dso;   /* dso_compute's, of each point */
    const uint8_t *own; /* of which points the average operator is; NULL: of all */
    unsigned threads;
};

/* quadrics[p], n of them: smooths the operator (dso_smooth) where it is ours, makes weights of it (dso_weights) about
 * *average, and assembles the quadrics with them (quadric_assemble).  *average: NAN, and it is found and set; or that
 * of the cloud which the points are a part of.  STATUS_NO_MEMORY.  O(n k log k). */
enum status point_quadrics_make(const struct point_quadrics *of, double *average,
                                struct packed_quadric *quadrics) MUST_CHECK;

#endif
