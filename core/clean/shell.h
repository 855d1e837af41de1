/* Whether points are a thick shell rather than a surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_SHELL_H
#define WHITTLE_CORE_CLEAN_SHELL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

enum { SHELL_MIN_POINTS = 1000 };

/* *share of the places that were looked at where n distinct points scatter about a surface by more than about half the
 * distance between them: near ones fill a ball, many more of them a disk.  Not edges, leaves and other shapes that are
 * as thick for their width however widely one looks, nor the steps of a depth camera, whose near points lie in one
 * plane.  0 for fewer than SHELL_MIN_POINTS.  Points should be in an order that keeps near ones near; knn is of them.
 * The same for any number of threads.  At most SHELL_PLACES places, but O(n log n) where those look noisy.
 * STATUS_NO_MEMORY, STATUS_LIMIT. */
enum { SHELL_PLACES = 1024 };

/* The nearest points of SHELL_ROWS places evenly along the points, every second of those that are looked at: rows of
 * SHELL_NEAR, the place itself among them. */
enum { SHELL_ROWS = SHELL_PLACES / 2, SHELL_NEAR = 9 };
struct shell_near {
    uint32_t id[SHELL_ROWS * SHELL_NEAR];
    double distance_sq[SHELL_ROWS * SHELL_NEAR];
};

/* near and filled may be NULL; *near is filled where there are SHELL_PLACES points or more, and then *filled is true.
 */
enum status shell_find(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share,
                       struct shell_near *near, bool *filled) MUST_CHECK;

/* From this share on a surface of the points is crumpled unless they are smoothed: rooms by depth cameras have .25 and
 * more, range maps, laser scans, trees and statues up to .13. */
#define SHELL_MANY 0.2

#endif
