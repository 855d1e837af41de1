/* The step between 1 and 2: outliers go, noise is smoothed, and the rest of the pipeline runs as if the cloud had come
 * like that.
 *
 * So the points that are left are put in order again, in the frame of their own bounding box (a stray far away must not
 * decide how long a hundredth of the diagonal is), and a moved point counts with the coordinates that will be written:
 * rounded to the type that the file has for them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <assert.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/clean/denoise.h"
#include "core/clean/facades.h"
#include "core/clean/layers.h"
#include "core/clean/misfit.h"
#include "core/clean/noise.h"
#include "core/clean/outliers.h"
#include "core/clean/shell.h"
#include "core/math/quantile.h"
#include "core/pipeline/pipeline_run.h"
#include "core/simplify/normals.h"
#include "core/spatial/two_sheets.h"

/* Points along the curve that are left, and where they are. */
struct remains {
    size_t count;
    uint32_t *id;   /* along the curve, ascending */
    vec3 *point;    /* in the frame, as they came */
    vec3 *position; /* in the input's coordinates, where they are to be */
    float *range;   /* from where they were seen; NULL = not known */
    uint32_t
        *near; /* rows of DENOISE_NEAR: which of them are nearest to each, as denoise_known has it; NULL = not known */
};

static void remains_done(struct remains *remains) {
    free(remains->id), free(remains->point), free(remains->position), free(remains->range), free(remains->near);
}

static enum status remains_new(const struct run *run, struct remains *remains) {
    size_t n = run->points.count;
    remains->count = n;
    remains->id = alloc_array(n, sizeof *remains->id);
    remains->point = alloc_array(n, sizeof *remains->point);
    remains->position = alloc_array(n, sizeof *remains->position);
    if (!remains->id || !remains->point || !remains->position) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        remains->id[i] = (uint32_t)i;
        remains->point[i] = run->points.point[i];
        remains->position[i] = run->cloud->position[run->points.original[i]];
    }
    return STATUS_OK;
}

/* What pays was measured on Horse and Venus with noise, doubles and outliers of many levels, and on six scans: outliers
 * from one in a hundred on, of which clean scans have fewer, at places that matter, leaves among them; smoothing from
 * REPORT_LARGE_NOISE on. */
static const double MANY_OUTLIERS = 0.01;

static void drop(struct remains *remains, const uint8_t *dropped) {
    size_t left = 0;
    for (size_t i = 0; i < remains->count; i++) {
        if (dropped[i]) continue;
        remains->id[left] = remains->id[i];
        remains->point[left] = remains->point[i];
        if (remains->range) remains->range[left] = remains->range[i];
        remains->position[left++] = remains->position[i];
    }
    remains->count = left;
}

/* Who is near whom once the outliers have been dropped, where enough is left. */
static enum status take_near(struct remains *remains, struct planes *planes, const uint8_t *outlier, unsigned threads) {
    size_t n = remains->count, left = 0;
    static_assert((int)DENOISE_NEAR <= (int)OFFSETS_K, "rows are long enough");
    uint8_t *stays = alloc_array(n, sizeof *stays);
    uint32_t *number = alloc_array(n, sizeof *number);
    enum status status = stays && number ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++) {
        stays[p] = !outlier[p];
        number[p] = (uint32_t)left;
        left += stays[p];
    }
    if (!status && left > OFFSETS_K) status = planes_trust(planes, stays, threads);
    if (!status && left > OFFSETS_K) remains->near = alloc_array(left, DENOISE_NEAR * sizeof *remains->near);
    if (!status && left > OFFSETS_K && !remains->near) status = STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status && remains->near; p++)
        for (unsigned i = 0; i < DENOISE_NEAR && stays[p]; i++)
            remains->near[(size_t)number[p] * DENOISE_NEAR + i] = number[planes_near(planes, p)[i]];
    free(stays), free(number);
    return status;
}

/* What is done about outliers. */
struct dropping {
    double least_share; /* they stay where they are fewer */
    size_t most;        /* or more, unless it is 0 */
    bool *layered;      /* whether points of a less exact scan are among them; NULL = it isn't looked for */
    bool near_wanted;   /* remains->near is */
};

