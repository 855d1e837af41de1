/* How noisy a cloud is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_NOISE_H
#define WHITTLE_CORE_CLEAN_NOISE_H

#include "core/base/status.h"
#include "core/spatial/knn.h"
#include "core/spatial/neighbourhood.h"

/* *level = the standard deviation of the points from the surface, along their normals (unit, of any sign), estimated
 * from how the offsets of neighbours differ: curvature, which neighbours share, doesn't count, outliers hardly do.  In
 * the points' units.  Points of a curved surface without noise have a few percent of their spacing, since they are no
 * grid; what is noise over distances of many spacings, as where scans don't fit together, isn't seen.  At most
 * NOISE_SAMPLES points are looked at.  STATUS_NO_MEMORY. */
enum { NOISE_SAMPLES = 1 << 16 };
enum status noise_estimate(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                           double *level) MUST_CHECK;

/* *share = how far neighbours lie off the quadratic surface through them, as root mean square by their spacing, where
 * that is least: in a tenth of 2048 places.  Of exact points on a body with plane or evenly bent parts under .002,
 * where all of it is bent as tightly as its points are apart up to .02; noise of .01 of the spacing has as much.  Of
 * distinct points, which the index is of.  10 ms.  STATUS_NO_MEMORY. */
enum status noise_where_least(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                              double *share) MUST_CHECK;

#endif
