/* The method, from a cloud to results, as a table of steps.
 *
 *     points -> order -> neighbours -> normals -> dso -> quadrics -> contract -> keep -> tangent      a cloud
 *                                                                                   |
 *                                    measure <- refine <- reconstruct <- delaunay <-+                 a mesh
 *
 *  1 order        distinct points in a frame of their own, along a space-filling curve
 *    denoise      where it is asked for: outliers go, noise is smoothed along the normals
 *    faces        for a mesh: whether the input's own faces are the surface, and which of them
 *  2 neighbours   FLANN, and Gopi's neighbourhood
 *  3 normals      least squares
 *    sides        where a mesh or normals are asked for: whether the input's normals fit, which way normals point
 *  4 dso          the discrete shape operator
 *  5 quadrics     of the virtual triangles, times the weights from the operator
 *  6 contract     virtual edges, all the way: a ranking of the points
 *    space        where a spacing is asked for: points that are too near to a more important one go first
 *    search       where a deviation is bounded: the fewest points with which it holds
 *  7 keep         as many as are wanted
 *  8 tangent      the error of the cloud alone
 *    local_delaunay
 *                 for a mesh that is refined: triangles between neighbouring original points, and where few points are
 *                 kept the samples that they make
 *  9 delaunay     tetrahedra of the kept points
 * 10 reconstruct  Tight Cocone; where walls are too thin for the kept points, of more, and then edges are collapsed;
 *                 where the input's faces are the surface, theirs are
 * 11 refine       flips and moves against the original points, or the input's faces
 *    holes        where it is asked for: those of a mesh with borders are closed
 *    vertices     where the input's faces are the surface: the cloud becomes the mesh's vertices, if those are points
 * 12 examine      is it closed, oriented, a manifold
 * 13 measure      distances in both directions
 *    verify       where a deviation is bounded: the one measured is within it
 *    distances    where error.ply is asked for: of every original point to the mesh
 *
 * Steps work for the points or for all results (enum serves).  Where the input's faces are the surface and their mesh
 * is all that is asked for, those for the points are left out:
 *
 *     points -> order -> faces -> keep (how many) -> reconstruct -> refine -> examine, measure
 *
 * Lee, Jong: Point-based simplification algorithm, section 4, is steps 2 to 7 and 10; step 11 is ours.
 *
 * Everything between is in the normalised frame (lengths are fractions of the diagonal) and indexed along the curve;
 * only the result speaks of the input's ids and coordinates.  A step's scratch dies with it; what later steps need is
 * in struct run.
 *
 * Delaunay is one thread's work, and tangent and local_delaunay need nothing of it: they run beside it, as examine does
 * beside measure.  Each step's time is from its own beginning to its own end, so those of steps side by side come to
 * more than the whole takes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/pipeline.h"

#include <math.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "core/base/par.h"
#include "core/base/process_memory.h"
#include "core/mesh/vertex_normals.h"
#include "core/pipeline/pipeline_run.h"

static bool refinement_wanted(const struct params *params) {
    return params_want_mesh(params) && params->refine != REFINE_NONE;
}

static bool distances_wanted(const struct params *params) {
    return params->outputs & (OUTPUT_ERROR | OUTPUT_PREVIEW) && params_want_mesh(params);
}

static bool denoise_wanted(const struct params *params) { return params_want_denoising(params); }

static bool deviation_bounded(const struct params *params) { return params_bound_deviation(params); }

static bool spacing_wanted(const struct params *params) { return !isnan(params->spacing); }

static bool sides_wanted(const struct params *params) {
    return params_want_mesh(params) || params->normals == SWITCH_TRUE;
}

static bool holes_wanted(const struct params *params) {
    return params_want_mesh(params) && !isnan(params->close_holes);
}

static bool faces_wanted(const struct params *params) {
    return params_want_mesh(params) && (params->surface == SURFACE_GIVEN || params->surface == SURFACE_AUTO);
}

/* Vertices of several levels aren't all of each other's. */
static bool vertices_wanted(const struct params *params) {
    return faces_wanted(params) && params->outputs & OUTPUT_ANY_CLOUD && params->levels.count < 2;
}

static bool always(const struct params *params) {
    (void)params;
    return true;
}

