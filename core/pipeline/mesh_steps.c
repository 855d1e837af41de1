/* Steps 9 to 11: from the kept points to a mesh.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/pipeline/decide.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/reconstruct.h"
#include "core/surface/sheet/globe.h"
#include "core/surface/sheet/holes.h"
#include "core/surface/sheet/orient.h"
#include "core/surface/sheet/scan_lines.h"
#include "core/surface/sheet/sheet.h"

size_t pipeline_tetrahedra_allowed(const struct run *run, bool of_all, const struct params *params) {
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    return memory_tetrahedra(&job, run->kept_count, of_all, params);
}

/* STATUS_LIMIT becomes STATUS_NO_MEMORY where memory is what there is too little of. */
static enum status explain_tetrahedra(const struct run *run, const struct sites *sites, bool of_all,
                                      enum status status) {
    struct params unlimited = *run->params;
    unlimited.memory_bytes = 0;
    size_t most = pipeline_tetrahedra_allowed(run, of_all, run->params);
    if (status != STATUS_LIMIT || most == pipeline_tetrahedra_allowed(run, of_all, &unlimited)) return status;
    return error_set(run->error, STATUS_NO_MEMORY, "delaunay",
                     "the %zu points of the mesh have more than %zu tetrahedra between them, as points along lines "
                     "have, and %" PRIu64 " MiB have no room for more: allow more memory, keep fewer points (ratio), "
                     "or leave the mesh out (outputs=cloud)",
                     sites->count, most, run->params->memory_bytes >> 20);
}

enum status pipeline_triangulate(const struct run *run, const struct sites *sites, bool of_all, struct tets *tets) {
    enum status status =
        delaunay_build_within(sites->point, sites->count, pipeline_tetrahedra_allowed(run, of_all, run->params),
                              run->threads, &run->progress, tets, run->error);
    return explain_tetrahedra(run, sites, of_all, status);
}

/* Points that lie far denser along lines than these are apart have tetrahedra with all that they see of the next line,
 * the more of them the denser they lie, and what is between the lines isn't known any better for it.  So the mesh goes
 * through the more important half of them, or a half of these, until there are no more than CROWDED for each.  Surfaces
 * and volumes have 7, points at random on a cone 20.  Those of curves stay, for which there is a message. */
enum { CROWDED = 24, HALVINGS = 5 };

static enum status triangulate_sites(struct run *run) {
    struct error crowded = {0};
    size_t kept = run->sites.count, allowed = pipeline_tetrahedra_allowed(run, false, run->params), k = kept;
    bool curves = false;
    enum status status = STATUS_LIMIT;
    if (CROWDED * k >= allowed)
        return pipeline_triangulate(run, &run->sites, false, &run->tets); /* memory is what is short */
    for (int halving = 0; halving <= HALVINGS && k >= 4 && status == STATUS_LIMIT; halving++, k /= 2) {
        if (halving == 1 && scan_lines_are_curves(&run->neighbours, run->points.point, run->threads, &curves))
            return pipeline_no_memory(run, "delaunay");
        if (curves) break;
        if (halving > 0) pipeline_sites_done(&run->sites);
        if (halving > 0 && pipeline_sites_of(run, k, &run->sites)) return pipeline_no_memory(run, "delaunay");
        status =
            delaunay_build_within(run->sites.point, k, CROWDED * k, run->threads, &run->progress, &run->tets, &crowded);
    }
    if (status == STATUS_LIMIT) {
        pipeline_sites_done(&run->sites);
        if (pipeline_sites_of(run, kept, &run->sites)) return pipeline_no_memory(run, "delaunay");
        return pipeline_triangulate(run, &run->sites, false, &run->tets);
    }
    if (status && run->error) *run->error = crowded;
    if (!status && run->sites.count < kept)
        left_out_add(&run->report.left_out, "mesh",
                     "%zu of %zu points as vertices: they lie so much denser along lines than these are apart",
                     kept - run->sites.count, kept);
    return status;
}

/* ------------------------------------------------------------------------------------------------ which side */

void pipeline_see_from_pattern(const struct run *run, struct sheet_sides *sides) {
    const struct scan_pattern *pattern = &run->pattern;
    sides->guessed = pattern->places > 1;
    sides->viewed = pattern->views.is_one, sides->view = pattern->views.one;
    sides->views = pattern->views.each;
}

