/* The place that one scan was taken from, whatever the order of its points: seen from there they are a lattice.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_LATTICE_H
#define WHITTLE_CORE_SURFACE_SHEET_LATTICE_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

struct knn;

struct lattice {
    bool found;
    vec3 at;
    double exact; /* share of the points that lie midway between others as seen from there */
    double usual; /* and from elsewhere */
};

/* The place from which n points are a lattice, where they are one from no other.  Up to three of four may be missing at
 * random where rays are exact, up to half where they aren't.  Not found of several scans, or of points that are a
 * lattice themselves.  knn: of the points.  Some tenths of a second of one processor.  The same for any number of
 * threads.  STATUS_NO_MEMORY. */
enum status lattice_find(const vec3 *point, size_t n, const struct knn *knn, unsigned threads,
                         struct lattice *lattice) MUST_CHECK;

/* Whether n points are a lattice as seen from a place, but neither from others nor from the one opposite, so that it is
 * where they were seen from: up to three of four may be missing at random.  Less than a tenth of the time.
 * STATUS_NO_MEMORY. */
enum status lattice_is_from(const vec3 *point, size_t n, const struct knn *knn, unsigned threads, vec3 place,
                            bool *is) MUST_CHECK;

#endif
