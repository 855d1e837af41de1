/* The offset of a point is how far it lies from the middle of its neighbours, along its normal.  On a smooth surface
 * without noise it comes from curvature, and its neighbours have nearly the same; so what is taken is the difference
 * between a point's offset and the mean of its neighbours' offsets.
 *
 * Of independent deviations e with variance 1 that difference is, with k neighbours that share some of theirs,
 *
 *     e_p (1 + 1/k)  -  about 1.6 / k of each neighbour's e,        variance (1 + 1/k)^2 + 2.56 / k
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/noise.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"

static const double OF_GAUSS = 1.4826; /* standard deviation by the median of absolute values */
/* Where every STEP_KEPT-th point or more is looked at, offsets are worked out once for all points: each is needed by
 * about as many points as it has neighbours. */
enum { STEP_KEPT = 6 };

struct offsets {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    double *kept; /* of every point; NULL: each is worked out when it is needed */
};

static double offset_of(const struct offsets *offsets, size_t p) {
    const struct neighbourhood *neighbours = offsets->neighbours;
    vec3 sum = {0, 0, 0};
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        uint32_t q = neighbours->id[p * neighbours->stride + i];
        sum = vec3_add(sum, vec3_sub(offsets->point[q], offsets->point[p]));
    }
    return neighbours->count[p] ? -vec3_dot(sum, offsets->normal[p]) / neighbours->count[p] : 0;
}

static double offset_at(const struct offsets *offsets, size_t p) {
    return offsets->kept ? offsets->kept[p] : offset_of(offsets, p);
}

static double difference_at(const struct offsets *offsets, size_t p) {
    const struct neighbourhood *neighbours = offsets->neighbours;
    double mean = 0;
    unsigned k = neighbours->count[p];
    if (k == 0) return 0;
    for (unsigned i = 0; i < k; i++) {
        uint32_t q = neighbours->id[p * neighbours->stride + i];
        double sign = vec3_dot(offsets->normal[p], offsets->normal[q]) < 0 ? -1 : 1;
        mean += sign * offset_at(offsets, q) / k;
    }
    double variance = (1 + 1.0 / k) * (1 + 1.0 / k) + 2.56 / k;
    return fabs(offset_at(offsets, p) - mean) / sqrt(variance);
}

enum status noise_estimate(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                           double *level) {
    size_t step = neighbours->n / NOISE_SAMPLES + 1, count = (neighbours->n + step - 1) / step;
    struct offsets offsets = {point, normal, neighbours, NULL};
    float *difference = alloc_array(count, sizeof *difference);
    double *kept = step <= STEP_KEPT ? alloc_array(neighbours->n, sizeof *kept) : NULL;
    enum status status = difference && (kept || step > STEP_KEPT) ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        for (size_t p = 0; kept && p < neighbours->n; p++) kept[p] = offset_of(&offsets, p);
        offsets.kept = kept;
        for (size_t i = 0; i < count; i++) difference[i] = (float)difference_at(&offsets, i * step);
        *level = count ? OF_GAUSS * (double)quantile_of(difference, count, 0.5) : 0;
    }
    free(difference), free(kept);
    return status;
}