/* A globe's outside is in front, and a region's on it where no place tells more. */
static enum status see_globe(const struct run *run, struct sheet_sides *sides) {
    bool is = run->pattern.globe;
    vec3 middle = pipeline_in_frame(run, is ? run->pattern.middle : (vec3){0, 0, 0});
    if (sides->viewed || sides->views) return STATUS_OK;
    enum status status = is ? STATUS_OK : globe_is_map(run->points.point, run->points.count, middle, &is);
    if (!status && is) sides->viewed = sides->away = true, sides->view = middle;
    return status;
}

/* The points' normals on the outside of a closed mesh that was left, zero where that isn't known; NULL: no memory. */
static vec3 *outer_normals(const struct run *run) {
    vec3 *normal = alloc_array(run->points.count, sizeof *normal);
    for (size_t i = 0; normal && i < run->points.count; i++) normal[i] = vec3_scale(run->normal[i], run->outside[i]);
    return normal;
}

static enum status orient(struct run *run, bool field, struct mesh *mesh) {
    static const char *const names[] = {[SIDE_NORMALS] = "normals",
                                        [SIDE_VIEW] = "viewpoint",
                                        [SIDE_UP] = "upwards",
                                        [SIDE_SIGHT] = "inwards",
                                        [SIDE_OUT] = "outwards"};
    vec3 *normal = NULL;
    struct sheet_sides sides = {.up = field ? run->surface.up : (vec3){0, 0, 1},
                                .field = field,
                                .room = run->faces_inwards,
                                .inside = run->surface.room,
                                .landscape = surface_is_from_above(&run->signs) || run->surface.volume,
                                .gallery = &run->gallery};
    struct views views = {0};
    enum sheet_side side = SIDE_OUT;
    run->gallery = (struct gallery){0};
    enum status status = pipeline_given_normals(run, &normal);
    if (!status) status = pipeline_views(run, &views);
    if (!status && !field && !normal) status = scan_pattern_check_told(run, &views);
    sides.normal = normal;
    sides.viewed = views.is_one, sides.view = views.one;
    sides.views = views.each;
    bool told = normal || views.is_one || views.each;
    bool sought = run->pattern.views.each || run->pattern.views.is_one;
    bool by_outside = run->outside && !field && !told && !sought;
    if (!status && by_outside) {
        sides.normal = normal = outer_normals(run);
        told = true;
        if (!normal) status = STATUS_NO_MEMORY;
    }
    if (!status && !field && !told) status = pipeline_seek_pattern(run);
    if (!field && !told) pipeline_see_from_pattern(run, &sides);
    if (!status && field && !told) status = scan_pattern_exact_place(run, &sides.viewed, &sides.view);
    if (!status && !told) status = see_globe(run, &sides);
    bool faces = run->viewed && !field && !normal; /* all of it is made to face the one place that is known */
    if (!status && !faces && !field && !(told && run->pattern.hides))
        status = sheet_part_turned(mesh, &sides, run->threads);
    if (!status && !faces) status = sheet_orient(mesh, &sides, run->threads, &side);
    if (faces) side = SIDE_VIEW;
    run->faces_inwards = side == SIDE_SIGHT;
    snprintf(run->report.surface.orientation, sizeof run->report.surface.orientation, "%s",
             side == SIDE_VIEW && sides.away      ? names[SIDE_OUT]
             : side == SIDE_VIEW && !told         ? "scan pattern"
             : side == SIDE_NORMALS && by_outside ? names[SIDE_OUT]
                                                  : names[side]);
    free(normal), free(views.each);
    return status;
}

struct reconstruct_dense pipeline_dense_of(struct run *run, const struct sites *sites) {
    const struct made_points *made = &run->made;
    if (sites->made) {
        made_points_tell(run);
        return (struct reconstruct_dense){run->points.count + made->count,
                                          made->point,
                                          made->normal,
                                          made->spacing,
                                          sites->of_point,
                                          made->knn,
                                          NULL,
                                          &made->creases,
                                          &run->plane};
    }
    return (struct reconstruct_dense){run->points.count,       run->points.point, pipeline_normals_told(run),
                                      run->neighbours.spacing, sites->of_point,   run->knn,
                                      &run->neighbours,        &run->creases,     &run->plane};
}

