/* Neighbourhoods by k-nearest queries, cut by Gopi's radius.
 *
 * The literal rule hangs on one distance: a single accidental close pair shrinks the ball to nothing.  So s is at least
 * half the distance to the third neighbour, and count stays within min .. max.
 *
 * Scan lines are the other trap: where the spacing along the line is much smaller than across, all near neighbours are
 * collinear and no plane can be fitted.  A point whose neighbours have a middle eigenvalue below LINE_RATIO of the
 * largest asks again for WIDE_K neighbours and takes the nearest ones of each of eight sectors around the line.
 *
 * Noise is the third.  A few neighbours of a noisy surface fill a ball rather than a disk, and contraction then takes
 * noise for shape.  Around some points, spread over the cloud, two neighbourhoods of different width are compared: a
 * wider one is flatter for its width where what is seen is noise, and less flat where it is curvature.  Where most say
 * noise the whole cloud gets more neighbours.  Both sides of a wall that is hardly thicker than its points are apart
 * look the same, but lie at two heights, and noise has all; those of a thin bar are all as far from its axis.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/neighbourhood.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/heights.h"
#include "core/spatial/tube.h"

enum { CHUNK = 4096, WIDE_K = 48, SECTORS = 8 };
static const double LINE_RATIO = 0.02;

enum { SAMPLES = 256, SAMPLE_GRAIN = 16, NARROW_K = 11, BROAD_K = 31 };
static const double THICK = 0.006, FLATTER = 0.95; /* surface variation, and its ratio, that noise has */
static const double BALL = 0.1, BALL_RATIO = 1.6;  /* and where even the wider neighbourhood is nearly a ball */
static const double TWO_SHEETS = 1.5; /* kurtosis at a quarter of the places, at most: both sides of thin walls */

struct search {
    const struct knn *knn;
    const vec3 *point;
    const struct neighbourhood_options *options;
    struct neighbourhood *out;
    enum status *chunk_status;
};

/* Copies the neighbours within Gopi's radius from a sorted list of k found ones, dropping p itself. */
static void cut(const struct search *search, size_t p, const uint32_t *found, const double *distance_sq, unsigned k) {
    const struct neighbourhood_options *options = search->options;
    uint32_t *id = &search->out->id[p * search->out->stride];
    double nearest = 0, third = 0, sum = 0;
    unsigned count = 0, rank = 0;
    for (unsigned i = 0; i < k && count < options->max && found[i] != UINT32_MAX; i++) {
        if (found[i] == p) continue;
        double d = sqrt(distance_sq[i]);
        rank++;
        if (rank == 1) nearest = d;
        if (rank == 3) third = d;
        if (rank > options->min && d > options->radius * fmax(nearest, third / 2)) break;
        id[count++] = found[i];
        sum += d;
    }
    search->out->count[p] = (uint8_t)count;
    search->out->spacing[p] = count ? (float)(sum / count) : 0;
}

/* Second moments of the points id[0 .. count-1] about p. */
static sym3 moment_about(const struct search *search, size_t p, const uint32_t *id, unsigned count) {
    sym3 moment = {0};
    for (unsigned i = 0; i < count && id[i] != UINT32_MAX; i++)
        moment = sym3_add(moment, sym3_outer(vec3_sub(search->point[id[i]], search->point[p])));
    return moment;
}

/* Whether the middle eigenvalue is small against the largest, from the characteristic polynomial's coefficients: the
 * sum of the principal minors is about middle x largest where the smallest is small. */
static int is_line(sym3 m) {
    double minors = m.xx * m.yy - m.xy * m.xy + m.xx * m.zz - m.xz * m.xz + m.yy * m.zz - m.yz * m.yz;
    return minors < LINE_RATIO * sym3_trace(m) * sym3_trace(m);
}

/* Which of eight directions in the plane of the two longest principal axes e points to. */
static unsigned sector_of(vec3 e, const vec3 axis[3]) {
    double angle = atan2(vec3_dot(e, axis[1]), vec3_dot(e, axis[2])) + M_PI;
    unsigned sector = (unsigned)(angle * (SECTORS / (2 * M_PI)));
    return sector < SECTORS ? sector : SECTORS - 1;
}

