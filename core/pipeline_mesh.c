/* Steps 9 to 13: from the kept points to a mesh and its error.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/bvh.h"
#include "core/cocone.h"
#include "core/delaunay_cgal.h"
#include "core/metro.h"
#include "core/pipeline_run.h"
#include "core/refine.h"
#include "core/sym3.h"

/* The points that stand for themselves, and the index of each among them. */
static void number_sites(const struct run *run, struct sites *sites, uint32_t *index) {
    uint32_t i = 0;
    for (uint32_t p = 0; p < run->points.count; p++) {
        if (sites->of_point[p] != p) continue;
        sites->id[i] = p;
        sites->point[i] = run->points.point[p];
        sites->normal[i] = run->normal[p];
        sites->support[i] = 0;
        index[p] = i++;
    }
}

/* support = max over the points that a site stands for of the distance to it + the spacing there. */
static void find_support(const struct run *run, const uint32_t *index, struct sites *sites) {
    for (size_t x = 0; x < run->points.count; x++) {
        uint32_t i = sites->of_point[x] = index[sites->of_point[x]];
        double reach = vec3_distance(run->points.point[x], sites->point[i]) + (double)run->hood.spacing[x];
        sites->support[i] = fmax(sites->support[i], reach);
    }
}

/* The k most important points as sites. */
static enum status sites_of(const struct run *run, size_t k, struct sites *sites) {
    *sites = (struct sites){.count = k};
    uint32_t *index = alloc_array(run->points.count, sizeof *index);
    sites->id = alloc_array(k, sizeof *sites->id);
    sites->point = alloc_array(k, sizeof *sites->point);
    sites->normal = alloc_array(k, sizeof *sites->normal);
    sites->support = alloc_array(k, sizeof *sites->support);
    sites->of_point = alloc_array(run->points.count, sizeof *sites->of_point);
    bool ok = index && sites->id && sites->point && sites->normal && sites->support && sites->of_point;
    if (ok) {
        contraction_representatives(&run->contraction, k, sites->of_point);
        number_sites(run, sites, index);
        find_support(run, index, sites);
    }
    free(index);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

/* How many of the sites' principal extents are over FLAT: 0 when they coincide, 3 when they span space.  Rounding of
 * coordinates makes points of a tilted plane leave it by about 1e-7 of the diagonal; no scan has two sides that near.
 */
static const double FLAT = 1e-6;

static int dimension_of(const struct sites *sites) {
    sym3 moment = {0};
    vec3 mean = {0, 0, 0}, axis[3];
    double value[3];
    int dimension = 0;
    for (size_t i = 0; i < sites->count; i++) mean = vec3_add(mean, sites->point[i]);
    mean = vec3_scale(mean, 1 / (double)sites->count);
    for (size_t i = 0; i < sites->count; i++) moment = sym3_add(moment, sym3_outer(vec3_sub(sites->point[i], mean)));
    sym3_eigen(moment, value, axis);
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (size_t i = 0; i < sites->count; i++) {
            double x = vec3_dot(vec3_sub(sites->point[i], mean), axis[k]);
            low = fmin(low, x), high = fmax(high, x);
        }
        dimension += high - low > FLAT;
    }
    return dimension;
}

enum status pipeline_delaunay(struct run *run) {
    static const char *const flat[] = {"coincide in one point", "lie on one line", "lie on one plane"};
    enum status status = sites_of(run, run->kept_count, &run->sites);
    if (status) return pipeline_no_memory(run, "delaunay");
    if (run->sites.count < 4)
        return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                         "a closed mesh takes 4 distinct points; of %zu, %zu of them distinct, there are %zu kept",
                         run->cloud->count, run->points.count, run->sites.count);
    int dimension = dimension_of(&run->sites);
    if (dimension < 3)
        return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                         "all %zu kept points %s: there is no closed mesh of them", run->sites.count, flat[dimension]);
    return delaunay_build(run->sites.point, run->sites.count, run->threads, &run->progress, &run->tets, run->error);
}