enum status pipeline_reconstruct_unless(struct run *run, enum surface_form form, const struct sites *sites,
                                        const struct tets *tets, const struct reconstruct_probe *probe,
                                        struct mesh *mesh, struct reconstruct_facts *facts) {
    struct reconstruct_dense dense = pipeline_dense_of(run, sites);
    struct reconstruct_input input = {.points = sites->point,
                                      .n = sites->count,
                                      .normals = sites->normal,
                                      .bars = run->bars,
                                      .oriented = run->normals_fit,
                                      .support = sites->support,
                                      .dense = &dense,
                                      .gaps = run->gaps,
                                      .pieces = run->pieces};
    bool of_all = sites != &run->sites;
    struct reconstruct_options options = {.method = (unsigned)run->params->reconstruction,
                                          .boundary = (enum boundary_form)run->params->boundary,
                                          .threads = run->threads,
                                          .surface = form,
                                          .up = run->surface.up,
                                          .landscape = run->landscape,
                                          .viewed = run->viewed,
                                          .view = run->view,
                                          .probe = probe};
    enum status status = form == SURFACE_CLOSED
                             ? reconstruct_surface(tets, &input, &options, &run->progress, mesh, facts)
                             : reconstruct_sheet(tets, &input, &options, &run->progress, mesh, facts, run->error);
    status = explain_tetrahedra(run, sites, of_all, status);
    for (size_t v = 0; !status && v < mesh->vertex_count; v++) mesh->source[v] = sites->id[mesh->source[v]];
    if (status || (form == SURFACE_OPEN && run->sides_wait)) return status;
    if (form != SURFACE_CLOSED) return orient(run, form == SURFACE_HEIGHTFIELD, mesh);
    snprintf(run->report.surface.orientation, sizeof run->report.surface.orientation, "outwards");
    return status;
}

enum status pipeline_reconstruct_as(struct run *run, enum surface_form form, const struct sites *sites,
                                    const struct tets *tets, struct mesh *mesh, struct reconstruct_facts *facts) {
    return pipeline_reconstruct_unless(run, form, sites, tets, NULL, mesh, facts);
}

enum status pipeline_delaunay(struct run *run) {
    static const char *const flat[] = {"coincide in one point", "lie on one line", "lie on one plane"};
    if (pipeline_is_given(run)) return STATUS_OK;
    enum status status = pipeline_sites_of(run, run->kept_count, &run->sites);
    if (status) return pipeline_no_memory(run, "delaunay");
    status = decide_find_bars(run);
    if (!status && run->decision == UNDECIDED) status = decide_by_points(run);
    if (status == STATUS_DEGENERATE) return status;
    if (status) return pipeline_no_memory(run, "delaunay");
    bool closed = run->decision != DECIDED || run->surface.form == SURFACE_CLOSED;
    if (run->sites.count < 4)
        return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                         "%s mesh needs 4 distinct points; points of the cloud: %zu, distinct: %zu, kept: %zu",
                         closed ? "a closed" : "an open", run->cloud->count, run->points.count, run->sites.count);
    vec3 axis[3];
    bool field = run->decision == DECIDED && run->surface.form == SURFACE_HEIGHTFIELD;
    int dimension = pipeline_dimension_of(run->sites.point, run->sites.count, axis);
    if (dimension < (field ? 2 : 3))
        return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                         "all %zu kept points %s: there is no %s mesh of them%s", run->sites.count, flat[dimension],
                         closed ? "closed" : "open", dimension == 2 ? "; surface=open makes an open one" : "");
    if (field) return STATUS_OK;
    bool left_out = false;
    status = decide_early(run);
    if (!status && run->decision == DECIDED && run->surface.form == SURFACE_OPEN)
        status = pipeline_is_left_out(run, &left_out);
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "delaunay");
    if (status) return status;
    return left_out ? pipeline_triangulate_ahead(run) : triangulate_sites(run);
}

/* A height field, unless its mesh says that it isn't one after all. */
static enum status reconstruct_field(struct run *run, const struct sites *sites, struct mesh *mesh,
                                     struct reconstruct_facts *facts) {
    struct tets tets = {0};
    enum status status = pipeline_reconstruct_as(run, SURFACE_HEIGHTFIELD, sites, NULL, mesh, facts);
    if (!status && !run->field_judged) status = decide_by_field(run, mesh);
    if (status || run->surface.form == SURFACE_HEIGHTFIELD) return status;
    mesh_done(mesh);
    status = pipeline_triangulate(run, sites, sites != &run->sites, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, sites, &tets, mesh, facts);
    tets_done(&tets);
    return status;
}

/* The surface of the kept points that is known to have borders, unless it would be made for nothing: one of more points
 * takes its place, and nothing is asked of it. */
static enum status reconstruct_open(struct run *run, const struct sites *sites, const struct tets *tets,
                                    struct mesh *mesh, struct reconstruct_facts *facts) {
    bool left_out = false;
    enum status status = sites == &run->sites ? pipeline_is_left_out(run, &left_out) : STATUS_OK;
    return status || left_out ? status : pipeline_reconstruct_as(run, SURFACE_OPEN, sites, tets, mesh, facts);
}

