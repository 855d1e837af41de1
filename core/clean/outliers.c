/* Four rules, each for a kind of stray that the others can't see.  m_p is the mean distance to the eight nearest
 * neighbours, and all is judged by its logarithm, because spacings spread by factors, not by sums; a threshold is the
 * median and some median absolute deviations, which half of the points can't shift.
 *
 *  far      m_p is large against those of all points: dust in empty space
 *  apart    m_p is large against those of its neighbours: a stray close above a surface
 *  cluster  a component of the graph of neighbours with few points, and a wide gap around it, unless it is a piece of
 *           a surface: flat, or as dense as the cloud.  Where all was seen along rays only the smallest are dropped:
 *           gaps between rings on far ground grow with the square of the distance, and what stands before a background
 *           has one behind it
 *
 *  off      it lies off the tangent planes of all its neighbours but one: a stray within a spacing of a surface
 *
 * Density that changes within a scan is no reason to drop anything: a point that the first two rules suspect is kept
 * where it lies in one plane with its neighbours.  The last rule judges suspects too, by planes that no suspect has a
 * part in: who fits them and isn't far from them stays, such as the few points inside of a nostril.  And what lies
 * along a line of points is a scanner's ring, however far off.
 *
 * Rusu et al.: Towards 3D point cloud based object maps for household environments (2008) is the statistical filter
 * that the first rule comes from; Breunig et al.: LOF (2000) has the idea of the second.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/outliers.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/clean/offsets.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"

enum {
    CHUNK = 2048,
    K = 8,
    CLUSTER_MOST = 48,
    CLUSTER_MOST_SEEN = 3,
    CLUSTER_SHARE = 500,
    JUDGED = 2,
    COMPANY = 4,
    COMPANY_MORE = 2
};
static const double DEVIATION = 1.4826;                  /* from a median absolute deviation to a standard one */
static const double FAR_DEVIATIONS = 4, FAR_LEAST = 0.9; /* e^0.9 = 2.5 times the usual spacing at least */
static const double ALONE = 2.1;                         /* e^2.1 = 8 times */
static const double APART_DEVIATIONS = 5, APART_LEAST = 0.6;
static const double FLAT = 0.02;       /* smallest over middle eigenvalue below which a suspect lies on a surface */
static const double SHEET = 0.1;       /* the same, which half of what is around strays stays above */
static const double CLUSTER_GAP = 1.6; /* logarithm of the gap over the usual m */
static const double AS_DENSE = 0.5;    /* the same of a piece's points: 1.65 times */
/* Off by so many times what is usual beside it and what is rough there; by so much of the neighbourhood's radius, and
 * by so many times what a quarter of all points exceed, of theirs. */
static const float OFF_USUAL = 8, OFF_ROUGH = 4, OFF_RADIUS = 0.1F, OFF_NOISE = 5;
static const float SPARSE = 3;          /* as far from others as a point beside them may be */
static const double COMPANY_NEAR = 0.5; /* distance to the COMPANY-th nearest other outlier, over its median */

struct hunt {
    const struct knn *knn;
    const vec3 *point;
    const float *range; /* NULL: not known */
    size_t n;
    uint32_t *near;    /* n * K */
    float *log_m;      /* n */
    float *log_ratio;  /* n: against the neighbours' median */
    double far, apart; /* thresholds of the two */
    uint8_t *outlier;
    struct planes *planes;
};

static double range_of(const float *range, size_t p) { return range ? (double)range[p] : 1; }

/* ------------------------------------------------------------------------------------------------ spacing */

static void measure_range(void *ctx, size_t begin, size_t end) {
    struct hunt *hunt = ctx;
    for (size_t p = begin; p < end; p++) {
        const uint32_t *near = planes_near(hunt->planes, p);
        double sum = 0;
        for (unsigned i = 0; i < K; i++) sum += vec3_distance(hunt->point[p], hunt->point[near[i]]);
        memcpy(&hunt->near[p * K], near, K * sizeof *near);
        hunt->log_m[p] = (float)log(fmax(sum / K / range_of(hunt->range, p), DBL_MIN));
    }
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

/* How a place and its k neighbours are spread: along axis[2] the most, by value[2] (squared, summed). */
static void find_spread(const vec3 *point, vec3 place, const uint32_t *near, unsigned k, double value[3],
                        vec3 axis[3]) {
    vec3 sum = {0, 0, 0};
    sym3 moment = {0};
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[near[i]], place);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    sym3_eigen(sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / (k + 1))), value, axis);
}