/* Takes the nearest neighbour of each sector, then the second nearest of each, until there are max. */
static void take_sectors(const struct search *search, size_t p, const uint32_t *found, const double *distance_sq) {
    struct neighbourhood *out = search->out;
    double value[3];
    vec3 axis[3];
    sym3_eigen(moment_about(search, p, found, WIDE_K), value, axis);
    unsigned round_of[WIDE_K], taken[SECTORS] = {0}, count = 0;
    double sum = 0;
    for (unsigned i = 0; i < WIDE_K && found[i] != UINT32_MAX; i++)
        round_of[i] =
            found[i] == p ? UINT32_MAX : taken[sector_of(vec3_sub(search->point[found[i]], search->point[p]), axis)]++;
    for (unsigned round = 0; round < WIDE_K && count < search->options->max; round++)
        for (unsigned i = 0; i < WIDE_K && found[i] != UINT32_MAX && count < search->options->max; i++) {
            if (round_of[i] != round) continue;
            out->id[p * out->stride + count++] = found[i];
            sum += sqrt(distance_sq[i]);
        }
    out->count[p] = (uint8_t)count;
    out->spacing[p] = count ? (float)(sum / count) : 0;
}

/* Pauly's surface variation of the points id[0 .. k-1]. */
static double variation_of(const vec3 *point, const uint32_t *id, unsigned k) {
    vec3 sum = {0, 0, 0}, axis[3];
    sym3 moment = {0};
    double value[3];
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    sym3_eigen(sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k)), value, axis);
    double trace = value[0] + value[1] + value[2];
    return trace > 0 ? fmax(value[0], 0) / trace : 0;
}

struct sampling {
    const struct knn *knn;
    const vec3 *point;
    size_t step; /* between the points that are looked at */
    float narrow[SAMPLES], ratio[SAMPLES];
    enum status status[SAMPLES];
};

static void sample_range(void *ctx, size_t begin, size_t end) {
    struct sampling *s = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t id[BROAD_K];
        double distance_sq[BROAD_K];
        s->status[i] = knn_search(s->knn, &s->point[i * s->step], 1, BROAD_K, 1, id, distance_sq);
        if (s->status[i]) continue;
        double variation = variation_of(s->point, id, NARROW_K);
        s->narrow[i] = (float)variation;
        s->ratio[i] = variation > 0 ? (float)fmin(variation_of(s->point, id, BROAD_K) / variation, 100) : 100;
    }
}

struct wide_sampling {
    const struct knn *knn;
    const vec3 *point;
    size_t step;
    float near[SAMPLES], wide[SAMPLES];           /* kurtosis */
    float near_axis[SAMPLES], wide_axis[SAMPLES]; /* unevenness */
    enum status status[SAMPLES];
};

static void sample_widely(void *ctx, size_t begin, size_t end) {
    struct wide_sampling *s = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t id[HEIGHTS_K];
        double distance_sq[HEIGHTS_K];
        s->status[i] = knn_search(s->knn, &s->point[i * s->step], 1, HEIGHTS_K, 1, id, distance_sq);
        if (s->status[i]) continue;
        s->near[i] = (float)fmin(heights_kurtosis(s->point, id, HEIGHTS_K / 2), HEIGHTS_K);
        s->wide[i] = (float)fmin(heights_kurtosis(s->point, id, HEIGHTS_K), HEIGHTS_K);
        s->near_axis[i] = (float)fmin(tube_unevenness(s->point, id, HEIGHTS_K / 2), 1);
        s->wide_axis[i] = (float)fmin(tube_unevenness(s->point, id, HEIGHTS_K), 1);
    }
}

/* What tells whether thick places are walls or bars, as few points tell or, where these are at random, more, unless
 * they reach the next one: kurtosis, and unevenness around an axis.  At least HEIGHTS_K points. */
static enum status look_widely(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *kurtosis,
                               double *unevenness) {
    struct wide_sampling w = {.knn = knn, .point = point, .step = (n - 1) / SAMPLES + 1};
    size_t count = (n - 1) / w.step + 1;
    par_for(threads, count, SAMPLE_GRAIN, sample_widely, &w);
    for (size_t i = 0; i < count; i++)
        if (w.status[i]) return w.status[i];
    *kurtosis = (double)fminf(quantile_of(w.near, count, 0.25), quantile_of(w.wide, count, 0.25));
    *unevenness = (double)fminf(quantile_of(w.near_axis, count, 0.25), quantile_of(w.wide_axis, count, 0.25));
    return STATUS_OK;
}

enum status neighbourhood_noisy(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, bool *noisy,
                                bool *walls) {
    struct sampling s = {.knn = knn, .point = point, .step = (n - 1) / SAMPLES + 1};
    size_t count = (n - 1) / s.step + 1;
    *noisy = false;
    if (walls) *walls = false;
    if (n < BROAD_K) return STATUS_OK;
    par_for(threads, count, SAMPLE_GRAIN, sample_range, &s);
    for (size_t i = 0; i < count; i++)
        if (s.status[i]) return s.status[i];
    double usual = (double)quantile_of(s.narrow, count, 0.5), usual_ratio = (double)quantile_of(s.ratio, count, 0.5);
    bool as_noise = (usual > THICK && usual_ratio < FLATTER) || (usual > BALL && usual_ratio < BALL_RATIO);
    double kurtosis = INFINITY, unevenness = INFINITY;
    enum status status = STATUS_OK;
    if (usual > THICK && n >= HEIGHTS_K) status = look_widely(knn, point, n, threads, &kurtosis, &unevenness);
    bool bars = unevenness < TUBE_UNEVENNESS_MOST, two_sheets = kurtosis < TWO_SHEETS;
    *noisy = !status && as_noise && !two_sheets && !bars;
    if (walls) *walls = !status && two_sheets && !bars;
    return status;
}

