/* Flat points and candidates.
 *
 * A point is flat when its Voronoi cell is thin across its normal (the width, in the plane through the point) against
 * how far it reaches along it (the heights), and when the normals around it agree.  Points at boundaries, sharp edges
 * and in undersampled places aren't, and have no say on facets.
 *
 * Source: T. K. Dey, S. Goswami, Tight Cocone (2003), sections 2 and 3; T. K. Dey, J. Giesen, Detecting undersampling
 * in surface reconstruction (2001).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

#define THINNESS 1.2
#define FLAT_COSINE 0.5 /* of 60 degrees, between neighbouring normals as lines */

/* ------------------------------------------------------------------------------------------------ flat points */

/* Where the dual edge of a facet crosses the plane of v: squared distance from v, or 0 where it doesn't. */
static double crossing_sq(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t half, uint32_t v) {
    uint32_t near = cocone_star_cell(half), far = cocone_star_cell(cocone_star_twin(star, half));
    if (!cocone_star_is_finite(star, near)) {
        uint32_t swap = near;
        near = far;
        far = swap;
    }
    if (!cocone_star_is_finite(star, near)) return 0;
    bool is_ray = !cocone_star_is_finite(star, far);
    vec3 from = cocone_star_dual(star, near, v), to = cocone_star_dual(star, far, v), normal = frame->normal[v];
    vec3 along = is_ray ? to : vec3_sub(to, from);
    double height = vec3_dot(from, normal), slope = vec3_dot(along, normal);
    if (slope == 0) return 0;
    double t = -height / slope;
    if (t < 0 || (!is_ray && t > 1)) return 0;
    return vec3_length_sq(vec3_add(from, vec3_scale(along, t)));
}

/* Calls visit for every facet at v, once from either side; stops at the first false, which is the answer. */
static bool all_facets(const struct cocone_star *star, uint32_t v, bool (*visit)(void *ctx, uint32_t half), void *ctx) {
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        for (unsigned k = 0; k < 4; k++) {
            if (k == cocone_star_index(star->corner[i])) continue;
            if (!visit(ctx, cocone_star_pack(cocone_star_cell(star->corner[i]), k))) return false;
        }
    }
    return true;
}

struct view {
    const struct cocone_star *star;
    const struct cocone_frame *frame;
    uint32_t v;
    double width_sq;     /* found by widen */
    const uint8_t *flat; /* used by is_alone */
};

static bool widen(void *ctx, uint32_t half) {
    struct view *view = ctx;
    view->width_sq = fmax(view->width_sq, crossing_sq(view->star, view->frame, half, view->v));
    return true;
}

static bool normals_agree(const struct view *view, uint32_t q) {
    return fabs(vec3_dot(view->frame->normal[view->v], view->frame->normal[q])) >= FLAT_COSINE;
}

/* Whether q is another vertex of the facet, finite, and its cocone meets the dual edge. */
static bool is_cocone_neighbour(const struct view *view, uint32_t half, uint32_t q) {
    return q != view->v && q != NONE && cocone_frame_accepts(view->star, view->frame, half, q);
}

static bool agrees_with_all(void *ctx, uint32_t half) {
    const struct view *view = ctx;
    uint32_t vertex[3];
    cocone_star_vertices(view->star, half, vertex);
    for (int k = 0; k < 3; k++)
        if (is_cocone_neighbour(view, half, vertex[k]) && !normals_agree(view, vertex[k])) return false;
    return true;
}

static bool is_alone(void *ctx, uint32_t half) {
    const struct view *view = ctx;
    uint32_t vertex[3];
    cocone_star_vertices(view->star, half, vertex);
    for (int k = 0; k < 3; k++)
        if (is_cocone_neighbour(view, half, vertex[k]) && view->flat[vertex[k]] && normals_agree(view, vertex[k]))
            return false;
    return true;
}

/* How far the Voronoi cell reaches on the shorter side of the tangent plane. */
static double least_height(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t v) {
    double above_sq = 0, below_sq = 0;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        vec3 dual = cocone_star_dual(star, cell, v);
        double *side_sq = vec3_dot(dual, frame->normal[v]) < 0 ? &below_sq : &above_sq;
        if (cocone_star_is_finite(star, cell))
            *side_sq = fmax(*side_sq, vec3_length_sq(dual));
        else
            above_sq = INFINITY;
    }
    return sqrt(fmin(above_sq, below_sq));
}

/* thin[v]: the ratio test; flat[v]: and the normal test. */
static void find_flat(const struct cocone_star *star, const struct cocone_frame *frame, uint8_t *thin, uint8_t *flat) {
    for (uint32_t v = 0; v < star->n; v++) {
        struct view view = {star, frame, v, 0, NULL};
        all_facets(star, v, widen, &view);
        thin[v] = THINNESS * sqrt(view.width_sq) <= least_height(star, frame, v);
        flat[v] = thin[v] && all_facets(star, v, agrees_with_all, &view);
    }
}

/* Thin points next to a flat one with a like normal become flat, until none does. */
static void spread_flat(const struct cocone_star *star, const struct cocone_frame *frame, const uint8_t *thin,
                        uint8_t *flat) {
    for (bool changed = true; changed;) {
        changed = false;
        for (uint32_t v = 0; v < star->n; v++) {
            struct view view = {star, frame, v, 0, flat};
            if (flat[v] || !thin[v] || all_facets(star, v, is_alone, &view)) continue;
            flat[v] = 1;
            changed = true;
        }
    }
}

