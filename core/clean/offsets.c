/* Planes are fitted with weights that fall with the distance, and in all but the first round with the height over the
 * plane before: 1 on it, 1/4 at 1.4 times the weighted spread of heights (Geman, McClure).  The spread falls from round
 * to round, so a plane between two layers goes over to one of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/offsets.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/knn.h"

enum { GRAIN = 1024, K = OFFSETS_K, SPACING_K = 8, ROUNDS = 4 };
static const double RIM_SQ = 1.44;    /* where weights end, of the squared distance to the last neighbour */
static const double SPREAD_SQ = 2;    /* tolerance of squared heights, of the weighted mean of them */
static const double LEAST_SQ = 1e-24; /* of the squared radius: spread that is none */

struct planes {
    const vec3 *point;
    size_t n;
    const uint8_t *trusted;
    vec3 *listened; /* the trusted points, and which they are */
    uint32_t *listened_id;
    struct knn *knn; /* over them */
    uint32_t *near;  /* n * K: ids of trusted points, nearest first, the point itself left out */
    float *spacing;  /* n: mean distance to the nearest SPACING_K */
    vec3 *normal;    /* n: of the plane of a trusted point */
    double *height;  /* n: of that plane over the origin */
    enum status *chunk_status;
    struct offsets made;
};

static double square_of(double x) { return x * x; }

static enum status find_near_chunk(struct planes *s, size_t begin, size_t end) {
    uint32_t found[GRAIN * (K + 1)];
    double *distance_sq = alloc_array(end - begin, (K + 1) * sizeof *distance_sq);
    if (!distance_sq) return STATUS_NO_MEMORY;
    enum status status = knn_search(s->knn, &s->point[begin], end - begin, K + 1, 1, found, distance_sq);
    for (size_t p = begin; !status && p < end; p++) {
        size_t row = (p - begin) * (K + 1);
        double sum = 0, last = 0;
        unsigned taken = 0;
        for (unsigned i = 0; i <= K && taken < K; i++) {
            uint32_t q = s->listened_id[found[row + i]];
            if (q == p) continue;
            last = sqrt(distance_sq[row + i]);
            if (taken < SPACING_K) sum += last;
            s->near[p * K + taken++] = q;
        }
        s->spacing[p] = fmaxf((float)(sum / SPACING_K), FLT_MIN);
        s->made.radius[p] = fmaxf((float)last, FLT_MIN);
    }
    free(distance_sq);
    return status;
}

static void find_near_range(void *ctx, size_t begin, size_t end) {
    struct planes *s = ctx;
    s->chunk_status[begin / GRAIN] = find_near_chunk(s, begin, end);
}

/* The plane through p's neighbourhood, relative to p: its normal, and *height of it over p. */
static vec3 fit_plane_near(const struct planes *s, size_t p, double *height) {
    vec3 e[K + 1], normal = {0, 0, 0};
    double near[K + 1], radius_sq = square_of((double)s->made.radius[p]), spread_sq = 0;
    for (unsigned i = 0; i <= K; i++) {
        e[i] = i < K ? vec3_sub(s->point[s->near[p * K + i]], s->point[p]) : (vec3){0, 0, 0};
        near[i] = square_of(fmax(0, 1 - vec3_length_sq(e[i]) / (RIM_SQ * radius_sq)));
    }
    *height = 0;
    for (int round = 0; round < ROUNDS; round++) {
        vec3 sum = {0, 0, 0};
        sym3 moment = {0};
        double total = 0, least, scale_sq = SPREAD_SQ * fmax(spread_sq, LEAST_SQ * radius_sq);
        for (unsigned i = 0; i <= K; i++) {
            double w = near[i];
            if (round > 0) w *= square_of(scale_sq / (scale_sq + square_of(vec3_dot(normal, e[i]) - *height)));
            total += w;
            sum = vec3_add(sum, vec3_scale(e[i], w));
            moment = sym3_add(moment, sym3_scale(sym3_outer(e[i]), w));
        }
        if (total <= 0) break;
        moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1 / total));
        sym3_least(&moment, 1, &least, &normal);
        spread_sq = fmax(least, 0) / total;
        *height = vec3_dot(normal, sum) / total;
    }
    return normal;
}