/* How thick they are for their width, of the plane that fits: squared, 0 to 1. */
static double flatness_of(const vec3 *point, vec3 place, const uint32_t *near, unsigned k) {
    double value[3];
    vec3 axis[3];
    find_spread(point, place, near, k, value, axis);
    return value[1] > 0 ? fmax(value[0], 0) / value[1] : 0;
}

/* Who was sampled by need, densely where it bends, has a good part of its points far from others, and these are of a
 * surface as well: strays are no share of a cloud so large, or are as thick around themselves as they are wide.  Of n
 * points so many are far, and these are the flatnesses of some of them, which are scratch. */
static bool is_sampled_by_need(size_t n, size_t far, float *flatness, size_t some) {
    static const double FAR_SHARE = 0.05;
    return (double)far > FAR_SHARE * (double)n && (double)quantile_of(flatness, some, 0.5) < SHEET;
}

/* Whether they lie in one plane, and are at least so wide in it for their length (squared): a stray and the surface far
 * below it nearly lie on a line. */
static bool is_flat(const vec3 *point, vec3 place, const uint32_t *near, unsigned k, double least_width) {
    double value[3];
    vec3 axis[3];
    find_spread(point, place, near, k, value, axis);
    return value[0] <= FLAT * value[1] && value[1] >= least_width * value[2];
}

static int ascending(const void *a, const void *b) {
    const double *x = a, *y = b;
    return (*x > *y) - (*x < *y);
}

/* Whether they are along one line that has points all along it, as far off a scanner's ring is; a stray beyond the end
 * of some, or far above a surface, has a gap before it. */
static bool is_on_line(const vec3 *point, vec3 place, const uint32_t near[K]) {
    static const double THIN = 0.01, GAP = 0.5; /* middle over largest eigenvalue; of the length */
    double value[3], at[K + 1], widest = 0;
    vec3 axis[3];
    find_spread(point, place, near, K, value, axis);
    if (value[1] > THIN * value[2]) return false;
    at[K] = 0;
    for (unsigned i = 0; i < K; i++) at[i] = vec3_dot(vec3_sub(point[near[i]], place), axis[2]);
    qsort(at, K + 1, sizeof *at, ascending);
    for (unsigned i = 1; i <= K; i++) widest = fmax(widest, at[i] - at[i - 1]);
    return widest <= GAP * (at[K] - at[0]);
}

