/* The method, from a cloud to results, as a table of steps.
 *
 *     points -> order -> neighbours -> normals -> dso -> quadrics -> contract -> keep -> tangent      a cloud
 *                                                                                   |
 *                                    measure <- refine <- reconstruct <- delaunay <-+                 a mesh
 *
 *  1 order        distinct points in a frame of their own, along a space-filling curve
 *  2 neighbours   FLANN, and Gopi's neighbourhood
 *  3 normals      least squares
 *  4 dso          the discrete shape operator, and the weights from it
 *  5 quadrics     of the virtual triangles, weighted
 *  6 contract     virtual edges, all the way: a ranking of the points
 *  7 keep         as many as are wanted
 *  8 tangent      the error of the cloud alone
 *  9 delaunay     tetrahedra of the kept points
 * 10 reconstruct  Tight Cocone
 * 11 refine       flips and moves against the original points
 * 12 measure      distances in both directions
 *
 * Lee, Jong: Point-based simplification algorithm, section 4, is steps 2 to 7 and 10; step 11 is ours.
 *
 * Everything between is in the normalised frame (lengths are fractions of the diagonal) and indexed along the curve;
 * only the result speaks of the input's ids and coordinates.  A step's scratch dies with it; what later steps need is
 * in struct run.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

#include "core/alloc.h"
#include "core/contract.h"
#include "core/dso.h"
#include "core/knn.h"
#include "core/neighbourhood.h"
#include "core/normals.h"
#include "core/order.h"
#include "core/quadric.h"
#include "core/tangent.h"

struct run {
    const struct cloud *cloud;
    const struct params *params;
    struct progress progress; /* of the step that runs: turns its fraction into the whole's */
    struct error *error;
    unsigned threads;
    struct ordered_points points;
    struct knn *knn;
    struct neighbourhood hood;
    vec3 *normal;
    float *dso;
    quadric *quadrics;
    struct contraction contraction;
    size_t kept_count;
    uint32_t *kept; /* along the curve's ids, most important first */
    struct mesh mesh;
    struct report report;
};

static enum status no_memory(struct run *run, const char *where) {
    return error_set(run->error, STATUS_NO_MEMORY, where, "not enough memory for %zu points", run->cloud->count);
}

/* ------------------------------------------------------------------------------------------------ steps */

static enum status check_size(struct run *run) {
    for (size_t i = 0; i < run->cloud->count; i++) {
        vec3 p = run->cloud->position[i];
        if (fmax(fabs(p.x), fmax(fabs(p.y), fabs(p.z))) < ORDER_LARGEST) continue;
        return error_set(run->error, STATUS_MALFORMED, "order", "the coordinates of point %zu are over %g", i + 1,
                         ORDER_LARGEST);
    }
    return STATUS_OK;
}

static enum status order_step(struct run *run) {
    if (check_size(run)) return STATUS_MALFORMED;
    enum status status = order_points(run->cloud->position, run->cloud->count, run->threads, &run->points);
    if (status) return no_memory(run, "order");
    struct report *report = &run->report;
    report->points_in = run->cloud->count;
    report->points_distinct = run->points.count;
    report->diagonal = run->points.scale;
    memcpy(report->box_min, &run->points.box_min, sizeof report->box_min);
    memcpy(report->box_max, &run->points.box_max, sizeof report->box_max);
    snprintf(report->format, sizeof report->format, "%s", cloud_format_name(run->cloud->format));
    return STATUS_OK;
}

static enum status neighbours_step(struct run *run) {
    enum status status = knn_new(run->points.point, run->points.count, &run->knn, run->error);
    if (status) return status;
    struct neighbourhood_options options = {run->params->neighbourhood, (unsigned)run->params->neighbours_min,
                                            (unsigned)run->params->neighbours_max, run->threads};
    status = neighbourhood_find(run->knn, run->points.point, run->points.count, &options, &run->hood);
    return status ? no_memory(run, "neighbours") : STATUS_OK;
}

static enum status normals_step(struct run *run) {
    run->normal = alloc_array(run->points.count, sizeof *run->normal);
    if (!run->normal) return no_memory(run, "normals");
    normals_fit(run->points.point, &run->hood, run->threads, run->normal, NULL);
    return STATUS_OK;
}

static enum status dso_step(struct run *run) {
    run->dso = alloc_array(run->points.count, sizeof *run->dso);
    if (!run->dso) return no_memory(run, "dso");
    dso_compute(run->points.point, run->normal, &run->hood, (enum dso_form)run->params->dso, run->threads, run->dso);
    return STATUS_OK;
}

static enum status quadrics_step(struct run *run) {
    size_t n = run->points.count;
    float *weight = alloc_array(n, sizeof *weight);
    run->quadrics = alloc_array(n, sizeof *run->quadrics);
    if (weight && run->quadrics) {
        struct quadric_options options = {(enum area_weight)run->params->area_weight, run->params->line_quadric,
                                          run->threads};
        dso_weights(run->dso, n, run->params->dso_exponent, weight);
        quadric_assemble(run->points.point, run->normal, &run->hood, weight, &options, run->quadrics);
    }
    free(weight);
    return weight && run->quadrics ? STATUS_OK : no_memory(run, "quadrics");
}

static enum status contract_step(struct run *run) {
    enum status status =
        contract(run->points.point, &run->hood, run->quadrics, run->threads, &run->progress, &run->contraction);
    free(run->quadrics);
    run->quadrics = NULL;
    return status == STATUS_NO_MEMORY ? no_memory(run, "contract") : status;
}