/* Tight Cocone over the sites; the mesh's sources become ids along the curve. */
static enum status reconstruct(const struct run *run, const struct sites *sites, const struct tets *tets,
                               struct mesh *mesh, struct cocone_facts *facts) {
    struct cocone_dense dense = {run->points.count, run->points.point, run->normal,
                                 run->hood.spacing, sites->of_point,   run->knn};
    struct cocone_input input = {sites->point, sites->count, sites->normal, sites->support, &dense};
    struct cocone_options options = {.form = (enum cocone_form)run->params->cocone,
                                     .boundary = (enum boundary_form)run->params->boundary,
                                     .threads = run->threads};
    enum status status = cocone_reconstruct(tets, &input, &options, &run->progress, mesh, facts);
    for (size_t v = 0; !status && v < mesh->vertex_count; v++) mesh->source[v] = sites->id[mesh->source[v]];
    return status;
}

static enum status explain_reconstruction(struct run *run, enum status status) {
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "reconstruct");
    if (status == STATUS_DEGENERATE)
        return error_set(run->error, status, "reconstruct", "no surface could be found through the kept points");
    return status;
}

enum status pipeline_reconstruct(struct run *run) {
    struct cocone_facts facts = {0};
    enum status status = reconstruct(run, &run->sites, &run->tets, &run->mesh, &facts);
    tets_done(&run->tets);
    if (status) return explain_reconstruction(run, status);
    run->report.level[run->level].points_lost = facts.points_lost;
    run->report.level[run->level].vertices_split = facts.vertices_split;
    snprintf(run->report.level[run->level].reconstruction, sizeof run->report.level[run->level].reconstruction, "%s",
             facts.form);
    return STATUS_OK;
}

static struct refine_input refine_input_of(struct run *run) {
    return (struct refine_input){.points = run->points.point,
                                 .normals = run->normal,
                                 .n = run->points.count,
                                 .spacing = run->hood.spacing,
                                 .hood = &run->hood,
                                 .umbrellas = &run->umbrellas,
                                 .samples = &run->samples};
}

/* Whether triangulation and samples take no more memory together than the refinement does after them (memory.c). */
static bool has_room_for_samples(const struct run *run) {
    enum { FEWER = 4 };
    return run->params->placement == PLACEMENT_OPTIMAL || run->kept_count <= run->points.count / FEWER;
}

/* There are about twice as many triangles as points; refine_mesh finds what it hasn't got. */
enum status pipeline_umbrellas(struct run *run) {
    if (!refine_wants_umbrellas(run->points.count, 2 * run->kept_count)) return STATUS_OK;
    enum status status = umbrella_find(run->points.point, run->normal, &run->hood, run->threads, &run->umbrellas);
    if (status || !has_room_for_samples(run)) return status;
    struct refine_input input = refine_input_of(run);
    status = samples_init(&run->samples, &input, 1, run->threads);
    if (run->params->placement == PLACEMENT_SUBSET) umbrella_done(&run->umbrellas);
    return status;
}

enum status pipeline_refine(struct run *run) {
    struct refine_input input = refine_input_of(run);
    struct refine_options options = {(enum refine_form)run->params->refine, (enum placement)run->params->placement,
                                     run->threads};
    enum status status = refine_mesh(&run->mesh, &input, &options, &run->progress, NULL);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "refine") : status;
}

/* The input's own faces in the normalised frame.  Borrows the triangles. */
static enum status faces_of(const struct run *run, struct mesh *surface) {
    size_t n = run->cloud->count;
    surface->vertex = alloc_array(n, sizeof *surface->vertex);
    if (!surface->vertex) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i++)
        surface->vertex[i] = vec3_scale(vec3_sub(run->cloud->position[i], run->points.centre), 1 / run->points.scale);
    surface->vertex_count = n;
    surface->triangle_count = run->cloud->triangle_count;
    surface->triangle = run->cloud->triangle;
    return STATUS_OK;
}