static void suspect_range(void *ctx, size_t begin, size_t end) {
    const struct hunt *hunt = ctx;
    for (size_t p = begin; p < end; p++) {
        int suspect = (double)hunt->log_m[p] > hunt->far || (double)hunt->log_ratio[p] > hunt->apart;
        hunt->outlier[p] = suspect && !is_flat(hunt->point, hunt->point[p], &hunt->near[p * K], K, 0);
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

/* The distance, by range, from p to the nearest point that is neither in its component nor an outlier; infinity past
 * the nearest KNN_MAX_K.  More than the component's size are asked for, so none is a long way off. */
static enum status gap_at(const struct hunt *hunt, uint32_t *parent, size_t p, double *gap) {
    uint32_t found[KNN_MAX_K], root = root_of(parent, (uint32_t)p);
    double distance_sq[KNN_MAX_K];
    enum status status = knn_search(hunt->knn, &hunt->point[p], 1, KNN_MAX_K, 1, found, distance_sq);
    if (status) return status;
    unsigned i = 0;
    while (i < KNN_MAX_K && found[i] != NONE && (hunt->outlier[found[i]] || root_of(parent, found[i]) == root)) i++;
    *gap = i < KNN_MAX_K && found[i] != NONE ? sqrt(distance_sq[i]) / range_of(hunt->range, p) : INFINITY;
    return STATUS_OK;
}

/* keep[root] of each small component becomes 1 where some point of it has a neighbour within `gap`. */
static enum status find_near_components(const struct hunt *hunt, uint32_t *parent, const uint32_t *size, double limit,
                                        uint8_t *keep) {
    size_t most = hunt->range ? CLUSTER_MOST_SEEN : CLUSTER_MOST;
    if (most > hunt->n / CLUSTER_SHARE) most = hunt->n / CLUSTER_SHARE;
    enum status status = STATUS_OK;
    for (size_t p = 0; p < hunt->n && !status; p++) {
        uint32_t root = root_of(parent, (uint32_t)p);
        double gap = 0;
        if (!hunt->outlier[p] && !keep[root] && size[root] <= most) status = gap_at(hunt, parent, p, &gap);
        if (gap <= limit) keep[root] = 1;
    }
    return status;
}

/* keep[root] of each small component becomes 1 that is a piece of a surface, such as what is seen through a gap: more
 * than a point's nearest, half of which or more lie in a plane with theirs, or are as near to theirs as the points of
 * the whole cloud are. */
static void find_pieces(const struct hunt *hunt, uint32_t *parent, const uint32_t *size, double usual_m,
                        uint32_t *of_surface, uint8_t *keep) {
    for (size_t p = 0; p < hunt->n; p++) {
        uint32_t root = root_of(parent, (uint32_t)p);
        if (hunt->outlier[p] || keep[root] || size[root] > CLUSTER_MOST || size[root] <= K) continue;
        of_surface[root] += (double)hunt->log_m[p] < usual_m + AS_DENSE ||
                            flatness_of(hunt->point, hunt->point[p], &hunt->near[p * K], K) < SHEET;
        keep[root] = 2 * of_surface[root] >= size[root];
    }
}

static enum status drop_clusters(const struct hunt *hunt, double usual_m, double limit) {
    uint32_t *parent = alloc_array(hunt->n, sizeof *parent), *size = alloc_array(hunt->n, sizeof *size);
    uint32_t *of_surface = alloc_zeroed(hunt->n, sizeof *of_surface);
    uint8_t *keep = alloc_zeroed(hunt->n, sizeof *keep);
    enum status status = parent && size && of_surface && keep ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) find_components(hunt, parent, size);
    if (!status) find_pieces(hunt, parent, size, usual_m, of_surface, keep);
    if (!status) status = find_near_components(hunt, parent, size, limit, keep);
    for (size_t p = 0; p < hunt->n && !status; p++)
        if (!hunt->outlier[p] && !keep[root_of(parent, (uint32_t)p)]) hunt->outlier[p] = 1;
    free(parent), free(size), free(of_surface), free(keep);
    return status;
}

/* ------------------------------------------------------------------------------------------------ off surfaces */

/* Of the neighbourhood's radius: how far off no point is that isn't a stray. */
static enum status find_limit(const struct hunt *hunt, const struct offsets *offsets, float *limit) {
    float *relative = alloc_array(hunt->n, sizeof *relative);
    if (!relative) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < hunt->n; p++) relative[p] = offsets->quarter[p] / offsets->radius[p];
    *limit = fmaxf(OFF_RADIUS, OFF_NOISE * quantile_of(relative, hunt->n, 0.75));
    free(relative);
    return STATUS_OK;
}

/* Whether a suspect's neighbours are sparse for want of trusted points alone: some points of a surface that went out of
 * sight are near each other, and far from all else but strays, which would be as far from each other. */
static bool is_far_from_few(const struct hunt *hunt, size_t p) {
    const uint32_t *near = planes_near(hunt->planes, p);
    float m[OFFSETS_K];
    double sum = 0;
    for (unsigned i = 0; i < OFFSETS_K; i++) m[i] = hunt->log_m[near[i]];
    for (unsigned i = 0; i < K; i++) sum += vec3_distance(hunt->point[p], hunt->point[near[i]]);
    return log(fmax(sum / K / range_of(hunt->range, p), DBL_MIN)) >
           (double)quantile_of(m, OFFSETS_K, 0.75) + log((double)SPARSE);
}

