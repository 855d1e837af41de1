/* Steps 12 and 13: what the mesh is, and how far it is from the input.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/measure/metro.h"
#include "core/measure/support.h"
#include "core/mesh/intersect.h"
#include "core/pipeline/pipeline_run.h"
#include "core/spatial/bvh.h"

/* Which of the faces make the surface, in their order: those with an area, each once.  What lies in many layers at one
 * place is as near to everything, so that telling it apart would take forever, and isn't more surface. */
static enum status pick_faces(struct run *run, struct mesh *surface) {
    size_t n = run->cloud->triangle_count, flat, repeated;
    uint8_t *left_out = alloc_zeroed(n, sizeof *left_out);
    surface->triangle = alloc_array(n, sizeof *surface->triangle);
    enum status status = STATUS_NO_MEMORY;
    if (left_out && surface->triangle)
        status = faces_sort_out(run->cloud, &run->points, false, run->threads, left_out, &flat, &repeated);
    if (!status) {
        for (size_t t = 0; t < n; t++)
            if (!left_out[t])
                memcpy(surface->triangle[surface->triangle_count++], run->cloud->triangle[t],
                       sizeof *surface->triangle);
        if (flat)
            left_out_add(&run->report.left_out, "input",
                         LEFT_OUT_NOTE "%zu faces without area are no part of the surface", flat);
        if (repeated)
            left_out_add(&run->report.left_out, "input", LEFT_OUT_NOTE "%zu faces are there already, and count once",
                         repeated);
    }
    free(left_out);
    return status;
}

/* The input's own faces in the normalised frame. */
static enum status faces_of(struct run *run, struct mesh *surface) {
    size_t n = run->cloud->count;
    surface->vertex = alloc_array(n, sizeof *surface->vertex);
    if (!surface->vertex) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i++)
        surface->vertex[i] = vec3_scale(vec3_sub(run->cloud->position[i], run->points.centre), 1 / run->points.scale);
    surface->vertex_count = n;
    return pick_faces(run, surface);
}

/* Visits of a hierarchy's nodes for each sample, from which on the input's faces are no reference.  Scans take 10
 * to 45.
 */
enum { MOST_VISITS = 120 };

static enum reference_form reference_of(const struct run *run) {
    enum reference_form asked = (enum reference_form)run->params->reference;
    if (asked != REFERENCE_AUTO) return asked;
    return run->cloud->triangle_count ? REFERENCE_FACES : REFERENCE_POINTS;
}

static void report_errors(struct run *run, const struct metro_errors *errors, enum reference_form form) {
    static const char *const names[] = {"", "points", "faces", "reconstruction"};
    struct report_level *report = &run->report.level[run->level];
    report->has_error = true;
    report->input_to_mesh = errors->forward;
    report->mesh_to_input = errors->backward;
    report->surface_to_mesh = errors->surface;
    pipeline_scale(&report->input_to_mesh, run->points.scale);
    pipeline_scale(&report->mesh_to_input, run->points.scale);
    pipeline_scale(&report->surface_to_mesh, run->points.scale);
    report_set_symmetric(report);
    snprintf(report->reference, sizeof report->reference, "%s", names[form]);
}

static enum status measure_support(struct run *run, const uint32_t *nearest) {
    enum status status = pipeline_neighbours(run);
    if (status) return status;
    struct support_points points = {run->points.point, run->neighbours.spacing, run->knn, nearest};
    return support_missing(&run->mesh, &points, run->params->seed, run->threads,
                           &run->report.level[run->level].unsupported);
}

/* Measures against the surface, or the points alone where it has no faces. */
static enum status measure_against(struct run *run, const struct mesh *surface, enum reference_form form,
                                   uint32_t *nearest) {
    struct metro_errors errors;
    struct metro_reference reference = {run->points.count, run->points.point,
                                        run->normal,       run->neighbours.spacing,
                                        run->knn,          surface->triangle_count ? surface : NULL};
    struct metro_options options = {.seed = run->params->seed,
                                    .threads = run->threads,
                                    .progress = &run->progress,
                                    .nearest = nearest,
                                    .most_visits = form == REFERENCE_FACES ? MOST_VISITS : 0};
    enum status status = metro_measure(&run->mesh, &reference, &options, &errors);
    if (!status) report_errors(run, &errors, form);
    return status;
}

