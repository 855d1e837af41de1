/* How thick neighbourhoods are for their width, from near to wide: noise is as thick however widely one looks, so it
 * gets thinner for the width; edges don't, and curvature gets thicker.  Both sides of a thin wall are as thick as
 * noise, but nothing lies between them; points of a thin bar are all as far from its axis.  A wood gets thinner, too,
 * where one looks so widely that its trees are a layer; but a place in a crown tells how high those beside it are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/shell.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/heights.h"
#include "core/spatial/tube.h"

enum { GRAIN = 64 };
enum { NEAR_K = 15, WIDE_K = 63, LEAST_STEP = 4, MOST_STEP = 256 };
static const double THICK = 0.15;     /* for the width, of near points; a shell as thick as half a spacing has it */
static const double THINNER = 0.5;    /* by so much where many more points are looked at */
static const double TWO_SHEETS = 1.6; /* kurtosis at half of the thick places, at most */
static const double RIM_SQ = 1.44;    /* where weights end, of the squared distance to the last neighbour */
/* Where all but a few places are thick, noise of several distances between points is no thicker than its body by much;
 * what a body is filled with evenly isn't as dense in the middle. */
static const double EVERYWHERE = 0.95, SOMEWHAT_THINNER = 0.7;
static const double PEAKED = 2.4; /* median kurtosis where places are thinnest, at least */
static const double UNTOLD = 0.8; /* median nugget of those that get thin far off alone, at least */

/* Around place: standard deviation from a plane for the distance to the last of k neighbours, who weigh less the
 * farther they are. */
static double thickness_of(const vec3 *point, vec3 place, const uint32_t *near, unsigned k, double last_sq) {
    vec3 sum = {0, 0, 0}, across;
    sym3 moment = {0};
    double total = 0, least = 0;
    for (unsigned i = 0; i <= k; i++) {
        vec3 e = vec3_sub(point[near[i]], place);
        double t = fmax(0, 1 - vec3_length_sq(e) / (RIM_SQ * last_sq)), w = t * t;
        total += w;
        sum = vec3_add(sum, vec3_scale(e, w));
        moment = sym3_add(moment, sym3_scale(sym3_outer(e), w));
    }
    if (!(total > 0)) return 0;
    moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1 / total));
    sym3_least(&moment, 1, &least, &across);
    return sqrt(fmax(least, 0) / total / last_sq);
}

struct places {
    size_t count;
    vec3 *at;
    float *near, *wide; /* thickness among the nearest, and the least among more */
    float *peak;        /* kurtosis of the heights there */
    float *soon;        /* the least thickness up to LEAST_STEP */
    float *nugget;      /* of the heights among every LEAST_STEP-th point */
    uint32_t *id;       /* count rows of WIDE_K + 1 */
    double *distance_sq;
};

struct shell_look {
    const vec3 *point;
    struct places *places;
    size_t step;
};

static void thickness_range(void *ctx, size_t begin, size_t end) {
    const struct shell_look *look = ctx;
    struct places *places = look->places;
    for (size_t i = begin; i < end; i++) {
        const uint32_t *id = &places->id[i * (WIDE_K + 1)];
        const double *distance_sq = &places->distance_sq[i * (WIDE_K + 1)];
        if (look->step == 1) {
            places->near[i] = (float)thickness_of(look->point, places->at[i], id, NEAR_K, distance_sq[NEAR_K]);
            places->wide[i] = places->near[i];
            places->peak[i] = 0;
        }
        double wide = thickness_of(look->point, places->at[i], id, WIDE_K, distance_sq[WIDE_K]);
        if (look->step <= LEAST_STEP) places->soon[i] = fminf((float)wide, places->wide[i]);
        if (look->step == LEAST_STEP) places->nugget[i] = (float)heights_nugget(look->point, id, WIDE_K + 1);
        if (!(wide < (double)places->wide[i])) continue;
        places->wide[i] = (float)wide;
        places->peak[i] = (float)fmin(heights_kurtosis(look->point, id, WIDE_K + 1), WIDE_K);
    }
}

/* Looks at the neighbours among every step-th point; all of them have WIDE_K. */
static enum status look(const struct knn *knn, const vec3 *point, size_t step, unsigned threads,
                        struct places *places) {
    struct shell_look look = {point, places, step};
    enum status status =
        knn_search(knn, places->at, places->count, WIDE_K + 1, threads, places->id, places->distance_sq);
    if (!status) par_for(threads, places->count, GRAIN, thickness_range, &look);
    return status;
}

static enum status look_among(const vec3 *point, size_t n, size_t step, unsigned threads, struct places *places) {
    size_t m = (n - 1) / step + 1;
    struct knn *knn = NULL;
    vec3 *some = alloc_array(m, sizeof *some);
    enum status status = some ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < m; i++) some[i] = point[i * step];
    if (!status) status = knn_new(some, m, threads, &knn, NULL);
    if (!status) status = look(knn, some, step, threads, places);
    knn_free(knn);
    free(some);
    return status;
}

/* Of the places: those with near points in a ball that are thinner by so much where one looks widely. */
static double share_of(const struct places *places, double thinner) {
    size_t thick = 0;
    for (size_t i = 0; i < places->count; i++)
        thick += (double)places->near[i] > THICK && (double)places->wide[i] < thinner * (double)places->near[i];
    return (double)thick / (double)places->count;
}

