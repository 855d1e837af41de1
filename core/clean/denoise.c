/* Smoothing that knows of curvature and edges.
 *
 * A point p looks at a neighbour q from half-way between their two tangent planes,
 *
 *     h_pq = (n_p + n_q) / 2 . (q - p),
 *
 * which is zero for any two points of a plane, a sphere or a cylinder, and of third order in the distance elsewhere: so
 * what is left of it is noise, and its spread around p measures how much.  p moves along n_p by a mean of h_pq whose
 * weights fall with the distance, with the angle between the normals (nobody is heard across an edge), and with h_pq
 * against the noise (nor from the other side of a thin sheet).
 *
 * Normals come first: of a weighted plane, fitted again without who lies off it, then filtered in the same bilateral
 * manner, so that each side of an edge keeps its own.  How far to look follows from the noise: the smallest of a few
 * neighbourhoods that is wide against it.  All of that is done a few times; what noise is left falls each time.
 *
 * Fleishman, Drori, Cohen-Or: Bilateral mesh denoising (2003); Oztireli, Guennebaud, Gross: Feature preserving point
 * set surfaces based on non-linear kernel regression (2009); the mean of two normals is in Rusinkiewicz: A symmetric
 * objective function for ICP (2019).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/denoise.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/knn.h"

enum { GRAIN = 1024, MOST_K = 63, ROUNDS = 3, FILTERS = 1 };
static const double RIM = 1.2;                     /* where weights end, of the distance to the last neighbour */
static const double ANGLE = 0.3;                   /* between normals: the tolerance where there is no noise; in rad */
static const double HEIGHT = 4;                    /* tolerance of heights, of the noise */
static const double STRAY = 5, STRAY_LEAST = 0.25; /* of the noise; of the radius */

/* Neighbourhoods from small to wide: k neighbours among every step-th point, enough where the radius is `width` times
 * the noise. */
static const struct level {
    unsigned k, step;
    double width;
} levels[] = {{15, 1, 8}, {31, 1, 8}, {MOST_K, 1, 4}, {MOST_K, 4, 4}};
enum { LEVELS = sizeof levels / sizeof levels[0] };

struct surface {
    size_t n;
    unsigned threads;
    const struct level *level;
    vec3 *listened; /* the points that may be neighbours, and their index */
    struct knn *knn;
    unsigned k;
    uint32_t *near;              /* n * k, nearest first */
    float *rim_sq;               /* n: squared distance at which the weight of a neighbour ends */
    vec3 *point, *normal, *next; /* next: of points or normals, while they are made */
    float *spread;               /* n: standard deviation of the heights around p */
    double noise;                /* median of spread */
    double radius;               /* median distance to the last neighbour */
    double angle_sq;             /* tolerance between normals; the noisier the larger */
    enum status *chunk_status;
};

static double square(double x) { return x * x; }

/* 1 at 0, 1/4 at the scale, and hardly anything far beyond (Geman, McClure). */
static double tolerance(double x_sq, double scale_sq) { return square(scale_sq / (scale_sq + x_sq)); }

/* 1 at p, 0 at the rim. */
static double nearness(const struct surface *s, size_t p, vec3 e) {
    double t = 1 - vec3_length_sq(e) / (double)s->rim_sq[p];
    return t > 0 ? t * t : 0;
}

static vec3 aligned(vec3 normal, vec3 to) { return vec3_dot(normal, to) < 0 ? vec3_scale(normal, -1) : normal; }

/* ------------------------------------------------------------------------------------------------ neighbours */

static enum status find_chunk(const struct surface *s, size_t begin, size_t end) {
    uint32_t found[GRAIN * (MOST_K + 1)];
    double *distance_sq = alloc_array(end - begin, (s->k + 1) * sizeof *distance_sq);
    if (!distance_sq) return STATUS_NO_MEMORY;
    enum status status = knn_search(s->knn, &s->point[begin], end - begin, s->k + 1, 1, found, distance_sq);
    for (size_t p = begin; !status && p < end; p++) {
        size_t row = (p - begin) * (s->k + 1);
        unsigned taken = 0;
        for (unsigned i = 0; i <= s->k && taken < s->k; i++)
            if (found[row + i] * s->level->step != p) s->near[p * s->k + taken++] = found[row + i] * s->level->step;
        s->rim_sq[p] = fmaxf((float)(RIM * RIM * distance_sq[row + s->k]), FLT_MIN); /* what is divided by */
    }
    free(distance_sq);
    return status;
}

static void find_range(void *ctx, size_t begin, size_t end) {
    struct surface *s = ctx;
    s->chunk_status[begin / GRAIN] = find_chunk(s, begin, end);
}

/* ------------------------------------------------------------------------------------------------ normals */

/* The plane of least squares through p's neighbourhood, a point at height z over the plane (mean, normal) weighing less
 * the more its height exceeds `scale`. */