/* Judges each point again by the planes of those that aren't outliers so far. */
static enum status judge(struct hunt *hunt, uint8_t *trusted, unsigned threads) {
    const struct offsets *offsets = NULL;
    size_t left = 0;
    float limit = 0;
    for (size_t p = 0; p < hunt->n; p++) left += trusted[p] = !hunt->outlier[p];
    if (left < OUTLIERS_MIN_POINTS) return STATUS_OK;
    enum status status = planes_measure(hunt->planes, trusted, threads, &offsets);
    if (!status) status = find_limit(hunt, offsets, &limit);
    for (size_t p = 0; p < hunt->n && !status; p++) {
        float off = offsets->second[p];
        bool is_off = off > OFF_USUAL * offsets->usual[p] && off > OFF_ROUGH * offsets->rough[p] &&
                      off > limit * offsets->radius[p];
        bool is_sparse = offsets->sparsity[p] > SPARSE || (hunt->outlier[p] && is_far_from_few(hunt, p));
        hunt->outlier[p] = is_sparse ? OUTLIER_FAR : is_off ? OUTLIER_OFF : 0;
    }
    return status;
}

/* has_company[i]: far more of the m strays are near stray i than is usual.  near: m rows of the COMPANY nearest. */
static enum status find_company(const vec3 *stray, size_t m, unsigned threads, uint32_t *near, uint8_t *has_company) {
    struct knn *knn = NULL;
    float *apart = alloc_array(m, sizeof *apart);
    double usual = 0, mad;
    enum status status = apart ? knn_new(stray, m, threads, &knn, NULL) : STATUS_NO_MEMORY;
    for (size_t i = 0; i < m && !status; i++) {
        uint32_t found[COMPANY + 1];
        double distance_sq[COMPANY + 1];
        status = knn_search(knn, &stray[i], 1, COMPANY + 1, 1, found, distance_sq);
        if (status) break;
        apart[i] = (float)sqrt(distance_sq[COMPANY]);
        for (size_t j = 0, taken = 0; j <= COMPANY && taken < COMPANY; j++)
            if (found[j] != i) near[i * COMPANY + taken++] = found[j];
    }
    if (!status) status = quantile_spread(apart, m, &usual, &mad);
    for (size_t i = 0; i < m && !status; i++) has_company[i] = (double)apart[i] < COMPANY_NEAR * usual;
    knn_free(knn);
    free(apart);
    return status;
}

/* Strays are scattered, and what was taken for some of them in a place with few points comes together: outliers of
 * which far more others are near than is usual are none.  By chance that is so of some strays, but not of those around
 * them too. */
static enum status keep_company(struct hunt *hunt, unsigned threads) {
    size_t m = 0;
    vec3 *stray = alloc_array(hunt->n, sizeof *stray);
    uint8_t *has_company = alloc_array(hunt->n, sizeof *has_company);
    uint32_t *near = NULL;
    enum status status = stray && has_company ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < hunt->n && !status; p++)
        if (hunt->outlier[p]) stray[m++] = hunt->point[p];
    if (m <= COMPANY || status) goto out;
    near = alloc_array(m, COMPANY * sizeof *near);
    status = near ? find_company(stray, m, threads, near, has_company) : STATUS_NO_MEMORY;
    for (size_t p = 0, i = 0; p < hunt->n && !status; p++) {
        if (!hunt->outlier[p]) continue;
        int more = 0;
        for (size_t j = 0; j < COMPANY; j++) more += has_company[near[i * COMPANY + j]];
        if (has_company[i] && more >= COMPANY_MORE) hunt->outlier[p] = 0;
        i++;
    }
out:
    free(stray), free(has_company), free(near);
    return status;
}