/* What a step works for.  Where the surface is that of the input's faces and nothing is asked of the points, which are
 * more important and what they look like matters to nobody: those steps are left out. */
enum serves { ALL, POINTS };

enum how { ONCE, EACH, BESIDE /* each level, at the same time as the step after it */ };

/* share: of the whole's time, roughly, for progress.  A step beside another asks for no progress, fails for want of
 * memory alone, and says nothing of it. */
static const struct step {
    const char *name;
    enum status (*run)(struct run *run);
    bool (*wanted)(const struct params *params);
    enum how how;
    enum serves serves;
    double share;
} steps[] = {
    {"order", pipeline_order, always, ONCE, ALL, 2},
    {"denoise", pipeline_denoise, denoise_wanted, ONCE, ALL, 30},
    {"faces", pipeline_faces, faces_wanted, ONCE, ALL, 4},
    {"neighbours", pipeline_neighbours, always, ONCE, POINTS, 10},
    {"normals", pipeline_normals, always, ONCE, POINTS, 4},
    {"sides", pipeline_sides, sides_wanted, ONCE, POINTS, 1},
    {"dso", pipeline_dso, always, ONCE, POINTS, 2},
    {"quadrics", pipeline_quadrics, always, ONCE, POINTS, 5},
    {"contract", pipeline_contract, always, ONCE, POINTS, 20},
    {"space", pipeline_space, spacing_wanted, ONCE, POINTS, 3},
    {"search", pipeline_search, deviation_bounded, ONCE, POINTS, 600},
    {"keep", pipeline_keep, always, EACH, ALL, 1},
    {"local_delaunay", pipeline_local_delaunay, refinement_wanted, BESIDE, ALL, 4},
    {"tangent", pipeline_tangent, always, BESIDE, POINTS, 2},
    {"delaunay", pipeline_delaunay, params_want_mesh, EACH, ALL, 10},
    {"reconstruct", pipeline_reconstruct, params_want_mesh, EACH, ALL, 10},
    {"refine", pipeline_refine, refinement_wanted, EACH, ALL, 60},
    {"holes", pipeline_close_holes, holes_wanted, EACH, ALL, 1},
    {"vertices", pipeline_vertices, vertices_wanted, EACH, POINTS, 1},
    {"examine", pipeline_examine, params_want_mesh, BESIDE, ALL, 1},
    {"measure", pipeline_measure, params_want_mesh, EACH, ALL, 20},
    {"verify", pipeline_verify, deviation_bounded, EACH, POINTS, 0},
    {"distances", pipeline_distances, distances_wanted, EACH, ALL, 4},
};
enum { STEPS = sizeof steps / sizeof steps[0] };

/* Known from the step `faces` on. */
static bool is_run(const struct run *run, const struct step *step) {
    return step->wanted(run->params) && (step->serves == ALL || !run->faces_alone);
}

struct overall {
    const struct progress *progress;
    double before, share, total;
};

static int overall_tick(void *ctx, const char *stage, double fraction) {
    const struct overall *overall = ctx;
    return progress_tick(overall->progress, stage, (overall->before + overall->share * fraction) / overall->total);
}

/* From the normalised frame and ids along the curve to the input's. */
static void restore_vertex(const struct run *run, struct mesh *mesh, size_t v) {
    uint32_t source = mesh->source[v] == NONE ? NONE : run->points.original[mesh->source[v]];
    if (source != NONE && run->record && run->faces.on_seam[mesh->source[v]]) source = run->record[v];
    mesh->source[v] = source;
    const vec3 *position = run->moved ? run->moved : run->cloud->position;
    mesh->vertex[v] = source != NONE ? position[source]
                                     : vec3_add(vec3_scale(mesh->vertex[v], run->points.scale), run->points.centre);
}

void pipeline_leave_level(struct run *run) {
    pipeline_sites_done(&run->sites);
    local_delaunay_done(&run->local_delaunay);
    samples_done(&run->samples);
    tets_done(&run->tets);
    pipeline_many_done(&run->ahead);
    mesh_done(&run->mesh);
    mesh_done(&run->aside.mesh);
    run->aside = (struct mesh_aside){0};
    run->dense_tried = 0;
    run->sharpened = run->stay_blunt = run->by_cells = false;
    free(run->told);
    run->told = NULL;
    free(run->record);
    run->record = NULL;
    surface_faces_done(&run->fitted_to);
}