static vec3 fit_plane(const struct surface *s, size_t p, vec3 *mean, vec3 normal, double scale_sq) {
    vec3 sum = {0, 0, 0}, across;
    sym3 moment = {0};
    double total = 0, least;
    for (unsigned i = 0; i <= s->k; i++) {
        vec3 e = i < s->k ? vec3_sub(s->point[s->near[p * s->k + i]], s->point[p]) : (vec3){0, 0, 0};
        double w = nearness(s, p, e);
        if (scale_sq > 0) w *= tolerance(square(vec3_dot(normal, vec3_sub(e, *mean))), scale_sq);
        total += w;
        sum = vec3_add(sum, vec3_scale(e, w));
        moment = sym3_add(moment, sym3_scale(sym3_outer(e), w));
    }
    *mean = vec3_scale(sum, 1 / total);
    moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1 / total));
    sym3_least(&moment, 1, &least, &across);
    s->spread[p] = (float)sqrt(fmax(least, 0) / total);
    return across;
}

static void fit_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        vec3 mean = {0, 0, 0};
        vec3 normal = fit_plane(s, p, &mean, (vec3){0, 0, 0}, 0);
        double spread_sq = square((double)s->spread[p]);
        s->normal[p] = spread_sq > 0 ? fit_plane(s, p, &mean, normal, 4 * spread_sq) : normal;
        s->spread[p] = (float)sqrt(spread_sq);
    }
}

static void filter_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        vec3 sum = s->normal[p];
        for (unsigned i = 0; i < s->k; i++) {
            uint32_t q = s->near[p * s->k + i];
            vec3 normal = aligned(s->normal[q], s->normal[p]);
            double w = nearness(s, p, vec3_sub(s->point[q], s->point[p])) *
                       tolerance(vec3_distance_sq(normal, s->normal[p]), s->angle_sq);
            sum = vec3_add(sum, vec3_scale(normal, w));
        }
        s->next[p] = vec3_unit(sum);
    }
}

static void swap_in(vec3 **current, vec3 **next) {
    vec3 *t = *current;
    *current = *next, *next = t;
}

static void find_normals(struct surface *s) {
    s->angle_sq = square(ANGLE + s->noise / s->radius);
    par_for(s->threads, s->n, GRAIN, fit_range, s);
    for (int i = 0; i < FILTERS; i++) {
        par_for(s->threads, s->n, GRAIN, filter_range, s);
        swap_in(&s->normal, &s->next);
    }
}

/* ------------------------------------------------------------------------------------------------ heights */

/* How high q's surface passes over p, and how much q has to say of that but for the height itself. */
static double height(const struct surface *s, size_t p, uint32_t q, double *weight) {
    vec3 e = vec3_sub(s->point[q], s->point[p]), normal = aligned(s->normal[q], s->normal[p]);
    *weight = nearness(s, p, e) * tolerance(vec3_distance_sq(normal, s->normal[p]), s->angle_sq);
    return vec3_dot(vec3_add(s->normal[p], normal), e) / 2;
}

static void spread_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        double total = 1, sum = 0, sum_sq = 0, w;
        for (unsigned i = 0; i < s->k; i++) {
            double h = height(s, p, s->near[p * s->k + i], &w);
            total += w, sum += w * h, sum_sq += w * h * h;
        }
        s->spread[p] = (float)sqrt(fmax(sum_sq / total - square(sum / total), 0));
    }
}

static enum status find_noise(struct surface *s) {
    double mad;
    par_for(s->threads, s->n, GRAIN, spread_range, s);
    return quantile_spread(s->spread, s->n, &s->noise, &mad);
}

static void move_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        double total = 1, sum = 0, w, scale_sq = square(HEIGHT * s->noise);
        for (unsigned i = 0; i < s->k && scale_sq > 0; i++) {
            double h = height(s, p, s->near[p * s->k + i], &w);
            w *= tolerance(h * h, scale_sq);
            total += w, sum += w * h;
        }
        s->next[p] = vec3_add(s->point[p], vec3_scale(s->normal[p], sum / total));
    }
}

/* ------------------------------------------------------------------------------------------------ strays */

/* The distance from x to the tangent planes of p's neighbours that a quarter of them stay below.  Near a surface some
 * of them pass through x, at an edge too. */
static double off_surface(const struct surface *s, size_t p, vec3 x) {
    float distance[MOST_K];
    for (unsigned i = 0; i < s->k; i++) {
        uint32_t q = s->near[p * s->k + i];
        distance[i] = (float)fabs(vec3_dot(s->normal[q], vec3_sub(x, s->point[q])));
    }
    return (double)quantile_of(distance, s->k, 0.25);
}

static void stray_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) s->spread[p] = (float)off_surface(s, p, s->point[p]);
}

