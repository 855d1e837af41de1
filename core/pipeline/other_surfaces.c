/* Step 10, where it isn't sure what surface the points have: one that was made is compared with one of another kind,
 * and the one that goes through them better stays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/pipeline/pipeline_run.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/orient.h"

enum status pipeline_match(const struct run *run, const struct mesh *mesh, struct surface_match *match) {
    const struct surface_points points = {run->points.count, run->points.point, run->normal, run->neighbours.spacing};
    return surface_match_of(mesh, &points, run->threads, match);
}

/* All that is known of run->mesh, which a surface that is tried and put back must leave as it was. */
struct made_surface {
    struct surface_choice choice;
    bool landscape, viewed, faces_inwards;
    struct gallery gallery;
    struct mesh mesh;
    struct reconstruct_facts facts;
    struct report_surface told;
    struct report_level level;
};

static struct made_surface made_so_far(const struct run *run, const struct reconstruct_facts *facts) {
    return (struct made_surface){.choice = run->surface,
                                 .landscape = run->landscape,
                                 .viewed = run->viewed,
                                 .faces_inwards = run->faces_inwards,
                                 .gallery = run->gallery,
                                 .mesh = run->mesh,
                                 .facts = *facts,
                                 .told = run->report.surface,
                                 .level = run->report.level[run->level]};
}

static void restore(struct run *run, struct reconstruct_facts *facts, const struct made_surface *made) {
    run->surface = made->choice, run->landscape = made->landscape, run->viewed = made->viewed;
    run->faces_inwards = made->faces_inwards, run->gallery = made->gallery;
    run->mesh = made->mesh, *facts = made->facts;
    run->report.surface = made->told, run->report.level[run->level] = made->level;
}

/* ------------------------------------------------------------------------------------------------ one place */

enum status pipeline_find_view(struct run *run, bool *known, vec3 *view) {
    bool told = false;
    enum status status = scan_pattern_told_place(run, &told, known, view);
    if (status || told) return status;
    status = pipeline_seek_pattern(run);
    *known = run->pattern.places == 1;
    if (run->pattern.views.is_one) *view = run->pattern.views.one;
    if (*known && run->pattern.views.each) *known = scan_pattern_one_place(run, view);
    return status;
}

/* The share of a mesh's area that faces away from the place. */
static double away_from_view(const struct run *run, const struct mesh *mesh) {
    const struct sheet_sides sides = {.viewed = true, .view = run->view};
    return (1 - sheet_facing(mesh, &sides)) / 2;
}

/* Whether the surface seen from the place goes through about as many points as one of more points than are kept would,
 * which misses at most half of what that of the kept ones does; and by as much more as the share of that one's area
 * which faces away. */
static bool misses_few(const struct surface_match *seen, const struct surface_match *kept, double away) {
    static const double MISSED = 0.02, OF_KEPT = 0.5, MOST_AWAY = 0.05;
    return seen->missed <= OF_KEPT * kept->missed + MISSED + fmin(away, MOST_AWAY);
}

