/* Surfaces with borders, and height fields, that are made of more points than are kept, and collapsed to as many.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>

#include "core/mesh/components.h"
#include "core/mesh/decimate.h"
#include "core/pipeline/decide.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/reconstruct.h"
#include "core/surface/sheet/scan_lines.h"
#include "core/surface/sheet/sheet.h"

enum { DENSER = 4, DENSER_IN_PLANE = 10 };

void pipeline_many_done(struct many *many) {
    tets_done(&many->tets);
    pipeline_sites_done(&many->sites);
    *many = (struct many){0};
}

enum status pipeline_triangulate_many(const struct run *run, size_t k, struct many *many) {
    struct error ignored = {0};
    many->k = k;
    enum status status = pipeline_sites_of(run, k, &many->sites);
    if (status) return status;
    return delaunay_build_within(many->sites.point, k, pipeline_tetrahedra_allowed(run, false, run->params),
                                 run->threads, &run->progress, &many->tets, &ignored);
}

/* How many points a surface with borders is reconstructed from before it is simplified: so many times as many as are
 * kept, or those kept where it isn't.  Tetrahedra take memory; triangles in a plane are two for each point.  But
 * between rings of a turning scanner more points make more pieces, which have no vertices to spare. */
static enum status count_denser(const struct run *run, size_t times, size_t *k) {
    bool viewed = run->viewed && !sheet_is_in_rings(&run->neighbours, run->points.point);
    bool in_plane = run->surface.form == SURFACE_HEIGHTFIELD || viewed;
    size_t n = run->points.count, most = memory_usual_points(n, run->kept_count), many = run->kept_count * times;
    bool asked = run->params->order == ORDER_RECONSTRUCT_FIRST, spaced = !isnan(run->params->spacing);
    *k = run->kept_count;
    if (!in_plane && many > most) many = most;
    if (many > n) many = n;
    if (run->params->order == ORDER_SIMPLIFY_FIRST || (spaced && !asked) || many <= run->kept_count) return STATUS_OK;
    bool curves; /* whose points don't tell what is between them, however many they are */
    enum status status = scan_lines_are_curves(&run->neighbours, run->points.point, run->threads, &curves);
    if (!status && (!curves || asked)) *k = many;
    return status;
}

/* What is a surface in a plane, or of the directions from one place, is cheap to make. */
static enum status count_dense(const struct run *run, size_t *k) {
    bool in_plane = run->surface.form == SURFACE_HEIGHTFIELD || run->viewed;
    return count_denser(run, in_plane ? DENSER_IN_PLANE : DENSER, k);
}

enum status pipeline_is_left_out(struct run *run, bool *left_out) {
    bool told = false, known = false;
    vec3 place;
    size_t k = 0;
    *left_out = false;
    if (run->surface_alone || run->sites.count < DECIDE_ENOUGH || decide_may_try_field(run) || run->viewed)
        return STATUS_OK;
    enum status status = count_dense(run, &k);
    if (status || k <= run->kept_count) return status;
    status = scan_pattern_told_place(run, &told, &known, &place);
    if (!status && !told) status = pipeline_seek_pattern(run);
    *left_out = !status && !known && run->pattern.places != 1;
    return status;
}

enum status pipeline_triangulate_ahead(struct run *run) {
    struct many *ahead = &run->ahead;
    size_t k;
    enum status status = count_dense(run, &k);
    if (!status) status = pipeline_triangulate_many(run, k, ahead);
    if (status) pipeline_many_done(ahead);
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "delaunay");
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* The surface of run->surface's form through the k most important points. */
static enum status reconstruct_of_many(struct run *run, size_t k, struct mesh *mesh, struct reconstruct_facts *facts) {
    struct many many = {0};
    enum surface_form form = run->surface.form;
    bool by_tets = form == SURFACE_OPEN && !run->viewed;
    enum status status = STATUS_OK;
    if (by_tets && run->ahead.k == k)
        many = run->ahead, run->ahead = (struct many){0};
    else
        status = by_tets ? pipeline_triangulate_many(run, k, &many) : pipeline_sites_of(run, k, &many.sites);
    if (!status) status = pipeline_reconstruct_as(run, form, &many.sites, &many.tets, mesh, facts);
    pipeline_many_done(&many);
    return status;
}

/* Whether a mesh is in so many pieces that there is hardly a vertex to choose among those kept, as each piece has a
 * triangle at least. */
static enum status is_crowded(const struct run *run, const struct mesh *mesh, bool *crowded) {
    static const double NEARLY_ALL = 0.75;
    size_t components;
    enum status status = components_count(mesh, &components);
    *crowded = !status && 3 * (double)components > NEARLY_ALL * (double)run->kept_count;
    return status;
}

