/* Step 11: the mesh is fitted to the original points.
 *
 * Where vertices move freely and the surface has borders, it is fitted twice: with vertices that stay at points, and
 * with such that don't; what is nearer to the points is taken.  On noisy points moving may gain little of what a vertex
 * at a point has for nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine.h"

#include "core/base/left_out.h"
#include "core/measure/metro.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/sheet/sheet.h"

static struct refine_input refine_input_of(struct run *run, struct refine_faces *faces) {
    const struct surface_faces *dense = run->fitted_to.face ? &run->fitted_to : NULL;
    *faces = (struct refine_faces){run->faces.count, (const uint32_t(*)[3])run->faces.triangle, run->faces.on_seam};
    if (dense) *faces = (struct refine_faces){dense->count, (const uint32_t(*)[3])dense->face, NULL};
    return (struct refine_input){.points = run->points.point,
                                 .normals = run->normal,
                                 .n = run->points.count,
                                 .spacing = run->neighbours.spacing,
                                 .neighbours = &run->neighbours,
                                 .creases = &run->creases,
                                 .up = run->surface.form == SURFACE_HEIGHTFIELD ? run->surface.up : (vec3){0},
                                 .local_delaunay = &run->local_delaunay,
                                 .samples = &run->samples,
                                 .faces = pipeline_is_given(run) || dense ? faces : NULL,
                                 .settled = dense || (pipeline_is_given(run) && !run->faces.record)};
}

/* Whether triangulation and samples take no more memory together than the refinement does after them (memory.c). */
static bool has_room_for_samples(const struct run *run) {
    enum { FEWER = 4 };
    return run->placement == PLACEMENT_OPTIMAL || run->kept_count <= run->points.count / FEWER;
}

/* There are about twice as many triangles as points; refine_mesh finds what it hasn't got, and where it may get a
 * surface of all points that is all. */
enum status pipeline_local_delaunay(struct run *run) {
    bool given = pipeline_is_given(run);
    if (!given && pipeline_wants_dense(run)) return STATUS_OK;
    if (!given && !refine_uses_local_delaunay(run->points.count, 2 * run->kept_count)) return STATUS_OK;
    enum status status = STATUS_OK;
    if (!given)
        status = local_delaunay_find(run->points.point, run->normal, &run->neighbours, &run->creases, run->threads,
                                     &run->local_delaunay);
    if (status || !has_room_for_samples(run)) return status;
    struct refine_faces faces;
    struct refine_input input = refine_input_of(run, &faces);
    status = samples_init(&run->samples, &input, 1, run->threads);
    if (run->placement == PLACEMENT_SUBSET) local_delaunay_done(&run->local_delaunay);
    return status;
}

/* A part of the step, from a fraction of it on. */
struct refine_part {
    const struct progress *whole;
    double before, share;
};

static int tick_part(void *ctx, const char *stage, double fraction) {
    const struct refine_part *part = ctx;
    return progress_tick(part->whole, stage, part->before + part->share * fraction);
}

static enum status refine_as(struct run *run, enum placement placement, struct refine_part part, struct mesh *mesh) {
    struct refine_faces faces;
    struct refine_input input = refine_input_of(run, &faces);
    struct refine_options options = {(enum refine_form)run->params->refine, placement, run->threads};
    struct progress progress = {tick_part, &part};
    enum status status = refine_mesh(mesh, &input, &options, &progress, NULL);
    struct reconstruct_dense dense = pipeline_dense_of(run, &run->sites);
    if (!status && run->surface.form == SURFACE_OPEN) status = sheet_trim(mesh, &dense, run->threads);
    return status;
}

/* How far the points are from a mesh, and it from what they tell of the surface, as pipeline_measure reports. */
static enum status find_errors(const struct run *run, const struct mesh *mesh, struct metro_errors *errors) {
    enum { SAMPLES = 20000 };
    struct metro_reference reference = {run->points.count,       run->points.point, run->normal,
                                        run->neighbours.spacing, run->knn,          NULL};
    struct metro_options options = {.samples = SAMPLES, .seed = run->params->seed, .threads = run->threads};
    return metro_measure(mesh, &reference, &options, errors);
}

/* Never farther from the points, nor by more than samples may err in both directions together. */
static bool is_nearer(const struct metro_errors *errors, const struct metro_errors *than) {
    static const double SLACK = 1.05;
    double both = errors->forward.mean + errors->backward.mean;
    return errors->forward.mean <= than->forward.mean && both <= SLACK * (than->forward.mean + than->backward.mean);
}

/* Takes the vertices' free places only where they are nearer than points are. */
static enum status refine_both_ways(struct run *run) {
    static const double AT_POINTS = 0.5; /* of the time */
    struct metro_errors free_errors, errors;
    struct mesh at_points = {0};
    enum status status = mesh_copy(&at_points, &run->mesh);
    if (!status)
        status = refine_as(run, PLACEMENT_SUBSET, (struct refine_part){&run->progress, 0, AT_POINTS}, &at_points);
    if (!status)
        status = refine_as(run, PLACEMENT_OPTIMAL, (struct refine_part){&run->progress, AT_POINTS, 1 - AT_POINTS},
                           &run->mesh);
    bool there = at_points.triangle_count > 0;
    bool both = there && run->mesh.triangle_count > 0;
    if (!status && both) status = find_errors(run, &run->mesh, &free_errors);
    if (!status && both) status = find_errors(run, &at_points, &errors);
    if (!status && there && (!both || !is_nearer(&free_errors, &errors))) {
        struct mesh before = run->mesh;
        run->mesh = at_points, at_points = before;
        left_out_add(&run->report.left_out, "mesh",
                     "placement=optimal: vertices stay at points, since the mesh is nearer to the points then");
    }
    mesh_done(&at_points);
    return status;
}

enum status pipeline_refine(struct run *run) {
    enum placement placement = run->record ? PLACEMENT_SUBSET : run->placement;
    bool open = run->surface.form == SURFACE_OPEN || run->surface.form == SURFACE_HEIGHTFIELD;
    bool doubtful = open && placement == PLACEMENT_OPTIMAL && run->params->refine == REFINE_FULL;
    enum status status = doubtful ? refine_both_ways(run)
                                  : refine_as(run, placement, (struct refine_part){&run->progress, 0, 1}, &run->mesh);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "refine") : status;
}
