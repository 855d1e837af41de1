/* Three rules, each for a kind of stray that the others can't see.  m_p is the mean distance to the eight nearest
 * neighbours, and all is judged by its logarithm, because spacings spread by factors, not by sums; a threshold is the
 * median and some median absolute deviations, which half of the points can't shift.
 *
 *  far      m_p is large against those of all points: dust in empty space
 *  apart    m_p is large against those of its neighbours: a stray close above a surface
 *  cluster  a component of the graph of neighbours with few points, and a wide gap around it
 *
 * Density that changes within a scan is no reason to drop anything: a point that the first two rules suspect is kept
 * where it lies in one plane with its neighbours.
 *
 * Rusu et al.: Towards 3D point cloud based object maps for household environments (2008) is the statistical filter
 * that the first rule comes from; Breunig et al.: LOF (2000) has the idea of the second.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/outliers.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/quantile.h"
#include "core/cloud/cloud.h"
#include "core/math/sym3.h"

enum { CHUNK = 2048, K = 8, CLUSTER_MOST = 48, CLUSTER_SHARE = 500 };
static const double DEVIATION = 1.4826;                  /* from a median absolute deviation to a standard one */
static const double FAR_DEVIATIONS = 4, FAR_LEAST = 0.9; /* e^0.9 = 2.5 times the usual spacing at least */
static const double APART_DEVIATIONS = 5, APART_LEAST = 0.6;
static const double FLAT = 0.02;       /* smallest over middle eigenvalue below which a suspect lies on a surface */
static const double CLUSTER_GAP = 1.6; /* logarithm of the gap over the usual m */

struct hunt {
    const struct knn *knn;
    const vec3 *point;
    size_t n;
    uint32_t *near;    /* n * K */
    float *log_m;      /* n */
    float *log_ratio;  /* n: against the neighbours' median */
    double far, apart; /* thresholds of the two */
    uint8_t *outlier;
    enum status *chunk_status;
};

/* ------------------------------------------------------------------------------------------------ spacing */

static enum status measure_chunk(const struct hunt *hunt, size_t begin, size_t end) {
    uint32_t found[CHUNK * (K + 1)];
    double distance_sq[CHUNK * (K + 1)];
    enum status status = knn_search(hunt->knn, &hunt->point[begin], end - begin, K + 1, 1, found, distance_sq);
    for (size_t p = begin; !status && p < end; p++) {
        size_t row = (p - begin) * (K + 1);
        double sum = 0;
        unsigned taken = 0;
        for (unsigned i = 0; i <= K && taken < K; i++) {
            if (found[row + i] == p) continue;
            hunt->near[p * K + taken++] = found[row + i];
            sum += sqrt(distance_sq[row + i]);
        }
        hunt->log_m[p] = (float)log(fmax(sum / K, DBL_MIN));
    }
    return status;
}

static void measure_range(void *ctx, size_t begin, size_t end) {
    struct hunt *hunt = ctx;
    hunt->chunk_status[begin / CHUNK] = measure_chunk(hunt, begin, end);
}

static void compare_range(void *ctx, size_t begin, size_t end) {
    const struct hunt *hunt = ctx;
    for (size_t p = begin; p < end; p++) {
        float m[K];
        for (unsigned i = 0; i < K; i++) m[i] = hunt->log_m[hunt->near[p * K + i]];
        hunt->log_ratio[p] = hunt->log_m[p] - quantile_of(m, K, 0.5);
    }
}

/* ------------------------------------------------------------------------------------------------ suspects */

/* Whether p and its neighbours lie in one plane: not on a line, as a stray and the surface far below it nearly do. */
static int is_flat(const struct hunt *hunt, size_t p) {
    vec3 sum = {0, 0, 0}, axis[3];
    sym3 moment = {0};
    double value[3];
    for (unsigned i = 0; i < K; i++) {
        vec3 e = vec3_sub(hunt->point[hunt->near[p * K + i]], hunt->point[p]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    sym3_eigen(sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / (K + 1))), value, axis);
    return value[0] <= FLAT * value[1];
}

static void suspect_range(void *ctx, size_t begin, size_t end) {
    const struct hunt *hunt = ctx;
    for (size_t p = begin; p < end; p++) {
        int suspect = (double)hunt->log_m[p] > hunt->far || (double)hunt->log_ratio[p] > hunt->apart;
        hunt->outlier[p] = suspect && !is_flat(hunt, p);
    }
}

/* ------------------------------------------------------------------------------------------------ clusters */

static uint32_t root_of(uint32_t *parent, uint32_t p) {
    while (parent[p] != p) p = parent[p] = parent[parent[p]];
    return p;
}

static void join(uint32_t *parent, uint32_t *size, uint32_t a, uint32_t b) {
    a = root_of(parent, a), b = root_of(parent, b);
    if (a == b) return;
    uint32_t low = a < b ? a : b, high = a < b ? b : a;
    parent[high] = low;
    size[low] += size[high];
}

