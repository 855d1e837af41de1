/* Steps 9 to 11: from the kept points to a mesh.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/sym3.h"
#include "core/mesh/decimate.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline_run.h"
#include "core/spatial/tube.h"
#include "core/spatial/two_sheets.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/reconstruct.h"
#include "core/surface/sheet/holes.h"
#include "core/surface/sheet/orient.h"
#include "core/surface/sheet/scan_lines.h"
#include "core/surface/sheet/sheet.h"

/* The points that stand for themselves, and the index of each among them. */
static void number_sites(const struct run *run, struct sites *sites, uint32_t *index) {
    const vec3 *normal = pipeline_normals_told(run);
    uint32_t i = 0;
    for (uint32_t p = 0; p < run->points.count; p++) {
        if (sites->of_point[p] != p) continue;
        sites->id[i] = p;
        sites->point[i] = run->points.point[p];
        sites->normal[i] = normal[p];
        sites->support[i] = 0;
        index[p] = i++;
    }
}

/* support = max over the points that a site stands for of the distance to it + the spacing there. */
static void find_support(const struct run *run, const uint32_t *index, struct sites *sites) {
    for (size_t x = 0; x < run->points.count; x++) {
        uint32_t i = sites->of_point[x] = index[sites->of_point[x]];
        double reach = vec3_distance(run->points.point[x], sites->point[i]) + (double)run->neighbours.spacing[x];
        sites->support[i] = fmax(sites->support[i], reach);
    }
}

enum status pipeline_sites_of(const struct run *run, size_t k, struct sites *sites) {
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

/* How many of the points' principal extents are over FLAT: 0 when they coincide, 3 when they span space.  Rounding of
 * coordinates makes points of a tilted plane leave it by about 1e-7 of the diagonal; no scan has two sides that near.
 */
static const double FLAT = 1e-6;

/* Principal axes of points, the shortest first, and how many extents are over FLAT. */
static int dimension_of(const vec3 *point, size_t n, vec3 axis[3]) {
    sym3 moment = {0};
    vec3 mean = {0, 0, 0};
    double value[3];
    int dimension = 0;
    for (size_t i = 0; i < n; i++) mean = vec3_add(mean, point[i]);
    mean = vec3_scale(mean, 1 / (double)n);
    for (size_t i = 0; i < n; i++) moment = sym3_add(moment, sym3_outer(vec3_sub(point[i], mean)));
    sym3_eigen(moment, value, axis);
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (size_t i = 0; i < n; i++) {
            double x = vec3_dot(vec3_sub(point[i], mean), axis[k]);
            low = fmin(low, x), high = fmax(high, x);
        }
        dimension += high - low > FLAT;
    }
    return dimension;
}

/* ------------------------------------------------------------------------------------------------ what surface */

void pipeline_decide(struct run *run, struct surface_choice choice) {
    static const char *const forms[] = {[SURFACE_CLOSED] = "closed",
                                        [SURFACE_OPEN] = "open",
                                        [SURFACE_HEIGHTFIELD] = "heightfield",
                                        [SURFACE_GIVEN] = "given"};
    struct report_surface *report = &run->report.surface;
    run->surface = choice;
    run->decision = DECIDED;
    report->sure = choice.sure;
    snprintf(report->kind, sizeof report->kind, "%s", forms[choice.form]);
    snprintf(report->reason, sizeof report->reason, "%s", choice.reason[0] ? choice.reason : "it was asked for");
}

/* Whether the input's own faces are a closed surface. */
static enum status has_closed_faces(const struct run *run, bool *closed) {
    const struct cloud *cloud = run->cloud;
    struct mesh faces = {cloud->count, cloud->position, NULL, cloud->triangle_count, cloud->triangle, NULL};
    struct mesh_facts facts = {0};
    enum status status = cloud->triangle_count ? mesh_examine(&faces, &facts) : STATUS_OK;
    if (!status) *closed = facts.watertight;
    return status;
}

