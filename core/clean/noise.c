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
#include "core/base/quantile.h"

static const double OF_GAUSS = 1.4826; /* standard deviation by the median of absolute values */

static double offset_of(const vec3 *point, const struct neighbourhood *neighbours, size_t p, vec3 normal) {
    vec3 sum = {0, 0, 0};
    for (unsigned i = 0; i < neighbours->count[p]; i++)
        sum = vec3_add(sum, vec3_sub(point[neighbours->id[p * neighbours->stride + i]], point[p]));
    return neighbours->count[p] ? -vec3_dot(sum, normal) / neighbours->count[p] : 0;
}

static double difference_at(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours, size_t p) {
    double mean = 0;
    unsigned k = neighbours->count[p];
    if (k == 0) return 0;
    for (unsigned i = 0; i < k; i++) {
        uint32_t q = neighbours->id[p * neighbours->stride + i];
        double sign = vec3_dot(normal[p], normal[q]) < 0 ? -1 : 1;
        mean += sign * offset_of(point, neighbours, q, normal[q]) / k;
    }
    double variance = (1 + 1.0 / k) * (1 + 1.0 / k) + 2.56 / k;
    return fabs(offset_of(point, neighbours, p, normal[p]) - mean) / sqrt(variance);
}

enum status noise_estimate(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbours,
                           double *level) {
    size_t step = neighbours->n / NOISE_SAMPLES + 1, count = (neighbours->n + step - 1) / step;
    float *difference = alloc_array(count, sizeof *difference);
    if (!difference) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < count; i++) difference[i] = (float)difference_at(point, normal, neighbours, i * step);
    *level = count ? OF_GAUSS * (double)quantile_of(difference, count, 0.5) : 0;
    free(difference);
    return STATUS_OK;
}