/* The input's faces may be so many at one place, or lie so far across, that most of them are as near as the nearest:
 * then the points are what is measured against, unless the faces were asked for. */
static enum status measure_faces(struct run *run, uint32_t *nearest) {
    struct mesh surface = {0};
    const char *why = "no face of the input has an area";
    bool asked = run->params->reference == REFERENCE_FACES;
    enum status status = faces_of(run, &surface);
    if (!status)
        status = surface.triangle_count ? measure_against(run, &surface, REFERENCE_FACES, nearest) : STATUS_LIMIT;
    if (surface.triangle_count) why = "so many of the input's faces are equally near that measuring takes too long";
    mesh_done(&surface);
    if (status != STATUS_LIMIT) return status;
    if (asked) return error_set(run->error, STATUS_BAD_PARAMETER, "reference", "%s: take reference=points", why);
    left_out_add(&run->report.left_out, "measure", LEFT_OUT_NOTE "%s: errors are measured against its points", why);
    status = pipeline_turn_to_points(run);
    return status ? status : measure_against(run, &surface, REFERENCE_POINTS, nearest);
}

static enum status measure_reconstruction(struct run *run, uint32_t *nearest) {
    struct mesh surface = {0};
    enum status status = pipeline_reconstruct_all(run, &surface);
    if (!status) status = measure_against(run, &surface, REFERENCE_RECONSTRUCTION, nearest);
    mesh_done(&surface);
    return status;
}

/* The points that were dropped, in the frame and the order of the input.  New; NULL without memory. */
static vec3 *list_dropped(const struct run *run) {
    size_t count = 0;
    vec3 *point = alloc_array(run->report.points_outliers, sizeof *point);
    for (size_t j = 0; point && j < run->cloud->count; j++)
        if (run->points.distinct[j] == NONE) point[count++] = pipeline_in_frame(run, run->cloud->position[j]);
    return point;
}

/* How far off the dropped points are, which nothing else that is measured tells. */
static enum status measure_dropped(struct run *run) {
    struct distance_stats *stats = &run->report.level[run->level].dropped;
    struct metro_options options = {.threads = run->threads};
    if (!run->report.points_outliers) return STATUS_OK;
    vec3 *point = list_dropped(run);
    if (!point) return STATUS_NO_MEMORY;
    enum status status = metro_points(point, run->report.points_outliers, &run->mesh, &options, stats);
    if (!status) pipeline_scale(stats, run->points.scale);
    free(point);
    return status;
}

enum status pipeline_measure(struct run *run) {
    enum reference_form form = reference_of(run);
    const struct mesh none = {0};
    if (form == REFERENCE_FACES && !run->cloud->triangle_count)
        return error_set(run->error, STATUS_BAD_PARAMETER, "reference", "faces: the input has no faces");
    uint32_t *nearest = alloc_array(run->points.count, sizeof *nearest);
    enum status status = !nearest                           ? STATUS_NO_MEMORY
                         : form == REFERENCE_FACES          ? measure_faces(run, nearest)
                         : form == REFERENCE_RECONSTRUCTION ? measure_reconstruction(run, nearest)
                                                            : measure_against(run, &none, form, nearest);
    if (!status) status = measure_support(run, nearest);
    if (!status) status = measure_dropped(run);
    free(nearest);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "measure") : status;
}

static enum status prepare_points(struct run *run) {
    enum status status = pipeline_order(run);
    if (!status) status = pipeline_neighbours(run);
    return status ? status : pipeline_normals(run);
}