/* ------------------------------------------------------------------------------------------------ candidates */

static bool is_candidate(const struct cocone_star *star, const struct cocone_frame *frame, const uint8_t *flat,
                         uint32_t half) {
    uint32_t cell = cocone_star_cell(half), vertex[3];
    if (!cocone_star_is_finite(star, cell) || star->tets->neighbour[cell][cocone_star_index(half)] < cell) return false;
    int voters = 0;
    cocone_star_vertices(star, half, vertex);
    for (int k = 0; k < 3; k++) {
        if (!flat[vertex[k]]) continue;
        if (!cocone_frame_accepts(star, frame, half, vertex[k])) return false;
        voters++;
    }
    return voters > 0;
}

static void list_candidates(const struct cocone_star *star, const struct cocone_frame *frame,
                            struct cocone_facets *facets) {
    for (uint32_t half = 0; half < 4 * star->tets->cell_count; half++) facets->of_half[half] = NONE;
    facets->count = 0;
    for (uint32_t half = 0; half < 4 * star->tets->finite_count; half++) {
        if (!is_candidate(star, frame, facets->flat, half)) continue;
        facets->of_half[half] = facets->of_half[cocone_star_twin(star, half)] = (uint32_t)facets->count;
        facets->half[facets->count++] = half;
    }
}

static void list_around(const struct cocone_star *star, struct cocone_facets *facets) {
    uint32_t *begin = facets->begin;
    for (size_t f = 0; f < facets->count; f++) {
        facets->alive[f] = 1;
        cocone_star_vertices(star, facets->half[f], facets->vertex[f]);
        for (int k = 0; k < 3; k++) begin[facets->vertex[f][k]]++;
    }
    for (size_t v = 0; v < star->n; v++) begin[v + 1] += begin[v];
    for (size_t f = facets->count; f-- > 0;)
        for (int k = 0; k < 3; k++) facets->around[--begin[facets->vertex[f][k]]] = (uint32_t)f;
}

static enum status find_points(const struct cocone_star *star, const struct cocone_frame *frame,
                               struct cocone_facets *facets) {
    uint8_t *thin = alloc_array(star->n, 1);
    facets->flat = alloc_array(star->n, 1);
    if (thin && facets->flat) {
        find_flat(star, frame, thin, facets->flat);
        spread_flat(star, frame, thin, facets->flat);
    }
    free(thin);
    return thin && facets->flat ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status find_facets(const struct cocone_star *star, const struct cocone_frame *frame,
                               struct cocone_facets *facets) {
    size_t halves = 4 * star->tets->cell_count;
    facets->of_half = alloc_array(halves, sizeof *facets->of_half);
    facets->half = alloc_array(halves / 2, sizeof *facets->half);
    if (!facets->of_half || !facets->half) return STATUS_NO_MEMORY;
    list_candidates(star, frame, facets);
    facets->vertex = alloc_array(facets->count, sizeof *facets->vertex);
    facets->alive = alloc_array(facets->count, 1);
    facets->begin = alloc_zeroed(star->n + 1, sizeof *facets->begin);
    facets->around = alloc_array(3 * facets->count, sizeof *facets->around);
    if (!facets->vertex || !facets->alive || !facets->begin || !facets->around) return STATUS_NO_MEMORY;
    list_around(star, facets);
    return STATUS_OK;
}

enum status cocone_facets_find(const struct cocone_star *star, const struct cocone_frame *frame,
                               struct cocone_facets *out) {
    struct cocone_facets facets = {0};
    enum status status = find_points(star, frame, &facets);
    if (!status) status = find_facets(star, frame, &facets);
    if (status)
        cocone_facets_done(&facets);
    else
        *out = facets;
    return status;
}

void cocone_facets_done(struct cocone_facets *facets) {
    free(facets->half), free(facets->vertex), free(facets->alive);
    free(facets->of_half), free(facets->begin), free(facets->around);
    free(facets->flat);
    *facets = (struct cocone_facets){0};
}

bool cocone_facets_has(const struct cocone_facets *facets, uint32_t facet, uint32_t vertex) {
    const uint32_t *v = facets->vertex[facet];
    return v[0] == vertex || v[1] == vertex || v[2] == vertex;
}

uint32_t cocone_facets_apex(const struct cocone_facets *facets, uint32_t facet, uint32_t a, uint32_t b) {
    const uint32_t *v = facets->vertex[facet];
    return v[0] != a && v[0] != b ? v[0] : v[1] != a && v[1] != b ? v[1] : v[2];
}

double cocone_facets_cosine(const struct cocone_star *star, const struct cocone_facets *facets, uint32_t f, uint32_t g,
                            uint32_t a, uint32_t b) {
    const vec3 *p = star->point;
    vec3 edge = vec3_sub(p[b], p[a]);
    vec3 u = vec3_sub(p[cocone_facets_apex(facets, f, a, b)], p[a]);
    vec3 z = vec3_sub(p[cocone_facets_apex(facets, g, a, b)], p[a]);
    return vec3_dot(vec3_unit(vec3_cross(u, edge)), vec3_unit(vec3_cross(edge, z)));
}
