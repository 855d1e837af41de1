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
 * 12 examine      is it closed, oriented, a manifold
 * 13 measure      distances in both directions
 *
 * Lee, Jong: Point-based simplification algorithm, section 4, is steps 2 to 7 and 10; step 11 is ours.
 *
 * Everything between is in the normalised frame (lengths are fractions of the diagonal) and indexed along the curve;
 * only the result speaks of the input's ids and coordinates.  A step's scratch dies with it; what later steps need is
 * in struct run.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline.h"

#include <stdlib.h>
#include <sys/resource.h>
#include <time.h>

#include "core/pipeline_run.h"

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
    {"order", pipeline_order, always, 2},
    {"neighbours", pipeline_neighbours, always, 10},
    {"normals", pipeline_normals, always, 4},
    {"dso", pipeline_dso, always, 2},
    {"quadrics", pipeline_quadrics, always, 5},
    {"contract", pipeline_contract, always, 20},
    {"keep", pipeline_keep, always, 1},
    {"tangent", pipeline_tangent, always, 4},
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

/* From the normalised frame and ids along the curve to the input's. */
static void restore_vertex(const struct run *run, struct mesh *mesh, size_t v) {
    uint32_t source = mesh->source[v] == NONE ? NONE : run->points.original[mesh->source[v]];
    mesh->source[v] = source;
    mesh->vertex[v] = source != NONE ? run->cloud->position[source]
                                     : vec3_add(vec3_scale(mesh->vertex[v], run->points.scale), run->points.centre);
}

static enum status hand_over(struct run *run, struct pipeline_result *result) {
    struct pipeline_result made = {.kept_count = run->kept_count, .kept = run->kept, .mesh = run->mesh};
    for (size_t i = 0; i < made.kept_count; i++) made.kept[i] = run->points.original[made.kept[i]];
    for (size_t v = 0; v < made.mesh.vertex_count; v++) restore_vertex(run, &made.mesh, v);
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
    tets_done(&run->tets);
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
