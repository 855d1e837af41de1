/* The largest distance from a surface to a target, which samples alone miss: it lies in a corner or on an edge.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_LARGEST_H
#define WHITTLE_CORE_MEASURE_LARGEST_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"

enum { LARGEST_BATCH = 4096 };

struct largest_search {
    const struct mesh *from;
    const float *seen;     /* of each of its triangles: the largest distance of a sample on it; 0 where it has none */
    const struct mesh *to; /* whose triangles `nearest` names; NULL = distances are to something else than a surface */
    /* distance[i] and, where `to` is given, nearest[i] of n <= LARGEST_BATCH positions; any threads. */
    enum status (*measure)(void *ctx, const vec3 *position, size_t n, double *distance, uint32_t *nearest);
    void *ctx;
    unsigned threads;
};

/* Raises *largest, the largest distance known so far, by what the search finds.  To a surface the result is below the
 * true maximum by at most LARGEST_SLACK of it, unless more than a few thousand pieces might hold it at once: then, and
 * to other targets, the search goes on where distances are largest.  About one distance for each triangle (none where
 * there is no surface), and at most 50 000 more.  The same for any number of threads.  STATUS_NO_MEMORY, and what
 * measure returns.
 *
 * Source: branch and bound as in Tang, Lee, Kim: Interactive Hausdorff distance computation for general polygonal
 * models (2009), with the bound of a convex target. */
#define LARGEST_SLACK 0.02
enum status largest_distance(const struct largest_search *search, double *largest) MUST_CHECK;

#endif
