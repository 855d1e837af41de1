/* Each patch is fitted by a paraboloid, and what is left of heights by a step between points of low ids and of high
 * ones.  Chance, noise and edges make steps too, but at other ids in each patch; of scans that fit, one patch in a
 * hundred has its step where another has it, of two that don't a third at least.
 *
 * What the step is as a vector, its height along the patch's normal, is the shift's part along that normal, if there is
 * one; of both sides of a thin wall it is as high everywhere.  Which of these it is the medians of what is left tell,
 * as a patch across an edge has no normal.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/misfit.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"

enum { PATCHES = 256, WIDE = 48, FORMS = 6 };
static const double EXPLAINED = 0.5; /* of what is left of heights, by the step: patches that vote */
static const double BESIDE = 2;      /* points' worth of step that no paraboloid takes over, at least */
static const double AGREE = 0.1;     /* of the patches vote for the same place */
static const double CLOSER = 0.25;   /* of what steps of one height leave, one shift leaves at most */
static const double CLOSE = 0.15;    /* of the usual height of steps, likewise */
enum { ROUNDS = 10 };                /* of fitting a shift to most patches */

/* What is left of heights in a patch, its points in the order of their ids. */
struct patch {
    vec3 normal;
    uint32_t id[WIDE];
    double form[FORMS][WIDE]; /* an orthonormal basis of paraboloids */
    double left[WIDE], left_sq;
};

struct step {
    double height, gain; /* of the points above it over the others; squares that it explains */
};

static int by_low_word(const void *a, const void *b) {
    const uint64_t *x = a, *y = b;
    return (*x > *y) - (*x < *y);
}

static double dot(const double *a, const double *b) {
    double sum = 0;
    for (unsigned i = 0; i < WIDE; i++) sum += a[i] * b[i];
    return sum;
}

/* Takes off `from` what the forms so far explain of it. */
static void take_off(const struct patch *patch, unsigned forms, double *from) {
    for (unsigned j = 0; j < forms; j++) {
        double share = dot(patch->form[j], from);
        for (unsigned i = 0; i < WIDE; i++) from[i] -= share * patch->form[j][i];
    }
}

/* x and y in units of about 1. */
static void make_forms(struct patch *patch, const double *x, const double *y) {
    static const double NOTHING = 1e-6;
    for (unsigned i = 0; i < WIDE; i++) {
        const double of[FORMS] = {1, x[i], y[i], x[i] * x[i], x[i] * y[i], y[i] * y[i]};
        for (unsigned j = 0; j < FORMS; j++) patch->form[j][i] = of[j];
    }
    for (unsigned j = 0; j < FORMS; j++) {
        take_off(patch, j, patch->form[j]);
        double length = sqrt(dot(patch->form[j], patch->form[j]));
        for (unsigned i = 0; i < WIDE; i++) patch->form[j][i] = length > NOTHING ? patch->form[j][i] / length : 0;
    }
}

static void fill_patch(const vec3 *point, const uint32_t *id, const uint32_t *near, struct patch *patch) {
    uint64_t sorted[WIDE];
    vec3 at[WIDE], sum = {0, 0, 0}, across[3];
    sym3 moment = {0};
    double x[WIDE], y[WIDE], spread[3];
    for (unsigned i = 0; i < WIDE; i++) sorted[i] = (uint64_t)id[near[i]] << 32 | near[i];
    qsort(sorted, WIDE, sizeof *sorted, by_low_word);
    for (unsigned i = 0; i < WIDE; i++) {
        patch->id[i] = (uint32_t)(sorted[i] >> 32);
        at[i] = vec3_sub(point[(uint32_t)sorted[i]], point[near[0]]);
        sum = vec3_add(sum, at[i]);
    }
    for (unsigned i = 0; i < WIDE; i++) {
        at[i] = vec3_sub(at[i], vec3_scale(sum, 1.0 / WIDE));
        moment = sym3_add(moment, sym3_scale(sym3_outer(at[i]), 1.0 / WIDE));
    }
    sym3_eigen(moment, spread, across);
    double unit = spread[2] > 0 ? 1 / sqrt(spread[2]) : 0;
    for (unsigned i = 0; i < WIDE; i++) {
        x[i] = vec3_dot(across[1], at[i]) * unit, y[i] = vec3_dot(across[2], at[i]) * unit;
        patch->left[i] = vec3_dot(across[0], at[i]);
    }
    patch->normal = across[0];
    make_forms(patch, x, y);
    take_off(patch, FORMS, patch->left);
    patch->left_sq = dot(patch->left, patch->left);
}

/* The step below the point `above`, fitted together with the paraboloid. */
static struct step fit_step(const struct patch *patch, unsigned above) {
    double along = 0, own = WIDE - above;
    for (unsigned i = above; i < WIDE; i++) along += patch->left[i];
    for (unsigned j = 0; j < FORMS; j++) {
        double shared = 0;
        for (unsigned i = above; i < WIDE; i++) shared += patch->form[j][i];
        own -= shared * shared;
    }
    if (own < BESIDE) return (struct step){0, 0};
    return (struct step){along / own, along * along / own};
}

