/* The input's own faces as the surface: whether they are one, and the mesh that their edges are collapsed to.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/mesh/decimate.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/spatial/bvh.h"

/* Faces that fewer of the points have, or that meet in fans at more of them, are no surface to anybody who didn't ask
 * for it. */
static const double USED_LEAST = 0.5, KNOTTED_MOST = 0.05;

/* Whether somebody asked for a reconstruction by saying how it is to be done. */
static bool reconstruction_is_asked(const struct params *params) {
    return params->order != ORDER_AUTO || params->reconstruction != 0;
}

static bool are_surface(const struct run *run, const struct faces_facts *facts) {
    return run->faces.count && (double)facts->used >= USED_LEAST * (double)run->points.count &&
           (double)facts->knotted <= KNOTTED_MOST * (double)facts->used;
}

static void tell_of_faces(struct run *run, const struct faces_facts *facts) {
    struct left_out *notes = &run->report.left_out;
    if (facts->turned)
        left_out_add(notes, "input", LEFT_OUT_NOTE "%zu faces faced against those beside them, and were turned over",
                     facts->turned);
    if (facts->knotted)
        left_out_add(notes, "input",
                     LEFT_OUT_NOTE
                     "%zu vertices where more than two faces share an edge, or fans of faces meet, stay where they are",
                     facts->knotted);
    if (facts->seams_dropped)
        left_out_add(notes, "input",
                     "%s: they differ at nearly every edge, so that no vertex could go if they were kept apart",
                     facts->seams ? "normals of each face's own" : "texture coordinates or normals of each face's own");
    if (facts->seams && run->params->placement == PLACEMENT_OPTIMAL)
        left_out_add(notes, "mesh",
                     LEFT_OUT_NOTE "placement=optimal: vertices stay at points, since there are %zu edges on seams",
                     facts->seams);
}

/* A vertex that is moved has the texture coordinates of the nearest point, so a picture would shift on the surface. */
static bool may_move(const struct run *run, const struct faces_facts *facts) {
    const struct property *texture[2];
    return !facts->seams && !attribute_find_texture(run->cloud, texture);
}

/* Whether something of the points is to be told or written, or decides how many vertices there are. */
static bool points_are_asked_for(const struct params *params) {
    const unsigned of_points = OUTPUT_ANY_CLOUD | OUTPUT_DSO | OUTPUT_PREVIEW;
    return params->outputs & of_points || params->normals == SWITCH_TRUE || params->weights[0] ||
           params->reference == REFERENCE_POINTS || !isnan(params->max_error) || !isnan(params->spacing) ||
           params_bound_deviation(params);
}

static void take_faces(struct run *run, const struct faces_facts *facts) {
    struct surface_choice choice = {.form = SURFACE_GIVEN, .sure = true};
    if (run->params->surface == SURFACE_AUTO)
        snprintf(choice.reason, sizeof choice.reason,
                 "the input has faces (surface=closed, open or heightfield makes others)");
    if (run->params->placement == PLACEMENT_AUTO && may_move(run, facts)) {
        size_t used = strlen(choice.reason);
        run->placement = PLACEMENT_OPTIMAL;
        snprintf(choice.reason + used, sizeof choice.reason - used,
                 "%s; vertices move freely (placement=subset keeps them at points)", used ? "" : "it was asked for");
    }
    pipeline_decide(run, choice);
    snprintf(run->report.surface.orientation, sizeof run->report.surface.orientation, "faces");
    tell_of_faces(run, facts);
    run->faces_alone = !run->surface_alone && !points_are_asked_for(run->params);
    run->fits = run->points.count;
    if (run->faces_alone) run->report.noise_level = NAN;
}

