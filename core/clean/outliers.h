/* Points that belong to no surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_OUTLIERS_H
#define WHITTLE_CORE_CLEAN_OUTLIERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/clean/offsets.h"
#include "core/clean/shell.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"
#include "core/spatial/neighbourhood.h"

/* Below this many points nothing can be told, and no point is an outlier. */
enum { OUTLIERS_MIN_POINTS = 32 };

/* Why a point is one: nothing is as far from others, or it lies off the planes of its neighbours. */
enum { OUTLIER_FAR = 1, OUTLIER_OFF = 2 };

/* Where a scanner stood is known: it turns by the same angle from ray to ray, so points lie the farther apart the
 * farther they are from it, and distances between them are judged by their share of range[p], the distance of point p
 * from there (above 0).  NULL = not known, and points are judged as if all were as far. */

/* Sets outlier[p] of n distinct points (knn is over them) to one of these where p stands off, else to 0; *count of them
 * aren't 0.  Never more than half of the points.  The same for any number of threads, and for any scale and density of
 * the points.  O(n log n).  *planes, unless planes is NULL, are those it went by, for planes_free, or NULL for fewer
 * than OUTLIERS_MIN_POINTS.  STATUS_NO_MEMORY. */
enum status outliers_find(const struct knn *knn, const vec3 *point, const float *range, size_t n, unsigned threads,
                          uint8_t *outlier, size_t *count, struct planes **planes) MUST_CHECK;

/* Shares of places: far from all others and in no plane with them; of these, eight times as far as is usual. */
struct stray_shares {
    double far, alone;
};

/* *shares of at most OUTLIERS_PLACES of n distinct points (knn is over them), which is less than outliers_find finds; 0
 * for fewer than OUTLIERS_MIN_POINTS, and where 512 places have none that is far: of .01 one time in 170, of .005 one
 * time in 13.  Far are .038 and more of 5 % of strays in the bounding box, .005 to .01 of 1 %, of scans and solids
 * without up to .006, of trees and cities from the air up to .016; alone .0051 to .0073 of 1 % of strays, of the others
 * up to .0007.  O(log n).
 * known: what is near these 512, where it has been looked for; may be NULL.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum { OUTLIERS_PLACES = 4096 };
enum status outliers_estimate(const struct knn *knn, const vec3 *point, const float *range, size_t n, unsigned threads,
                              const struct shell_near *known, struct stray_shares *shares) MUST_CHECK;

/* From either share on a mesh has spikes and pieces of its own. */
#define OUTLIERS_MANY 0.02
#define OUTLIERS_ALONE 0.0025

/* Looks for strays among n points, however few, by the neighbourhoods of all.  *scattered: so many stand off, spread
 * between the others, and outliers_find will tell more of them; 0: they aren't.  Of what stands off in scans and scenes
 * without strays at most a fourth does so by eight times what is usual, and where 2 to 150 of 50 000 were added over a
 * third as a rule.
 *
 * off[p]: 1 where point p is eight times as far from those around it as these from each other, up to .035 % in cities
 * from the air, or five times where no more than eight points are 3.3 times as far, else 0; *count of them are 1.  Of
 * few points eight times what is usual may be more than a twentieth of the diagonal: that is enough then, and five
 * times at least, where ranges are not known, but both what is far from all and from those around it has to be
 * scattered.  Of fewer than OUTLIERS_MIN_SURVEYED points none is.  The same for any number of threads.  O(n).
 * STATUS_NO_MEMORY. */
enum { OUTLIERS_MIN_SURVEYED = 1000 };
enum status outliers_survey(const vec3 *point, const float *range, const struct neighbourhood *neighbours,
                            unsigned threads, uint8_t *off, size_t *count, size_t *scattered) MUST_CHECK;

#endif
