/* How far a simplified cloud is from the original one, without a mesh.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_TANGENT_H
#define WHITTLE_CORE_MEASURE_TANGENT_H

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/measure/distance_sum.h"
#include "core/report.h"
#include "core/spatial/knn.h"

/* The distance of every one of n original points to the tangent plane (normal of unit length, sign arbitrary) at its
 * nearest kept point: kept[i] < n, k >= 1 of them.  Zero on a plane, second order in the spacing elsewhere; it tells
 * what a reconstruction can reach at best rather than what one does reach.  In units of the points.  O(n log k).
 * distance (NULL = not wanted) gets that of each point.  STATUS_NO_MEMORY. */
enum status tangent_error(const vec3 *point, const vec3 *normal, size_t n, const uint32_t *kept, size_t k,
                          unsigned threads, struct distance_stats *stats, float *distance) MUST_CHECK;

/* The same in parts, for points that aren't all in memory: the planes are those at the k points of an index. */
struct tangent_planes {
    const struct knn *knn;
    const vec3 *point, *normal; /* of the index: borrowed, as it is */
};
enum status tangent_add(const struct tangent_planes *planes, const vec3 *point, size_t n, unsigned threads,
                        struct distance_sum *sum) MUST_CHECK;

#endif
