/* What is measured is each point's distance from its neighbours' planes against that of the more exact ones among them
 * (core/clean/offsets.h).  Of noise that is the same everywhere up to 1.7 % of the points have 24 times that and a
 * twentieth of the neighbourhood's radius; of a depth camera's, which grows with the depth, 3 %; of two layers there
 * are more.
 *
 * Weights by accuracy would be those of least squares: a layer ten times as far off counts a hundredth.  So it is
 * dropped.  What the first round drops of the more exact layer, at edges and on thin parts, comes back in the next
 * ones, where it is compared with planes that no other layer disturbs.
 *
 * Amid doubles strays and sparse places are told badly, for there is hardly a point that doesn't lie off some of its
 * neighbours' planes.  So all that can't be doubles, being too far off, are judged again when the doubles are gone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/layers.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/clean/offsets.h"
#include "core/clean/outliers.h"
#include "core/math/quantile.h"

enum { ROUNDS = 3 };
static const float MUCH = 24, MUCH_LEAST = 0.05F; /* off by so many times what is usual; and of the radius */
static const double LAYER_SHARE = 0.03;           /* of the points that are that far off */
static const float DROPPED = 4;                   /* of what is usual */
/* Of the layer's width: no double is farther off, and what is nearer stays. */
static const float DOUBLE_MOST = 3, DOUBLE_LEAST = 0.25F;
static const double CLEARLY = 0.1; /* of what is dropped, so many points at least are that far off */
enum { BESIDE = 8 };               /* neighbours that are looked at */
/* So many at most have seven such neighbours of eight: of what is dropped, and of what is far off. */
static const double AMID_DOUBLES = 0.05, AMID_OF_FAR = 0.12;
/* Coordinates in steps, as of depth cameras, have a core that is far sharper than the rest too: points of one step,
 * which lie in its plane.  A tenth of all points then is many times nearer than a quarter of them, where any smooth
 * density has four tenths. */
static const float STEPS = 0.3F;

/* Whether p is off by so much as only some points of any noise are. */
static bool is_far_off(const struct offsets *offsets, const float *off, size_t p) {
    return off[p] > MUCH * offsets->usual[p] && off[p] > MUCH_LEAST * offsets->radius[p];
}

/* *share of the points that aren't left out are far off; 0 where all lie in steps. */
static enum status find_share(const struct offsets *offsets, size_t n, const uint8_t *left_out, double *share) {
    float *relative = alloc_array(n, sizeof *relative);
    if (!relative) return STATUS_NO_MEMORY;
    size_t many = 0, counted = 0;
    for (size_t p = 0; p < n; p++) {
        if (left_out[p] == OUTLIER_FAR) continue;
        many += is_far_off(offsets, offsets->quarter, p);
        relative[counted++] = offsets->quarter[p] / offsets->radius[p];
    }
    *share = 0;
    if (counted > 0 && quantile_of(relative, counted, 0.1) > STEPS * quantile_of(relative, counted, 0.25))
        *share = (double)many / (double)counted;
    free(relative);
    return STATUS_OK;
}

/* Judges all that outliers_find didn't find far off against those that are trusted, who are those that pass. */
static size_t judge_layers(const struct offsets *offsets, const float *off, size_t n, const uint8_t *outlier,
                           uint8_t *trusted) {
    size_t left = 0;
    for (size_t p = 0; p < n; p++) {
        trusted[p] = outlier[p] != OUTLIER_FAR && off[p] <= DROPPED * offsets->usual[p];
        left += trusted[p];
    }
    return left;
}

/* Whether what is dropped is off by so much that a surface of all would be rough.  Of few points for what they show,
 * such as a room with its furniture, all but the flat parts are many times as far off as these, but most of them by
 * little. */
static enum status is_rough(const struct offsets *offsets, const float *off, size_t n, const uint8_t *outlier,
                            const uint8_t *trusted, bool *is) {
    size_t count = 0;
    float *relative = alloc_array(n, sizeof *relative);
    if (!relative) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < n; p++)
        if (!trusted[p] && outlier[p] != OUTLIER_FAR) relative[count++] = off[p] / offsets->radius[p];
    *is = count > 0 && quantile_of(relative, count, 0.5) >= MUCH_LEAST;
    free(relative);
    return STATUS_OK;
}

/* The layer's width: the median distance of what is dropped and is far off.  Most of what is dropped beside may be
 * bends and details of the more exact layer, which are off by less. */
static enum status find_layer_width(const struct offsets *offsets, const float *off, size_t n, const uint8_t *outlier,
                                    const uint8_t *trusted, float *width) {
    size_t count = 0;
    float *far_off = alloc_array(n, sizeof *far_off);
    if (!far_off) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < n; p++)
        if (!trusted[p] && outlier[p] != OUTLIER_FAR && is_far_off(offsets, off, p)) far_off[count++] = off[p];
    *width = count ? quantile_of(far_off, count, 0.5) : 0;
    free(far_off);
    return STATUS_OK;
}