/* The index of all points, where there is one, is used up. */
static enum status drop_outliers(struct run *run, struct remains *remains, struct dropping dropping) {
    struct knn *knn = run->knn;
    struct planes *planes = NULL;
    bool *layered = dropping.layered, plans = layered || dropping.near_wanted;
    size_t n = remains->count, count = 0, inexact = 0, spared = 0;
    uint8_t *outlier = alloc_array(n, sizeof *outlier);
    enum status status = outlier ? STATUS_OK : STATUS_NO_MEMORY;
    run->knn = NULL;
    if (!status && !knn) status = knn_new(remains->point, n, run->threads, &knn, run->error);
    if (!status)
        status = outliers_find(knn, remains->point, remains->range, n, run->threads, outlier, &count,
                               plans ? &planes : NULL);
    if (!status && layered)
        status = layers_find(remains->point, remains->range, n, run->threads, planes, outlier, &inexact);
    if (!status && !remains->range && inexact == 0)
        status = facades_spare(remains->point, n, run->threads, outlier, &spared);
    count -= spared;
    if (layered) *layered = inexact > 0;
    double least = inexact > 0 ? 0 : dropping.least_share * (double)n;
    bool drops = (double)count >= least && (dropping.most == 0 || inexact > 0 || count <= dropping.most);
    if (!status && !drops) memset(outlier, 0, n);
    if (!status && dropping.near_wanted && planes) status = take_near(remains, planes, outlier, run->threads);
    planes_free(planes);
    knn_free(knn);
    if (!status && drops) drop(remains, outlier);
    free(outlier);
    return status;
}

/* Whether noise is large against the distances between points. */
static enum status find_noise(struct run *run, const struct remains *remains, bool *large) {
    struct knn *knn = NULL;
    struct neighbourhood neighbours = {0};
    struct neighbourhood_options options = {run->params->neighbourhood, (unsigned)run->params->neighbours_min,
                                            (unsigned)run->params->neighbours_max, run->threads};
    size_t n = remains->count;
    double level = 0;
    vec3 *normal = alloc_array(n, sizeof *normal);
    enum status status = normal ? knn_new(remains->point, n, run->threads, &knn, run->error) : STATUS_NO_MEMORY;
    if (!status) status = neighbourhood_find(knn, remains->point, n, &options, &neighbours);
    knn_free(knn);
    if (!status) {
        normals_fit(remains->point, &neighbours, run->threads, normal, NULL);
        status = noise_estimate(remains->point, normal, &neighbours, &level);
    }
    if (!status) *large = level > REPORT_LARGE_NOISE * (double)quantile_of(neighbours.spacing, n, 0.5);
    neighbourhood_done(&neighbours);
    free(normal);
    return status;
}

static vec3 to_input(const struct ordered_points *frame, vec3 p) {
    return vec3_add(vec3_scale(p, frame->scale), frame->centre);
}

static enum status smooth(struct run *run, struct remains *remains, bool is_shell) {
    struct denoise_result smoothed = {0};
    struct denoise_known known = {remains->near, is_shell};
    enum status status = denoise_smooth(remains->point, remains->count, &known, run->threads, &smoothed);
    if (status) return status;
    for (size_t i = 0; i < remains->count; i++)
        if (!vec3_equal(smoothed.point[i], remains->point[i]))
            remains->position[i] = cloud_round(run->cloud, to_input(&run->points, smoothed.point[i]));
    run->report.noise = smoothed.noise * run->points.scale;
    drop(remains, smoothed.stray);
    denoise_done(&smoothed);
    return STATUS_OK;
}

/* Gives `ordered`, which is of the remains, the input's ids: original and distinct as if it were of the input.  kept_as
 * (one for each point of run->points) is scratch. */
static void rename_points(struct run *run, const struct remains *remains, struct ordered_points *ordered,
                          uint32_t *distinct, uint32_t *kept_as) {
    for (size_t i = 0; i < run->points.count; i++) kept_as[i] = NONE;
    for (size_t i = 0; i < remains->count; i++) kept_as[remains->id[i]] = ordered->distinct[i];
    for (size_t i = 0; i < ordered->count; i++)
        ordered->original[i] = run->points.original[remains->id[ordered->original[i]]];
    run->report.points_outliers = 0;
    for (size_t j = 0; j < run->cloud->count; j++) {
        uint32_t was = run->points.distinct[j]; /* NONE of what was dropped before */
        distinct[j] = was == NONE ? NONE : kept_as[was];
        run->report.points_outliers += distinct[j] == NONE;
    }
    free(ordered->distinct);
    ordered->distinct = distinct;
}