/* Hands the level's results over and leaves the run ready for the next one. */
static void take_level(struct run *run, struct pipeline_level *level) {
    for (size_t v = 0; v < run->mesh.vertex_count; v++) restore_vertex(run, &run->mesh, v);
    *level = (struct pipeline_level){run->kept_count, run->mesh};
    run->mesh = (struct mesh){0};
    pipeline_leave_level(run);
}

/* A step and those beside it, which come before it in the table, one after the other. */
struct group {
    struct run *run;
    const struct step *first, *last;
    enum status status[STEPS];
    double ms[STEPS];
    atomic_bool failed;
};

static void run_step(struct group *group, const struct step *step) {
    ptrdiff_t i = step - group->first;
    if (!is_run(group->run, step) || atomic_load(&group->failed)) return;
    double start_ms = clock_exact_ms();
    group->status[i] = step->run(group->run);
    group->ms[i] = clock_exact_ms() - start_ms;
    if (group->status[i]) atomic_store(&group->failed, true);
}

static void run_last(void *ctx) {
    struct group *group = ctx;
    run_step(group, group->last);
}

static void run_others(void *ctx) {
    struct group *group = ctx;
    for (const struct step *step = group->first; step < group->last; step++) run_step(group, step);
}

/* Tells the times, and, unless the last one has failed, which of the others did. */
static enum status report_group(struct group *group) {
    enum status status = group->status[group->last - group->first];
    for (const struct step *step = group->first; step <= group->last; step++) {
        ptrdiff_t i = step - group->first;
        if (!is_run(group->run, step)) continue;
        report_add_stage(&group->run->report, step->name, group->ms[i]);
        if (!status && group->status[i]) status = pipeline_no_memory(group->run, step->name);
    }
    return status;
}

static enum status run_group(struct run *run, const struct step *first, const struct step *last,
                             struct overall *overall) {
    struct group group = {.run = run, .first = first, .last = last};
    enum status status = STATUS_OK;
    overall->share = 0;
    for (const struct step *step = first; step <= last && !status; step++) {
        if (!step->wanted(run->params)) continue;
        if (is_run(run, step) && overall_tick(overall, step->name, 0)) status = STATUS_CANCELLED;
        overall->share += step->share;
    }
    if (!status) {
        par_beside(first < last ? run->threads : 1, run_last, run_others, &group);
        status = report_group(&group);
    }
    overall->before += overall->share;
    return status;
}

enum status pipeline_turn_to_points(struct run *run) {
    enum status status = STATUS_OK;
    if (!run->faces_alone) return STATUS_OK;
    run->faces_alone = false;
    for (const struct step *step = steps; step->run != pipeline_delaunay && !status; step++)
        if ((step->serves == POINTS || step->run == pipeline_keep) && step->wanted(run->params))
            status = step->run(run);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "points") : status;
}

static bool is_after_surface(const struct step *step) {
    while (step > steps && step[-1].run != pipeline_reconstruct) step--;
    return step > steps;
}

/* Runs the groups from *next on that are to be run once, or for each level. */
static enum status run_groups(struct run *run, const struct step **next, bool once, struct overall *overall) {
    enum status status = STATUS_OK;
    while (*next < steps + STEPS && ((*next)->how == ONCE) == once && !status) {
        const struct step *first = *next, *last = first;
        while (last->how == BESIDE) last++;
        if (run->surface_alone && is_after_surface(first)) return STATUS_OK;
        status = run_group(run, first, last, overall);
        *next = last + 1;
    }
    return status;
}

/* Says which of several levels it was that couldn't be made. */
static enum status in_level(const struct run *run, size_t level, enum status status) {
    const struct param_levels *levels = &run->params->levels;
    if (!status || status == STATUS_CANCELLED || levels->count < 2 || !run->error) return status;
    struct error plain = *run->error;
    return error_set_at(run->error, status, plain.where, plain.line, plain.byte_offset, "level %g: %s",
                        levels->ratio[level], plain.text);
}