static enum status reconstruct_known(struct run *run, const struct sites *sites, const struct tets *tets,
                                     struct mesh *mesh, struct reconstruct_facts *facts) {
    enum surface_form form = run->surface.form;
    if (form == SURFACE_HEIGHTFIELD) return reconstruct_field(run, sites, mesh, facts);
    if (form == SURFACE_OPEN) return reconstruct_open(run, sites, tets, mesh, facts);
    return pipeline_reconstruct_as(run, form, sites, tets, mesh, facts);
}

/* The surface of the sites as it is known to be, or found out to be; of a small cloud always of as many points, so that
 * it is of the same kind however many are kept, and where most of it is thin walls, of all points: fewer are farther
 * apart than those are thick, and what they have is a lid from one side to the other. */
static enum status reconstruct(struct run *run, const struct sites *sites, const struct tets *tets, struct mesh *mesh,
                               struct reconstruct_facts *facts) {
    enum { LEAST = 2000 };
    enum status status = STATUS_OK;
    size_t n = run->points.count;
    if (run->decision != DECIDED && run->neighbours.walls && sites->count < pipeline_wall_points(run))
        status = decide_by_walls(run);
    if (!status && run->decision != DECIDED && decide_are_few(run, sites->count))
        status = decide_by_others(run, decide_enough_of(run));
    if (!status && run->decision != DECIDED && !run->quarter_asked) status = decide_by_quarter(run, sites->count);
    if (status) return status;
    if (run->decision == DECIDED) return reconstruct_known(run, sites, tets, mesh, facts);
    struct closed_probe of = {run, sites};
    const struct reconstruct_probe probe = {decide_is_none_closed, &of};
    status = pipeline_reconstruct_unless(run, SURFACE_CLOSED, sites, tets, &probe, mesh, facts);
    if (status == STATUS_DEGENERATE) {
        decide_none_is_closed(run);
        return reconstruct_open(run, sites, tets, mesh, facts);
    }
    bool judges = !status && run->decision != DECIDED, doubtful = false;
    if (judges) status = decide_by_lid(run, mesh);
    if (status || run->surface.form == SURFACE_CLOSED) return status;
    if (judges && sites->count < LEAST && LEAST < n) status = decide_may_be_walls(run, mesh, &doubtful);
    if (!status && doubtful) status = decide_by_others(run, LEAST);
    if (status || run->surface.form == SURFACE_CLOSED) return status;
    mesh_done(mesh);
    if (run->surface.form == SURFACE_OPEN) return reconstruct_open(run, sites, tets, mesh, facts);
    return pipeline_reconstruct_as(run, run->surface.form, sites, tets, mesh, facts);
}

enum status pipeline_reconstruct_closed(struct run *run, const struct sites *sites, const struct tets *tets,
                                        struct mesh *mesh, struct reconstruct_facts *facts) {
    return pipeline_reconstruct_as(run, SURFACE_CLOSED, sites, tets, mesh, facts);
}

/* The surface with borders of the kept points after all, where there is none of more points. */
static enum status reconstruct_left_out(struct run *run, struct reconstruct_facts *facts) {
    struct tets tets = {0};
    if (run->surface.form != SURFACE_OPEN) return STATUS_OK;
    enum status status = pipeline_triangulate(run, &run->sites, false, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, &run->sites, &tets, &run->mesh, facts);
    tets_done(&tets);
    return status;
}

/* run->mesh, of the kept points, becomes one of more of them.  Where it isn't sure what they are of, surfaces of other
 * kinds come first, since those are compared with what is there so far; that tells only where it is of enough points.
 */
static enum status reconstruct_more(struct run *run, struct reconstruct_facts *facts) {
    bool seen = false, tells = run->sites.count >= DECIDE_ENOUGH;
    enum status status = STATUS_OK;
    bool tried = run->surface.form == SURFACE_OPEN && (!tells || run->field_left);
    if (run->surface.form == SURFACE_HEIGHTFIELD || tried) status = pipeline_reconstruct_first(run, facts);
    if (!status && run->surface.form == SURFACE_HEIGHTFIELD)
        status = pipeline_doubt_field(run, facts);
    else if (!status && decide_may_try_field(run))
        status = pipeline_try_field(run, facts);
    if (!status && run->surface.form == SURFACE_OPEN && run->sides_wait) status = orient(run, false, &run->mesh);
    run->sides_wait = false;
    if (!status && run->surface.form == SURFACE_OPEN && !run->view_judged)
        status = pipeline_look_from_view(run, facts, &seen);
    bool of_kept = run->report.level[run->level].reconstructed_from <= run->kept_count;
    if (!status && run->surface.form == SURFACE_OPEN && !tried && !seen && of_kept)
        status = pipeline_reconstruct_first(run, facts);
    return status || run->mesh.triangle_count > 0 ? status : reconstruct_left_out(run, facts);
}