/* moved[j]: where input point j goes to; outliers stay. */
static void place_all(const struct run *run, const struct remains *remains, vec3 *moved, uint32_t *at) {
    for (size_t i = 0; i < run->points.count; i++) at[i] = NONE;
    for (size_t i = 0; i < remains->count; i++) at[remains->id[i]] = (uint32_t)i;
    for (size_t j = 0; j < run->cloud->count; j++) {
        uint32_t was = run->points.distinct[j], i = was == NONE ? NONE : at[was];
        moved[j] = i == NONE ? run->cloud->position[j] : remains->position[i];
    }
}

static enum status put_in_order(struct run *run, const struct remains *remains, bool is_full) {
    struct ordered_points ordered = {0};
    uint32_t *distinct = alloc_array(run->cloud->count, sizeof *distinct);
    uint32_t *scratch = alloc_array(run->points.count, sizeof *scratch);
    if (is_full) run->moved = alloc_array(run->cloud->count, sizeof *run->moved);
    enum status status = distinct && scratch && (!is_full || run->moved) ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = order_points(remains->position, remains->count, run->threads, &ordered);
    if (!status) {
        if (is_full) place_all(run, remains, run->moved, scratch);
        rename_points(run, remains, &ordered, distinct, scratch);
        ordered_points_done(&run->points);
        run->points = ordered;
        distinct = NULL;
    }
    free(distinct), free(scratch);
    return status;
}

/* What was asked for or found out about the cloud. */
struct treatment {
    double least_share; /* outliers go where they aren't fewer */
    size_t most;        /* or more, unless it is 0 */
    bool seeks_noise;   /* smooth where noise is large against the distances between points */
    bool smooths;
    bool is_shell; /* as far as is known */
};

/* Whether what is left once a less exact layer has gone is still as thick. */
static enum status find_shell(struct run *run, const struct remains *remains, bool *is_shell) {
    struct knn *knn = NULL;
    double share = 0;
    enum status status = knn_new(remains->point, remains->count, run->threads, &knn, run->error);
    if (!status) status = shell_find(knn, remains->point, remains->count, run->threads, &share, NULL, NULL);
    knn_free(knn);
    *is_shell = share >= SHELL_MANY;
    return status;
}

static enum status denoise(struct run *run, const struct treatment *treatment) {
    struct remains remains = {0};
    size_t n = run->points.count;
    enum status status = remains_new(run, &remains);
    if (!status) status = pipeline_ranges(run, &remains.range);
    bool is_full = treatment->smooths, is_layered = false, was_layered = run->report.denoised[0];
    bool *layered = run->params->denoise != DENOISE_OUTLIERS ? &is_layered : NULL;
    const struct dropping dropping = {treatment->least_share, treatment->most, layered, is_full};
    if (!status) status = drop_outliers(run, &remains, dropping);
    if (!status && treatment->seeks_noise) status = find_noise(run, &remains, &is_full);
    if (!status && treatment->seeks_noise && is_full && remains.count == n)
        status = drop_outliers(run, &remains, (struct dropping){.near_wanted = true});
    if (!status && is_layered && treatment->is_shell) status = find_shell(run, &remains, &is_full);
    if (!status && is_full) status = smooth(run, &remains, treatment->is_shell && !is_layered);
    bool is_other = is_full || remains.count < n || run->params->denoise == DENOISE_OUTLIERS;
    if (!status && is_other) status = put_in_order(run, &remains, is_full);
    if (!status && is_other) pipeline_report_box(run);
    snprintf(run->report.denoised, sizeof run->report.denoised, "%s",
             is_full                     ? "full"
             : is_layered || was_layered ? "layers"
             : is_other                  ? "outliers"
                                         : "none");
    remains_done(&remains);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "denoise") : status;
}

static bool has_strays(const struct stray_shares *strays) {
    return strays->far >= OUTLIERS_MANY || strays->alone >= OUTLIERS_ALONE;
}

/* What seems to be strays is judged again by ranges, where they are known: that takes longer. */
static enum status estimate_strays(struct run *run, const struct shell_near *near, struct stray_shares *strays) {
    const struct ordered_points *points = &run->points;
    float *range = NULL;
    enum status status = outliers_estimate(run->knn, points->point, NULL, points->count, run->threads, near, strays);
    if (status || !has_strays(strays)) return status;
    status = pipeline_ranges(run, &range);
    if (!status && range)
        status = outliers_estimate(run->knn, points->point, range, points->count, run->threads, near, strays);
    free(range);
    return status;
}

/* Whether there may be a less exact layer, though there are no strays, and no noise.  Both sides of a plate as thick as
 * points are apart are as exact as each other. */
