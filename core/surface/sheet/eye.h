/* Where a scanner may have stood, and whether points tell of one: they lie as rays from one place do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_EYE_H
#define WHITTLE_CORE_SURFACE_SHEET_EYE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Places to try: a grid around the points and a finer one among them. */
enum { EYE_AROUND = 9, EYE_WITHIN = 7 /* along an axis */ };
enum { EYE_PLACES = EYE_AROUND * EYE_AROUND * EYE_AROUND + EYE_WITHIN * EYE_WITHIN * EYE_WITHIN };
enum { EYE_POINTS = 4096 };

/* Fills place with those of 1 to EYE_POINTS points, but for strays; returns a step to try beside them. */
double eye_places(const vec3 *point, size_t n, vec3 place[EYE_PLACES]);

/* The first of these, around the points. */
enum { EYE_PLACES_AROUND = EYE_AROUND * EYE_AROUND * EYE_AROUND };
double eye_places_around(const vec3 *point, size_t n, vec3 place[EYE_PLACES_AROUND]);

/* Others: where the points are dense along each axis, as they are near a scanner, and somewhat beyond them. */
enum { EYE_DENSE = 9 /* along an axis */, EYE_PLACES_DENSE = EYE_DENSE * EYE_DENSE * EYE_DENSE };
void eye_places_dense(const vec3 *point, size_t n, vec3 place[EYE_PLACES_DENSE]);

/* Whether a place may be sought: points are dense near a scanner and sparse far from it, so n of them (distinct, in any
 * frame) are uneven.  Those of few points or of a solid's skin aren't.  The same for any number of threads.  Some
 * thousandths of a second.  STATUS_NO_MEMORY. */
enum status eye_is_sought(const vec3 *point, size_t n, unsigned threads, bool *sought) MUST_CHECK;

#endif