static enum status run_steps(struct run *run, const struct progress *progress, struct pipeline_result *made) {
    struct overall overall = {.progress = progress};
    const struct step *of_levels = steps;
    for (size_t j = 0; j < STEPS; j++)
        if (steps[j].wanted(run->params))
            overall.total += steps[j].share * (double)(steps[j].how == ONCE ? 1 : made->level_count);
    run->progress = (struct progress){overall_tick, &overall};
    enum status status = run_groups(run, &of_levels, true, &overall);
    for (run->level = 0; run->level < made->level_count && !status; run->level++) {
        const struct step *next = of_levels;
        status = in_level(run, run->level, run_groups(run, &next, false, &overall));
        take_level(run, &made->level[run->level]);
    }
    return status;
}

/* Spreads values of the distinct points over all points of the input, in the input's units.  Outliers show those of
 * their own, in their order, or, where there are none (NULL), the largest one. */
static float *spread(const struct run *run, const float *value, const float *own, double scale) {
    float *all = alloc_array(run->cloud->count, sizeof *all), largest = 0;
    for (size_t i = 0; i < run->points.count; i++) largest = fmaxf(largest, value[i]);
    for (size_t i = 0; all && i < run->cloud->count; i++) {
        uint32_t p = run->points.distinct[i];
        float of_outlier = p == NONE && own ? *own++ : largest;
        all[i] = (float)((double)(p == NONE ? of_outlier : value[p]) * scale);
    }
    return all;
}

/* Whichever side they are of; an outlier has none. */
static float (*spread_facing(const struct run *run))[3] {
    float(*all)[3] = alloc_array(run->cloud->count, sizeof *all);
    for (size_t i = 0; all && i < run->cloud->count; i++) {
        uint32_t p = run->points.distinct[i];
        vec3 n = p == NONE ? (vec3){0, 0, 0} : run->normal[p];
        all[i][0] = (float)n.x, all[i][1] = (float)n.y, all[i][2] = (float)n.z;
    }
    return all;
}

static bool *list_whether_dropped(const struct run *run) {
    bool *dropped = alloc_array(run->cloud->count, sizeof *dropped);
    for (size_t i = 0; dropped && i < run->cloud->count; i++) dropped[i] = run->points.distinct[i] == NONE;
    return dropped;
}

/* The normals of points that a mesh has for vertices point to the side that its faces around them do, whatever the
 * points alone have told. */
static enum status turn_to_mesh(const struct mesh *mesh, float (*normal)[3]) {
    vec3 *around = alloc_array(mesh->vertex_count, sizeof *around);
    if (!around) return STATUS_NO_MEMORY;
    mesh_vertex_normals(mesh, around);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        if (!mesh->source || mesh->source[v] == NONE) continue;
        float *n = normal[mesh->source[v]];
        vec3 own = {(double)n[0], (double)n[1], (double)n[2]};
        if (vec3_dot(own, around[v]) >= 0) continue;
        for (int k = 0; k < 3; k++) n[k] = -n[k];
    }
    free(around);
    return STATUS_OK;
}

/* The finest mesh, which has the vertices of the others, last. */
static enum status turn_to_meshes(struct run *run, struct pipeline_result *made) {
    enum status status = STATUS_OK;
    for (size_t k = made->level_count; k-- > 0 && !status;)
        if (made->level[k].mesh.triangle_count > 0) status = turn_to_mesh(&made->level[k].mesh, made->normal);
    if (made->level_count > 0 && made->level[0].mesh.triangle_count > 0)
        snprintf(run->report.normals.orientation, sizeof run->report.normals.orientation, "%s",
                 run->report.surface.orientation);
    return status;
}