/* Tight Cocone of the full cloud. */
static enum status reconstruction_of(struct run *run, struct mesh *surface) {
    struct sites sites;
    struct tets tets = {0};
    struct cocone_facts facts = {0};
    enum status status = sites_of(run, run->points.count, &sites);
    if (!status) status = delaunay_build(sites.point, sites.count, run->threads, &run->progress, &tets, run->error);
    if (!status) status = reconstruct(run, &sites, &tets, surface, &facts);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return explain_reconstruction(run, status);
}

static enum reference_form reference_of(const struct run *run) {
    enum reference_form asked = (enum reference_form)run->params->reference;
    if (asked != REFERENCE_AUTO) return asked;
    return run->cloud->triangle_count ? REFERENCE_FACES : REFERENCE_POINTS;
}

static void report_errors(struct run *run, const struct metro_errors *errors, enum reference_form form) {
    static const char *const names[] = {"", "points", "faces", "reconstruction"};
    struct report_level *report = &run->report.level[run->level];
    report->has_error = true;
    report->forward = errors->forward;
    report->backward = errors->backward;
    report->surface = errors->surface;
    pipeline_scale(&report->forward, run->points.scale);
    pipeline_scale(&report->backward, run->points.scale);
    pipeline_scale(&report->surface, run->points.scale);
    report->hausdorff = errors->hausdorff * run->points.scale;
    snprintf(report->reference, sizeof report->reference, "%s", names[form]);
}

enum status pipeline_measure(struct run *run) {
    enum reference_form form = reference_of(run);
    struct mesh surface = {0};
    struct metro_errors errors;
    if (form == REFERENCE_FACES && !run->cloud->triangle_count)
        return error_set(run->error, STATUS_BAD_PARAMETER, "reference", "the input has no faces");
    enum status status = STATUS_OK;
    if (form == REFERENCE_FACES) status = faces_of(run, &surface);
    if (form == REFERENCE_RECONSTRUCTION) status = reconstruction_of(run, &surface);
    struct metro_reference reference = {run->points.count, run->points.point, run->normal,
                                        run->hood.spacing, run->knn,          surface.triangle_count ? &surface : NULL};
    struct metro_options options = {.seed = run->params->seed, .threads = run->threads, .progress = &run->progress};
    if (!status) status = metro_measure(&run->mesh, &reference, &options, &errors);
    if (!status) report_errors(run, &errors, form);
    if (form == REFERENCE_FACES) surface.triangle = NULL;
    mesh_done(&surface);
    return status == STATUS_NO_MEMORY ? pipeline_no_memory(run, "measure") : status;
}

enum status pipeline_examine(struct run *run) {
    struct mesh_facts facts;
    enum status status = mesh_examine(&run->mesh, &facts);
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
    report->area = facts.area * scale * scale;
    report->volume = facts.volume * scale * scale * scale;
    return STATUS_OK;
}

/* Chunks of queries, so that the hits of all points need not be held at once. */
enum { DISTANCE_CHUNK = 1 << 16 };

enum status pipeline_distances(struct run *run) {
    struct bvh *bvh = NULL;
    size_t n = run->points.count;
    struct bvh_hit *hit = alloc_array(DISTANCE_CHUNK, sizeof *hit);
    run->distance = alloc_array(n, sizeof *run->distance);
    enum status status = hit && run->distance ? bvh_new(&run->mesh, run->threads, &bvh) : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < n; begin += DISTANCE_CHUNK) {
        size_t m = n - begin < DISTANCE_CHUNK ? n - begin : DISTANCE_CHUNK;
        bvh_closest_all(bvh, &run->points.point[begin], m, run->threads, hit);
        for (size_t i = 0; i < m; i++) run->distance[begin + i] = (float)sqrt(hit[i].distance_sq);
    }
    bvh_free(bvh);
    free(hit);
    return status ? pipeline_no_memory(run, "distances") : STATUS_OK;
}