/* p's neighbours were looked for among the first k that were found. */
static void keep_reach(const struct search *search, size_t p, const uint32_t *found, const double *distance_sq,
                       unsigned k) {
    if (search->out->reach_sq)
        search->out->reach_sq[p] = found[k - 1] == UINT32_MAX ? INFINITY : (float)distance_sq[k - 1];
}

/* Where p's neighbours lie on a line, others are taken.  found, distance_sq: room for WIDE_K. */
static enum status leave_line(const struct search *search, size_t p, uint32_t *found, double *distance_sq) {
    unsigned count = search->out->count[p];
    if (count < 3 || !is_line(moment_about(search, p, &search->out->id[p * search->out->stride], count)))
        return STATUS_OK;
    enum status status = knn_search(search->knn, &search->point[p], 1, WIDE_K, 1, found, distance_sq);
    if (status) return status;
    take_sectors(search, p, found, distance_sq);
    keep_reach(search, p, found, distance_sq, WIDE_K);
    return STATUS_OK;
}

static enum status find_chunk(const struct search *search, size_t begin, size_t end) {
    unsigned k = search->options->max + 1;
    uint32_t *found = alloc_array((end - begin) * k + WIDE_K, sizeof *found);
    double *distance_sq = alloc_array((end - begin) * k + WIDE_K, sizeof *distance_sq);
    enum status status = found && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = knn_search(search->knn, &search->point[begin], end - begin, k, 1, found, distance_sq);
    for (size_t p = begin; !status && p < end; p++) {
        const uint32_t *row = &found[(p - begin) * k];
        cut(search, p, row, &distance_sq[(p - begin) * k], k);
        keep_reach(search, p, row, &distance_sq[(p - begin) * k], k);
    }
    for (size_t p = begin; !status && p < end; p++) status = leave_line(search, p, found, distance_sq);
    free(found);
    free(distance_sq);
    return status;
}

static void find_range(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    search->chunk_status[begin / CHUNK] = find_chunk(search, begin, end);
}

static struct neighbourhood_options fit_options(const struct neighbourhood_options *options, bool noisy) {
    struct neighbourhood_options fitting = *options;
    if (noisy) {
        fitting.min = neighbourhood_noisy_count(options->min);
        fitting.max = neighbourhood_noisy_count(options->max);
    }
    return fitting;
}

static enum status find_all(const struct knn *knn, const vec3 *point, size_t n,
                            const struct neighbourhood_options *options, bool noisy, bool keeps_reach,
                            struct neighbourhood *out) {
    assert(options->min >= 3 && options->min <= options->max && options->max < KNN_MAX_K);
    struct neighbourhood_options fitting = fit_options(options, noisy);
    enum status status;
    struct neighbourhood found = {.n = n, .stride = fitting.max, .noisy = noisy};
    size_t chunks = n / CHUNK + 1;
    found.id = alloc_array(n, found.stride * sizeof *found.id);
    found.count = alloc_array(n, sizeof *found.count);
    found.spacing = alloc_array(n, sizeof *found.spacing);
    enum status *chunk_status = alloc_zeroed(chunks, sizeof *chunk_status);
    status = STATUS_NO_MEMORY;
    if (keeps_reach) found.reach_sq = alloc_array(n, sizeof *found.reach_sq);
    if (!found.id || !found.count || !found.spacing || !chunk_status || (keeps_reach && !found.reach_sq)) goto out;
    struct search search = {knn, point, &fitting, &found, chunk_status};
    par_for(options->threads, n, CHUNK, find_range, &search);
    status = STATUS_OK;
    for (size_t i = 0; i < chunks && !status; i++) status = chunk_status[i];
out:
    free(chunk_status);
    if (status)
        neighbourhood_done(&found);
    else
        *out = found;
    return status;
}

enum status neighbourhood_find_as(const struct knn *knn, const vec3 *point, size_t n,
                                  const struct neighbourhood_options *options, bool noisy, struct neighbourhood *out) {
    return find_all(knn, point, n, options, noisy, false, out);
}

static enum status find_and_tell(const struct knn *knn, const vec3 *point, size_t n,
                                 const struct neighbourhood_options *options, bool keeps_reach,
                                 struct neighbourhood *out) {
    bool noisy, walls;
    enum status status = neighbourhood_noisy(knn, point, n, options->threads, &noisy, &walls);
    if (!status) status = find_all(knn, point, n, options, noisy, keeps_reach, out);
    if (!status) out->walls = walls;
    return status;
}

