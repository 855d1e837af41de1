/* Step 11: the mesh is fitted to the original points.
 *
 * Where vertices move freely the mesh is fitted twice: with vertices that stay at points, and with such that don't;
 * what is nearer to the points is taken.  On noisy points moving may gain little of what a vertex at a point has for
 * nothing.
 *
 * A closed surface may have been made of many points (dense.c).  Such a mesh goes where the points tell more exactly,
 * and where they tell little it may have spikes that a mesh of the kept points doesn't have.  So it is looked at beside
 * the one with vertices at points, which is made for either: where it goes astray by more than that one, the mesh of
 * the kept points is fitted with free vertices as well, and the dense one is taken only if it is about as near.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine.h"

#include <math.h>

#include "core/base/left_out.h"
#include "core/measure/metro.h"
#include "core/measure/phantom.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/sheet/sheet.h"

/* The input's own faces tell all of the surface. */
static struct refine_input refine_input_of_given(struct run *run, struct refine_faces *faces) {
    *faces = (struct refine_faces){run->faces.count, (const uint32_t(*)[3])run->faces.triangle, run->faces.on_seam};
    return (struct refine_input){.points = run->points.point,
                                 .n = run->points.count,
                                 .faces = faces,
                                 .samples = &run->samples,
                                 .settled = !run->faces.record,
                                 .exact = true};
}