enum status pipeline_faces(struct run *run) {
    enum surface_form asked = (enum surface_form)run->params->surface;
    struct faces_facts facts = {0};
    if (asked == SURFACE_GIVEN && !run->cloud->triangle_count)
        return error_set(run->error, STATUS_BAD_PARAMETER, "surface",
                         "given: the input has no faces; leave it out, and the surface is reconstructed");
    if (asked != SURFACE_GIVEN && (asked != SURFACE_AUTO || reconstruction_is_asked(run->params))) return STATUS_OK;
    if (!run->cloud->triangle_count) return STATUS_OK;
    if (faces_make(run->cloud, &run->points, run->threads, &run->faces, &facts))
        return pipeline_no_memory(run, "faces");
    if (asked == SURFACE_GIVEN && !run->faces.count)
        return error_set(run->error, STATUS_DEGENERATE, "faces",
                         "none of the input's %zu triangles has three corners at different places",
                         run->cloud->triangle_count);
    if (asked == SURFACE_GIVEN || are_surface(run, &facts)) {
        take_faces(run, &facts);
        return STATUS_OK;
    }
    left_out_add(&run->report.left_out, "input",
                 "its faces as a surface: %zu of %zu points have any, %zu several fans; surface=given takes them",
                 facts.used, run->points.count, facts.knotted);
    faces_done(&run->faces);
    return STATUS_OK;
}

/* A mesh that can't become as small as it should may take more memory than there is for it. */
static bool has_room(const struct run *run) {
    struct params as_many = *run->params;
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    size_t n = run->mesh.vertex_count;
    if (n <= run->kept_count || !as_many.memory_bytes) return true;
    as_many.points = n, as_many.ratio = NAN, as_many.levels.count = 0;
    return memory_predict(&job, &as_many) <= as_many.memory_bytes;
}

/* Whether so much of the mesh is as near to the points as the nearest that fitting it to them takes too long: sheets
 * lie near few of each other, triangles that lie across each other near most. */
static enum status find_tangles(const struct run *run, bool *tangled) {
    enum { TRIALS = 256, MOST_VISITS = 200 };
    vec3 trial[TRIALS];
    struct bvh *bvh = NULL;
    size_t count = run->points.count, n = count < TRIALS ? count : TRIALS;
    enum status status = bvh_new(&run->mesh, run->threads, &bvh);
    for (size_t i = 0; i < n; i++) trial[i] = run->points.point[i * (count / n)];
    if (!status) *tangled = bvh_visits(bvh, trial, n, MOST_VISITS * n) > MOST_VISITS * n;
    bvh_free(bvh);
    return status;
}

/* The surface is found by the points instead. */
static enum status reconstruct_instead(struct run *run, const char *why) {
    left_out_add(&run->report.left_out, "input", "its faces as a surface: simplified to %zu vertices, %s",
                 run->mesh.vertex_count, why);
    mesh_done(&run->mesh);
    run->mesh = (struct mesh){0};
    faces_done(&run->faces);
    run->decision = UNDECIDED;
    if (run->params->placement == PLACEMENT_AUTO) run->placement = PLACEMENT_SUBSET;
    enum status status = pipeline_turn_to_points(run);
    if (!status) status = pipeline_delaunay(run);
    return status ? status : pipeline_reconstruct(run);
}

static enum status refuse_tangle(struct run *run) {
    return error_set(run->error, STATUS_DEGENERATE, "collapse",
                     "the input's faces lie so far across each other that most of them are as near to a point as the "
                     "nearest: there is no surface of them; leave surface=given out, and it is reconstructed from the "
                     "points, or take outputs=cloud");
}

static enum status refuse_for_room(struct run *run) {
    return error_set(run->error, STATUS_NO_MEMORY, "collapse",
                     "the input's faces can't be simplified to fewer than %zu vertices, and %" PRIu64
                     " MiB have no room for them: allow more memory, or have the surface reconstructed "
                     "(surface=closed, surface=open)",
                     run->mesh.vertex_count, run->params->memory_bytes >> 20);
}

/* The mesh's seams become borders, of which refinement lets go no vertex. */
static enum status cut_seams(struct run *run, const uint32_t (*record)[3]) {
    size_t before = run->mesh.vertex_count;
    enum status status = faces_cut(&run->mesh, record, &run->record);
    run->report.level[run->level].vertices_split = run->mesh.vertex_count - before;
    return status;
}

