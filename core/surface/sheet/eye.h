/* Where a scan was taken from, where nobody says: points of one scan lie as rays from one place do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_EYE_H
#define WHITTLE_CORE_SURFACE_SHEET_EYE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

/* Places where a scanner may have stood: a grid around the points and a finer one among them. */
enum { EYE_AROUND = 9, EYE_WITHIN = 7 /* along an axis */ };
enum { EYE_PLACES = EYE_AROUND * EYE_AROUND * EYE_AROUND + EYE_WITHIN * EYE_WITHIN * EYE_WITHIN };
enum { EYE_POINTS = 4096 };

struct eye {
    bool found;
    vec3 at;
    double spread;  /* of how many points lie in equal parts of what is seen from there: interquartile, a logarithm */
    double layered; /* share of the points that lie in parts with a nearer and a farther surface */
    double seen;    /* of the sphere around it, the share where there are points */
    double uneven;  /* the same spread of how many points lie on equal parts of the surface */
};

/* The place that n points (distinct, in any frame) were scanned from: one from which they are evenly spread and behind
 * none of the others, where on the surface they aren't evenly spread.  origin, of the input's coordinates, is tried
 * first where it isn't far off, since scanners count from themselves.  Not found where points are of several scans from
 * different places, or have been made even.  By some thousands of points; .1 s of one processor where density varies,
 * else nothing.  The same for any number of threads.  STATUS_NO_MEMORY. */
enum status eye_find(const vec3 *point, size_t n, vec3 origin, unsigned threads, struct eye *eye) MUST_CHECK;

/* Fills place with those of 1 to EYE_POINTS points, but for strays; returns a step to try beside them. */
double eye_places(const vec3 *point, size_t n, vec3 place[EYE_PLACES]);

/* The first of these, around the points. */
enum { EYE_PLACES_AROUND = EYE_AROUND * EYE_AROUND * EYE_AROUND };
double eye_places_around(const vec3 *point, size_t n, vec3 place[EYE_PLACES_AROUND]);

/* Others: where the points are dense along each axis, as they are near a scanner, and somewhat beyond them. */
enum { EYE_DENSE = 9 /* along an axis */, EYE_PLACES_DENSE = EYE_DENSE * EYE_DENSE * EYE_DENSE };
void eye_places_dense(const vec3 *point, size_t n, vec3 place[EYE_PLACES_DENSE]);

/* Whether eye_find would seek: the points are so unevenly dense that a place may explain it.  Some thousandths of a
 * second.  STATUS_NO_MEMORY. */
enum status eye_is_sought(const vec3 *point, size_t n, unsigned threads, bool *sought) MUST_CHECK;

#endif
