/* Places where a scanner may have stood, on grids in and around the points, and how unevenly these are spread.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/eye.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/spatial/knn.h"

enum { POINTS = EYE_POINTS, BESIDE = 17 /* the point itself and others */ };
static const double REACH = 2, INNER = 0.9; /* of half the box */
static const double BEYOND = 0.3;           /* of the extent of most points */
static const double FIRST_STEP = 0.2;
static const double UNEVEN = 0.65;     /* of the surface: below, there is nothing to be explained */
static const double MARGIN_OUT = 0.01; /* so many points on either side may be strays */
enum { FEW = 8 /* of so many points of a sample one tells how uneven it is about */ };
static const double CLEARLY_EVEN = 0.45; /* of the surface by those: far below UNEVEN for what they tell */

struct sample {
    size_t n;
    vec3 *point;
};

/* From the first quarter to the third. */
static double spread_of_values(float *value, size_t n) {
    double low = (double)quantile_of(value, n, 0.25), high = (double)quantile_of(value, n, 0.75);
    return high - low;
}

/* Middle and half the extent of most points. */
static vec3 box_of(const vec3 *point, size_t n, vec3 *half) {
    float at[POINTS];
    double middle[3], extent[3];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < n; i++) at[i] = (float)(axis == 0 ? point[i].x : axis == 1 ? point[i].y : point[i].z);
        double low = (double)quantile_of(at, n, MARGIN_OUT), high = (double)quantile_of(at, n, 1 - MARGIN_OUT);
        middle[axis] = (low + high) / 2, extent[axis] = (high - low) / 2;
    }
    *half = (vec3){extent[0], extent[1], extent[2]};
    return (vec3){middle[0], middle[1], middle[2]};
}

/* side^3 places of a grid of this half size. */
static size_t lay_grid(vec3 middle, vec3 half, int side, vec3 *place) {
    size_t count = 0;
    for (int i = 0; i < side * side * side; i++) {
        vec3 at = {i % side, i / side % side, i / (side * side)};
        vec3 share = vec3_sub(vec3_scale(at, 2.0 / (side - 1)), (vec3){1, 1, 1});
        place[count++] = vec3_add(middle, (vec3){share.x * half.x, share.y * half.y, share.z * half.z});
    }
    return count;
}

/* Middle and half the size of the grid around points, and of that within them; half of the points' longest side. */
static double grids_of(const vec3 *point, size_t n, vec3 *middle, vec3 *around, vec3 *within) {
    vec3 half;
    *middle = box_of(point, n, &half);
    double most = fmax(half.x, fmax(half.y, half.z)), wide = REACH * most, thin = 0.15 * most;
    *around = (vec3){wide, wide, wide};
    *within = vec3_scale(vec3_max(half, (vec3){thin, thin, thin}), INNER);
    return most;
}

double eye_places_around(const vec3 *point, size_t n, vec3 place[EYE_PLACES_AROUND]) {
    vec3 middle, around, within;
    double most = grids_of(point, n, &middle, &around, &within);
    lay_grid(middle, around, EYE_AROUND, place);
    return FIRST_STEP * most;
}

double eye_places(const vec3 *point, size_t n, vec3 place[EYE_PLACES]) {
    vec3 middle, around, within;
    double most = grids_of(point, n, &middle, &around, &within);
    size_t count = lay_grid(middle, around, EYE_AROUND, place);
    lay_grid(middle, within, EYE_WITHIN, &place[count]);
    return FIRST_STEP * most;
}

void eye_places_dense(const vec3 *point, size_t n, vec3 place[EYE_PLACES_DENSE]) {
    static const double share[EYE_DENSE] = {0.02, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98, 0.98};
    double own[3][EYE_DENSE];
    float at[EYE_POINTS];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < n; i++) at[i] = (float)(axis == 0 ? point[i].x : axis == 1 ? point[i].y : point[i].z);
        for (int k = 0; k < EYE_DENSE; k++) own[axis][k] = (double)quantile_of(at, n, share[k]);
        double beyond = BEYOND * (own[axis][EYE_DENSE - 1] - own[axis][0]);
        own[axis][0] -= beyond, own[axis][EYE_DENSE - 1] += beyond;
    }
    for (int i = 0; i < EYE_PLACES_DENSE; i++)
        place[i] =
            (vec3){own[0][i % EYE_DENSE], own[1][i / EYE_DENSE % EYE_DENSE], own[2][i / (EYE_DENSE * EYE_DENSE)]};
}

/* How unevenly points lie on their surface: how far the 16th neighbour of each is, twice its logarithm.  By all points
 * of the sample, or one of `each`. */
static enum status find_uneven(const struct sample *sample, size_t each, unsigned threads, double *uneven) {
    struct knn *knn = NULL;
    size_t n = sample->n / each;
    vec3 *asked = alloc_array(n, sizeof *asked);
    uint32_t *id = alloc_array(n * BESIDE, sizeof *id);
    double *distance_sq = alloc_array(n * BESIDE, sizeof *distance_sq);
    float *density = alloc_array(n, sizeof *density);
    enum status status = asked && id && distance_sq && density ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < n; i++) asked[i] = sample->point[i * each];
    if (!status) status = knn_new(sample->point, sample->n, threads, &knn, NULL);
    if (!status) status = knn_search(knn, asked, n, BESIDE, threads, id, distance_sq);
    for (size_t i = 0; !status && i < n; i++)
        density[i] = logf(fmaxf((float)distance_sq[i * BESIDE + BESIDE - 1], 1e-30F));
    if (!status) *uneven = spread_of_values(density, n);
    knn_free(knn);
    free(asked), free(id), free(distance_sq), free(density);
    return status;
}

/* Some of the points; nothing of few. */
static enum status take_sample(const vec3 *point, size_t n, struct sample *sample) {
    *sample = (struct sample){POINTS, NULL};
    if (n < POINTS) return STATUS_OK;
    sample->point = alloc_array(POINTS, sizeof *sample->point);
    if (!sample->point) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < POINTS; i++) sample->point[i] = point[i * n / POINTS];
    return STATUS_OK;
}

enum status eye_is_sought(const vec3 *point, size_t n, unsigned threads, bool *sought) {
    struct sample sample;
    double uneven = 0;
    enum status status = take_sample(point, n, &sample);
    if (!status && sample.point) status = find_uneven(&sample, FEW, threads, &uneven);
    if (!status && uneven > CLEARLY_EVEN) status = find_uneven(&sample, 1, threads, &uneven);
    *sought = !status && uneven > UNEVEN;
    free(sample.point);
    return status;
}