/* Points of curves alone bound no surface: what there is between them is slivers from end to end. */
static enum status refuse_curves(struct run *run) {
    bool curves;
    enum status status = scan_lines_are_curves(&run->neighbours, run->points.point, run->threads, &curves);
    if (status || !curves) return status;
    return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                     "the points lie along curves, however coarsely one looks, and curves bound no surface: leave the "
                     "mesh out (outputs=cloud), or say what surface it is to be (surface)");
}

/* Whether what is seen along a direction has a back, however near it is behind: most of it is both sides of walls, or
 * the given normals say so. */
static bool faces_both_ways(const struct run *run) {
    static const double CLEARLY = 0.5, BACK = 0.1;
    size_t towards = 0, away = 0;
    if (run->neighbours.walls) return true;
    for (size_t p = 0; p < run->points.count && run->normals_fit; p++) {
        double along = vec3_dot(run->normal[p], run->signs.up);
        towards += along > CLEARLY, away += along < -CLEARLY;
    }
    return (double)(towards < away ? towards : away) > BACK * (double)(towards + away);
}

/* *choice becomes a surface with borders where the points are known to be of no solid. */
static bool is_no_solid(const struct run *run, struct surface_choice *choice) {
    if (!scan_pattern_sees_no_back(run)) return false;
    choice->form = SURFACE_OPEN;
    snprintf(choice->reason, sizeof choice->reason,
             "a solid has a back, but all points were seen from one place, as their rays tell");
    return true;
}

/* Finds out whether many points are on thin bars, where a surface may be closed. */
static enum status look_for_bars(struct run *run) {
    enum { LEAST = 256 };
    bool may_be_closed = run->params->surface == SURFACE_AUTO || run->params->surface == SURFACE_CLOSED;
    static const double MOSTLY = 0.25;
    double share = 0;
    bool round = false;
    if (!may_be_closed || run->bars_sought || !run->knn || run->points.count < LEAST) return STATUS_OK;
    enum status status = tube_share(run->knn, run->points.point, run->points.count, run->threads, &share, &round);
    run->bars_sought = !status, run->bars = share > TUBE_MANY, run->rods = round && share > MOSTLY;
    return status;
}

static enum status look_for_plates(struct run *run) {
    double share = 0;
    if (!run->knn) return STATUS_OK;
    enum status status = two_sheets_share(run->knn, run->points.point, run->points.count, run->threads, &share);
    run->two_sided = share > TWO_SHEETS_MOSTLY;
    return status;
}

/* Decides where the points alone tell, as they were looked at. */
static void decide_by_signs(struct run *run) {
    struct surface_choice choice = {.form = SURFACE_AUTO, .up = run->signs.up, .sure = true};
    if (run->bars || run->two_sided || faces_both_ways(run)) return;
    if (surface_choose_by_signs(&run->signs, &choice) || is_no_solid(run, &choice)) pipeline_decide(run, choice);
}

/* What the points tell of their surface before there is a mesh: nothing where many are on bars, which lie over each
 * other by chance.  Points on one plane are a height field of it, unless they are said to be a solid's. */
static enum status look_at_points(struct run *run) {
    enum surface_form asked = (enum surface_form)run->params->surface;
    struct surface_choice choice = {.form = asked, .sure = true};
    vec3 axis[3];
    bool closed = asked == SURFACE_CLOSED;
    enum status status = STATUS_OK;
    int dimension = closed ? 3 : dimension_of(run->points.point, run->points.count, axis);
    if (dimension < 2 && asked == SURFACE_AUTO) return STATUS_OK;
    if (dimension == 2 && asked == SURFACE_AUTO) status = refuse_curves(run);
    if (status) return status;
    if (dimension == 2) {
        choice.form = SURFACE_HEIGHTFIELD, choice.up = axis[0];
        snprintf(choice.reason, sizeof choice.reason, "all points lie on one plane");
        pipeline_decide(run, choice);
        run->field_judged = true;
        return STATUS_OK;
    }
    run->field_judged = asked == SURFACE_HEIGHTFIELD;
    if (asked == SURFACE_AUTO) status = has_closed_faces(run, &closed);
    if (!status && asked == SURFACE_AUTO && !closed) status = refuse_curves(run);
    if (!status && !closed)
        status = surface_signs_of(run->points.point, run->normal, run->points.count, run->threads, &run->signs);
    if (!status && !closed) status = look_for_plates(run);
    if (status) return status;
    run->decision = LOOKED_AT;
    run->landscape = surface_is_landscape(&run->signs);
    choice.up = run->signs.up;
    if (asked == SURFACE_AUTO && closed) {
        choice.form = SURFACE_CLOSED;
        snprintf(choice.reason, sizeof choice.reason, "the input's own faces are a closed surface");
    }
    if (asked != SURFACE_AUTO || closed) pipeline_decide(run, choice);
    return STATUS_OK;
}