static void find_strays(struct surface *s, const vec3 *start, struct denoise_result *made) {
    double limit = fmax(STRAY * made->noise, STRAY_LEAST * s->radius);
    par_for(s->threads, s->n, GRAIN, stray_range, s);
    size_t count = 0;
    for (size_t p = 0; p < s->n; p++) count += (double)s->spread[p] > limit;
    for (size_t p = 0; p < s->n && count <= s->n / 2; p++) {
        if ((double)s->spread[p] <= limit) continue;
        s->point[p] = start[p];
        made->stray[p] = 1;
        made->stray_count++;
    }
}

/* ------------------------------------------------------------------------------------------------ scale */

static enum status index_listened(struct surface *s) {
    size_t m = (s->n - 1) / s->level->step + 1;
    knn_free(s->knn);
    free(s->listened);
    s->knn = NULL;
    s->listened = alloc_array(m, sizeof *s->listened);
    if (!s->listened) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < m; i++) s->listened[i] = s->point[i * s->level->step];
    return knn_new(s->listened, m, s->threads, &s->knn, NULL);
}

static enum status allocate_near(struct surface *s, unsigned k) {
    s->k = k;
    free(s->near);
    s->near = alloc_array(s->n, k * sizeof *s->near);
    return s->near ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Finds the neighbours of a level, and how rough the surface is there: the spread about planes. */
static enum status look_around(struct surface *s, const struct level *level) {
    double mad, rim_sq;
    s->level = level;
    enum status status = allocate_near(s, level->k);
    if (!status) status = index_listened(s);
    if (status) return status;
    par_for(s->threads, s->n, GRAIN, find_range, s);
    for (size_t i = 0; i <= s->n / GRAIN; i++)
        if (s->chunk_status[i]) return s->chunk_status[i];
    status = quantile_spread(s->rim_sq, s->n, &rim_sq, &mad);
    s->radius = sqrt(rim_sq) / RIM;
    par_for(s->threads, s->n, GRAIN, fit_range, s);
    return status ? status : quantile_spread(s->spread, s->n, &s->noise, &mad);
}

/* The first level that is wide enough, or the last one that there are points for. */
static enum status choose_level(struct surface *s) {
    enum status status = look_around(s, &levels[0]);
    for (size_t i = 1; i < LEVELS && !status; i++) {
        bool is_wide = s->noise * s->level->width <= s->radius;
        if (is_wide || s->n / levels[i].step <= 2 * levels[i].k) break;
        status = look_around(s, &levels[i]);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status smooth_round(struct surface *s) {
    find_normals(s);
    enum status status = find_noise(s);
    par_for(s->threads, s->n, GRAIN, move_range, s);
    swap_in(&s->point, &s->next);
    return status;
}

static enum status smooth(struct surface *s, struct denoise_result *made) {
    enum status status = choose_level(s);
    for (int round = 0; round < ROUNDS && !status; round++) {
        status = smooth_round(s);
        if (made->noise == 0) made->noise = s->noise;
        bool is_last = round + 1 == ROUNDS;
        if (is_last && s->level->step > 1 && !status) status = look_around(s, s->level - 1), round = -1;
    }
    return status;
}

static enum status allocate(struct surface *s) {
    size_t n = s->n;
    s->normal = alloc_array(n, sizeof *s->normal);
    s->next = alloc_array(n, sizeof *s->next);
    s->rim_sq = alloc_array(n, sizeof *s->rim_sq);
    s->spread = alloc_array(n, sizeof *s->spread);
    s->chunk_status = alloc_zeroed(n / GRAIN + 1, sizeof *s->chunk_status);
    return s->normal && s->next && s->rim_sq && s->spread && s->chunk_status ? STATUS_OK : STATUS_NO_MEMORY;
}

static void surface_done(struct surface *s) {
    knn_free(s->knn);
    free(s->listened), free(s->near), free(s->rim_sq), free(s->spread), free(s->chunk_status);
    free(s->point), free(s->normal), free(s->next);
}

enum status denoise_smooth(const vec3 *point, size_t n, unsigned threads, struct denoise_result *result) {
    struct surface s = {.n = n, .threads = threads};
    struct denoise_result made = {0};
    enum status status = STATUS_NO_MEMORY;
    s.point = alloc_array(n, sizeof *s.point);
    made.stray = alloc_zeroed(n, sizeof *made.stray);
    if (!s.point || !made.stray) goto out;
    memcpy(s.point, point, n * sizeof *s.point);
    status = n < DENOISE_MIN_POINTS ? STATUS_OK : allocate(&s);
    if (status || n < DENOISE_MIN_POINTS) goto out;
    status = smooth(&s, &made);
    if (!status) find_strays(&s, point, &made);
out:
    if (!status) made.point = s.point, s.point = NULL;
    surface_done(&s);
    if (status)
        denoise_done(&made);
    else
        *result = made;
    return status;
}

void denoise_done(struct denoise_result *result) {
    if (!result) return;
    free(result->point);
    free(result->stray);
    *result = (struct denoise_result){0};
}