static enum status hand_over_values(struct run *run, struct pipeline_result *made) {
    bool normals = run->params->normals == SWITCH_TRUE && !run->normals_fit;
    if (normals) made->normal = pipeline_spread_normals(run);
    if (made->normal && turn_to_meshes(run, made)) return pipeline_no_memory(run, "output");
    made->report.normals = run->report.normals;
    bool dso = run->params->outputs & OUTPUT_DSO, facing = run->params->outputs & OUTPUT_PREVIEW;
    bool distance = run->params->outputs & (OUTPUT_ERROR | OUTPUT_PREVIEW);
    if (facing) made->facing = spread_facing(run);
    if (dso) made->dso = spread(run, run->dso, NULL, 1 / run->points.scale);
    if (distance) made->distance = spread(run, run->distance, run->of_dropped, run->points.scale);
    bool drops = run->report.points_outliers > 0;
    if (drops) made->dropped = list_whether_dropped(run);
    bool ok = (!normals || made->normal) && (!dso || made->dso) && (!distance || made->distance) &&
              (!facing || made->facing) && (!drops || made->dropped);
    return ok ? STATUS_OK : pipeline_no_memory(run, "output");
}

static enum status hand_over(struct run *run, struct pipeline_result *made) {
    for (size_t i = 0; run->kept && i < made->level[0].kept_count; i++)
        run->kept[i] = run->points.original[run->kept[i]];
    made->kept = run->kept;
    run->kept = NULL;
    made->moved = run->moved;
    run->moved = NULL;
    run->report.level_count = made->level_count;
    run->report.peak_rss_bytes = process_peak_bytes(0);
    made->report = run->report;
    return hand_over_values(run, made);
}

static void run_done(struct run *run) {
    ordered_points_done(&run->points);
    free(run->moved), free(run->pattern.views.each), free(run->plane.reach);
    knn_free(run->knn);
    neighbourhood_done(&run->neighbours);
    creases_done(&run->creases);
    faces_done(&run->faces);
    free(run->normal), free(run->mended), free(run->turned), free(run->dso), free(run->distance), free(run->of_dropped);
    free(run->quadrics), free(run->kept);
    free(run->outside);
    contraction_done(&run->contraction);
    pipeline_leave_level(run);
    made_points_done(&run->made);
    for (int i = 0; i < DENSE_TRIALS; i++) dense_surface_done(&run->dense[i]);
}

static enum status run_whole(struct run *run, const struct progress *progress, struct pipeline_result *made) {
    const struct params *params = run->params;
    double start_ms = clock_exact_ms();
    run->threads = (unsigned)params->threads;
    run->mesh_follows = params_want_mesh(params);
    run->placement = params->placement == PLACEMENT_OPTIMAL ? PLACEMENT_OPTIMAL : PLACEMENT_SUBSET;
    made->level_count = params->levels.count ? params->levels.count : 1;
    if (run->error) *run->error = (struct error){0};
    if (run->cloud->count == 0) return error_set(run->error, STATUS_DEGENERATE, "points", "the cloud has no points");
    struct par_team *team = par_team_new();
    enum status status = team ? run_steps(run, progress, made) : pipeline_no_memory(run, "threads");
    par_team_free(team);
    run->report.total_ms = clock_exact_ms() - start_ms;
    return status == STATUS_CANCELLED ? error_set(run->error, status, "pipeline", "cancelled") : status;
}

enum status pipeline_run(const struct cloud *cloud, const struct params *params, const struct progress *progress,
                         struct pipeline_result *result, struct error *error) {
    struct run run = {.cloud = cloud, .params = params, .error = error};
    struct pipeline_result made = {0};
    enum status status = run_whole(&run, progress, &made);
    if (!status) status = hand_over(&run, &made);
    if (status)
        pipeline_result_done(&made);
    else
        *result = made;
    run_done(&run);
    return status;
}

enum status pipeline_find_surface(const struct cloud *cloud, const struct params *params, struct report *report,
                                  struct error *error) {
    struct run run = {.cloud = cloud, .params = params, .error = error, .surface_alone = true};
    struct pipeline_result made = {0};
    enum status status = run_whole(&run, NULL, &made);
    if (status == STATUS_DEGENERATE) run.report.surface = (struct report_surface){0};
    if (!status || status == STATUS_DEGENERATE) *report = run.report;
    pipeline_result_done(&made);
    run_done(&run);
    return status;
}

void pipeline_result_done(struct pipeline_result *result) {
    if (!result) return;
    free(result->kept), free(result->moved), free(result->normal), free(result->dso), free(result->distance);
    free(result->facing), free(result->dropped);
    for (size_t i = 0; i < result->level_count; i++) mesh_done(&result->level[i].mesh);
    *result = (struct pipeline_result){0};
}
