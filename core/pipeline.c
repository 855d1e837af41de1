/* The method, from a cloud to results, as a table of steps.
 *
 *     points -> order -> neighbours -> normals -> dso -> quadrics -> contract -> keep -> tangent      a cloud
 *                                                                                   |
 *                                    measure <- refine <- reconstruct <- delaunay <-+                 a mesh
 *
 *  1 order        distinct points in a frame of their own, along a space-filling curve
 *    denoise      where it is asked for: outliers go, noise is smoothed along the normals
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
 *    distances    where error.ply is asked for: of every original point to the mesh
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

#include "core/alloc.h"
#include "core/par.h"
#include "core/pipeline_run.h"

static bool mesh_wanted(const struct params *params) { return params->outputs & (OUTPUT_ANY_MESH | OUTPUT_ERROR); }

static bool refinement_wanted(const struct params *params) {
    return mesh_wanted(params) && params->refine != REFINE_NONE;
}

static bool distances_wanted(const struct params *params) { return params->outputs & OUTPUT_ERROR; }

static bool denoise_wanted(const struct params *params) { return params->denoise != DENOISE_NONE; }

static bool always(const struct params *params) {
    (void)params;
    return true;
}

/* share: of the whole's time, roughly, for progress. */
static const struct step {
    const char *name;
    enum status (*run)(struct run *run);
    bool (*wanted)(const struct params *params);
    bool each_level;
    double share;
} steps[] = {
    {"order", pipeline_order, always, false, 2},
    {"denoise", pipeline_denoise, denoise_wanted, false, 30},
    {"neighbours", pipeline_neighbours, always, false, 10},
    {"normals", pipeline_normals, always, false, 4},
    {"dso", pipeline_dso, always, false, 2},
    {"quadrics", pipeline_quadrics, always, false, 5},
    {"contract", pipeline_contract, always, false, 20},
    {"keep", pipeline_keep, always, true, 1},
    {"tangent", pipeline_tangent, always, true, 4},
    {"delaunay", pipeline_delaunay, mesh_wanted, true, 10},
    {"reconstruct", pipeline_reconstruct, mesh_wanted, true, 10},
    {"refine", pipeline_refine, refinement_wanted, true, 60},
    {"examine", pipeline_examine, mesh_wanted, true, 1},
    {"measure", pipeline_measure, mesh_wanted, true, 20},
    {"distances", pipeline_distances, distances_wanted, true, 4},
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

/* From the normalised frame and ids along the curve to the input's. */
static void restore_vertex(const struct run *run, struct mesh *mesh, size_t v) {
    uint32_t source = mesh->source[v] == NONE ? NONE : run->points.original[mesh->source[v]];
    mesh->source[v] = source;
    const vec3 *position = run->moved ? run->moved : run->cloud->position;
    mesh->vertex[v] = source != NONE ? position[source]
                                     : vec3_add(vec3_scale(mesh->vertex[v], run->points.scale), run->points.centre);
}

/* Hands the level's results over and leaves the run ready for the next one. */
static void take_level(struct run *run, struct pipeline_level *level) {
    for (size_t v = 0; v < run->mesh.vertex_count; v++) restore_vertex(run, &run->mesh, v);
    *level = (struct pipeline_level){run->kept_count, run->mesh};
    run->mesh = (struct mesh){0};
    pipeline_sites_done(&run->sites);
}

static enum status run_step(struct run *run, const struct step *step, struct overall *overall) {
    if (!step->wanted(run->params)) return STATUS_OK;
    double start_ms = now_ms();
    overall->share = step->share;
    enum status status = overall_tick(overall, step->name, 0) ? STATUS_CANCELLED : step->run(run);
    overall->before += overall->share;
    report_add_stage(&run->report, step->name, now_ms() - start_ms);
    return status;
}

static enum status run_steps(struct run *run, const struct progress *progress, struct pipeline_result *made) {
    struct overall overall = {.progress = progress};
    enum status status = STATUS_OK;
    size_t i = 0;
    for (size_t j = 0; j < STEPS; j++)
        if (steps[j].wanted(run->params))
            overall.total += steps[j].share * (double)(steps[j].each_level ? made->level_count : 1);
    run->progress = (struct progress){overall_tick, &overall};
    for (; !steps[i].each_level && !status; i++) status = run_step(run, &steps[i], &overall);
    for (run->level = 0; run->level < made->level_count && !status; run->level++) {
        for (size_t j = i; j < STEPS && !status; j++) status = run_step(run, &steps[j], &overall);
        take_level(run, &made->level[run->level]);
    }
    return status;
}

/* Spreads values of the distinct points over all points of the input, in the input's units.  An outlier shows the
 * largest one. */
static float *spread(const struct run *run, const float *value, double scale) {
    float *all = alloc_array(run->cloud->count, sizeof *all), largest = 0;
    for (size_t i = 0; i < run->points.count; i++) largest = fmaxf(largest, value[i]);
    for (size_t i = 0; all && i < run->cloud->count; i++) {
        uint32_t p = run->points.distinct[i];
        all[i] = (float)((double)(p == NONE ? largest : value[p]) * scale);
    }
    return all;
}

static enum status hand_over_values(struct run *run, struct pipeline_result *made) {
    bool dso = run->params->outputs & OUTPUT_DSO, distance = run->params->outputs & OUTPUT_ERROR;
    if (dso) made->dso = spread(run, run->dso, 1 / run->points.scale);
    if (distance) made->distance = spread(run, run->distance, run->points.scale);
    bool ok = (!dso || made->dso) && (!distance || made->distance);
    return ok ? STATUS_OK : pipeline_no_memory(run, "output");
}

static enum status hand_over(struct run *run, struct pipeline_result *made) {
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    for (size_t i = 0; i < made->level[0].kept_count; i++) run->kept[i] = run->points.original[run->kept[i]];
    made->kept = run->kept;
    run->kept = NULL;
    made->moved = run->moved;
    run->moved = NULL;
    run->report.level_count = made->level_count;
    run->report.peak_rss_bytes = (uint64_t)usage.ru_maxrss * 1024;
    made->report = run->report;
    return hand_over_values(run, made);
}

static void run_done(struct run *run) {
    ordered_points_done(&run->points);
    free(run->moved);
    knn_free(run->knn);
    neighbourhood_done(&run->hood);
    free(run->normal), free(run->dso), free(run->distance), free(run->quadrics), free(run->kept);
    contraction_done(&run->contraction);
    pipeline_sites_done(&run->sites);
    tets_done(&run->tets);
    mesh_done(&run->mesh);
}

enum status pipeline_run(const struct cloud *cloud, const struct params *params, const struct progress *progress,
                         struct pipeline_result *result, struct error *error) {
    struct run run = {.cloud = cloud, .params = params, .error = error, .threads = (unsigned)params->threads};
    struct pipeline_result made = {.level_count = params->levels.count ? params->levels.count : 1};
    double start_ms = now_ms();
    run.mesh_follows = mesh_wanted(params);
    if (cloud->count == 0) return error_set(error, STATUS_DEGENERATE, "points", "the cloud has no points");
    struct par_team *team = par_team_new();
    enum status status = team ? run_steps(&run, progress, &made) : pipeline_no_memory(&run, "threads");
    par_team_free(team);
    run.report.total_ms = now_ms() - start_ms;
    if (!status) status = hand_over(&run, &made);
    if (status == STATUS_CANCELLED) error_set(error, status, "pipeline", "cancelled");
    if (status)
        pipeline_result_done(&made);
    else
        *result = made;
    run_done(&run);
    return status;
}

void pipeline_result_done(struct pipeline_result *result) {
    if (!result) return;
    free(result->kept), free(result->moved), free(result->dso), free(result->distance);
    for (size_t i = 0; i < result->level_count; i++) mesh_done(&result->level[i].mesh);
    *result = (struct pipeline_result){0};
}