/* How much of a mesh of the sites has no points; with_made: places made up on flat faces are as good as points. */
static enum status find_lid(const struct run *run, const struct mesh *mesh, enum surface_form of, bool with_made,
                            struct surface_lid *lid) {
    size_t n = run->points.count, made = with_made ? run->made.count : 0;
    struct sheet_points points = {.knn = made ? run->made.knn : run->knn};
    float *reach = alloc_array(n + made, sizeof *reach);
    uint8_t *stray = alloc_zeroed(n + made, sizeof *stray);
    enum status status = reach && stray
                             ? sheet_reach_in(&run->neighbours, run->points.point, run->threads, reach, &points.median)
                             : STATUS_NO_MEMORY;
    if (!status) sheet_find_strays(&run->neighbours, reach, run->threads, stray);
    for (size_t i = n; !status && i < n + made; i++) reach[i] = fmaxf(run->made.spacing[i], points.median);
    points.reach = reach, points.stray = stray;
    if (!status) status = surface_lid_of(mesh, &points, of, run->threads, lid);
    free(reach), free(stray);
    return status;
}

/* Decides by a closed mesh whether it should be one. */
static enum status judge_closed(struct run *run, const struct mesh *closed) {
    struct surface_lid lid = {0};
    struct surface_choice choice = {0};
    enum status status = find_lid(run, closed, SURFACE_CLOSED, false, &lid);
    if (status) return status;
    surface_choose_by_lid(&run->signs, &lid, &choice);
    run->lid_share = lid.share;
    pipeline_decide(run, choice);
    return STATUS_OK;
}

/* Decides by a height field's mesh, of what looks like one, whether it should be one.  A landscape's walls aren't all
 * that counts: of that the surface with borders is compared with it, unless one place sees it all. */
static enum status judge_field(struct run *run, const struct mesh *field) {
    struct surface_lid lid = {0};
    struct surface_choice choice = run->surface;
    enum status status = find_lid(run, field, SURFACE_HEIGHTFIELD, false, &lid);
    bool seen = false;
    vec3 place;
    if (!status && surface_may_have_steps(&run->signs, lid.share)) status = pipeline_find_view(run, &seen, &place);
    bool leaves = !status && surface_leave_field(&run->signs, lid.share, seen, &choice);
    if (leaves) pipeline_decide(run, choice);
    run->field_judged = !leaves || !run->landscape || seen;
    run->field_left = leaves && !run->field_judged;
    return status;
}

/* How many tetrahedra the kept points may have between them, or all points. */
static size_t tetrahedra_allowed(const struct run *run, bool of_all, const struct params *params) {
    const struct memory_job job = {run->cloud->count, run->cloud->record_bytes, run->cloud->triangle_count, 0, 0};
    return memory_tetrahedra(&job, run->kept_count, of_all, params);
}