static enum status explain_reconstruction(struct run *run, enum status status) {
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "reconstruct");
    if (status == STATUS_DEGENERATE)
        return error_set(run->error, status, "reconstruct", "no surface could be found through the kept points");
    return status;
}

enum status pipeline_reconstruct(struct run *run) {
    if (pipeline_is_given(run)) return pipeline_collapse(run);
    struct reconstruct_facts facts = {0};
    run->sides_wait = !run->surface_alone && run->sites.count >= DECIDE_ENOUGH && decide_may_try_field(run);
    enum status status = reconstruct(run, &run->sites, &run->tets, &run->mesh, &facts);
    run->sides_wait = run->sides_wait && run->surface.form == SURFACE_OPEN;
    run->report.level[run->level].reconstructed_from = run->sites.count;
    bool judges = run->params->surface == SURFACE_AUTO && !run->closed_judged; /* once, for all levels */
    if (!status && judges && run->surface.form == SURFACE_CLOSED)
        status = pipeline_doubt_side(run, &run->sites, &run->tets, &run->mesh, &facts);
    if (!status && run->rough && run->surface.form == SURFACE_CLOSED) {
        mesh_done(&run->mesh);
        status = pipeline_reconstruct_as(run, SURFACE_CLOSED, &run->sites, &run->tets, &run->mesh, &facts);
        if (!status && run->lid_doubted) status = decide_by_lid(run, &run->mesh);
        if (!status && run->surface.form == SURFACE_OPEN) {
            mesh_done(&run->mesh);
            status = reconstruct_open(run, &run->sites, &run->tets, &run->mesh, &facts);
        }
    }
    run->rough = run->lid_doubted = run->quarter_asked = false;
    if (!status && run->surface.form == SURFACE_CLOSED && run->params->boundary != BOUNDARY_KEEP)
        status = pipeline_resolve_walls(run, &facts);
    if (!status && judges && run->surface.form == SURFACE_CLOSED)
        status = pipeline_doubt_closed(run, &run->sites, &run->tets, &run->mesh, &facts);
    run->closed_judged = true;
    tets_done(&run->tets);
    if (!status && !run->surface_alone) status = reconstruct_more(run, &facts);
    free(run->plane.reach);
    run->plane = (struct plane_reach){.reach = NULL};
    if (status || run->surface_alone) return explain_reconstruction(run, status);
    run->report.level[run->level].points_lost = facts.points_lost;
    run->report.level[run->level].vertices_split = facts.vertices_split;
    snprintf(run->report.level[run->level].reconstruction, sizeof run->report.level[run->level].reconstruction, "%s",
             facts.form);
    status = run->surface.form == SURFACE_CLOSED ? pipeline_densify(run) : STATUS_OK;
    return status ? explain_reconstruction(run, status) : STATUS_OK;
}

enum status pipeline_reconstruct_all(struct run *run, struct mesh *surface) {
    if (pipeline_is_given(run)) return explain_reconstruction(run, faces_mesh(&run->faces, &run->points, surface));
    struct sites sites;
    struct tets tets = {0};
    struct reconstruct_facts facts = {0};
    enum status status = pipeline_sites_of(run, run->points.count, &sites);
    bool field = run->surface.form == SURFACE_HEIGHTFIELD; /* decided by now */
    if (!status && !field) status = pipeline_triangulate(run, &sites, true, &tets);
    if (!status) status = reconstruct(run, &sites, &tets, surface, &facts);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return explain_reconstruction(run, status);
}

enum status pipeline_close_holes(struct run *run) {
    size_t closed = 0;
    if (run->record) {
        left_out_add(&run->report.left_out, "mesh", "close_holes: holes of a surface with seams stay open");
        return STATUS_OK;
    }
    double longest = run->params->close_holes / run->points.scale;
    enum status status = sheet_close_holes(&run->mesh, longest, run->threads, &closed);
    run->report.level[run->level].holes_closed = closed;
    return status ? pipeline_no_memory(run, "holes") : STATUS_OK;
}