/* Of the places: those with near points in a ball. */
static double share_thick(const struct places *places) { return share_of(places, INFINITY); }

/* Noise is densest in its middle, unlike leaves and grain that fill a body. */
static bool is_peaked(struct places *places) { return (double)quantile_of(places->peak, places->count, 0.5) >= PEAKED; }

/* Whether most places that are thick near by have two sheets, a wall's, which are not to become one, or many are of
 * thin bars, which are not to become lines. */
static enum status shell_is_thin(const vec3 *point, const struct places *places, bool *have) {
    static const double MANY = 0.25;
    size_t n = 0, of_bars = 0;
    float *kurtosis = alloc_array(places->count, sizeof *kurtosis);
    if (!kurtosis) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < places->count; i++) {
        const uint32_t *id = &places->id[i * (WIDE_K + 1)];
        if ((double)places->near[i] <= THICK) continue;
        kurtosis[n++] = (float)fmin(heights_kurtosis(point, id, HEIGHTS_K), HEIGHTS_K);
        double uneven = fmin(tube_unevenness(point, id, HEIGHTS_K), tube_unevenness(point, id, HEIGHTS_K / 2));
        of_bars += uneven < TUBE_UNEVENNESS_MOST;
    }
    *have = n > 0 && ((double)quantile_of(kurtosis, n, 0.5) < TWO_SHEETS || (double)of_bars > MANY * (double)n);
    free(kurtosis);
    return STATUS_OK;
}

static bool is_thinner(const struct places *places, size_t i, float wide) {
    return (double)places->near[i] > THICK && (double)wide < THINNER * (double)places->near[i];
}

/* Forgets who gets thin far off alone, where these have a shape that isn't as thin. */
static enum status forget_shapes(struct places *places) {
    size_t n = 0;
    float *nugget = alloc_array(places->count, sizeof *nugget);
    if (!nugget) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < places->count; i++)
        if (is_thinner(places, i, places->wide[i]) && !is_thinner(places, i, places->soon[i]))
            nugget[n++] = places->nugget[i];
    bool shaped = n > 0 && (double)quantile_of(nugget, n, 0.5) < UNTOLD;
    for (size_t i = 0; i < places->count && shaped; i++) places->wide[i] = places->soon[i];
    free(nugget);
    return STATUS_OK;
}

static enum status places_new(const vec3 *point, size_t n, struct places *places) {
    size_t count = n < SHELL_PLACES ? n : SHELL_PLACES;
    places->count = count;
    places->at = alloc_array(count, sizeof *places->at);
    places->near = alloc_array(count, sizeof *places->near);
    places->wide = alloc_array(count, sizeof *places->wide);
    places->peak = alloc_array(count, sizeof *places->peak);
    places->soon = alloc_array(count, sizeof *places->soon);
    places->nugget = alloc_array(count, sizeof *places->nugget);
    places->id = alloc_array(count, (WIDE_K + 1) * sizeof *places->id);
    places->distance_sq = alloc_array(count, (WIDE_K + 1) * sizeof *places->distance_sq);
    bool has_numbers = places->near && places->wide && places->peak && places->soon && places->nugget;
    if (!has_numbers || !places->at || !places->id || !places->distance_sq) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < count; i++) places->at[i] = point[n / count * i + n % count * i / count];
    return STATUS_OK;
}

static void places_done(struct places *places) {
    free(places->at), free(places->near), free(places->wide), free(places->peak), free(places->soon);
    free(places->nugget), free(places->id), free(places->distance_sq);
}

static void copy_near(const struct places *places, struct shell_near *near) {
    for (size_t i = 0; i < SHELL_ROWS; i++) {
        size_t from = 2 * i * (WIDE_K + 1), to = i * SHELL_NEAR;
        memcpy(&near->id[to], &places->id[from], SHELL_NEAR * sizeof *near->id);
        memcpy(&near->distance_sq[to], &places->distance_sq[from], SHELL_NEAR * sizeof *near->distance_sq);
    }
}

enum status shell_find(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share,
                       struct shell_near *near, bool *filled) {
    struct places places = {0};
    *share = 0;
    if (near) *filled = false;
    if (n < SHELL_MIN_POINTS) return STATUS_OK;
    enum status status = places_new(point, n, &places);
    if (!status) status = look(knn, point, 1, threads, &places);
    if (!status && near && places.count == SHELL_PLACES) {
        copy_near(&places, near);
        *filled = true;
    }
    bool may_be = !status && share_thick(&places) >= SHELL_MANY, is_thin = false;
    if (may_be) status = shell_is_thin(point, &places, &is_thin);
    may_be = may_be && !status && !is_thin;
    for (size_t step = LEAST_STEP; may_be && !status && step <= MOST_STEP && n / step > 2 * WIDE_K; step *= LEAST_STEP)
        status = look_among(point, n, step, threads, &places);
    if (!status && may_be) status = forget_shapes(&places);
    if (!status && may_be) *share = share_of(&places, THINNER);
    if (!status && may_be && *share < SHELL_MANY && share_thick(&places) >= EVERYWHERE && is_peaked(&places))
        *share = share_of(&places, SOMEWHAT_THINNER);
    places_done(&places);
    return status;
}