/* is_double[p] of what isn't trusted where it is as far off as doubles are; 0 elsewhere.  A double that is as near as
 * details are does little harm. */
static enum status find_doubles(const struct offsets *offsets, const float *off, size_t n, const uint8_t *outlier,
                                const uint8_t *trusted, uint8_t *is_double) {
    float width = 0;
    enum status status = find_layer_width(offsets, off, n, outlier, trusted, &width);
    for (size_t p = 0; p < n; p++)
        is_double[p] =
            !trusted[p] && outlier[p] != OUTLIER_FAR && off[p] >= DOUBLE_LEAST * width && off[p] <= DOUBLE_MOST * width;
    return status;
}

/* Whether enough of what is dropped is far off: of a layer .11 to .63 are, of a depth camera's noise .065 to .08. */
static bool is_clearly_off(const uint8_t *is_double, size_t n, double far_off) {
    size_t doubles = 0;
    for (size_t p = 0; p < n; p++) doubles += is_double[p];
    return far_off > CLEARLY * (double)doubles;
}

/* Whether what is dropped, so many of which are far off, lies amid what isn't, as a layer does that covers a part of
 * the other.  Of a surface whose points are few for its curvature, it is bends that are far off their neighbours'
 * planes, and all points of them; of few points of trees, whole tufts. */
static enum status is_beside_another(struct planes *planes, const uint8_t *is_double, size_t n, double far_off,
                                     unsigned threads, const uint8_t *outlier, uint8_t *judged, bool *is) {
    size_t doubles = 0, amid_doubles = 0;
    for (size_t p = 0; p < n; p++) judged[p] = outlier[p] != OUTLIER_FAR;
    enum status status = planes_trust(planes, judged, threads);
    for (size_t p = 0; p < n && !status; p++) {
        unsigned others = 0;
        for (unsigned i = 0; i < BESIDE && is_double[p]; i++) others += !is_double[planes_near(planes, p)[i]];
        doubles += is_double[p];
        amid_doubles += is_double[p] && others <= 1;
    }
    *is = (double)amid_doubles <= fmin(AMID_DOUBLES * (double)doubles, AMID_OF_FAR * far_off);
    return status;
}

/* Replaces `outlier` by what is found where the doubles aren't, and by OUTLIER_OFF of those. */
static enum status judge_rest(const vec3 *point, const float *range, size_t n, const uint8_t *is_double,
                              unsigned threads, uint8_t *outlier) {
    vec3 *rest = alloc_array(n, sizeof *rest);
    float *of_rest = range ? alloc_array(n, sizeof *of_rest) : NULL;
    uint8_t *judged = alloc_array(n, sizeof *judged);
    struct knn *knn = NULL;
    size_t m = 0, count;
    enum status status = rest && judged && (of_rest || !range) ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++)
        if (!is_double[p]) {
            if (range) of_rest[m] = range[p];
            rest[m++] = point[p];
        }
    if (!status) status = knn_new(rest, m, threads, &knn, NULL);
    if (!status) status = outliers_find(knn, rest, of_rest, m, threads, judged, &count, NULL);
    for (size_t p = 0, i = 0; p < n && !status; p++) outlier[p] = is_double[p] ? OUTLIER_OFF : judged[i++];
    knn_free(knn);
    free(rest), free(of_rest), free(judged);
    return status;
}

enum status layers_find(const vec3 *point, const float *range, size_t n, unsigned threads, struct planes *planes,
                        uint8_t *outlier, size_t *count) {
    const struct offsets *offsets = NULL;
    double share = 0;
    uint8_t *trusted = alloc_array(n, sizeof *trusted), *is_double = alloc_array(n, sizeof *is_double);
    size_t left = 0;
    *count = 0;
    enum status status = trusted && is_double ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++) left += trusted[p] = outlier[p] != OUTLIER_FAR;
    bool layered = !status && left > OUTLIERS_MIN_POINTS;
    for (int round = 0; round < ROUNDS && !status && layered; round++) {
        bool is_last = round + 1 == ROUNDS;
        status = planes_measure(planes, trusted, threads, &offsets);
        if (!status && round == 0) status = find_share(offsets, n, outlier, &share);
        layered = !status && share > LAYER_SHARE;
        const float *off = status ? NULL : round ? offsets->third : offsets->quarter;
        if (layered) left = judge_layers(offsets, off, n, outlier, trusted);
        if (layered && is_last) status = is_rough(offsets, off, n, outlier, trusted, &layered);
        if (layered && is_last && !status) status = find_doubles(offsets, off, n, outlier, trusted, is_double);
        layered = layered && left > OUTLIERS_MIN_POINTS;
    }
    layered = layered && !status && is_clearly_off(is_double, n, share * (double)n);
    if (layered)
        status = is_beside_another(planes, is_double, n, share * (double)n, threads, outlier, trusted, &layered);
    layered = layered && !status;
    if (layered) status = judge_rest(point, range, n, is_double, threads, outlier);
    for (size_t p = 0; p < n && layered && !status; p++) *count += is_double[p];
    free(trusted), free(is_double);
    return status;
}

