/* Nobody sees points from the middle of the sphere that they lie on, but as the inside of a dome, and domes have
 * floors; there are many globes.  A plane has the middle of its sphere far off.
 *
 *        . - ~ - .           spread: from the nearest to the middle to the farthest, but for a twentieth of either
 *      /     |     \         bend:   how far the sphere stands out of a chord that has the points above it, both by
 *     ---------------                the distance from the middle
 *            o
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/globe.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"

enum { POINTS = 4096 };
static const double OUTER = 0.05;       /* share of the points on either end that doesn't count */
static const double SPREAD_MOST = 0.15; /* mountains that are drawn ten times as high have .02 */
static const double OF_BEND = 0.35;
static const double BEND_LEAST =
    0.1;                          /* of 26 degrees on either side: less may be a dish, and where up is tells of maps */
static const double BESIDE = 0.8; /* of the radius: parallels are nearly as even from beside the middle */

static const double MAP_LEAST = 0.01; /* bend of eight degrees on either side */
static const double MAP_MOST = 0.6;   /* of 66: bowls are modelled around the origin as well */

/* Some of the points. */
struct some_points {
    const vec3 *point;
    size_t n, step;
};

/* The middle of the sphere that is nearest to them: of (|p|^2 - 2 m p - c)^2 the least sum, p from their mean on. */
static vec3 find_middle(const struct some_points *some) {
    vec3 mean = {0, 0, 0}, right = {0, 0, 0}, middle = {0, 0, 0}, axis[3];
    sym3 moment = {0};
    double square = 0, value[3], count = (double)((some->n - 1) / some->step + 1);
    for (size_t i = 0; i < some->n; i += some->step) mean = vec3_add(mean, vec3_scale(some->point[i], 1 / count));
    for (size_t i = 0; i < some->n; i += some->step) square += vec3_distance_sq(some->point[i], mean) / count;
    for (size_t i = 0; i < some->n; i += some->step) {
        vec3 p = vec3_sub(some->point[i], mean);
        moment = sym3_add(moment, sym3_outer(p));
        right = vec3_add(right, vec3_scale(p, (vec3_length_sq(p) - square) / 2));
    }
    sym3_eigen(moment, value, axis);
    for (int k = 0; k < 3; k++)
        if (value[k] > 0) middle = vec3_add(middle, vec3_scale(axis[k], vec3_dot(axis[k], right) / value[k]));
    return vec3_add(mean, middle);
}

/* What is seen of them from a place. */
struct seen_around {
    double spread, bend, range;
};

static enum status look_from_middle(const struct some_points *some, vec3 place, struct seen_around *seen) {
    float *range = alloc_array(POINTS, sizeof *range), *along = alloc_array(POINTS, sizeof *along);
    enum status status = range && along ? STATUS_OK : STATUS_NO_MEMORY;
    vec3 sum = {0, 0, 0};
    size_t count = 0;
    for (size_t i = 0; i < some->n && !status; i += some->step, count++)
        sum = vec3_add(sum, vec3_unit(vec3_sub(some->point[i], place)));
    vec3 middle = vec3_unit(sum);
    count = 0;
    for (size_t i = 0; i < some->n && !status; i += some->step, count++) {
        vec3 to = vec3_sub(some->point[i], place);
        range[count] = (float)vec3_length(to), along[count] = (float)vec3_dot(vec3_unit(to), middle);
    }
    if (!status) {
        seen->range = (double)quantile_of(range, count, 0.5);
        seen->spread = (double)quantile_of(range, count, 1 - OUTER) - (double)quantile_of(range, count, OUTER);
        seen->bend = fmin(1 - (double)quantile_of(along, count, 2 * OUTER), 1);
    }
    free(range), free(along);
    return status;
}

enum status globe_is_around(const vec3 *point, size_t n, vec3 place, vec3 *middle, bool *is) {
    struct some_points some = {point, n, (n + POINTS - 1) / POINTS};
    struct seen_around seen;
    *is = false;
    if (n == 0) return STATUS_OK;
    *middle = find_middle(&some);
    enum status status = look_from_middle(&some, *middle, &seen);
    if (status) return status;
    *is = seen.bend > BEND_LEAST && seen.spread < fmin(SPREAD_MOST, OF_BEND * seen.bend) * seen.range &&
          vec3_distance(place, *middle) < BESIDE * seen.range;
    return STATUS_OK;
}

enum status globe_is_map(const vec3 *point, size_t n, vec3 origin, bool *is) {
    const struct some_points some = {point, n, (n + POINTS - 1) / POINTS};
    struct seen_around seen;
    *is = false;
    enum status status = n > 0 ? look_from_middle(&some, origin, &seen) : STATUS_OK;
    if (status || n == 0) return status;
    *is = seen.bend > MAP_LEAST && seen.bend < MAP_MOST && seen.spread < OF_BEND * seen.bend * seen.range;
    return STATUS_OK;
}
