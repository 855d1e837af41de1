/* Points of a less exact scan beside those of a more exact one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_LAYERS_H
#define WHITTLE_CORE_CLEAN_LAYERS_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/clean/offsets.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

/* Where of n distinct points some lie many times as far off the surface as others beside them do, as registration
 * leaves doubles, by a twentieth of the neighbourhood's radius at least, and these others cover the surface too, the
 * former get OUTLIER_OFF; *count of them are found.
 * outlier is what outliers_find gave with the same range, and planes, which measure something else then, are its own;
 * all others then get what it gives of what is left.  A cloud
 * without such layers, and one that is as noisy everywhere, stays as it is, and *count is 0.  The same for any number
 * of threads. O(n log n).  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status layers_find(const vec3 *point, const float *range, size_t n, unsigned threads, struct planes *planes,
                        uint8_t *outlier, size_t *count) MUST_CHECK;

/* The share of points that are so far off, of some patches of n distinct points, over which knn is: where it is more
 * than LAYERS_MANY it is worth looking for a layer.  0 of few points.  The same for any number of threads.  O(log n).
 * STATUS_NO_MEMORY. */
enum status layers_estimate(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                            double *share) MUST_CHECK;
#define LAYERS_MANY 0.045

#endif