enum status pipeline_look_from_view(struct run *run, struct reconstruct_facts *facts, bool *taken) {
    static const double HARDLY = 0.0035; /* of the area faces away */
    double away = 0;
    struct made_surface plain = made_so_far(run, facts);
    struct surface_match match, seen;
    *taken = false;
    run->view_judged = true;
    enum status status = pipeline_find_view(run, &run->viewed, &run->view);
    if (!status && run->viewed) away = away_from_view(run, &plain.mesh);
    if (away <= HARDLY) run->viewed = false;
    if (status || !run->viewed) return status;
    status = pipeline_match(run, &plain.mesh, &match);
    run->mesh = (struct mesh){0};
    if (!status) status = pipeline_reconstruct_seen(run, facts);
    if (!status) status = pipeline_match(run, &run->mesh, &seen);
    *taken = !status && misses_few(&seen, &match, away);
    mesh_done(*taken ? &plain.mesh : &run->mesh);
    if (*taken) return STATUS_OK;
    restore(run, facts, &plain);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

enum status pipeline_doubt_field(struct run *run, struct reconstruct_facts *facts) {
    static const double MUCH = 0.02; /* of the area faces away */
    bool told = false, known = false, chosen = run->params->surface == SURFACE_AUTO && run->level == 0;
    if (!chosen || run->landscape || run->field_tried || run->signs.points == 0) return STATUS_OK;
    enum status status = scan_pattern_told_place(run, &told, &known, &run->view);
    if (!status && !told) status = scan_pattern_exact_place(run, &known, &run->view);
    double away = status || !known ? 0 : away_from_view(run, &run->mesh);
    if (away <= MUCH) return status;
    struct made_surface field = made_so_far(run, facts);
    struct surface_match of_field, seen;
    struct surface_choice choice = {.form = SURFACE_OPEN, .up = run->surface.up, .sure = true};
    status = pipeline_match(run, &field.mesh, &of_field);
    run->mesh = (struct mesh){0};
    run->surface.form = SURFACE_OPEN, run->viewed = true;
    if (!status) status = pipeline_reconstruct_seen(run, facts);
    if (!status) status = pipeline_match(run, &run->mesh, &seen);
    if (!status && misses_few(&seen, &of_field, away)) {
        snprintf(choice.reason, sizeof choice.reason,
                 "all points were seen from one place, from which %.1f %% of a height field face away", 100 * away);
        pipeline_decide(run, choice);
        run->view_judged = true;
        mesh_done(&field.mesh);
        return STATUS_OK;
    }
    mesh_done(&run->mesh);
    restore(run, facts, &field);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* ------------------------------------------------------------------------------------------------ from above */

/* Whether run->mesh, a height field of the kept points, leaves no hope for one of more: where all points were seen from
 * one place, as their rays tell, the surface that is seen from there is nearer than a field that isn't nearer than
 * the surface with borders already. */
static enum status is_hopeless_field(const struct run *run, const struct surface_match *of_other, bool *hopeless) {
    struct surface_match of_kept = {0};
    *hopeless = false;
    if (!scan_pattern_sees_no_back(run)) return STATUS_OK;
    enum status status = pipeline_match(run, &run->mesh, &of_kept);
    *hopeless = !status && of_kept.distance > of_other->distance;
    return status;
}

/* Whether all points were seen from one place below them, so that they are no landscape. */
static enum status is_seen_from_below(struct run *run, bool *below) {
    static const double BELOW = -0.5; /* cosine */
    bool told = false, known = false;
    vec3 place;
    enum status status = scan_pattern_told_place(run, &told, &known, &place);
    if (!status && !told) status = scan_pattern_exact_place(run, &known, &place);
    *below = !status && known && vec3_dot(place, run->signs.up) < BELOW * vec3_length(place);
    return status;
}

enum status pipeline_try_field(struct run *run, struct reconstruct_facts *facts) {
    struct made_surface other = made_so_far(run, facts);
    struct surface_match of_other, of_field;
    struct surface_choice choice = run->surface;
    bool of_kept = run->report.level[run->level].reconstructed_from <= run->kept_count;
    bool below = false, hopeless = false;
    enum status status = is_seen_from_below(run, &below);
    if (status || below) return status;
    status = pipeline_match(run, &run->mesh, &of_other);
    if (status) return status;
    run->mesh = (struct mesh){0};
    run->field_tried = true;
    run->surface.form = SURFACE_HEIGHTFIELD, run->surface.up = run->signs.up, run->landscape = true;
    status = pipeline_reconstruct_as(run, SURFACE_HEIGHTFIELD, &run->sites, NULL, &run->mesh, facts);
    run->report.level[run->level].reconstructed_from = run->sites.count;
    if (!status) status = pipeline_count_vertices(run, &run->mesh, facts);
    if (!status && of_kept) status = is_hopeless_field(run, &of_other, &hopeless);
    if (!status && !hopeless) status = pipeline_reconstruct_first(run, facts);
    if (!status && !hopeless) status = pipeline_match(run, &run->mesh, &of_field);
    bool of_more = of_kept && run->report.level[run->level].reconstructed_from > run->kept_count;
    if (!status && !hopeless &&
        surface_take_field(&run->signs, &of_other, &of_field, of_more, run->field_left, &choice)) {
        snprintf(other.told.orientation, sizeof other.told.orientation, "%s", run->report.surface.orientation);
        run->report.surface = other.told;
        pipeline_decide(run, choice);
        mesh_done(&other.mesh);
        return STATUS_OK;
    }
    mesh_done(&run->mesh);
    restore(run, facts, &other);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

/* ------------------------------------------------------------------------------------------------ solids */

/* How a closed mesh faces where the points were seen from: 1 = all of it towards there, -1 = away, as that of a room.
 * What the points tell of it themselves is looked for where the mesh isn't surely closed or they are unevenly dense.
 * by_each: each point has a place of its own. */
static enum status find_facing(struct run *run, const struct mesh *closed, bool sure, double *facing, bool *by_each) {
    struct views views = {0};
    bool sought = !sure;
    enum status status = pipeline_views(run, &views);
    if (!status) status = scan_pattern_check_told(run, &views);
    struct sheet_sides sides = {.viewed = views.is_one, .view = views.one, .views = views.each};
    if (!status && !views.is_one && !views.each) {
        if (!sought) status = eye_is_sought(run->points.point, run->points.count, run->threads, &sought);
        if (!status && sought) status = pipeline_seek_pattern(run);
        if (!status && (run->pattern.views.each || run->pattern.views.is_one)) pipeline_see_from_pattern(run, &sides);
    }
    if (!status) *facing = sheet_facing(closed, &sides);
    *by_each = sides.views;
    free(views.each);
    return status;
}

/* The solid angle of a triangle as seen from a place, negative from behind: van Oosterom and Strackee, The solid angle
 * of a plane triangle (1983). */
static double solid_angle(const struct mesh *mesh, size_t t, vec3 place) {
    vec3 to[3];
    double length[3];
    for (int k = 0; k < 3; k++) {
        to[k] = vec3_sub(mesh->vertex[mesh->triangle[t][k]], place);
        length[k] = vec3_length(to[k]);
    }
    double volume = vec3_dot(to[0], vec3_cross(to[1], to[2])), below = length[0] * length[1] * length[2];
    for (int k = 0; k < 3; k++) below += vec3_dot(to[k], to[(k + 1) % 3]) * length[(k + 2) % 3];
    return 2 * atan2(volume, below);
}

/* Whether the points tell of one place that lies outside of a closed mesh without a lid: of that a place sees
 * no back, on which there are points all the same.  The corners of turned and toothed bodies come ring by ring, at even
 * angles around their middle, though nobody has seen them from there. */
static bool is_place_refuted(const struct run *run, const struct mesh *closed) {
    const struct views *views = &run->pattern.views;
    vec3 place = views->one;
    double around = 0;
    bool known = views->is_one || (views->each && scan_pattern_one_place(run, &place));
    if (!known) return false;
    for (size_t t = 0; t < closed->triangle_count; t++) around += solid_angle(closed, t, place);
    return fabs(around) < 2 * M_PI; /* 0 from outside, 4 pi from inside */
}

enum status pipeline_faces_away(struct run *run, const struct mesh *closed, bool sure, bool *away) {
    static const double MOST = -0.5, LID = 0.93;
    double facing = 0;
    bool by_each = false;
    enum status status = find_facing(run, closed, sure, &facing, &by_each);
    *away = !status && (facing < MOST || (by_each && !sure && facing < LID) || scan_pattern_sees_no_back(run));
    if (*away && sure && is_place_refuted(run, closed)) *away = false;
    return status;
}

/* Whether a mesh is of a room, where nothing tells which side is in front. */
static enum status looks_like_room(const struct run *run, const struct mesh *mesh, struct gallery *gallery) {
    struct views views = {0};
    *gallery = (struct gallery){0};
    enum status status = pipeline_views(run, &views);
    bool told = views.is_one || views.each || run->pattern.places > 0 || run->normals_fit;
    free(views.each);
    return status || told ? status : sheet_is_room(mesh, run->threads, gallery);
}

/* A mesh with borders takes the closed one's place where *leaves says so of what the two are. */
struct doubt {
    const struct sites *sites;
    const struct tets *tets;
    struct mesh *mesh;
    struct reconstruct_facts *facts;
    bool away;           /* the closed mesh faces away from where the points were seen from */
    struct gallery skin; /* of the closed mesh */
    bool by_distance;    /* how far the points are from either counts, too */
    bool by_lid;         /* nothing counts but that a lid lies across the points' normals */
};

static bool is_left(const struct run *run, const struct doubt *doubt, const struct surface_match *closed,
                    const struct surface_match *open, struct surface_choice *choice) {
    const struct gallery *of = doubt->skin.room ? &doubt->skin : &run->gallery;
    if (doubt->by_lid) return surface_leave_closed(closed, open, run->faces_inwards, choice) && choice->lid;
    return (doubt->by_distance && surface_leave_closed(closed, open, run->faces_inwards, choice)) ||
           (doubt->away && surface_leave_away(closed, open, choice)) ||
           (of->room && run->faces_inwards && surface_leave_room(closed, open, 1 - of->outside, choice));
}

/* The points whose side isn't known so far take that of most of their neighbours, by the cosines of their normals. */
static void spread_outside(const struct run *run, const int8_t *known, int8_t *outside) {
    const struct neighbourhood *near = &run->neighbours;
    for (size_t p = 0; p < near->n; p++) {
        double sum = 0;
        for (size_t i = 0; !known[p] && i < near->count[p]; i++) {
            uint32_t q = near->id[p * near->stride + i];
            sum += known[q] * vec3_dot(run->normal[p], run->normal[q]);
        }
        outside[p] = known[p] ? known[p] : (int8_t)((sum > 0) - (sum < 0));
    }
}

/* Keeps which side of the points is outside of a closed mesh of some of them. */
static enum status keep_outside(struct run *run, const struct mesh *closed) {
    enum { ROUNDS = 4 };
    size_t n = run->points.count;
    int8_t *known = alloc_zeroed(n, 1);
    run->outside = alloc_zeroed(n, 1);
    bool ok = known && run->outside;
    for (size_t t = 0; ok && t < closed->triangle_count; t++) {
        vec3 normal = mesh_triangle_normal(closed, t);
        for (int k = 0; k < 3; k++) {
            uint32_t p = closed->source[closed->triangle[t][k]];
            run->outside[p] = vec3_dot(normal, run->normal[p]) >= 0 ? 1 : -1;
        }
    }
    for (int round = 0; ok && round < ROUNDS; round++) {
        memcpy(known, run->outside, n);
        spread_outside(run, known, run->outside);
    }
    free(known);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

/* What tells how near a mesh goes to the points is those that are none of its vertices: where most of them are, one
 * with borders is as near as any, whatever it misses.  So whether the points are as near to it is asked of meshes of
 * fewer of them, too, where these are enough to tell. */
static enum status ask_fewer(struct run *run, const struct doubt *doubt, bool *left) {
    enum { ENOUGH = 2000 };
    static const double TELLING = 0.3; /* of the points: the limits were measured with so many and fewer */
    size_t k = (size_t)(TELLING * (double)run->points.count);
    if (k < ENOUGH || k >= doubt->sites->count) return STATUS_OK;
    struct many fewer = {0};
    struct mesh closed = {0}, open = {0};
    struct surface_match of_closed = {0}, of_open = {0};
    struct reconstruct_facts facts = {0};
    struct surface_choice choice = run->surface;
    enum status status = pipeline_triangulate_many(run, k, &fewer);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_CLOSED, &fewer.sites, &fewer.tets, &closed, &facts);
    if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, &fewer.sites, &fewer.tets, &open, &facts);
    if (!status) status = pipeline_match(run, &closed, &of_closed);
    if (!status) status = pipeline_match(run, &open, &of_open);
    if (!status) *left = is_left(run, doubt, &of_closed, &of_open, &choice);
    mesh_done(&closed), mesh_done(&open);
    pipeline_many_done(&fewer);
    return status;
}

static enum status try_open(struct run *run, const struct doubt *doubt) {
    struct surface_match closed = {0}, open = {0};
    struct surface_choice choice = run->surface;
    struct report_surface told = run->report.surface; /* of the closed mesh */
    struct reconstruct_facts found = {0};
    struct mesh other = {0};
    enum status status = pipeline_reconstruct_as(run, SURFACE_OPEN, doubt->sites, doubt->tets, &other, &found);
    bool asked = run->gallery.outside > 0; /* by the orientation, where what components see of each other didn't tell */
    if (!status && doubt->by_distance && run->faces_inwards && !asked)
        status = looks_like_room(run, &other, &run->gallery);
    if (!status) status = pipeline_match(run, doubt->mesh, &closed);
    if (!status) status = pipeline_match(run, &other, &open);
    bool left = !status && is_left(run, doubt, &closed, &open, &choice);
    if (left && choice.lid) status = ask_fewer(run, doubt, &left);
    left = left && !status;
    bool of_room = left && choice.lid && run->faces_inwards; /* whose closed mesh has the wrong side outside */
    choice.room = choice.room || of_room;
    if (left && choice.lid && !of_room) {
        mesh_done(&other);
        status = keep_outside(run, doubt->mesh);
        if (!status) status = pipeline_reconstruct_as(run, SURFACE_OPEN, doubt->sites, doubt->tets, &other, &found);
    }
    if (!status && left) {
        struct mesh before = *doubt->mesh;
        *doubt->mesh = other, other = before;
        *doubt->facts = found;
        pipeline_decide(run, choice);
        run->report.level[run->level].reconstructed_from = doubt->sites->count; /* the closed one may be of more */
    } else {
        run->report.surface = told;
    }
    mesh_done(&other);
    return status == STATUS_LIMIT || status == STATUS_DEGENERATE ? STATUS_OK : status;
}

enum status pipeline_doubt_side(struct run *run, const struct sites *sites, const struct tets *tets, struct mesh *mesh,
                                struct reconstruct_facts *facts) {
    struct doubt doubt = {.sites = sites, .tets = tets, .mesh = mesh, .facts = facts};
    enum status status = pipeline_faces_away(run, mesh, run->surface.sure, &doubt.away);
    if (!status && run->surface.sure && !doubt.away) status = looks_like_room(run, mesh, &doubt.skin);
    return status || (!doubt.away && !doubt.skin.room) ? status : try_open(run, &doubt);
}

enum status pipeline_doubt_closed(struct run *run, const struct sites *sites, const struct tets *tets,
                                  struct mesh *mesh, struct reconstruct_facts *facts) {
    const struct doubt doubt = {.sites = sites, .tets = tets, .mesh = mesh, .facts = facts, .by_distance = true};
    return run->surface.sure ? STATUS_OK : try_open(run, &doubt);
}

enum status pipeline_doubt_lid(struct run *run, struct reconstruct_facts *facts) {
    const struct doubt doubt = {
        .sites = &run->sites, .tets = &run->tets, .mesh = &run->mesh, .facts = facts, .by_lid = true};
    bool judges = run->params->surface == SURFACE_AUTO && !run->closed_judged, faces_inwards = run->faces_inwards;
    const struct gallery gallery = run->gallery;
    enum status status = run->surface.sure || !judges ? STATUS_OK : try_open(run, &doubt);
    if (run->surface.form == SURFACE_CLOSED) run->faces_inwards = faces_inwards, run->gallery = gallery;
    return status;
}
