/* Where parts of a scan were taken from, by the order of their points: a scanner turns by the same angle from one ray
 * to the next, and files keep that order.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_SWEEP_H
#define WHITTLE_CORE_SURFACE_SHEET_SWEEP_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

enum { SWEEP_PARTS = 64 };

/* Equal parts of the order, the k-th of n points being of part k * parts / n, and the place that each was seen from. */
struct sweep {
    size_t parts; /* a power of 2 up to SWEEP_PARTS; 0 = nothing is known */
    bool known[SWEEP_PARTS];
    vec3 eye[SWEEP_PARTS];
    double share;  /* of the parts, those that are known */
    size_t places; /* different ones among these */
    bool one;      /* all parts have the same place, and that exactly */
    bool complete; /* all parts were looked at */
};

/* The places that n points were scanned from, which are in the order that the scanner, or its file, has told them.
 * Where they are in another order, or from everywhere, nothing is known.  By some hundred steps of each part; some
 * tenths of a second of one processor where points of the order are near each other, else nothing; a fifth of that
 * where all that is asked is whether they have one place (one_alone), and no quarter of them has: then no part is
 * known.  The same for any number of threads.  STATUS_NO_MEMORY. */
enum status sweep_find(const vec3 *point, size_t n, bool one_alone, unsigned threads, struct sweep *sweep) MUST_CHECK;

#endif