static enum status judge_all(struct hunt *hunt, unsigned threads) {
    uint8_t *trusted = alloc_array(hunt->n, sizeof *trusted);
    enum status status = trusted ? STATUS_OK : STATUS_NO_MEMORY;
    for (int round = 0; round < JUDGED && !status; round++) status = judge(hunt, trusted, threads);
    free(trusted);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static double far_from(double usual_m, double mad) {
    return usual_m + fmax(FAR_DEVIATIONS * DEVIATION * mad, FAR_LEAST);
}

static enum status thresholds(struct hunt *hunt, double *usual_m) {
    double far_mad, apart_mad, ratio;
    enum status status = quantile_spread(hunt->log_m, hunt->n, usual_m, &far_mad);
    if (!status) status = quantile_spread(hunt->log_ratio, hunt->n, &ratio, &apart_mad);
    if (status) return status;
    hunt->far = far_from(*usual_m, far_mad);
    hunt->apart = ratio + fmax(APART_DEVIATIONS * DEVIATION * apart_mad, APART_LEAST);
    return STATUS_OK;
}

/* Nothing is far from all points where they were sampled by need, but from those around it. */
static enum status heed_need(struct hunt *hunt) {
    enum { SOME = 4096 };
    size_t far = 0, taken = 0;
    float *flatness = alloc_array(SOME, sizeof *flatness);
    if (!flatness) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < hunt->n; p++) far += (double)hunt->log_m[p] > hunt->far;
    size_t step = far / SOME + 1, at = 0;
    for (size_t p = 0; p < hunt->n; p++)
        if ((double)hunt->log_m[p] > hunt->far && at++ % step == 0)
            flatness[taken++] = (float)flatness_of(hunt->point, hunt->point[p], &hunt->near[p * K], K);
    if (is_sampled_by_need(hunt->n, far, flatness, taken)) hunt->far = INFINITY;
    free(flatness);
    return STATUS_OK;
}

static enum status hunt_all(struct hunt *hunt, unsigned threads) {
    double usual_m = 0;
    enum status status = planes_new(hunt->knn, hunt->point, hunt->n, threads, &hunt->planes);
    if (status) return status;
    par_for(threads, hunt->n, CHUNK, measure_range, hunt);
    par_for(threads, hunt->n, CHUNK, compare_range, hunt);
    status = thresholds(hunt, &usual_m);
    double gap = exp(fmax(hunt->far, usual_m + CLUSTER_GAP));
    if (!status) status = heed_need(hunt);
    if (status) return status;
    par_for(threads, hunt->n, CHUNK, suspect_range, hunt);
    status = judge_all(hunt, threads);
    if (!status) status = keep_company(hunt, threads);
    if (!status) status = drop_clusters(hunt, usual_m, gap);
    for (size_t p = 0; p < hunt->n && !status; p++)
        if (hunt->outlier[p] && is_on_line(hunt->point, hunt->point[p], &hunt->near[p * K])) hunt->outlier[p] = 0;
    return status;
}

enum status outliers_find(const struct knn *knn, const vec3 *point, const float *range, size_t n, unsigned threads,
                          uint8_t *outlier, size_t *count, struct planes **planes) {
    if (planes) *planes = NULL;
    struct hunt hunt = {.knn = knn, .point = point, .range = range, .n = n, .outlier = outlier};
    enum status status = STATUS_NO_MEMORY;
    size_t found = 0;
    if (n < OUTLIERS_MIN_POINTS) goto none;
    hunt.near = alloc_array(n, K * sizeof *hunt.near);
    hunt.log_m = alloc_array(n, sizeof *hunt.log_m);
    hunt.log_ratio = alloc_array(n, sizeof *hunt.log_ratio);
    if (hunt.near && hunt.log_m && hunt.log_ratio) status = hunt_all(&hunt, threads);
    free(hunt.near), free(hunt.log_m), free(hunt.log_ratio);
    if (status || !planes) planes_free(hunt.planes);
    if (status) return status;
    if (planes) *planes = hunt.planes;
    for (size_t p = 0; p < n; p++) found += outlier[p] != 0;
    if (found > n / 2) goto none;
    *count = found;
    return STATUS_OK;
none:
    memset(outlier, 0, n);
    *count = 0;
    return STATUS_OK;
}

/* By how much strays stand off: the logarithm of the times that is usual.  Of few points hardly any can be ALONE within
 * the box of a body.  What is nearer may be the corner of a solid that has points along its edges alone, which is far
 * from all by that, but not from those around it. */
static double much_of(const vec3 *point, size_t n, double usual_m) {
    static const double LEAST = 1.6, OF_DIAGONAL = 0.05; /* e^1.6 = 5 times */
    vec3 low = point[0], high = point[0];
    for (size_t p = 1; p < n; p++) {
        low = (vec3){fmin(low.x, point[p].x), fmin(low.y, point[p].y), fmin(low.z, point[p].z)};
        high = (vec3){fmax(high.x, point[p].x), fmax(high.y, point[p].y), fmax(high.z, point[p].z)};
    }
    double large = log(OF_DIAGONAL * vec3_distance(low, high)) - usual_m;
    return fmax(LEAST, fmin(large, ALONE));
}