/* A patch's best step is between these two ids. */
struct vote {
    uint32_t below, above;
};

static bool vote(const struct patch *patch, struct vote *vote) {
    double most = 0;
    unsigned best = 0;
    for (unsigned i = 1; i < WIDE; i++) {
        struct step step = fit_step(patch, i);
        if (step.gain > most) most = step.gain, best = i;
    }
    if (best == 0 || most <= EXPLAINED * patch->left_sq) return false;
    *vote = (struct vote){patch->id[best - 1], patch->id[best]};
    return true;
}

/* Where most votes agree, and how many do. */
static size_t count_votes(const struct vote *votes, size_t count, struct misfit *misfit) {
    size_t most = 0;
    for (size_t i = 0; i < count; i++) {
        uint32_t last = 0, first = votes[i].above;
        size_t agree = 0;
        for (size_t j = 0; j < count; j++) {
            if (votes[j].below >= votes[i].above || votes[j].above < votes[i].above) continue;
            last = votes[j].below > last ? votes[j].below : last;
            agree++;
        }
        if (agree > most) most = agree, misfit->last = last, misfit->first = first;
    }
    return most;
}

/* Steps of all patches that have points of both scans. */
struct steps {
    size_t count;
    vec3 normal[PATCHES];
    double height[PATCHES];
};

static void measure_steps(const struct patch *patch, const struct misfit *misfit, struct steps *steps) {
    steps->count = 0;
    for (size_t i = 0; i < PATCHES; i++) {
        unsigned above = 0;
        while (above < WIDE && patch[i].id[above] < misfit->first) above++;
        if (above == 0 || above == WIDE) continue;
        struct step step = fit_step(&patch[i], above);
        if (!(step.gain > 0)) continue;
        steps->normal[steps->count] = patch[i].normal;
        steps->height[steps->count++] = step.height;
    }
}

static double median_of(const double *value, size_t count) {
    float some[PATCHES];
    for (size_t i = 0; i < count; i++) some[i] = (float)value[i];
    return (double)quantile_of(some, count, 0.5);
}

/* The shift that most steps are the height of, by least absolute residuals; left: what is left of each. */
static vec3 fit_shift(const struct steps *steps, double usual, double *left) {
    static const double LITTLE = 1e-2, FLAT = 1e-6; /* of usual heights; of the moments' trace */
    vec3 shift = {0, 0, 0}, axis[3];
    double value[3], weight[PATCHES];
    for (size_t i = 0; i < steps->count; i++) weight[i] = 1;
    for (int round = 0; round < ROUNDS; round++) {
        sym3 moment = {0};
        vec3 sum = {0, 0, 0};
        for (size_t i = 0; i < steps->count; i++) {
            moment = sym3_add(moment, sym3_scale(sym3_outer(steps->normal[i]), weight[i]));
            sum = vec3_add(sum, vec3_scale(steps->normal[i], weight[i] * steps->height[i]));
        }
        sym3_eigen(moment, value, axis);
        shift = (vec3){0, 0, 0};
        for (int k = 0; k < 3; k++)
            if (value[k] > FLAT * sym3_trace(moment))
                shift = vec3_add(shift, vec3_scale(axis[k], vec3_dot(axis[k], sum) / value[k]));
        for (size_t i = 0; i < steps->count; i++) {
            left[i] = fabs(steps->height[i] - vec3_dot(steps->normal[i], shift));
            weight[i] = 1 / fmax(left[i], LITTLE * usual);
        }
    }
    return shift;
}

/* Whether steps are those of one shift, and surely not of one height. */
static bool find_shift(const struct steps *steps, vec3 *shift) {
    double height[PATCHES], left[PATCHES];
    for (size_t i = 0; i < steps->count; i++) height[i] = fabs(steps->height[i]);
    double usual = median_of(height, steps->count);
    if (!(usual > 0)) return false;
    *shift = fit_shift(steps, usual, left);
    double by_shift = median_of(left, steps->count);
    for (size_t i = 0; i < steps->count; i++) left[i] = fabs(height[i] - usual);
    double by_height = median_of(left, steps->count);
    return by_shift < CLOSER * by_height && by_shift < CLOSE * usual;
}

static enum status fill_patches(const struct knn *knn, const vec3 *point, const uint32_t *id, size_t n,
                                unsigned threads, struct patch *patch) {
    vec3 at[PATCHES];
    uint32_t *near = alloc_array((size_t)PATCHES * WIDE, sizeof *near);
    double *distance_sq = alloc_array((size_t)PATCHES * WIDE, sizeof *distance_sq);
    enum status status = near && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < PATCHES; i++) at[i] = point[n / PATCHES * i];
    if (!status) status = knn_search(knn, at, PATCHES, WIDE, threads, near, distance_sq);
    for (size_t i = 0; i < PATCHES && !status; i++) fill_patch(point, id, &near[i * WIDE], &patch[i]);
    free(near), free(distance_sq);
    return status;
}