/* The surface through the *k most important points, its edges collapsed until as many vertices are left as are kept;
 * through fewer points, *k, where that would be of pieces. */
static enum status reconstruct_denser(struct run *run, size_t *k, struct mesh *mesh, struct reconstruct_facts *facts) {
    bool viewed = run->surface.form == SURFACE_OPEN && run->viewed, crowded = false;
    size_t fewer = *k;
    enum status status = reconstruct_of_many(run, *k, mesh, facts);
    if (!status && viewed) status = is_crowded(run, mesh, &crowded);
    if (!status && crowded) status = count_denser(run, DENSER, &fewer);
    if (!status && fewer < *k) {
        *k = fewer;
        mesh_done(mesh);
        status = reconstruct_of_many(run, fewer, mesh, facts);
    }
    struct decimate_rules rules = {.borders = true, .viewed = viewed, .view = run->view, .threads = run->threads};
    return status ? status : mesh_decimate(mesh, &rules, run->kept_count);
}

/* Whether a mesh of many points goes through all of them better than run->mesh.  Only that of a height field may not,
 * where points lie over each other on walls: then *choice is a surface with borders, unless a height field was asked
 * for or made for another level. */
static enum status is_better(const struct run *run, const struct mesh *mesh, bool *better,
                             struct surface_choice *choice) {
    struct surface_match few, many;
    bool judges = run->params->surface == SURFACE_AUTO && run->level == 0 && !run->field_tried;
    *better = mesh->triangle_count > 0;
    if (!*better || run->surface.form != SURFACE_HEIGHTFIELD) return STATUS_OK;
    enum status status = pipeline_match(run, &run->mesh, &few);
    if (!status) status = pipeline_match(run, mesh, &many);
    if (!status) *better = many.distance <= few.distance;
    if (!status && judges) (void)surface_leave_walls(&run->signs, &few, &many, choice);
    return status;
}

/* run->mesh, a height field, becomes the surface with borders of the sites, if they have one that is nearer: of few
 * points among crowns and walls both are far off, and a field is whole. */
static enum status leave_field(struct run *run, const struct surface_choice *choice, struct reconstruct_facts *facts) {
    struct tets tets = {0};
    struct mesh open = {0};
    struct reconstruct_facts found = {0};
    struct error ignored = {0};
    struct report_surface told = run->report.surface; /* of the height field */
    enum status status =
        delaunay_build_within(run->sites.point, run->sites.count, pipeline_tetrahedra_allowed(run, false, run->params),
                              run->threads, &run->progress, &tets, &ignored);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, &run->sites, &tets, &open, &found);
    tets_done(&tets);
    struct surface_match of_field = {0}, of_open = {0};
    bool there = open.triangle_count > 0;
    if (!status && there) status = pipeline_match(run, &run->mesh, &of_field);
    if (!status && there) status = pipeline_match(run, &open, &of_open);
    if (!status && there && of_open.distance < of_field.distance) {
        struct mesh before = run->mesh;
        run->mesh = open, open = before;
        *facts = found;
        pipeline_decide(run, *choice);
        run->report.level[run->level].reconstructed_from = run->sites.count;
        status = pipeline_count_vertices(run, &run->mesh, facts);
    } else {
        run->report.surface = told;
    }
    mesh_done(&open);
    return status;
}

enum status pipeline_reconstruct_first(struct run *run, struct reconstruct_facts *facts) {
    struct reconstruct_facts found = {0};
    struct mesh mesh = {0};
    struct surface_choice choice = run->surface;
    bool better = false;
    size_t k;
    enum status status = count_dense(run, &k);
    if (status || k == run->kept_count) return status;
    status = reconstruct_denser(run, &k, &mesh, &found);
    if (!status) status = is_better(run, &mesh, &better, &choice);
    if (!status && better) {
        struct mesh before = run->mesh;
        run->mesh = mesh, mesh = before;
        *facts = found;
        status = pipeline_count_vertices(run, &run->mesh, facts);
        run->report.level[run->level].reconstructed_from = k;
    }
    mesh_done(&mesh);
    if (!status && choice.form != run->surface.form) status = leave_field(run, &choice, facts);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

enum status pipeline_reconstruct_seen(struct run *run, struct reconstruct_facts *facts) {
    size_t k;
    enum status status = count_dense(run, &k);
    if (!status) status = reconstruct_denser(run, &k, &run->mesh, facts);
    if (!status) status = pipeline_count_vertices(run, &run->mesh, facts);
    run->report.level[run->level].reconstructed_from = k;
    return status;
}