static enum status may_be_doubled(const struct run *run, bool *doubled) {
    const struct ordered_points *points = &run->points;
    double share = 0, plates = 0;
    enum status status = layers_estimate(run->knn, points->point, points->count, run->threads, &share);
    *doubled = !status && share > LAYERS_MANY;
    if (*doubled) status = two_sheets_share(run->knn, points->point, points->count, run->threads, &plates);
    *doubled = *doubled && plates <= TWO_SHEETS_MOSTLY;
    return status;
}

/* Whether a surface of the points would be crumpled, or full of spikes by strays.  If neither, *treatment is left.
 * Their index is left for what comes next.  Where deviations are bounded, those from the points as they came are meant:
 * strays go, which no surface is near to, but none is moved. */
static enum status find_treatment(struct run *run, struct treatment *treatment, bool *any) {
    double share = 0;
    struct stray_shares strays = {0, 0};
    const struct ordered_points *points = &run->points;
    bool known = false;
    struct shell_near *near = alloc_array(1, sizeof *near);
    enum status status = near ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && !run->knn) status = knn_new(points->point, points->count, run->threads, &run->knn, run->error);
    if (!status) status = shell_find(run->knn, points->point, points->count, run->threads, &share, near, &known);
    if (!status) status = estimate_strays(run, known ? near : NULL, &strays);
    free(near);
    run->report.noisy_share = share;
    run->report.strays_sought = true;
    bool alone = strays.alone >= OUTLIERS_ALONE;
    bool bounded = params_bound_deviation(run->params), smooths = share >= SHELL_MANY && !bounded, doubled = false;
    *any = smooths || has_strays(&strays);
    if (!status && !*any && !bounded) status = may_be_doubled(run, &doubled);
    *any = *any || doubled;
    if (status || !*any) return status;
    if (smooths)
        *treatment = (struct treatment){.smooths = true, .is_shell = true};
    else if (doubled)
        *treatment = (struct treatment){.least_share = 1};
    else
        *treatment = (struct treatment){.least_share = alone ? OUTLIERS_ALONE : OUTLIERS_MANY};
    return status;
}

/* Drops what is there twice, as one scan has it and as another that doesn't fit. */
static enum status drop_doubles_of(struct run *run, const struct misfit *misfit, bool *dropped) {
    struct remains remains = {0};
    size_t n = run->points.count, count = 0;
    uint8_t *is_double = alloc_array(n, sizeof *is_double);
    knn_free(run->knn);
    run->knn = NULL;
    enum status status = is_double ? remains_new(run, &remains) : STATUS_NO_MEMORY;
    if (!status)
        status = misfit_doubles(run->points.point, run->points.original, n, misfit, run->threads, is_double, &count);
    *dropped = !status && count > 0;
    if (*dropped) {
        drop(&remains, is_double);
        status = put_in_order(run, &remains, false);
    }
    if (*dropped && !status) {
        double beside = misfit->apart * run->points.scale;
        pipeline_report_box(run);
        snprintf(run->report.denoised, sizeof run->report.denoised, "layers");
        left_out_add(&run->report.left_out, "input",
                     LEFT_OUT_NOTE
                     "from about point %" PRIu32
                     " on all lie %.3g beside the others, a scan that doesn't fit: %zu doubles were dropped; "
                     "denoise=none keeps them",
                     misfit->first + 1, beside, count);
    }
    remains_done(&remains);
    free(is_double);
    return status;
}

/* One scan after the other goes where it doesn't fit.  The index of what is left is left for what comes next. */
static enum status drop_misfits(struct run *run) {
    enum { SCANS = 16 };
    bool found = true;
    enum status status = STATUS_OK;
    for (int scan = 1; scan < SCANS && found && !status; scan++) {
        const struct ordered_points *points = &run->points;
        struct misfit misfit;
        status = knn_new(points->point, points->count, run->threads, &run->knn, run->error);
        if (!status)
            status =
                misfit_find(run->knn, points->point, points->original, points->count, run->threads, &found, &misfit);
        if (!status && found) status = drop_doubles_of(run, &misfit, &found);
    }
    return status;
}

enum status pipeline_denoise(struct run *run) {
    static const struct treatment asked[] = {
        [DENOISE_OUTLIERS] = {0},
        [DENOISE_FULL] = {.smooths = true},
        [DENOISE_AUTO] = {.least_share = MANY_OUTLIERS, .seeks_noise = true},
    };
    bool finds = run->params->denoise == DENOISE_NOISY, any = true;
    if (finds && run->cloud->triangle_count > 0) return STATUS_OK;
    struct treatment treatment = {0};
    enum status status = STATUS_OK;
    bool drops = run->params->denoise != DENOISE_OUTLIERS && !params_bound_deviation(run->params);
    if (drops) status = drop_misfits(run);
    if (!status && finds)
        status = find_treatment(run, &treatment, &any);
    else if (!status)
        treatment = asked[run->params->denoise];
    if (status) return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "denoise") : status;
    return any ? denoise(run, &treatment) : STATUS_OK;
}