/* Components of the neighbours' graph without the outliers so far; parent leads to the lowest id of each. */
static void find_components(const struct hunt *hunt, uint32_t *parent, uint32_t *size) {
    for (size_t p = 0; p < hunt->n; p++) parent[p] = (uint32_t)p, size[p] = 1;
    for (size_t p = 0; p < hunt->n; p++)
        for (unsigned i = 0; i < K && !hunt->outlier[p]; i++) {
            uint32_t q = hunt->near[p * K + i];
            if (!hunt->outlier[q]) join(parent, size, (uint32_t)p, q);
        }
}

/* The distance from p to the nearest point that is neither in its component nor an outlier; infinity past the nearest
 * KNN_MAX_K.  More than the component's size are asked for, so none is a long way off. */
static enum status gap_at(const struct hunt *hunt, uint32_t *parent, size_t p, double *gap) {
    uint32_t found[KNN_MAX_K], root = root_of(parent, (uint32_t)p);
    double distance_sq[KNN_MAX_K];
    enum status status = knn_search(hunt->knn, &hunt->point[p], 1, KNN_MAX_K, 1, found, distance_sq);
    if (status) return status;
    unsigned i = 0;
    while (i < KNN_MAX_K && found[i] != NONE && (hunt->outlier[found[i]] || root_of(parent, found[i]) == root)) i++;
    *gap = i < KNN_MAX_K && found[i] != NONE ? sqrt(distance_sq[i]) : INFINITY;
    return STATUS_OK;
}

/* keep[root] of each small component becomes 1 where some point of it has a neighbour within `gap`. */
static enum status find_near_components(const struct hunt *hunt, uint32_t *parent, const uint32_t *size, double limit,
                                        uint8_t *keep) {
    size_t most = hunt->n / CLUSTER_SHARE < CLUSTER_MOST ? hunt->n / CLUSTER_SHARE : CLUSTER_MOST;
    enum status status = STATUS_OK;
    for (size_t p = 0; p < hunt->n && !status; p++) {
        uint32_t root = root_of(parent, (uint32_t)p);
        double gap = 0;
        if (!hunt->outlier[p] && !keep[root] && size[root] <= most) status = gap_at(hunt, parent, p, &gap);
        if (gap <= limit) keep[root] = 1;
    }
    return status;
}

static enum status drop_clusters(const struct hunt *hunt, double limit) {
    uint32_t *parent = alloc_array(hunt->n, sizeof *parent), *size = alloc_array(hunt->n, sizeof *size);
    uint8_t *keep = alloc_zeroed(hunt->n, sizeof *keep);
    enum status status = parent && size && keep ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) find_components(hunt, parent, size);
    if (!status) status = find_near_components(hunt, parent, size, limit, keep);
    for (size_t p = 0; p < hunt->n && !status; p++)
        if (!hunt->outlier[p] && !keep[root_of(parent, (uint32_t)p)]) hunt->outlier[p] = 1;
    free(parent), free(size), free(keep);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status thresholds(struct hunt *hunt, double *usual_m) {
    double far_mad, apart_mad, ratio;
    enum status status = quantile_spread(hunt->log_m, hunt->n, usual_m, &far_mad);
    if (!status) status = quantile_spread(hunt->log_ratio, hunt->n, &ratio, &apart_mad);
    if (status) return status;
    hunt->far = *usual_m + fmax(FAR_DEVIATIONS * DEVIATION * far_mad, FAR_LEAST);
    hunt->apart = ratio + fmax(APART_DEVIATIONS * DEVIATION * apart_mad, APART_LEAST);
    return STATUS_OK;
}

static enum status hunt_all(struct hunt *hunt, unsigned threads) {
    double usual_m = 0;
    par_for(threads, hunt->n, CHUNK, measure_range, hunt);
    for (size_t i = 0; i <= hunt->n / CHUNK; i++)
        if (hunt->chunk_status[i]) return hunt->chunk_status[i];
    par_for(threads, hunt->n, CHUNK, compare_range, hunt);
    enum status status = thresholds(hunt, &usual_m);
    if (status) return status;
    par_for(threads, hunt->n, CHUNK, suspect_range, hunt);
    return drop_clusters(hunt, exp(fmax(hunt->far, usual_m + CLUSTER_GAP)));
}

enum status outliers_find(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, uint8_t *outlier,
                          size_t *count) {
    struct hunt hunt = {.knn = knn, .point = point, .n = n, .outlier = outlier};
    enum status status = STATUS_NO_MEMORY;
    size_t found = 0;
    if (n < OUTLIERS_MIN_POINTS) goto none;
    hunt.near = alloc_array(n, K * sizeof *hunt.near);
    hunt.log_m = alloc_array(n, sizeof *hunt.log_m);
    hunt.log_ratio = alloc_array(n, sizeof *hunt.log_ratio);
    hunt.chunk_status = alloc_zeroed(n / CHUNK + 1, sizeof *hunt.chunk_status);
    if (hunt.near && hunt.log_m && hunt.log_ratio && hunt.chunk_status) status = hunt_all(&hunt, threads);
    free(hunt.near), free(hunt.log_m), free(hunt.log_ratio), free(hunt.chunk_status);
    if (status) return status;
    for (size_t p = 0; p < n; p++) found += outlier[p];
    if (found > n / 2) goto none;
    *count = found;
    return STATUS_OK;
none:
    memset(outlier, 0, n);
    *count = 0;
    return STATUS_OK;
}