enum status misfit_find(const struct knn *knn, const vec3 *point, const uint32_t *id, size_t n, unsigned threads,
                        bool *found, struct misfit *misfit) {
    struct vote votes[PATCHES];
    struct steps steps;
    size_t count = 0;
    *found = false;
    if (n < (size_t)PATCHES * WIDE / 2) return STATUS_OK;
    struct patch *patch = alloc_array(PATCHES, sizeof *patch);
    enum status status = patch ? fill_patches(knn, point, id, n, threads, patch) : STATUS_NO_MEMORY;
    for (size_t i = 0; i < PATCHES && !status; i++) count += vote(&patch[i], &votes[count]);
    size_t agree = status ? 0 : count_votes(votes, count, misfit);
    if ((double)agree >= AGREE * PATCHES) {
        measure_steps(patch, misfit, &steps);
        *found = find_shift(&steps, &misfit->shift);
    }
    free(patch);
    return status;
}

/* ------------------------------------------------------------------------------------------------ doubles */

static const double CLEARLY_MORE = 1.25; /* points has the latter scan if it is the one that stays */

/* The points of either scan; those between belong to neither, and go with the doubles. */
struct parted {
    uint32_t *goes;
    vec3 *stays;
    size_t goes_count, stays_count;
};

static void part(const vec3 *point, const uint32_t *id, size_t n, const struct misfit *misfit, struct parted *parted) {
    size_t before = 0, after = 0;
    for (size_t p = 0; p < n; p++) before += id[p] <= misfit->last, after += id[p] >= misfit->first;
    bool former_stays = (double)after <= CLEARLY_MORE * (double)before;
    for (size_t p = 0; p < n; p++) {
        bool stays = former_stays ? id[p] <= misfit->last : id[p] >= misfit->first;
        if (stays)
            parted->stays[parted->stays_count++] = point[p];
        else
            parted->goes[parted->goes_count++] = (uint32_t)p;
    }
}

/* Places at a time, and the neighbours of the nearest one that tell how far apart points are there. */
enum { BATCH = 1024, AROUND = 8 };

struct batch {
    vec3 at[BATCH];
    uint32_t nearest[BATCH], around[BATCH * AROUND];
    double distance_sq[BATCH], around_sq[BATCH * AROUND];
};

static enum status judge_batch(const struct knn *knn, const vec3 *point, const struct parted *parted, size_t begin,
                               size_t count, double shift, unsigned threads, struct batch *batch, uint8_t *is_double) {
    static const double MORE = 1.25;
    for (size_t i = 0; i < count; i++) batch->at[i] = point[parted->goes[begin + i]];
    enum status status = knn_search(knn, batch->at, count, 1, threads, batch->nearest, batch->distance_sq);
    if (status) return status;
    for (size_t i = 0; i < count; i++) batch->at[i] = parted->stays[batch->nearest[i]];
    status = knn_search(knn, batch->at, count, AROUND, threads, batch->around, batch->around_sq);
    for (size_t i = 0; i < count && !status; i++) {
        double apart = sqrt(batch->around_sq[i * AROUND + AROUND - 1]);
        is_double[parted->goes[begin + i]] = sqrt(batch->distance_sq[i]) <= MORE * shift + apart;
    }
    return status;
}

enum status misfit_doubles(const vec3 *point, const uint32_t *id, size_t n, const struct misfit *misfit,
                           unsigned threads, uint8_t *is_double, size_t *count) {
    struct parted parted = {.goes = alloc_array(n, sizeof *parted.goes), .stays = alloc_array(n, sizeof *parted.stays)};
    struct batch *batch = alloc_array(1, sizeof *batch);
    struct knn *knn = NULL;
    double shift = vec3_length(misfit->shift);
    enum status status = parted.goes && parted.stays && batch ? STATUS_OK : STATUS_NO_MEMORY;
    memset(is_double, 0, n);
    *count = 0;
    if (!status) part(point, id, n, misfit, &parted);
    if (!status && parted.stays_count > AROUND) status = knn_new(parted.stays, parted.stays_count, threads, &knn, NULL);
    for (size_t i = 0; i < parted.goes_count && knn && !status; i += BATCH) {
        size_t some = parted.goes_count - i < BATCH ? parted.goes_count - i : BATCH;
        status = judge_batch(knn, point, &parted, i, some, shift, threads, batch, is_double);
    }
    for (size_t p = 0; p < n && !status; p++) *count += is_double[p];
    knn_free(knn);
    free(parted.goes), free(parted.stays), free(batch);
    return status;
}