/* Of so many places, evenly along the points, the shares that are far from others and in no plane with them. */
static enum status find_shares(const struct knn *knn, const vec3 *point, const float *range, size_t n, size_t places,
                               unsigned threads, const struct shell_near *known, struct stray_shares *shares) {
    size_t row = K + 1, far = 0, alone = 0, sparse = 0;
    vec3 *at = alloc_array(places, sizeof *at);
    size_t *id = alloc_array(places, sizeof *id);
    uint32_t *found = alloc_array(places, row * sizeof *found);
    double *found_sq = alloc_array(places, row * sizeof *found_sq), usual_m, mad;
    const uint32_t *near = known ? known->id : found;
    const double *distance_sq = known ? known->distance_sq : found_sq;
    float *log_m = alloc_array(places, sizeof *log_m), *flatness = alloc_array(places, sizeof *flatness);
    enum status status = at && id && found && found_sq && log_m && flatness ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < places && !status; i++)
        id[i] = n / places * i + n % places * i / places, at[i] = point[id[i]];
    if (!status && !known) status = knn_search(knn, at, places, K + 1, threads, found, found_sq);
    for (size_t i = 0; i < places && !status; i++) {
        double sum = 0;
        for (unsigned j = 1; j <= K; j++) sum += sqrt(distance_sq[i * row + j]); /* the nearest is the place itself */
        log_m[i] = (float)log(fmax(sum / K / range_of(range, id[i]), DBL_MIN));
    }
    if (!status) status = quantile_spread(log_m, places, &usual_m, &mad);
    double much = status || range ? ALONE : much_of(point, n, usual_m);
    for (size_t i = 0; i < places && !status; i++) {
        if ((double)log_m[i] <= far_from(usual_m, mad)) continue;
        flatness[sparse] = (float)flatness_of(point, at[i], &near[i * row + 1], K);
        bool is_far = (double)flatness[sparse++] > FLAT;
        far += is_far;
        alone += is_far && (double)log_m[i] > usual_m + much;
    }
    if (!status && is_sampled_by_need(places, sparse, flatness, sparse)) far = alone = 0;
    if (!status) *shares = (struct stray_shares){(double)far / (double)places, (double)alone / (double)places};
    free(at), free(id), free(found), free(found_sq), free(log_m), free(flatness);
    return status;
}

/* Where a few places have none, as those of most clouds, no more are looked at. */
enum status outliers_estimate(const struct knn *knn, const vec3 *point, const float *range, size_t n, unsigned threads,
                              const struct shell_near *known, struct stray_shares *shares) {
    enum { FEW = SHELL_ROWS };
    static_assert(SHELL_NEAR == K + 1, "rows are those that are looked for");
    *shares = (struct stray_shares){0, 0};
    if (n < OUTLIERS_MIN_POINTS) return STATUS_OK;
    enum status status = find_shares(knn, point, range, n, n < FEW ? n : FEW, threads, n < FEW ? NULL : known, shares);
    if (status || !(shares->far > 0) || n <= FEW) return status;
    return find_shares(knn, point, range, n, n < OUTLIERS_PLACES ? n : OUTLIERS_PLACES, threads, NULL, shares);
}

/* ------------------------------------------------------------------------------------------------ by neighbourhoods */

/* How points stand off that are in no plane with their neighbours: from all, or from those around them.  By much is
 * eight times what is usual. */
enum { FAR_OFF = 1, FAR_MUCH = 2, APART = 4, APART_MORE = 8, APART_MUCH = 16 };

struct survey {
    const vec3 *point;
    const float *range; /* NULL: not known */
    const struct neighbourhood *neighbours;
    double usual, far; /* logarithms of spacings */
    double much;       /* of the times that is usual */
    uint8_t *off;      /* n */
};

static double spacing_of(const struct survey *survey, size_t p) {
    return fmax((double)survey->neighbours->spacing[p] / range_of(survey->range, p), DBL_MIN);
}