static void plane_range(void *ctx, size_t begin, size_t end) {
    const struct planes *s = ctx;
    for (size_t p = begin; p < end; p++)
        if (s->trusted[p]) s->normal[p] = fit_plane_near(s, p, &s->height[p]);
}

static void offset_range(void *ctx, size_t begin, size_t end) {
    const struct planes *s = ctx;
    for (size_t p = begin; p < end; p++) {
        float off[K], spacing[K];
        for (unsigned i = 0; i < K; i++) {
            uint32_t q = s->near[p * K + i];
            off[i] = (float)fabs(vec3_dot(s->normal[q], vec3_sub(s->point[p], s->point[q])) - s->height[q]);
            spacing[i] = s->spacing[q];
        }
        s->made.quarter[p] = quantile_of(off, K, 4.0 / (K - 1));
        s->made.third[p] = quantile_of(off, K, 2.0 / (K - 1));
        s->made.second[p] = quantile_of(off, K, 1.0 / (K - 1));
        s->made.sparsity[p] = s->spacing[p] / quantile_of(spacing, K, 0.75);
    }
}

static void usual_range(void *ctx, size_t begin, size_t end) {
    const struct planes *s = ctx;
    for (size_t p = begin; p < end; p++) {
        float off[K];
        for (unsigned i = 0; i < K; i++) off[i] = s->made.quarter[s->near[p * K + i]];
        s->made.usual[p] = quantile_of(off, K, 0.25);
        s->made.rough[p] = quantile_of(off, K, 0.75);
    }
}

static enum status allocate_planes(struct planes *s) {
    struct offsets *made = &s->made;
    float **each[] = {&made->second, &made->third,  &made->quarter,  &made->usual,
                      &made->rough,  &made->radius, &made->sparsity, &s->spacing};
    bool all = true;
    for (size_t i = 0; i < sizeof each / sizeof *each; i++) all = (*each[i] = alloc_array(s->n, sizeof(float))) && all;
    s->listened = alloc_array(s->n, sizeof *s->listened);
    s->listened_id = alloc_array(s->n, sizeof *s->listened_id);
    s->near = alloc_array(s->n, K * sizeof *s->near);
    s->normal = alloc_array(s->n, sizeof *s->normal);
    s->height = alloc_array(s->n, sizeof *s->height);
    s->chunk_status = alloc_zeroed(s->n / GRAIN + 1, sizeof *s->chunk_status);
    all = all && s->listened && s->listened_id && s->near && s->normal && s->height && s->chunk_status;
    return all ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status find_all(struct planes *s, unsigned threads) {
    size_t m = 0;
    for (size_t p = 0; p < s->n; p++)
        if (s->trusted[p]) s->listened[m] = s->point[p], s->listened_id[m++] = (uint32_t)p;
    enum status status = knn_new(s->listened, m, threads, &s->knn, NULL);
    if (status) return status;
    par_for(threads, s->n, GRAIN, find_near_range, s);
    for (size_t i = 0; i <= s->n / GRAIN; i++)
        if (s->chunk_status[i]) return s->chunk_status[i];
    par_for(threads, s->n, GRAIN, plane_range, s);
    par_for(threads, s->n, GRAIN, offset_range, s);
    par_for(threads, s->n, GRAIN, usual_range, s);
    return STATUS_OK;
}

enum status offsets_find(const vec3 *point, size_t n, const uint8_t *trusted, unsigned threads,
                         struct offsets *offsets) {
    struct planes s = {.point = point, .n = n, .trusted = trusted};
    enum status status = allocate_planes(&s);
    if (!status) status = find_all(&s, threads);
    knn_free(s.knn);
    free(s.listened), free(s.listened_id), free(s.near), free(s.spacing), free(s.normal), free(s.height);
    free(s.chunk_status);
    if (status)
        offsets_done(&s.made);
    else
        *offsets = s.made;
    return status;
}

void offsets_done(struct offsets *offsets) {
    free(offsets->second), free(offsets->third), free(offsets->quarter);
    free(offsets->usual), free(offsets->rough), free(offsets->radius), free(offsets->sparsity);
    *offsets = (struct offsets){0};
}