/* Collapses edges until as many vertices are left as are kept, or none can go. */
static enum status collapse(struct run *run, uint32_t (**record)[3]) {
    struct decimate_rules rules = {.borders = true, .slivers = true};
    rules.moves = run->placement == PLACEMENT_OPTIMAL && !run->faces.record;
    enum status status = faces_mesh(&run->faces, &run->points, &run->mesh);
    if (!status && run->faces.record) {
        *record = rules.record = alloc_array(run->faces.count, sizeof *rules.record);
        status = rules.record ? STATUS_OK : STATUS_NO_MEMORY;
        if (!status) memcpy(rules.record, run->faces.record, run->faces.count * sizeof *rules.record);
    }
    return status ? status : mesh_decimate(&run->mesh, &rules, run->kept_count);
}

enum status pipeline_collapse(struct run *run) {
    struct report_level *report = &run->report.level[run->level];
    uint32_t(*record)[3] = NULL;
    enum status status = collapse(run, &record);
    bool room = status || has_room(run), tangled = false, automatic = run->params->surface == SURFACE_AUTO;
    if (!status && (room || !automatic)) status = find_tangles(run, &tangled);
    if (!status && (!room || tangled)) {
        free(record);
        if (!automatic) return tangled ? refuse_tangle(run) : refuse_for_room(run);
        return reconstruct_instead(run, room ? "they lie across each other"
                                             : "from which none can go, they have no room in the memory");
    }
    if (!status && run->mesh.vertex_count > run->kept_count)
        left_out_add(&run->report.left_out, "mesh", "%zu vertices that can't go without changing what the surface is",
                     run->mesh.vertex_count - run->kept_count);
    if (!status && record) status = cut_seams(run, (const uint32_t(*)[3])record);
    free(record);
    report->reconstructed_from = run->points.count;
    snprintf(report->reconstruction, sizeof report->reconstruction, "given");
    return status ? pipeline_no_memory(run, "collapse") : STATUS_OK;
}

/* Beside a mesh whose vertices are points the cloud is those points, the most important first. */
enum status pipeline_vertices(struct run *run) {
    const struct contraction *contraction = &run->contraction;
    const struct mesh *mesh = &run->mesh;
    struct report_level *level = &run->report.level[run->level];
    size_t points = 0, at = 0;
    if (!pipeline_is_given(run)) return STATUS_OK;
    uint8_t *is_vertex = alloc_zeroed(run->points.count, sizeof *is_vertex);
    for (size_t v = 0; is_vertex && v < mesh->vertex_count; v++) {
        if (mesh->source[v] == NONE) { /* of several that may move freely */
            free(is_vertex);
            return STATUS_OK;
        }
        points += !is_vertex[mesh->source[v]];
        is_vertex[mesh->source[v]] = 1;
    }
    uint32_t *kept = is_vertex ? alloc_array(points, sizeof *kept) : NULL;
    for (size_t i = contraction->n; kept && i-- > 0;)
        if (is_vertex[contraction->order[i]]) kept[at++] = contraction->order[i];
    free(is_vertex);
    if (!kept) return pipeline_no_memory(run, "vertices");
    free(run->kept);
    run->kept = kept;
    run->kept_count = level->points_out = at;
    level->ratio = (double)at / (double)run->cloud->count;
    return pipeline_tangent(run) ? pipeline_no_memory(run, "vertices") : STATUS_OK;
}

/* The mesh without the copies that seams have made, for whoever asks what it is. */
enum status pipeline_join_seams(const struct run *run, struct mesh *joined) {
    uint32_t *first = alloc_array(run->points.count, sizeof *first);
    *joined = run->mesh;
    joined->triangle = alloc_array(run->mesh.triangle_count, sizeof *joined->triangle);
    bool room = first && joined->triangle;
    if (room) {
        memset(first, 0xff, run->points.count * sizeof *first);
        for (size_t v = 0; v < run->mesh.vertex_count; v++) {
            uint32_t source = run->mesh.source[v];
            if (source != NONE && run->faces.on_seam[source] && first[source] == NONE) first[source] = (uint32_t)v;
        }
        for (size_t t = 0; t < run->mesh.triangle_count; t++)
            for (int k = 0; k < 3; k++) {
                uint32_t v = run->mesh.triangle[t][k], source = run->mesh.source[v];
                bool on_seam = source != NONE && run->faces.on_seam[source];
                joined->triangle[t][k] = on_seam ? first[source] : v;
            }
    }
    free(first);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}