/* dense: the surface that the mesh was made of; NULL or zeroed: none that it is to be fitted to. */
static struct refine_input refine_input_of(struct run *run, const struct surface_faces *dense,
                                           struct refine_faces *faces) {
    if (dense && !dense->face) dense = NULL;
    if (pipeline_is_given(run)) return refine_input_of_given(run, faces);
    if (dense) *faces = (struct refine_faces){dense->count, (const uint32_t(*)[3])dense->face, NULL};
    bool sharp = dense && dense->point;
    return (struct refine_input){.points = sharp ? dense->point : run->points.point,
                                 .normals = sharp ? dense->normal : pipeline_normals_told(run),
                                 .n = sharp ? dense->n : run->points.count,
                                 .spacing = sharp ? dense->spacing : run->neighbours.spacing,
                                 .neighbours = &run->neighbours,
                                 .creases = &run->creases,
                                 .viewed = run->viewed && run->surface.form == SURFACE_OPEN,
                                 .view = run->view,
                                 .local_delaunay = &run->local_delaunay,
                                 .samples = &run->samples,
                                 .faces = dense ? faces : NULL,
                                 .settled = dense,
                                 .smoothed = run->moved != NULL,
                                 .sharp = sharp};
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
    struct refine_input input = refine_input_of(run, NULL, &faces);
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

/* Where a height field faces: up, or down where it was seen from there, or its normals say so. */
static vec3 front_of_field(const struct run *run, const struct mesh *mesh) {
    vec3 sum = {0, 0, 0};
    for (size_t t = 0; t < mesh->triangle_count; t++) sum = vec3_add(sum, mesh_triangle_normal(mesh, t));
    return vec3_scale(run->surface.up, vec3_dot(sum, run->surface.up) < 0 ? -1 : 1);
}

/* Places where faces meet are listed behind the points, and are none of the input's. */
static void forget_places_beside(const struct surface_faces *dense, size_t points, struct mesh *mesh) {
    for (size_t v = 0; dense && dense->point && mesh->source && v < mesh->vertex_count; v++)
        if (mesh->source[v] != NONE && mesh->source[v] >= points) mesh->source[v] = NONE;
}

static enum status refine_by(struct run *run, const struct refine_input *given, enum placement placement,
                             struct refine_part part, struct mesh *mesh) {
    struct refine_input input = *given;
    if (run->surface.form == SURFACE_HEIGHTFIELD) input.up = front_of_field(run, mesh);
    struct refine_options options = {(enum refine_form)run->params->refine, placement, run->threads};
    struct progress progress = {tick_part, &part};
    enum status status = refine_mesh(mesh, &input, &options, &progress, NULL);
    struct reconstruct_dense points = pipeline_dense_of(run, &run->sites);
    if (!status && run->surface.form == SURFACE_OPEN) status = sheet_trim(mesh, &points, run->viewed, run->threads);
    if (!status && run->surface.form == SURFACE_HEIGHTFIELD && run->landscape)
        status = sheet_trim_walls(mesh, &points, run->surface.up, run->threads);
    return status;
}

/* Points that lie anywhere on a body are its surface; triangles between them cut off what is round, and edges.  So free
 * vertices are fitted to the points alone, but along sharp creases where there are few points for each: these would
 * leave their places for what is nearer to a point or two. */
static void trust_points(const struct run *run, struct refine_input *input) {
    enum { ENOUGH = 3 /* points for each vertex */ };
    bool alone = !run->sharpened || run->points.count >= ENOUGH * run->kept_count;
    input->anywhere = true;
    input->samples = NULL; /* those that there are weigh otherwise */
    if (alone) input->neighbours = NULL, input->faces = NULL;
}

static enum status refine_as(struct run *run, enum placement placement, const struct surface_faces *dense,
                             struct refine_part part, struct mesh *mesh) {
    struct refine_faces faces;
    struct refine_input input = refine_input_of(run, dense, &faces);
    if (run->anywhere && placement == PLACEMENT_OPTIMAL) trust_points(run, &input);
    enum status status = refine_by(run, &input, placement, part, mesh);
    if (!status) forget_places_beside(dense, run->points.count, mesh);
    return status;
}

/* Vertices move freely, and nothing but the points themselves counts. */
static enum status refine_by_points(struct run *run, struct refine_part part, struct mesh *mesh) {
    struct refine_faces faces;
    struct refine_input input = refine_input_of(run, NULL, &faces);
    input.neighbours = NULL;
    return refine_by(run, &input, PLACEMENT_OPTIMAL, part, mesh);
}

static void swap_meshes(struct mesh *a, struct mesh *b) {
    struct mesh before = *a;
    *a = *b, *b = before;
}

static void take_at_points(struct run *run, struct mesh *at_points) {
    swap_meshes(&run->mesh, at_points);
    left_out_add(&run->report.left_out, "mesh",
                 LEFT_OUT_NOTE
                 "placement=optimal: vertices stay at points, as that mesh is nearer to them or has fewer holes");
}

/* ------------------------------------------------------------------------------------------------ with borders */

/* How far the points are from a mesh, and it from what they tell of the surface, as pipeline_measure reports. */
static enum status find_errors(const struct run *run, const struct mesh *mesh, struct metro_errors *errors) {
    enum { SAMPLES = 20000 };
    struct metro_reference reference = pipeline_reference(run);
    struct metro_options options = {.samples = SAMPLES, .seed = run->params->seed, .threads = run->threads};
    return metro_measure(mesh, &reference, &options, errors);
}

/* Never farther from the points, nor by more than samples may err in both directions together. */
static bool is_nearer(const struct metro_errors *errors, const struct metro_errors *than) {
    static const double SLACK = 1.05;
    double both = errors->forward.mean + errors->backward.mean;
    return errors->forward.mean <= than->forward.mean && both <= SLACK * (than->forward.mean + than->backward.mean);
}

/* Whether a mesh has far longer borders than another one, since triangles that had left the points were trimmed. */
static enum status is_torn(const struct mesh *mesh, const struct mesh *than, bool *torn) {
    static const double FAR_LONGER = 1.2;
    struct mesh_facts facts, other;
    enum status status = mesh_examine(mesh, &facts);
    if (!status) status = mesh_examine(than, &other);
    *torn = !status && facts.border_length > FAR_LONGER * other.border_length;
    return status;
}

/* Whether a mesh with free vertices is nearer than *errors of one at points, and as whole. */
static enum status is_worth_it(const struct run *run, const struct mesh *free_mesh, const struct mesh *at_points,
                               const struct metro_errors *errors, bool *worth) {
    struct metro_errors free_errors;
    bool torn = true;
    *worth = false;
    if (free_mesh->triangle_count == 0) return STATUS_OK;
    enum status status = is_torn(free_mesh, at_points, &torn);
    if (status || torn) return status;
    status = find_errors(run, free_mesh, &free_errors);
    *worth = !status && is_nearer(&free_errors, errors);
    return status;
}

/* Takes the vertices' free places only where they are nearer than points are, and the mesh stays whole.  Middles of
 * triangles between neighbours lead astray where the points are noisy or lie in steps: from what was fitted at points
 * the vertices are freed once more then, by the points alone. */
static enum status refine_both_ways(struct run *run) {
    static const double AT_POINTS = 0.4, FREELY = 0.4; /* of the time */
    struct metro_errors errors;
    struct mesh at_points = {0}, last = {0};
    bool worth = false;
    enum status status = mesh_copy(&at_points, &run->mesh);
    if (!status)
        status = refine_as(run, PLACEMENT_SUBSET, NULL, (struct refine_part){&run->progress, 0, AT_POINTS}, &at_points);
    if (!status)
        status = refine_as(run, PLACEMENT_OPTIMAL, NULL, (struct refine_part){&run->progress, AT_POINTS, FREELY},
                           &run->mesh);
    bool there = at_points.triangle_count > 0;
    if (!status && there) status = find_errors(run, &at_points, &errors);
    if (!status && there) status = is_worth_it(run, &run->mesh, &at_points, &errors, &worth);
    if (!status && there && !worth) {
        status = mesh_copy(&last, &at_points);
        if (!status)
            status = refine_by_points(
                run, (struct refine_part){&run->progress, AT_POINTS + FREELY, 1 - AT_POINTS - FREELY}, &last);
        if (!status) status = is_worth_it(run, &last, &at_points, &errors, &worth);
        if (!status && worth) swap_meshes(&run->mesh, &last);
        if (!status && !worth) take_at_points(run, &at_points);
    }
    mesh_done(&at_points), mesh_done(&last);
    return status;
}

/* ------------------------------------------------------------------------------------------------ closed */

/* Two meshes of the same points beside each other. */
struct beside {
    struct points_off points[2];
    struct phantom_depth astray[2];
};

static enum status put_beside(const struct run *run, const struct mesh *mesh, const struct mesh *other,
                              struct beside *beside) {
    const struct mesh *both[2] = {mesh, other};
    const struct metro_reference reference = pipeline_reference(run);
    const struct metro_options options = {.seed = run->params->seed, .threads = run->threads};
    enum status status = STATUS_OK;
    for (int i = 0; i < 2 && !status; i++) {
        status = pipeline_points_off(run, both[i], POINTS_OFF_MOST, &beside->points[i]);
        if (!status) status = phantom_depth(both[i], both[1 - i], &reference, &options, &beside->astray[i]);
    }
    return status;
}

static const double ROUNDING = 1e-7; /* of the diagonal: coordinates of files are no better */

/* In both directions together, as root mean square; places that are far off are most of it. */
static double rms_beside(const struct beside *beside, int i) {
    double points = beside->points[i].rms_by_area, astray = beside->astray[i].rms;
    return sqrt(points * points + astray * astray);
}

/* The same as mean, which is what is reported: as much of it may be in how little all other places are off. */
static double mean_beside(const struct beside *beside, int i) {
    return beside->points[i].mean_by_area + beside->astray[i].mean;
}

/* Whether the first is no farther off than the second, but for a share of that. */
static bool is_as_near(const struct beside *beside, double slack) {
    return rms_beside(beside, 0) <= (1 + slack) * rms_beside(beside, 1) + ROUNDING;
}

/* The same, but for what points of this spacing can't tell either: how much of an edge is cut off between them. */
static bool is_as_near_as_told(const struct beside *beside, double slack) {
    static const double TOLD = 0.01; /* of the spacing, as root mean square */
    double untold = TOLD * beside->points[1].spacing, second = (1 + slack) * rms_beside(beside, 1);
    return rms_beside(beside, 0) <= sqrt(second * second + untold * untold) + ROUNDING;
}

static bool is_nearer_in_mean(const struct beside *beside, double share) {
    return mean_beside(beside, 0) <= (1 - share) * mean_beside(beside, 1) + ROUNDING;
}

/* Whether the first is nearer by at least a share of how far the second is off, in the mean as well. */
static bool is_nearer_in_both(const struct beside *beside, double share) {
    return is_as_near(beside, -share) && is_nearer_in_mean(beside, share);
}

/* The closed mesh of the kept points, fitted both ways, each when it is first needed. */
struct of_kept {
    struct mesh at_points, free; /* without triangles: not yet */
    struct mesh contested; /* of a dense surface, fitted, that at_points contradicts; without triangles: none was */
    size_t contested_from; /* points that it is of */
    double done;           /* of the step, as far as progress tells */
};

/* What is fitted next has half of the time that is left. */
static struct refine_part next_part(const struct run *run, struct of_kept *kept) {
    double before = kept->done, share = (1 - before) / 2;
    kept->done += share;
    return (struct refine_part){&run->progress, before, share};
}

static enum status fit_kept(struct run *run, enum placement placement, struct of_kept *kept) {
    struct mesh *fitted = placement == PLACEMENT_SUBSET ? &kept->at_points : &kept->free;
    if (fitted->triangle_count) return STATUS_OK;
    enum status status = mesh_copy(fitted, run->aside.mesh.triangle_count ? &run->aside.mesh : &run->mesh);
    return status ? status : refine_as(run, placement, NULL, next_part(run, kept), fitted);
}

/* Whether two meshes contradict each other where no points tell which of them is right, as on a flat side that has
 * points along its edges alone: both are astray by much more than the points are off the second, and by some share of
 * how far apart these are, as the points are ever less off the more of them are kept. */
static bool is_contested(const struct beside *beside) {
    static const double MUCH = 3.3, SHARE = 0.05;
    double astray = fmin(beside->astray[0].rms, beside->astray[1].rms);
    return astray > MUCH * beside->points[1].rms_by_area && astray > SHARE * beside->points[1].spacing;
}

/* Of meshes that contradict each other one of the kept points may be as wrong as a dense one: where another one, of far
 * fewer points, tells the same as the dense one, that is two against one.  *taken: run->mesh becomes the earlier one.
 */
static enum status take_contested(struct run *run, struct of_kept *kept, bool *taken) {
    static const double FAR_FEWER = 0.75;
    size_t *from = &run->report.level[run->level].reconstructed_from;
    struct beside beside;
    if (!kept->contested.triangle_count) {
        kept->contested_from = *from;
        return mesh_copy(&kept->contested, &run->mesh);
    }
    if ((double)*from > FAR_FEWER * (double)kept->contested_from) return STATUS_OK;
    enum status status = put_beside(run, &kept->contested, &run->mesh, &beside);
    if (status || is_contested(&beside)) return status;
    swap_meshes(&run->mesh, &kept->contested);
    *from = kept->contested_from;
    *taken = true;
    return STATUS_OK;
}

/* Whether the fitted mesh of a dense surface, run->mesh, is to be taken. */
static enum status judge_dense(struct run *run, struct of_kept *kept, bool *taken) {
    static const double SLACK = 0.05; /* what the points can't tell where they are few */
    struct beside beside;
    enum status status = fit_kept(run, PLACEMENT_SUBSET, kept);
    if (!status) status = put_beside(run, &run->mesh, &kept->at_points, &beside);
    if (status || !is_as_near_as_told(&beside, 0) || !is_nearer_in_mean(&beside, 0)) return status;
    if (is_contested(&beside)) return take_contested(run, kept, taken);
    *taken = beside.astray[0].rms <= beside.astray[1].rms;
    if (*taken) return STATUS_OK;
    status = fit_kept(run, PLACEMENT_OPTIMAL, kept);
    if (!status) status = put_beside(run, &run->mesh, &kept->free, &beside);
    *taken = !status && is_as_near_as_told(&beside, SLACK);
    return status;
}

/* The mesh of the kept points, where no dense surface is taken.  Its free vertices are fitted to the points that judge
 * it here, and the fewer there are for each vertex the better it looks to them: it has to be nearer by more than that.
 */
static enum status take_kept(struct run *run, struct of_kept *kept) {
    static const double FLATTERY = 0.05; /* up to .04 with two points for each vertex */
    struct beside beside;
    enum status status = fit_kept(run, PLACEMENT_OPTIMAL, kept);
    if (!status) status = fit_kept(run, PLACEMENT_SUBSET, kept);
    if (!status) status = put_beside(run, &kept->free, &kept->at_points, &beside);
    if (status) return status;
    if (is_nearer_in_both(&beside, FLATTERY))
        swap_meshes(&run->mesh, &kept->free);
    else
        take_at_points(run, &kept->at_points);
    return STATUS_OK;
}

static enum status try_next_dense(struct run *run, struct of_kept *kept) {
    struct progress whole = run->progress;
    struct refine_part part = next_part(run, kept);
    part.whole = &whole;
    run->progress = (struct progress){tick_part, &part};
    pipeline_put_back(run);
    enum status status = pipeline_densify(run);
    run->progress = whole;
    return status;
}

static enum status refine_closed(struct run *run) {
    struct of_kept kept = {0};
    bool taken = false;
    enum status status = STATUS_OK;
    while (run->aside.mesh.triangle_count && !taken && !status) {
        status = refine_as(run, PLACEMENT_OPTIMAL, &run->fitted_to, next_part(run, &kept), &run->mesh);
        if (!status) status = judge_dense(run, &kept, &taken);
        if (!status && !taken) status = try_next_dense(run, &kept);
    }
    if (!status && !taken) status = take_kept(run, &kept);
    mesh_done(&kept.at_points), mesh_done(&kept.free), mesh_done(&kept.contested);
    return status;
}

enum status pipeline_refine(struct run *run) {
    enum placement placement = run->record ? PLACEMENT_SUBSET : run->placement;
    bool open = run->surface.form == SURFACE_OPEN || run->surface.form == SURFACE_HEIGHTFIELD;
    bool doubtful = placement == PLACEMENT_OPTIMAL && run->params->refine == REFINE_FULL;
    enum status status;
    if (doubtful && open)
        status = refine_both_ways(run);
    else if (doubtful && run->surface.form == SURFACE_CLOSED)
        status = refine_closed(run);
    else
        status = refine_as(run, placement, &run->fitted_to, (struct refine_part){&run->progress, 0, 1}, &run->mesh);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "refine") : status;
}