enum status pipeline_measure_mesh(const struct cloud *cloud, const struct mesh *mesh,
                                  const struct metro_options *options, struct metro_errors *errors,
                                  struct error *error) {
    struct params params;
    params_defaults(&params);
    params.denoise = DENOISE_NONE;
    struct run run = {
        .cloud = cloud, .params = &params, .error = error, .threads = options->threads, .mesh_follows = true};
    struct mesh framed = *mesh;
    framed.vertex = alloc_array(mesh->vertex_count, sizeof *framed.vertex);
    enum status status = framed.vertex ? prepare_points(&run) : STATUS_NO_MEMORY;
    if (!status) {
        for (size_t v = 0; v < mesh->vertex_count; v++) framed.vertex[v] = pipeline_in_frame(&run, mesh->vertex[v]);
        struct metro_reference reference = {run.points.count,       run.points.point, run.normal,
                                            run.neighbours.spacing, run.knn,          NULL};
        status = metro_measure(&framed, &reference, options, errors);
    }
    if (!status) {
        pipeline_scale(&errors->forward, run.points.scale);
        pipeline_scale(&errors->backward, run.points.scale);
        errors->hausdorff *= run.points.scale;
    }
    free(framed.vertex), free(run.normal);
    neighbourhood_done(&run.neighbours);
    knn_free(run.knn);
    ordered_points_done(&run.points);
    return status;
}

enum status pipeline_examine(struct run *run) {
    struct mesh_facts facts;
    size_t crossing = 0;
    struct mesh joined = run->mesh;
    enum status status = run->record ? pipeline_join_seams(run, &joined) : STATUS_OK;
    if (!status) status = mesh_examine(&joined, &facts);
    if (run->record) free(joined.triangle);
    if (!status) status = mesh_count_intersections(&run->mesh, run->threads, &crossing);
    if (status) return status;
    struct report_level *report = &run->report.level[run->level];
    double scale = run->points.scale;
    report->has_mesh = true;
    report->vertices = run->mesh.vertex_count;
    report->triangles = run->mesh.triangle_count;
    for (size_t t = 0; run->mesh.tag && t < run->mesh.triangle_count; t++)
        report->hole_fill_triangles += run->mesh.tag[t] == MESH_HOLE_FILL;
    report->components = facts.components;
    report->watertight = facts.watertight;
    report->manifold = facts.manifold;
    report->oriented = facts.misoriented_edges == 0;
    report->borders = facts.borders;
    report->self_intersections = crossing;
    report->border_length = facts.border_length * scale;
    if (facts.manifold && facts.misoriented_edges == 0)
        report->handles = (uint64_t)((2 * (long)facts.components - facts.euler - (long)facts.borders) / 2);
    report->area = facts.area * scale * scale;
    report->volume = facts.watertight ? facts.volume * scale * scale * scale : NAN;
    return STATUS_OK;
}

/* Chunks of queries, so that the hits of all points need not be held at once. */
enum { DISTANCE_CHUNK = 1 << 16 };

/* hit: scratch of DISTANCE_CHUNK. */
static void find_distances(const struct bvh *bvh, const vec3 *point, size_t n, unsigned threads, struct bvh_hit *hit,
                           float *distance) {
    for (size_t begin = 0; begin < n; begin += DISTANCE_CHUNK) {
        size_t m = n - begin < DISTANCE_CHUNK ? n - begin : DISTANCE_CHUNK;
        bvh_closest_all(bvh, &point[begin], m, threads, hit);
        for (size_t i = 0; i < m; i++) distance[begin + i] = (float)sqrt(hit[i].distance_sq);
    }
}

static enum status find_distances_of_dropped(struct run *run, const struct bvh *bvh, struct bvh_hit *hit) {
    size_t n = run->report.points_outliers;
    if (!n) return STATUS_OK;
    vec3 *point = list_dropped(run);
    run->of_dropped = alloc_array(n, sizeof *run->of_dropped);
    bool ok = point && run->of_dropped;
    if (ok) find_distances(bvh, point, n, run->threads, hit, run->of_dropped);
    free(point);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status pipeline_distances(struct run *run) {
    struct bvh *bvh = NULL;
    size_t n = run->points.count;
    if (run->level > 0) return STATUS_OK; /* the finest alone */
    struct bvh_hit *hit = alloc_array(DISTANCE_CHUNK, sizeof *hit);
    run->distance = alloc_array(n, sizeof *run->distance);
    enum status status = hit && run->distance ? bvh_new(&run->mesh, run->threads, &bvh) : STATUS_NO_MEMORY;
    if (!status) find_distances(bvh, run->points.point, n, run->threads, hit, run->distance);
    if (!status) status = find_distances_of_dropped(run, bvh, hit);
    bvh_free(bvh);
    free(hit);
    return status ? pipeline_no_memory(run, "distances") : STATUS_OK;
}