enum status neighbourhood_find(const struct knn *knn, const vec3 *point, size_t n,
                               const struct neighbourhood_options *options, struct neighbourhood *out) {
    return find_and_tell(knn, point, n, options, false, out);
}

enum status neighbourhood_find_reach(const struct knn *knn, const vec3 *point, size_t n,
                                     const struct neighbourhood_options *options, struct neighbourhood *out) {
    return find_and_tell(knn, point, n, options, true, out);
}

/* ------------------------------------------------------------------------------------------------ lost points */

struct losing {
    struct search search;
    const vec3 *before;
    const uint32_t *gone; /* the points that are lost */
    size_t gones;
    uint8_t *again; /* n: p's neighbours are looked for again */
};

/* With the rounding of a distance in float. */
static void find_reached(void *ctx, size_t begin, size_t end) {
    static const double ROUNDING = 1 + 1e-6;
    struct losing *l = ctx;
    for (size_t p = begin; p < end; p++) {
        double reach_sq = ROUNDING * (double)l->search.out->reach_sq[p];
        l->again[p] = 0;
        for (size_t i = 0; i < l->gones && !l->again[p]; i++)
            l->again[p] = vec3_distance_sq(l->before[l->gone[i]], l->before[p]) <= reach_sq;
    }
}

/* Rows move up, and have what is left called by its new name; *again moves with them. */
static void move_rows(struct neighbourhood *neighbours, const uint32_t *name, uint8_t *again) {
    size_t stride = neighbours->stride;
    for (size_t p = 0; p < neighbours->n; p++) {
        size_t q = name[p];
        if (q == NONE) continue;
        for (size_t i = 0; i < neighbours->count[p]; i++)
            neighbours->id[q * stride + i] = name[neighbours->id[p * stride + i]];
        neighbours->count[q] = neighbours->count[p], neighbours->spacing[q] = neighbours->spacing[p];
        neighbours->reach_sq[q] = neighbours->reach_sq[p], again[q] = again[p];
    }
}

static enum status look_again(const struct search *search, size_t p) {
    uint32_t found[KNN_MAX_K];
    double distance_sq[KNN_MAX_K];
    unsigned k = search->options->max + 1;
    enum status status = knn_search(search->knn, &search->point[p], 1, k, 1, found, distance_sq);
    if (status) return status;
    cut(search, p, found, distance_sq, k);
    keep_reach(search, p, found, distance_sq, k);
    return leave_line(search, p, found, distance_sq);
}

static void look_again_range(void *ctx, size_t begin, size_t end) {
    struct losing *l = ctx;
    enum status *status = &l->search.chunk_status[begin / CHUNK];
    for (size_t p = begin; p < end && !*status; p++)
        if (l->again[p]) *status = look_again(&l->search, p);
}

enum status neighbourhood_lose(const struct knn *knn, const vec3 *point, const struct neighbourhood_options *options,
                               const vec3 *before, const uint8_t *lost, struct neighbourhood *neighbours) {
    static_assert((int)WIDE_K <= (int)KNN_MAX_K, "room for those of a line");
    struct neighbourhood_options fitting = fit_options(options, neighbours->noisy);
    size_t n = neighbours->n, left = 0, gones = 0, chunks = n / CHUNK + 1;
    uint32_t *name = alloc_array(n, sizeof *name), *gone = alloc_array(n, sizeof *gone);
    uint8_t *again = alloc_array(n, 1);
    enum status *chunk_status = alloc_zeroed(chunks, sizeof *chunk_status);
    enum status status = name && gone && again && chunk_status ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++) {
        name[p] = lost[p] ? NONE : (uint32_t)left++;
        if (lost[p]) gone[gones++] = (uint32_t)p;
    }
    struct losing losing = {{knn, point, &fitting, neighbours, chunk_status}, before, gone, gones, again};
    if (!status) {
        par_for(options->threads, n, CHUNK, find_reached, &losing);
        move_rows(neighbours, name, again);
        neighbours->n = left;
        par_for(options->threads, left, CHUNK, look_again_range, &losing);
    }
    for (size_t i = 0; i < chunks && !status; i++) status = chunk_status[i];
    free(name), free(gone), free(again), free(chunk_status);
    if (status) neighbourhood_done(neighbours);
    return status;
}

void neighbourhood_done(struct neighbourhood *neighbourhood) {
    if (!neighbourhood) return;
    free(neighbourhood->id);
    free(neighbourhood->count);
    free(neighbourhood->spacing);
    free(neighbourhood->reach_sq);
    *neighbourhood = (struct neighbourhood){0};
}
