/* What surface the points are of: closed, open or a height field.  README.md has the order of what decides.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/decide.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/math/sym3.h"
#include "core/spatial/tube.h"
#include "core/spatial/two_sheets.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/sheet/scan_lines.h"
#include "core/surface/sheet/sheet.h"

/* How many of the points' principal extents are over FLAT: 0 when they coincide, 3 when they span space.  Rounding of
 * coordinates makes points of a tilted plane leave it by about 1e-7 of the diagonal; no scan has two sides that near.
 */
static const double FLAT = 1e-6;

int pipeline_dimension_of(const vec3 *point, size_t n, vec3 axis[3]) {
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

enum status decide_find_bars(struct run *run) {
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
    int dimension = closed ? 3 : pipeline_dimension_of(run->points.point, run->points.count, axis);
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

enum status decide_by_lid(struct run *run, const struct mesh *closed) {
    struct surface_lid lid = {0};
    struct surface_choice choice = {0};
    enum status status = find_lid(run, closed, SURFACE_CLOSED, false, &lid);
    if (status) return status;
    surface_choose_by_lid(&run->signs, &lid, &choice);
    run->lid_share = lid.share;
    pipeline_decide(run, choice);
    return STATUS_OK;
}

enum status decide_by_field(struct run *run, const struct mesh *field) {
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

enum status decide_is_none_closed(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
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
    bool asks_again = choice.form == SURFACE_OPEN && probe->sites->count >= DECIDE_ENOUGH;
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

enum status decide_by_quarter(struct run *run, size_t kept) {
    enum { QUARTER = 4 };
    static const double OF_SOLIDS = 0.8; /* .84 to .91; of scans with a lid .41 to .79 */
    struct sites sites;
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts = {0};
    if (kept < QUARTER * DECIDE_ENOUGH || run->signs.layered > OF_SOLIDS) return STATUS_OK;
    struct closed_probe of = {run, &sites};
    const struct reconstruct_probe probe = {is_clearly_open, &of};
    enum status status = pipeline_sites_of(run, kept / QUARTER, &sites);
    if (!status) status = pipeline_triangulate(run, &sites, false, &tets);
    if (!status) status = pipeline_reconstruct_unless(run, SURFACE_CLOSED, &sites, &tets, &probe, &mesh, &facts);
    mesh_done(&mesh);
    tets_done(&tets);
    pipeline_sites_done(&sites);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

void decide_none_is_closed(struct run *run) {
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
    if (!run->neighbours.walls) return pipeline_triangulate(run, sites, false, tets);
    return delaunay_build_within(sites->point, sites->count, pipeline_wall_tetrahedra(run), run->threads,
                                 &run->progress, tets, &ignored);
}

enum status decide_by_others(struct run *run, size_t k) {
    struct sites sites;
    struct tets tets = {0};
    struct mesh mesh = {0};
    struct reconstruct_facts facts = {0};
    enum status status = pipeline_sites_of(run, k, &sites);
    if (!status) status = triangulate_others(run, &sites, &tets);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_CLOSED, &sites, &tets, &mesh, &facts);
    if (!status) status = decide_by_lid(run, &mesh);
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

enum status decide_by_walls(struct run *run) {
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

enum status decide_may_be_walls(const struct run *run, const struct mesh *closed, bool *may) {
    static const double LOST = 0.003; /* share of the vertices: as of walls, but of some open scans, too */
    double lost = 0;
    enum status status = pipeline_find_lost(run, closed, &lost);
    *may = !status && lost > LOST;
    return status;
}

bool decide_may_try_field(const struct run *run) {
    bool by_signs = run->params->surface == SURFACE_AUTO && run->level == 0 && !faces_both_ways(run);
    return by_signs && !run->field_judged && surface_may_be_field(&run->signs, run->surface.volume);
}

size_t decide_enough_of(const struct run *run) {
    enum { TENTH = 10 };
    size_t n = run->points.count, enough = n / TENTH > DECIDE_ENOUGH ? n / TENTH : DECIDE_ENOUGH;
    return enough < n ? enough : n;
}

bool decide_are_few(const struct run *run, size_t sites) {
    enum { FEWER = 20, SMALL = 5000 };
    size_t n = run->points.count;
    return sites < decide_enough_of(run) && (n <= SMALL || sites < n / FEWER);
}

enum status decide_early(struct run *run) {
    bool waits = run->neighbours.walls || decide_are_few(run, run->sites.count) || run->surface_alone;
    if (run->decision == DECIDED || waits) return STATUS_OK;
    run->quarter_asked = true;
    return decide_by_quarter(run, run->sites.count);
}

enum status decide_by_points(struct run *run) {
    enum status status = look_at_points(run);
    if (!status && run->decision == LOOKED_AT) decide_by_signs(run);
    if (!status && run->decision == LOOKED_AT) status = decide_by_flat_faces(run);
    return status;
}