/* How many points are wanted: at least one, at most all distinct ones. */
static size_t wanted_points(const struct run *run) {
    const struct params *params = run->params;
    size_t wanted = 1, distinct = run->points.count;
    if (params->points) wanted = params->points;
    if (!isnan(params->ratio)) wanted = (size_t)floor(params->ratio * (double)run->cloud->count);
    if (!isnan(params->max_error)) {
        size_t tolerated = contraction_count_for_error(&run->contraction, params->max_error);
        if (tolerated > wanted) wanted = tolerated;
    }
    if (wanted < 1) wanted = 1;
    return wanted < distinct ? wanted : distinct;
}

static enum status keep_step(struct run *run) {
    const struct contraction *contraction = &run->contraction;
    run->kept_count = wanted_points(run);
    run->kept = alloc_array(run->kept_count, sizeof *run->kept);
    if (!run->kept) return no_memory(run, "keep");
    for (size_t i = 0; i < run->kept_count; i++) run->kept[i] = contraction->order[contraction->n - 1 - i];
    size_t made = contraction->n - run->kept_count;
    run->report.points_out = run->kept_count;
    run->report.has_contraction_error = true;
    run->report.contraction_error = made ? (double)contraction->error[made - 1] * run->points.scale : 0;
    return STATUS_OK;
}

static void scale_stats(struct distance_stats *stats, double scale) {
    stats->mean *= scale;
    stats->rms *= scale;
    stats->max *= scale;
}

static enum status tangent_step(struct run *run) {
    enum status status = tangent_error(run->points.point, run->normal, run->points.count, run->kept, run->kept_count,
                                       run->threads, &run->report.tangent);
    if (status) return no_memory(run, "tangent");
    scale_stats(&run->report.tangent, run->points.scale);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static bool always(const struct params *params) {
    (void)params;
    return true;
}

/* share: of the whole's time, roughly, for progress. */
static const struct step {
    const char *name;
    enum status (*run)(struct run *run);
    bool (*wanted)(const struct params *params);
    double share;
} steps[] = {
    {"order", order_step, always, 2},       {"neighbours", neighbours_step, always, 10},
    {"normals", normals_step, always, 4},   {"dso", dso_step, always, 2},
    {"quadrics", quadrics_step, always, 5}, {"contract", contract_step, always, 20},
    {"keep", keep_step, always, 1},         {"tangent", tangent_step, always, 4},
};
enum { STEPS = sizeof steps / sizeof steps[0] };

struct overall {
    const struct progress *progress;
    double before, share, total;
};

static int overall_tick(void *ctx, const char *stage, double fraction) {
    const struct overall *overall = ctx;
    return progress_tick(overall->progress, stage, (overall->before + overall->share * fraction) / overall->total);
}

static double now_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

static enum status run_steps(struct run *run, const struct progress *progress) {
    struct overall overall = {.progress = progress};
    enum status status = STATUS_OK;
    for (size_t i = 0; i < STEPS; i++) overall.total += steps[i].wanted(run->params) ? steps[i].share : 0;
    run->progress = (struct progress){overall_tick, &overall};
    for (size_t i = 0; i < STEPS && !status; i++) {
        if (!steps[i].wanted(run->params)) continue;
        double start_ms = now_ms();
        overall.share = steps[i].share;
        status = overall_tick(&overall, steps[i].name, 0) ? STATUS_CANCELLED : steps[i].run(run);
        overall.before += overall.share;
        report_add_stage(&run->report, steps[i].name, now_ms() - start_ms);
    }
    return status;
}

static enum status hand_over(struct run *run, struct pipeline_result *result) {
    struct pipeline_result made = {.kept_count = run->kept_count, .kept = run->kept, .mesh = run->mesh};
    for (size_t i = 0; i < made.kept_count; i++) made.kept[i] = run->points.original[made.kept[i]];
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    run->report.peak_rss_bytes = (uint64_t)usage.ru_maxrss * 1024;
    made.report = run->report;
    run->kept = NULL;
    run->mesh = (struct mesh){0};
    *result = made;
    return STATUS_OK;
}

static void run_done(struct run *run) {
    ordered_points_done(&run->points);
    knn_free(run->knn);
    neighbourhood_done(&run->hood);
    free(run->normal), free(run->dso), free(run->quadrics), free(run->kept);
    contraction_done(&run->contraction);
    mesh_done(&run->mesh);
}

enum status pipeline_run(const struct cloud *cloud, const struct params *params, const struct progress *progress,
                         struct pipeline_result *result, struct error *error) {
    struct run run = {.cloud = cloud, .params = params, .error = error, .threads = (unsigned)params->threads};
    double start_ms = now_ms();
    if (cloud->count == 0) return error_set(error, STATUS_DEGENERATE, "points", "the cloud has no points");
    enum status status = run_steps(&run, progress);
    run.report.total_ms = now_ms() - start_ms;
    if (!status) status = hand_over(&run, result);
    if (status == STATUS_CANCELLED) error_set(error, status, "pipeline", "cancelled");
    run_done(&run);
    return status;
}

void pipeline_result_done(struct pipeline_result *result) {
    if (!result) return;
    free(result->kept);
    mesh_done(&result->mesh);
    *result = (struct pipeline_result){0};
}