/* The logarithm of p's spacing over the median of its neighbours'. */
static double apartness(const struct survey *survey, size_t p, const uint32_t *near, unsigned k) {
    float m[K];
    for (unsigned i = 0; i < k; i++) m[i] = (float)spacing_of(survey, near[i]);
    return log(spacing_of(survey, p) / (double)quantile_of(m, k, 0.5));
}

static void survey_range(void *ctx, size_t begin, size_t end) {
    static const double LEAST = 1.2, MORE = 1.6, BESIDE = 0.9, TWICE = 2, WIDE = 0.1;
    const struct survey *survey = ctx;
    const struct neighbourhood *n = survey->neighbours;
    double far_from_all = exp(survey->far);
    for (size_t p = begin; p < end; p++) {
        const uint32_t *near = &n->id[p * n->stride];
        bool is_far = spacing_of(survey, p) > far_from_all;
        survey->off[p] = 0;
        unsigned k = n->count[p] < K ? n->count[p] : K;
        if (k == 0 || (!is_far && spacing_of(survey, p) < TWICE * spacing_of(survey, near[0]))) continue;
        double apart = apartness(survey, p, near, k);
        if ((!is_far && apart < LEAST) || is_flat(survey->point, survey->point[p], near, k, WIDE)) continue;
        bool by_much = is_far && apart > BESIDE && log(spacing_of(survey, p)) > survey->usual + survey->much;
        survey->off[p] = (uint8_t)((is_far ? FAR_OFF : 0) | (by_much ? FAR_MUCH : 0) | (apart > LEAST ? APART : 0) |
                                   (apart > MORE ? APART_MORE : 0) | (apart > survey->much ? APART_MUCH : 0));
    }
}

/* What is usual, of an even choice of points. */
static enum status find_usual(struct survey *survey) {
    enum { SOME = 1 << 14 };
    size_t n = survey->neighbours->n, step = n / SOME + 1, taken = 0;
    float *sample = alloc_array(n / step + 1, sizeof *sample);
    double mad = 0;
    enum status status = sample ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p += step) sample[taken++] = (float)log(spacing_of(survey, p));
    if (!status) status = quantile_spread(sample, taken, &survey->usual, &mad);
    survey->far = far_from(survey->usual, mad);
    survey->much = survey->range ? ALONE : much_of(survey->point, n, survey->usual);
    free(sample);
    return status;
}

/* What stands off where a surface ends or thins out does so by all distances, most of it by little; strays keep any
 * distance.  So of what is far, or apart, as large a share is so by much as chance gives it. */
static bool are_scattered(size_t some, size_t by_much) {
    static const double SCATTERED = 0.3125;
    return (double)by_much > SCATTERED * (double)some;
}

enum status outliers_survey(const vec3 *point, const float *range, const struct neighbourhood *neighbours,
                            unsigned threads, uint8_t *off, size_t *count, size_t *scattered) {
    enum { FEW = 8 };
    struct survey survey = {.point = point, .range = range, .neighbours = neighbours, .off = off};
    size_t n = neighbours->n, has[APART_MUCH + 1] = {0};
    *count = 0, *scattered = 0;
    memset(off, 0, n);
    if (n < OUTLIERS_MIN_SURVEYED) return STATUS_OK;
    enum status status = find_usual(&survey);
    if (status) return status;
    par_for(threads, n, CHUNK, survey_range, &survey);
    for (size_t p = 0; p < n; p++) {
        if (!off[p]) continue;
        for (uint8_t bit = FAR_OFF; bit <= APART_MUCH; bit = (uint8_t)(bit * 2)) has[bit] += (off[p] & bit) != 0;
    }
    bool far = are_scattered(has[FAR_OFF], has[FAR_MUCH]), apart = are_scattered(has[APART], has[APART_MUCH]);
    if (survey.much < ALONE ? far && apart : far || apart)
        *scattered = has[FAR_OFF] > has[APART] ? has[FAR_OFF] : has[APART];
    uint8_t kind = has[APART] <= FEW ? APART_MORE : APART_MUCH;
    for (size_t p = 0; p < n; p++) *count += off[p] = (off[p] & kind) != 0;
    return STATUS_OK;
}