/* STATUS_LIMIT becomes STATUS_NO_MEMORY where memory is what there is too little of. */
static enum status explain_tetrahedra(const struct run *run, const struct sites *sites, bool of_all,
                                      enum status status) {
    struct params unlimited = *run->params;
    unlimited.memory_bytes = 0;
    size_t most = tetrahedra_allowed(run, of_all, run->params);
    if (status != STATUS_LIMIT || most == tetrahedra_allowed(run, of_all, &unlimited)) return status;
    return error_set(run->error, STATUS_NO_MEMORY, "delaunay",
                     "the %zu points of the mesh have more than %zu tetrahedra between them, as points along lines "
                     "have, and %" PRIu64 " MiB have no room for more: allow more memory, keep fewer points (ratio), "
                     "or leave the mesh out (outputs=cloud)",
                     sites->count, most, run->params->memory_bytes >> 20);
}

static enum status triangulate(const struct run *run, const struct sites *sites, bool of_all, struct tets *tets) {
    enum status status = delaunay_build_within(sites->point, sites->count, tetrahedra_allowed(run, of_all, run->params),
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
    size_t kept = run->sites.count, allowed = tetrahedra_allowed(run, false, run->params), k = kept;
    bool curves = false;
    enum status status = STATUS_LIMIT;
    if (CROWDED * k >= allowed) return triangulate(run, &run->sites, false, &run->tets); /* memory is what is short */
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
        return triangulate(run, &run->sites, false, &run->tets);
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
    if (!status && !field && !(told && run->pattern.hides)) status = sheet_part_turned(mesh, &sides, run->threads);
    if (!status) status = sheet_orient(mesh, &sides, run->threads, &side);
    run->faces_inwards = side == SIDE_SIGHT;
    snprintf(run->report.surface.orientation, sizeof run->report.surface.orientation, "%s",
             side == SIDE_VIEW && !told           ? "scan pattern"
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

static enum status reconstruct_unless(struct run *run, enum surface_form form, const struct sites *sites,
                                      const struct tets *tets, const struct reconstruct_probe *probe, struct mesh *mesh,
                                      struct reconstruct_facts *facts) {
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
    return reconstruct_unless(run, form, sites, tets, NULL, mesh, facts);
}

enum { ENOUGH = 2000 }; /* kept points, for their mesh to tell what the points are of */

/* Whether a closed surface that isn't as good as it gets tells that none is closed: its lid is too large, or it faces
 * away from where the points were seen from. */
struct closed_probe {
    struct run *run;
    const struct sites *sites;
};

/* How large a lid has to be at a stage, of the area, so that the surface's own, in the end, is that of an open one:
 * what follows mends errors of the labelling, which may be most of a smaller lid. */
static const double CLEARLY[] = {[STAGE_LABELLED] = 0.2, [STAGE_JUDGED] = 0.1, [STAGE_REPAIRED] = 0.075};

/* The lid of a mesh of the probe's sites, and what would be chosen by it.  *mesh is the same of the points; its sources
 * are the caller's. */
static enum status choose_by_rough(const struct closed_probe *probe, const struct mesh *rough, struct mesh *mesh,
                                   struct surface_lid *lid, struct surface_choice *choice) {
    *mesh = *rough;
    mesh->source = alloc_array(mesh->vertex_count, sizeof *mesh->source);
    enum status status = mesh->source ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t v = 0; !status && v < mesh->vertex_count; v++) mesh->source[v] = probe->sites->id[rough->source[v]];
    if (!status) status = find_lid(probe->run, mesh, SURFACE_CLOSED, false, lid);
    if (!status) surface_choose_by_lid(&probe->run->signs, lid, choice);
    return status;
}

static enum status is_none_closed(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
                                  enum reconstruct_answer *answer) {
    const struct closed_probe *probe = ctx;
    struct run *run = probe->run;
    struct surface_lid lid = {0};
    struct surface_choice choice = {0};
    struct mesh mesh;
    enum status status = choose_by_rough(probe, rough, &mesh, &lid, &choice);
    bool has_lid = choice.form == SURFACE_OPEN, enough = has_lid && lid.share > CLEARLY[stage];
    if (!status && !enough && stage == STAGE_LABELLED)
        status = pipeline_faces_away(run, &mesh, !has_lid && choice.sure, &run->rough);
    free(mesh.source);
    if (status) return status;
    bool is_of_one_view = run->rough && has_lid && scan_pattern_sees_no_back(run); /* the lid is what that didn't see */
    if (is_of_one_view) run->rough = false;
    run->lid_doubted = run->rough && has_lid;
    if (run->lid_doubted) choice.form = SURFACE_CLOSED, choice.sure = false;
    enough = enough || is_of_one_view || run->rough;
    bool asks_again = choice.form == SURFACE_OPEN && probe->sites->count >= ENOUGH;
    *answer = enough ? ANSWER_ENOUGH : asks_again ? ANSWER_ASK_AGAIN : ANSWER_GO_ON;
    if (enough) pipeline_decide(run, choice);
    return STATUS_OK;
}

/* Decides by the labels of fewer points where these are clear, at once or when the points have judged them; no more is
 * asked of them. */
static enum status is_clearly_open(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
                                   enum reconstruct_answer *answer) {
    const struct closed_probe *probe = ctx;
    struct surface_lid lid = {0};
    struct surface_choice choice = {0};
    struct mesh mesh;
    enum status status = choose_by_rough(probe, rough, &mesh, &lid, &choice);
    free(mesh.source);
    bool has_lid = !status && choice.form == SURFACE_OPEN, clearly = has_lid && lid.share > CLEARLY[stage];
    if (clearly) pipeline_decide(probe->run, choice);
    *answer = has_lid && !clearly && stage == STAGE_LABELLED ? ANSWER_ASK_AGAIN : ANSWER_ENOUGH;
    return status;
}

/* Where fewer points lie over each other than those of solids do, the labels of a quarter of many kept ones are asked
 * first: a large lid hardly depends on how many there are. */
static enum status decide_by_quarter(struct run *run, size_t kept) {
    enum { QUARTER = 4 };
    static const double OF_SOLIDS = 0.8; /* .84 to .91; of scans with a lid .41 to .79 */
    struct sites sites;
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts = {0};
    if (kept < QUARTER * ENOUGH || run->signs.layered > OF_SOLIDS) return STATUS_OK;
    struct closed_probe of = {run, &sites};
    const struct reconstruct_probe probe = {is_clearly_open, &of};
    enum status status = pipeline_sites_of(run, kept / QUARTER, &sites);
    if (!status) status = triangulate(run, &sites, false, &tets);
    if (!status) status = reconstruct_unless(run, SURFACE_CLOSED, &sites, &tets, &probe, &mesh, &facts);
    mesh_done(&mesh);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* There is no closed surface through the points. */
static void decide_none_is_closed(struct run *run) {
    struct surface_choice choice = {.form = SURFACE_OPEN, .up = run->signs.up};
    snprintf(choice.reason, sizeof choice.reason, "no closed surface could be found");
    pipeline_decide(run, choice);
}

/* Where flat faces have points along their edges alone (core/spatial/flat_faces.h) a closed mesh of the points has
 * lids, and as such bodies are turned, their points come ring by ring, as if they had been seen from the axis.  But one
 * of all points and of places on those faces has next to no lid where they are a solid's; then nothing else is asked.
 */
static enum status decide_by_flat_faces(struct run *run) {
    enum { MOST = 20000 }; /* points of which such a surface is made (dense.c) */
    static const double LID = 0.005;
    size_t n = run->points.count;
    struct error ignored = {0};
    struct sites sites = {0};
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts = {0};
    struct surface_lid lid = {0};
    struct surface_choice choice = {0};
    if (n > MOST || run->neighbours.noisy || !run->knn) return STATUS_OK;
    enum status status = made_points_find(run);
    if (status || !run->made.count) return status;
    status = pipeline_sites_of(run, n, &sites);
    if (!status) status = made_points_add(run, &sites);
    if (!status)
        status = delaunay_build_within(sites.point, sites.count, pipeline_wall_tetrahedra(run), run->threads,
                                       &run->progress, &tets, &ignored);
    if (!status) status = pipeline_reconstruct_closed(run, &sites, &tets, &mesh, &facts);
    if (!status) status = find_lid(run, &mesh, SURFACE_CLOSED, true, &lid);
    if (!status) surface_choose_by_lid(&run->signs, &lid, &choice);
    if (!status && choice.form == SURFACE_CLOSED && lid.share < LID) {
        pipeline_decide(run, choice);
        run->closed_judged = true;
    }
    mesh_done(&mesh);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

static enum status triangulate_others(const struct run *run, const struct sites *sites, struct tets *tets) {
    struct error ignored = {0};
    if (!run->neighbours.walls) return triangulate(run, sites, false, tets);
    return delaunay_build_within(sites->point, sites->count, pipeline_wall_tetrahedra(run), run->threads,
                                 &run->progress, tets, &ignored);
}

/* Decides what surface the cloud has by a closed mesh of the k most important points, unless they have none. */
static enum status decide_by_others(struct run *run, size_t k) {
    struct sites sites;
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts = {0};
    enum status status = pipeline_sites_of(run, k, &sites);
    if (!status) status = triangulate_others(run, &sites, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_CLOSED, &sites, &tets, &mesh, &facts);
    if (!status) status = judge_closed(run, &mesh);
    bool judges = run->params->surface == SURFACE_AUTO && !run->closed_judged;
    if (!status && judges && run->surface.form == SURFACE_CLOSED)
        status = pipeline_doubt_side(run, &sites, &tets, &mesh, &facts);
    if (!status && judges && run->surface.form == SURFACE_CLOSED)
        status = pipeline_doubt_closed(run, &sites, &tets, &mesh, &facts);
    run->closed_judged = run->closed_judged || (!status && judges);
    mesh_done(&mesh);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* Where a closed mesh of all points has a lid, however small, or isn't closed, the two heights aren't those of thin
 * walls but of one surface that was scanned twice, and it is decided as if there weren't any. */
static enum status decide_by_walls(struct run *run) {
    static const double LID = 0.005;
    enum status status = decide_by_others(run, pipeline_wall_points(run));
    if (status || run->decision != DECIDED) return status;
    if (run->surface.form == SURFACE_CLOSED && run->lid_share < LID) return status;
    run->neighbours.walls = false;
    run->closed_judged = false;
    run->decision = LOOKED_AT;
    decide_by_signs(run);
    return STATUS_OK;
}

/* Whether a closed mesh of few points may have been found to be none for its walls alone: what of these is lost, its
 * inner or its outer side, spans where no points are. */
static enum status may_be_walls(const struct run *run, const struct mesh *closed, bool *may) {
    static const double LOST = 0.003; /* share of the vertices: as of walls, but of some open scans, too */
    double lost = 0;
    enum status status = pipeline_find_lost(run, closed, &lost);
    *may = !status && lost > LOST;
    return status;
}

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
    return delaunay_build_within(many->sites.point, k, tetrahedra_allowed(run, false, run->params), run->threads,
                                 &run->progress, &many->tets, &ignored);
}

/* How many points a surface with borders is reconstructed from before it is simplified: so many times as many as are
 * kept, or those kept where it isn't.  Tetrahedra take memory; triangles in a plane are two for each point. */
static enum status count_denser(const struct run *run, size_t times, size_t *k) {
    bool in_plane = run->surface.form == SURFACE_HEIGHTFIELD || run->viewed;
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

/* Whether a height field is tried where a surface of another kind is there. */
static bool may_try_field(const struct run *run) {
    bool by_signs = run->params->surface == SURFACE_AUTO && run->level == 0 && !faces_both_ways(run);
    return by_signs && !run->field_judged && surface_may_be_field(&run->signs, run->surface.volume);
}

/* Whether nothing is asked of the surface with borders of the kept points: neither whether a height field is nearer,
 * nor what one place sees. */
static enum status is_left_out(struct run *run, bool *left_out) {
    bool told = false, known = false;
    vec3 place;
    size_t k = 0;
    *left_out = false;
    if (run->surface_alone || run->sites.count < ENOUGH || may_try_field(run) || run->viewed) return STATUS_OK;
    enum status status = count_dense(run, &k);
    if (status || k <= run->kept_count) return status;
    status = scan_pattern_told_place(run, &told, &known, &place);
    if (!status && !told) status = pipeline_seek_pattern(run);
    *left_out = !status && !known && run->pattern.places != 1;
    return status;
}

/* As many points as a mesh is made of that decides, of a small cloud or where hardly any are kept; whether so many are
 * fewer. */
static size_t enough_of(const struct run *run) {
    enum { TENTH = 10 };
    size_t n = run->points.count, enough = n / TENTH > ENOUGH ? n / TENTH : ENOUGH;
    return enough < n ? enough : n;
}

static bool are_few(const struct run *run, size_t sites) {
    enum { FEWER = 20, SMALL = 5000 };
    size_t n = run->points.count;
    return sites < enough_of(run) && (n <= SMALL || sites < n / FEWER);
}

/* Decides by a quarter of the kept points where nothing else is asked before them, so that tetrahedra of all are made
 * only where they are needed. */
static enum status decide_early(struct run *run) {
    bool waits = run->neighbours.walls || are_few(run, run->sites.count) || run->surface_alone;
    if (run->decision == DECIDED || waits) return STATUS_OK;
    run->quarter_asked = true;
    return decide_by_quarter(run, run->sites.count);
}

/* The tetrahedra of the points that the surface with borders will be made of, where that of the kept ones is left out:
 * they are one thread's work, and made beside other steps. */
static enum status triangulate_ahead(struct run *run) {
    struct many *ahead = &run->ahead;
    size_t k;
    enum status status = count_dense(run, &k);
    if (!status) status = pipeline_triangulate_many(run, k, ahead);
    if (status) pipeline_many_done(ahead);
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "delaunay");
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* Decides what surface the cloud has where that needs no mesh of the kept points. */
static enum status decide_by_points(struct run *run) {
    enum status status = look_at_points(run);
    if (!status && run->decision == LOOKED_AT) decide_by_signs(run);
    if (!status && run->decision == LOOKED_AT) status = decide_by_flat_faces(run);
    return status;
}

enum status pipeline_delaunay(struct run *run) {
    static const char *const flat[] = {"coincide in one point", "lie on one line", "lie on one plane"};
    if (pipeline_is_given(run)) return STATUS_OK;
    enum status status = pipeline_sites_of(run, run->kept_count, &run->sites);
    if (status) return pipeline_no_memory(run, "delaunay");
    status = look_for_bars(run);
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
    int dimension = dimension_of(run->sites.point, run->sites.count, axis);
    if (dimension < (field ? 2 : 3))
        return error_set(run->error, STATUS_DEGENERATE, "delaunay",
                         "all %zu kept points %s: there is no %s mesh of them%s", run->sites.count, flat[dimension],
                         closed ? "closed" : "open", dimension == 2 ? "; surface=open makes an open one" : "");
    if (field) return STATUS_OK;
    bool left_out = false;
    status = decide_early(run);
    if (!status && run->decision == DECIDED && run->surface.form == SURFACE_OPEN) status = is_left_out(run, &left_out);
    if (status == STATUS_NO_MEMORY) return pipeline_no_memory(run, "delaunay");
    if (status) return status;
    return left_out ? triangulate_ahead(run) : triangulate_sites(run);
}

/* A height field, unless its mesh says that it isn't one after all. */
static enum status reconstruct_field(struct run *run, const struct sites *sites, struct mesh *mesh,
                                     struct reconstruct_facts *facts) {
    struct tets tets = {0};
    enum status status = pipeline_reconstruct_as(run, SURFACE_HEIGHTFIELD, sites, NULL, mesh, facts);
    if (!status && !run->field_judged) status = judge_field(run, mesh);
    if (status || run->surface.form == SURFACE_HEIGHTFIELD) return status;
    mesh_done(mesh);
    status = triangulate(run, sites, sites != &run->sites, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, sites, &tets, mesh, facts);
    tets_done(&tets);
    return status;
}

/* The surface of the kept points that is known to have borders, unless it would be made for nothing: one of more points
 * takes its place, and nothing is asked of it. */
static enum status reconstruct_open(struct run *run, const struct sites *sites, const struct tets *tets,
                                    struct mesh *mesh, struct reconstruct_facts *facts) {
    bool left_out = false;
    enum status status = sites == &run->sites ? is_left_out(run, &left_out) : STATUS_OK;
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
    if (!status && run->decision != DECIDED && are_few(run, sites->count))
        status = decide_by_others(run, enough_of(run));
    if (!status && run->decision != DECIDED && !run->quarter_asked) status = decide_by_quarter(run, sites->count);
    if (status) return status;
    if (run->decision == DECIDED) return reconstruct_known(run, sites, tets, mesh, facts);
    struct closed_probe of = {run, sites};
    const struct reconstruct_probe probe = {is_none_closed, &of};
    status = reconstruct_unless(run, SURFACE_CLOSED, sites, tets, &probe, mesh, facts);
    if (status == STATUS_DEGENERATE) {
        decide_none_is_closed(run);
        return reconstruct_open(run, sites, tets, mesh, facts);
    }
    bool judges = !status && run->decision != DECIDED, doubtful = false;
    if (judges) status = judge_closed(run, mesh);
    if (status || run->surface.form == SURFACE_CLOSED) return status;
    if (judges && sites->count < LEAST && LEAST < n) status = may_be_walls(run, mesh, &doubtful);
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
    struct mesh_facts facts;
    enum status status = mesh_examine(mesh, &facts);
    *crowded = !status && 3 * (double)facts.components > NEARLY_ALL * (double)run->kept_count;
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
        delaunay_build_within(run->sites.point, run->sites.count, tetrahedra_allowed(run, false, run->params),
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

/* The surface with borders of the kept points after all, where there is none of more points. */
static enum status reconstruct_left_out(struct run *run, struct reconstruct_facts *facts) {
    struct tets tets = {0};
    if (run->surface.form != SURFACE_OPEN) return STATUS_OK;
    enum status status = triangulate(run, &run->sites, false, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, &run->sites, &tets, &run->mesh, facts);
    tets_done(&tets);
    return status;
}

/* run->mesh, of the kept points, becomes one of more of them.  Where it isn't sure what they are of, surfaces of other
 * kinds come first, since those are compared with what is there so far; that tells only where it is of enough points.
 */
static enum status reconstruct_more(struct run *run, struct reconstruct_facts *facts) {
    bool seen = false, tells = run->sites.count >= ENOUGH;
    enum status status = STATUS_OK;
    bool tried = run->surface.form == SURFACE_OPEN && (!tells || run->field_left);
    if (run->surface.form == SURFACE_HEIGHTFIELD || tried) status = pipeline_reconstruct_first(run, facts);
    if (!status && run->surface.form == SURFACE_HEIGHTFIELD)
        status = pipeline_doubt_field(run, facts);
    else if (!status && may_try_field(run))
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
    run->sides_wait = !run->surface_alone && run->sites.count >= ENOUGH && may_try_field(run);
    enum status status = reconstruct(run, &run->sites, &run->tets, &run->mesh, &facts);
    run->sides_wait = run->sides_wait && run->surface.form == SURFACE_OPEN;
    run->report.level[run->level].reconstructed_from = run->sites.count;
    bool judges = run->params->surface == SURFACE_AUTO && !run->closed_judged; /* once, for all levels */
    if (!status && judges && run->surface.form == SURFACE_CLOSED)
        status = pipeline_doubt_side(run, &run->sites, &run->tets, &run->mesh, &facts);
    if (!status && run->rough && run->surface.form == SURFACE_CLOSED) {
        mesh_done(&run->mesh);
        status = pipeline_reconstruct_as(run, SURFACE_CLOSED, &run->sites, &run->tets, &run->mesh, &facts);
        if (!status && run->lid_doubted) status = judge_closed(run, &run->mesh);
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
    if (!status && !field) status = triangulate(run, &sites, true, &tets);
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