/* Whether the points that are left are where they were, in the same order, as in the same box. */
static bool is_frame_the_same(const struct run *run, const struct remains *remains) {
    bool same = remains->count == run->points.count;
    for (size_t i = 0; same && i < remains->count; i++) same = vec3_equal(remains->point[i], run->points.point[i]);
    return same;
}

/* Neighbourhoods of what is left, where the index says nothing else of noise; else they are forgotten. */
static enum status lose_neighbours(struct run *run, const vec3 *before, const uint8_t *off) {
    const struct neighbourhood_options options = pipeline_neighbourhood_options(run);
    bool noisy = false;
    enum status status = knn_new(run->points.point, run->points.count, run->threads, &run->knn, run->error);
    if (!status)
        status = neighbourhood_noisy(run->knn, run->points.point, run->points.count, run->threads, &noisy, NULL);
    if (!status && noisy == run->neighbours.noisy)
        return neighbourhood_lose(run->knn, run->points.point, &options, before, off, &run->neighbours);
    neighbourhood_done(&run->neighbours);
    return status;
}

/* The points that stand off go, and no others.  What is known of neighbours stays, where few have lost some. */
static enum status drop_alone(struct run *run, const uint8_t *off, size_t count) {
    enum { FEW = 256 };
    struct remains remains = {0};
    size_t n = run->points.count;
    vec3 *before = alloc_array(n, sizeof *before);
    enum status status = before ? remains_new(run, &remains) : STATUS_NO_MEMORY;
    if (!status) memcpy(before, run->points.point, n * sizeof *before);
    if (!status) drop(&remains, off);
    if (!status) status = put_in_order(run, &remains, false);
    if (!status) pipeline_report_box(run);
    if (!status) snprintf(run->report.denoised, sizeof run->report.denoised, "outliers");
    bool stays = !status && count <= FEW && run->neighbours.reach_sq && is_frame_the_same(run, &remains);
    remains_done(&remains);
    if (stays)
        status = lose_neighbours(run, before, off);
    else
        neighbourhood_done(&run->neighbours);
    free(before);
    return status;
}

static enum status survey(const struct run *run, const float *range, uint8_t *off, size_t *count, size_t *scattered) {
    return outliers_survey(run->points.point, range, &run->neighbours, run->threads, off, count, scattered);
}

/* Few strays can't be told by some of the points, and two of 50 000 are enough for spikes and pieces that double the
 * error of a mesh; so the neighbourhoods of all points are looked at, once they are known. */
enum status pipeline_drop_strays(struct run *run, bool *dropped) {
    enum { FEW = 1000 };    /* one of so many isn't worth looking for where it was seen from */
    enum { FEW_TIMES = 8 }; /* of those that stand off: more that seem to be strays are edges and thin parts */
    const struct params *params = run->params;
    bool seeks = params_want_denoising(params) && (params->denoise == DENOISE_NOISY || params->denoise == DENOISE_AUTO);
    bool treated = run->report.points_outliers > 0 || run->moved;
    size_t count = 0, spared = 0, scattered = 0;
    *dropped = false;
    if (!seeks || treated || run->cloud->triangle_count > 0) return STATUS_OK;
    uint8_t *off = alloc_array(run->points.count, sizeof *off);
    float *range = NULL;
    enum status status = off ? survey(run, NULL, off, &count, &scattered) : STATUS_NO_MEMORY;
    if (!status && (scattered > 0 || count > run->points.count / FEW)) status = pipeline_ranges(run, &range);
    if (!status && range) status = survey(run, range, off, &count, &scattered);
    if (!status && !range) status = facades_spare(run->points.point, run->points.count, run->threads, off, &spared);
    count -= spared;
    *dropped = !status && (scattered > 0 || count > 0);
    if (*dropped) {
        if (scattered > 0) neighbourhood_done(&run->neighbours);
        knn_free(run->knn);
        run->knn = NULL;
    }
    if (!status && scattered > 0) status = denoise(run, &(struct treatment){.most = FEW_TIMES * scattered});
    if (!status && count > 0 && run->report.points_outliers == 0) status = drop_alone(run, off, count);
    free(off), free(range);
    return status;
}
