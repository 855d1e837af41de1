/* Each patch is fitted by a paraboloid, and what is left of heights by a step between points of low ids and of high
 * ones.  Chance, noise and edges make steps too, but at other ids in each patch; of scans that fit, one patch in a
 * hundred has its step where another has it, of two that don't a tenth at least.
 *
 * The step's height is the part of the scan's motion along the patch's normal, if there is one; of both sides of a thin
 * wall it is as high everywhere.  Which of these it is the medians of what is left tell, as a patch across an edge has
 * no normal.  A motion that turns may be a wedge as well, unless normals are in all directions; and a shift the three
 * thicknesses of three walls that meet in a corner, unless some of them go inwards and some outwards.
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
static const double CLOSER = 0.25;   /* of what steps of one height leave, one motion leaves at most */
static const double CLOSE = 0.15;    /* of the usual height of steps, likewise */
enum { ROUNDS = 10 };                /* of fitting a motion to most patches */
/* Mean square of normals' least part, where a turn may be sought: a third where they are in all directions alike. */
static const double ALL_AROUND = 0.08;
static const double LIKE = 0.966;     /* cosine between normals of about one direction: 15 degrees */
static const double FEW_OTHERS = 0.2; /* of the patches */

/* What is left of heights in a patch, its points in the order of their ids. */
struct patch {
    vec3 at, normal;
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
    patch->at = vec3_add(point[near[0]], vec3_scale(sum, 1.0 / WIDE));
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

/* Where most votes agree; returns how many do.  Where a quarter as many agree elsewhere there are several scans. */
static size_t find_place(struct vote *votes, size_t count, struct misfit *misfit) {
    enum { QUARTER = 4 };
    struct misfit elsewhere;
    size_t agree = count_votes(votes, count, misfit), others = 0;
    for (size_t i = 0; i < count; i++)
        if (votes[i].below >= misfit->first || votes[i].above <= misfit->last) votes[others++] = votes[i];
    misfit->several = QUARTER * count_votes(votes, others, &elsewhere) >= agree;
    return agree;
}

/* Steps of all patches that have points of both scans. */
struct steps {
    size_t count;
    vec3 at[PATCHES], normal[PATCHES];
    double height[PATCHES];
    double usual; /* median height */
    vec3 centre;
    double size; /* of where they are, about it: root mean square */
};

static double median_of(const double *value, size_t count) {
    float some[PATCHES];
    for (size_t i = 0; i < count; i++) some[i] = (float)fabs(value[i]);
    return (double)quantile_of(some, count, 0.5);
}

static void measure_steps(const struct patch *patch, const struct misfit *misfit, struct steps *steps) {
    vec3 sum = {0, 0, 0};
    double squares = 0;
    steps->count = 0;
    for (size_t i = 0; i < PATCHES; i++) {
        unsigned above = 0;
        while (above < WIDE && patch[i].id[above] < misfit->first) above++;
        if (above == 0 || above == WIDE) continue;
        struct step step = fit_step(&patch[i], above);
        if (!(step.gain > 0)) continue;
        steps->at[steps->count] = patch[i].at;
        steps->normal[steps->count] = patch[i].normal;
        steps->height[steps->count++] = step.height;
        sum = vec3_add(sum, patch[i].at);
    }
    steps->centre = vec3_scale(sum, 1 / (double)steps->count);
    for (size_t i = 0; i < steps->count; i++) squares += vec3_distance_sq(steps->at[i], steps->centre);
    steps->size = sqrt(squares / (double)steps->count);
    steps->usual = median_of(steps->height, steps->count);
}

/* What a step's height is a sum of: the parts of a shift, and of a turn about the centre, in units of their size. */
enum { SHIFTS = 3, TURNS = 6 };

static void parts_of_step(const struct steps *steps, size_t i, double part[TURNS]) {
    vec3 n = steps->normal[i], arm = vec3_scale(vec3_sub(steps->at[i], steps->centre), 1 / steps->size);
    vec3 turned = vec3_cross(arm, n);
    part[0] = n.x, part[1] = n.y, part[2] = n.z, part[3] = turned.x, part[4] = turned.y, part[5] = turned.z;
}

/* Solves m x = x0 for x in place, m symmetric, of `size`, and made definite here: what no step tells of is 0. */
static void solve(double m[TURNS][TURNS], double x[TURNS], unsigned size) {
    static const double LITTLE = 1e-4; /* of the mean of the diagonal */
    double trace = 0;
    for (unsigned i = 0; i < size; i++) trace += m[i][i];
    for (unsigned i = 0; i < size; i++) m[i][i] += LITTLE * trace / size;
    for (unsigned i = 0; i < size; i++)
        for (unsigned j = i + 1; j < size; j++) {
            double share = m[j][i] / m[i][i];
            for (unsigned k = i; k < size; k++) m[j][k] -= share * m[i][k];
            x[j] -= share * x[i];
        }
    for (unsigned i = size; i-- > 0;) {
        for (unsigned k = i + 1; k < size; k++) x[i] -= m[i][k] * x[k];
        x[i] /= m[i][i];
    }
}

/* The motion, of SHIFTS or TURNS parts, that most steps are the heights of, by least absolute residuals; returns the
 * median of these. */
static double fit_motion(const struct steps *steps, unsigned parts, double motion[TURNS]) {
    static const double LITTLE = 1e-2; /* of usual heights */
    double weight[PATCHES], left[PATCHES], part[TURNS];
    for (size_t i = 0; i < steps->count; i++) weight[i] = 1;
    for (int round = 0; round < ROUNDS; round++) {
        double moment[TURNS][TURNS] = {{0}};
        for (unsigned j = 0; j < TURNS; j++) motion[j] = 0;
        for (size_t i = 0; i < steps->count; i++) {
            parts_of_step(steps, i, part);
            for (unsigned j = 0; j < parts; j++) {
                motion[j] += weight[i] * part[j] * steps->height[i];
                for (unsigned k = 0; k < parts; k++) moment[j][k] += weight[i] * part[j] * part[k];
            }
        }
        solve(moment, motion, parts);
        for (size_t i = 0; i < steps->count; i++) {
            left[i] = steps->height[i];
            parts_of_step(steps, i, part);
            for (unsigned j = 0; j < parts; j++) left[i] -= motion[j] * part[j];
            weight[i] = 1 / fmax(fabs(left[i]), LITTLE * steps->usual);
        }
    }
    return median_of(left, steps->count);
}

/* Whether normals are in all directions, as those of a leaf or a blade aren't. */
static bool face_all_around(const struct steps *steps) {
    double value[3];
    vec3 axis[3];
    sym3 moment = {0};
    for (size_t i = 0; i < steps->count; i++) moment = sym3_add(moment, sym3_outer(steps->normal[i]));
    sym3_eigen(moment, value, axis);
    return value[0] >= ALL_AROUND * (double)steps->count;
}

/* Whether three directions are nearly all that normals have, by far the most frequent first. */
static bool face_three_ways(const struct steps *steps) {
    enum { WAYS = 3 };
    bool taken[PATCHES] = {false};
    size_t left = steps->count;
    for (int way = 0; way < WAYS; way++) {
        size_t most = 0, best = 0;
        for (size_t i = 0; i < steps->count; i++) {
            size_t like = 0;
            for (size_t j = 0; j < steps->count; j++)
                like += !taken[j] && fabs(vec3_dot(steps->normal[i], steps->normal[j])) > LIKE;
            if (like > most) most = like, best = i;
        }
        for (size_t j = 0; j < steps->count; j++)
            taken[j] = taken[j] || fabs(vec3_dot(steps->normal[best], steps->normal[j])) > LIKE;
        left -= most;
    }
    return (double)left < FEW_OTHERS * (double)steps->count;
}

/* Whether all steps are outwards, or all inwards. */
static bool go_one_way(const struct steps *steps) {
    size_t outwards = 0;
    for (size_t i = 0; i < steps->count; i++)
        outwards += steps->height[i] * vec3_dot(steps->normal[i], vec3_sub(steps->at[i], steps->centre)) > 0;
    double share = (double)outwards / (double)steps->count;
    return fmin(share, 1 - share) < FEW_OTHERS;
}

static bool is_motion(const struct steps *steps, double left, double by_height) {
    return left < CLOSER * by_height && left < CLOSE * steps->usual;
}

/* Whether steps are those of one motion, and surely not of some thickness; fills it in. */
static bool find_motion(const struct steps *steps, struct misfit *misfit) {
    double motion[TURNS], off[PATCHES];
    if (!(steps->usual > 0)) return false;
    for (size_t i = 0; i < steps->count; i++) off[i] = fabs(steps->height[i]) - steps->usual;
    double by_height = median_of(off, steps->count);
    bool moved = is_motion(steps, fit_motion(steps, SHIFTS, motion), by_height);
    if (!moved && face_all_around(steps)) moved = is_motion(steps, fit_motion(steps, TURNS, motion), by_height);
    if (!moved || (face_three_ways(steps) && go_one_way(steps))) return false;
    misfit->shift = (vec3){motion[0], motion[1], motion[2]};
    misfit->turn = vec3_scale((vec3){motion[3], motion[4], motion[5]}, 1 / steps->size);
    misfit->about = steps->centre;
    for (size_t i = 0; i < steps->count; i++) off[i] = vec3_length(misfit_at(misfit, steps->at[i]));
    misfit->apart = median_of(off, steps->count);
    return true;
}

vec3 misfit_at(const struct misfit *misfit, vec3 place) {
    return vec3_add(misfit->shift, vec3_cross(misfit->turn, vec3_sub(place, misfit->about)));
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
    size_t agree = status ? 0 : find_place(votes, count, misfit);
    if ((double)agree >= AGREE * PATCHES) {
        measure_steps(patch, misfit, &steps);
        *found = find_motion(&steps, misfit);
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
    bool former_stays = misfit->several || (double)after <= CLEARLY_MORE * (double)before;
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
                               size_t count, const struct misfit *misfit, unsigned threads, struct batch *batch,
                               uint8_t *is_double) {
    static const double MORE = 1.25;
    for (size_t i = 0; i < count; i++) batch->at[i] = point[parted->goes[begin + i]];
    enum status status = knn_search(knn, batch->at, count, 1, threads, batch->nearest, batch->distance_sq);
    if (status) return status;
    for (size_t i = 0; i < count; i++) batch->at[i] = parted->stays[batch->nearest[i]];
    status = knn_search(knn, batch->at, count, AROUND, threads, batch->around, batch->around_sq);
    for (size_t i = 0; i < count && !status; i++) {
        double spread = sqrt(batch->around_sq[i * AROUND + AROUND - 1]);
        double apart = vec3_length(misfit_at(misfit, batch->at[i]));
        is_double[parted->goes[begin + i]] = sqrt(batch->distance_sq[i]) <= MORE * apart + spread;
    }
    return status;
}

enum status misfit_doubles(const vec3 *point, const uint32_t *id, size_t n, const struct misfit *misfit,
                           unsigned threads, uint8_t *is_double, size_t *count) {
    struct parted parted = {.goes = alloc_array(n, sizeof *parted.goes), .stays = alloc_array(n, sizeof *parted.stays)};
    struct batch *batch = alloc_array(1, sizeof *batch);
    struct knn *knn = NULL;
    enum status status = parted.goes && parted.stays && batch ? STATUS_OK : STATUS_NO_MEMORY;
    memset(is_double, 0, n);
    *count = 0;
    if (!status) part(point, id, n, misfit, &parted);
    if (!status && parted.stays_count > AROUND) status = knn_new(parted.stays, parted.stays_count, threads, &knn, NULL);
    for (size_t i = 0; i < parted.goes_count && knn && !status; i += BATCH) {
        size_t some = parted.goes_count - i < BATCH ? parted.goes_count - i : BATCH;
        status = judge_batch(knn, point, &parted, i, some, misfit, threads, batch, is_double);
    }
    for (size_t p = 0; p < n && !status; p++) *count += is_double[p];
    knn_free(knn);
    free(parted.goes), free(parted.stays), free(batch);
    return status;
}