/* ------------------------------------------------------------------------------------------------ by some patches */

/* A patch is the nearest WIDE of a place and theirs; the nearest INNER of the place lie far enough within it to be
 * measured as they would be among all. */
enum { PATCHES = 64, WIDE = 48, INNER = 24 };

static int by_id(const void *a, const void *b) {
    const uint32_t *x = a, *y = b;
    return (*x > *y) - (*x < *y);
}

/* Sorts count ids and leaves each once; returns how many. */
static size_t unite(uint32_t *id, size_t count) {
    size_t left = 0;
    qsort(id, count, sizeof *id, by_id);
    for (size_t i = 0; i < count; i++)
        if (left == 0 || id[i] != id[left - 1]) id[left++] = id[i];
    return left;
}

/* Who is in patches: count[0] ids, ascending, of which count[1] are within them. */
struct patches {
    uint32_t *id, *inner; /* room for PATCHES * WIDE * WIDE, and PATCHES * INNER */
    size_t count[2];
};

static enum status find_patches(const struct knn *knn, const vec3 *point, size_t n, unsigned threads,
                                struct patches *patches) {
    enum { CENTRES = PATCHES * WIDE };
    uint32_t *near = alloc_array(CENTRES, sizeof *near);
    double *distance_sq = alloc_array((size_t)CENTRES * WIDE, sizeof *distance_sq);
    vec3 *at = alloc_array(CENTRES, sizeof *at);
    enum status status = near && distance_sq && at ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < PATCHES && !status; i++) at[i] = point[n / PATCHES * i];
    if (!status) status = knn_search(knn, at, PATCHES, WIDE, threads, near, distance_sq);
    for (size_t i = 0; i < CENTRES && !status; i++) {
        at[i] = point[near[i]];
        if (i % WIDE < INNER) patches->inner[i / WIDE * INNER + i % WIDE] = near[i];
    }
    if (!status) status = knn_search(knn, at, CENTRES, WIDE, threads, patches->id, distance_sq);
    if (!status) patches->count[0] = unite(patches->id, (size_t)CENTRES * WIDE);
    if (!status) patches->count[1] = unite(patches->inner, (size_t)PATCHES * INNER);
    free(near), free(distance_sq), free(at);
    return status;
}

/* Whether those within fill a body, such as a lattice: a quarter of them is off by half of the radius or more, which no
 * doubles are. */
static enum status fill_body(const struct offsets *offsets, size_t n, const uint8_t *left_out, bool *fill) {
    size_t count = 0;
    float *relative = alloc_array(n, sizeof *relative);
    if (!relative) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < n; p++)
        if (!left_out[p]) relative[count++] = offsets->quarter[p] / offsets->radius[p];
    *fill = count > 0 && quantile_of(relative, count, 0.75) >= 0.5F;
    free(relative);
    return STATUS_OK;
}

static enum status measure_patches(const vec3 *point, unsigned threads, const struct patches *patches, double *share) {
    size_t n = patches->count[0];
    struct knn *knn = NULL;
    struct planes *planes = NULL;
    const struct offsets *offsets = NULL;
    vec3 *some = alloc_array(n, sizeof *some);
    uint8_t *trusted = alloc_array(n, sizeof *trusted), *left_out = alloc_array(n, sizeof *left_out);
    enum status status = some && trusted && left_out ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0, j = 0; i < n && !status; i++) {
        bool is_inner = j < patches->count[1] && patches->inner[j] == patches->id[i];
        some[i] = point[patches->id[i]];
        trusted[i] = 1;
        left_out[i] = is_inner ? 0 : OUTLIER_FAR;
        j += is_inner;
    }
    if (!status) status = knn_new(some, n, threads, &knn, NULL);
    if (!status) status = planes_new(knn, some, n, threads, &planes);
    if (!status) status = planes_measure(planes, trusted, threads, &offsets);
    bool fill = false;
    if (!status) status = fill_body(offsets, n, left_out, &fill);
    if (!status && !fill) status = find_share(offsets, n, left_out, share);
    planes_free(planes);
    knn_free(knn);
    free(some), free(trusted), free(left_out);
    return status;
}

enum status layers_estimate(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, double *share) {
    struct patches patches = {.id = alloc_array((size_t)PATCHES * WIDE * WIDE, sizeof *patches.id),
                              .inner = alloc_array((size_t)PATCHES * INNER, sizeof *patches.inner)};
    enum status status = patches.id && patches.inner ? STATUS_OK : STATUS_NO_MEMORY;
    *share = 0;
    if (!status && n >= OUTLIERS_MIN_POINTS && n >= (size_t)PATCHES * WIDE) {
        status = find_patches(knn, point, n, threads, &patches);
        if (!status) status = measure_patches(point, threads, &patches, share);
    }
    free(patches.id), free(patches.inner);
    return status;
}
