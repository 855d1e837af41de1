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
#include "core/math/sym3.h"

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

/* ------------------------------------------------------------------------------------------------ where it is least */

enum { AROUND = 16, TERMS = 6, PLACES = 2048 };

static double dot_of(const double a[AROUND], const double b[AROUND]) {
    double sum = 0;
    for (int i = 0; i < AROUND; i++) sum += a[i] * b[i];
    return sum;
}

/* What is left of a column without its parts along orthogonal ones, which are zero or unit. */
static void take_out(double (*unit)[AROUND], int n, double column[AROUND]) {
    for (int k = 0; k < n; k++) {
        double along = dot_of(unit[k], column);
        for (int i = 0; i < AROUND; i++) column[i] -= along * unit[k][i];
    }
}

/* The root mean square of what the points are off the quadratic surface that fits them best, seen along the normal of
 * their plane: Gram and Schmidt's way from term to term. */
static double off_quadratic(const vec3 *point, const uint32_t id[AROUND]) {
    static const double DEPENDENT = 1e-9; /* of a column's square */
    vec3 middle = {0}, axis[3];
    sym3 moment = {0};
    double value[3], term[TERMS][AROUND], height[AROUND];
    int rank = 0;
    for (int i = 0; i < AROUND; i++) middle = vec3_add(middle, vec3_scale(point[id[i]], 1.0 / AROUND));
    for (int i = 0; i < AROUND; i++) moment = sym3_add(moment, sym3_outer(vec3_sub(point[id[i]], middle)));
    sym3_eigen(moment, value, axis);
    double unit = sqrt(fmax(value[2], 0) / AROUND);
    if (!(unit > 0)) return 0;
    for (int i = 0; i < AROUND; i++) {
        vec3 to = vec3_scale(vec3_sub(point[id[i]], middle), 1 / unit);
        double x = vec3_dot(to, axis[2]), y = vec3_dot(to, axis[1]);
        term[0][i] = 1, term[1][i] = x, term[2][i] = y, term[3][i] = x * x, term[4][i] = x * y, term[5][i] = y * y;
        height[i] = vec3_dot(to, axis[0]);
    }
    for (int k = 0; k < TERMS; k++) {
        double before = dot_of(term[k], term[k]);
        take_out(term, k, term[k]);
        double left = dot_of(term[k], term[k]), length = left > DEPENDENT * before ? sqrt(left) : 0;
        for (int i = 0; i < AROUND; i++) term[k][i] = length > 0 ? term[k][i] / length : 0;
        rank += length > 0;
    }
    take_out(term, TERMS, height);
    return unit * sqrt(dot_of(height, height) / (AROUND - rank));
}

/* Of a place's nearest points, the first of which is itself. */
static double spacing_at_place(const double *distance_sq) {
    enum { NEXT = 8 };
    double sum = 0;
    for (int i = 1; i <= NEXT; i++) sum += sqrt(distance_sq[i]);
    return sum / NEXT;
}

enum status noise_where_least(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share) {
    static const double LEAST = 0.1; /* of the places */
    size_t places = n < PLACES ? n : PLACES;
    if (n <= AROUND) {
        *share = 1;
        return STATUS_OK;
    }
    vec3 *at = alloc_array(places, sizeof *at);
    uint32_t *id = alloc_array(places * (AROUND + 1), sizeof *id);
    double *distance_sq = alloc_array(places * (AROUND + 1), sizeof *distance_sq);
    float *off = alloc_array(places, sizeof *off);
    enum status status = at && id && distance_sq && off ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < places; i++) at[i] = point[i * n / places];
    if (!status) status = knn_search(knn, at, places, AROUND + 1, threads, id, distance_sq);
    for (size_t i = 0; !status && i < places; i++) {
        const size_t first = i * (AROUND + 1);
        off[i] = (float)(off_quadratic(point, &id[first + 1]) / spacing_at_place(&distance_sq[first]));
    }
    if (!status) *share = (double)quantile_of(off, places, LEAST);
    free(at), free(id), free(distance_sq), free(off);
    return status;
}
