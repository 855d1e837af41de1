/* A vertex is collapsed into a neighbour: its fan becomes one around that neighbour, with two triangles less.  On a
 * border, along which alone a vertex is collapsed there, it is one less.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <string.h>

#include "core/cloud/cloud.h"

enum { ENDS = 3 };

struct fan {
    size_t n, neighbours; /* as many as triangles, or one more on a border */
    uint32_t vertex, ring[FIT_MAX_RING];
    struct fit_region region;
    double cost;
};

/* i modulo n, for i < 2 n: a division takes longer than all else that is done with it. */
static size_t wrapped(size_t i, size_t n) { return i < n ? i : i - n; }

static bool fan_of(const struct fit *fit, uint32_t vertex, struct fan *fan) {
    bool on_border = fit_is_on_border(fit, vertex);
    fan->vertex = vertex;
    fan->n = fit_ring(fit, vertex, fan->ring);
    fan->neighbours = fan->n + on_border;
    fan->cost = 0;
    for (size_t i = 0; i < fan->n; i++) {
        fan->region.triangle[i] = fan->ring[i] / 3;
        fan->cost += fit->cost[fan->region.triangle[i]];
        prefetch(&fit->facing[fan->region.triangle[i]]);
        uint32_t across = fit->he.twin[halfedge_next(fan->ring[i])];
        if (across != NONE) prefetch(&fit->facing[across / 3]);
    }
    if (fan->n <= (on_border ? 1 : 3)) return false;
    fan->region.n = fan->n;
    fit_gather(fit, &fan->region);
    return true;
}

/* What a fan becomes without its vertex, all corners joined to neighbour `to`: triangles over those behind it. */
struct merger {
    size_t to, first, n; /* the fan's triangles that stay, from the first on */
};

static struct merger merger_of(const struct fan *fan, size_t to) {
    bool closed = fan->neighbours == fan->n;
    return (struct merger){to, closed || to == 0 ? wrapped(to + 1, fan->n) : 0, closed ? fan->n - 2 : fan->n - 1};
}

/* The rim's edge that the first of the new triangles takes along, from neighbour `to` to the next one; NONE where the
 * fan ends there. */
static uint32_t side_before(const struct fan *fan, const struct merger *merger) {
    return merger->to < fan->n ? halfedge_next(fan->ring[merger->to]) : NONE;
}

/* And that of the last one, from the neighbour before `to` to it. */
static uint32_t side_behind(const struct fan *fan, const struct merger *merger) {
    if (fan->neighbours == fan->n) return halfedge_next(fan->ring[wrapped(merger->to + fan->n - 1, fan->n)]);
    return merger->to == 0 ? NONE : halfedge_next(fan->ring[fan->n - 1]);
}

static vec3 outside_normal(const struct fit *fit, uint32_t h, vec3 otherwise) {
    uint32_t across = h == NONE ? NONE : fit->he.twin[h];
    return across == NONE ? otherwise : fit->facing[across / 3].normal;
}

/* Whether the fan without its vertex folds nowhere. */
static bool merge_is_fair(const struct fit *fit, const struct fan *fan, size_t to, const struct surface *made) {
    struct merger merger = merger_of(fan, to);
    vec3 before = outside_normal(fit, side_before(fan, &merger), surface_normal(made, 0));
    for (size_t j = 0; j < merger.n; j++) {
        size_t i = wrapped(merger.first + j, fan->n);
        vec3 new = surface_normal(made, j);
        const struct facing *old = &fit->facing[fan->region.triangle[i]];
        if (!fit_faces_front(fit, new, surface_middle(made, j))) return false;
        if (vec3_dot(old->normal, new) < fit_least_turn(fit, FIT_CANDIDATE_LEAST_TURN)) return false;
        if (!fit_shape_is_fair(old->shape, surface_shape(made, j))) return false;
        vec3 outside = outside_normal(fit, halfedge_next(fan->ring[i]), new);
        if (!fit_fold_is_fair(fit, vec3_dot(old->normal, outside), vec3_dot(new, outside))) return false;
        if (!fit->has_up && vec3_dot(before, new) < fit->fold) return false;
        before = new;
    }
    return fit->has_up || vec3_dot(outside_normal(fit, side_behind(fan, &merger), before), before) >= fit->fold;
}

static struct surface merged(const struct fit *fit, const struct fan *fan, size_t to, struct triangle_frames *frames) {
    struct triangle_corners corners[FIT_MAX_RING];
    struct merger merger = merger_of(fan, to);
    const vec3 *place = fit->mesh->vertex, *end = &place[fit_rim_vertex(fit, fan->ring, fan->n, to)];
    for (size_t j = 0; j < merger.n; j++) {
        uint32_t h = fan->ring[wrapped(merger.first + j, fan->n)];
        corners[j] =
            (struct triangle_corners){end, &place[halfedge_to(&fit->he, h)], &place[halfedge_apex(&fit->he, h)]};
    }
    return triangle_frames_make(frames, corners, merger.n);
}

/* The neighbours that the vertex is nearest to, the nearest first; their number.  Farther ones are hardly ever worth
 * merging into, and measuring them takes half the time.  On a border there are two alone. */
static size_t nearest_ends(const struct fit *fit, const struct fan *fan, vec3 from, size_t end[ENDS]) {
    double distance_sq[ENDS];
    size_t count = 0, step = fan->neighbours > fan->n ? fan->n : 1;
    for (size_t i = 0; i < fan->neighbours; i += step) {
        double d_sq = vec3_distance_sq(from, fit->mesh->vertex[fit_rim_vertex(fit, fan->ring, fan->n, i)]);
        if (count == ENDS && d_sq >= distance_sq[ENDS - 1]) continue;
        size_t at = count < ENDS ? count++ : ENDS - 1;
        for (; at > 0 && distance_sq[at - 1] > d_sq; at--) distance_sq[at] = distance_sq[at - 1], end[at] = end[at - 1];
        distance_sq[at] = d_sq, end[at] = i;
    }
    return count;
}

/* A neighbour that the vertex may be collapsed into, and what the fan becomes. */
struct end {
    uint32_t h;
    struct surface made;
};

/* The nearest of those that aren't knotted, and fold nothing; their number. */
static size_t fair_ends(const struct fit *fit, const struct fan *fan, vec3 from, struct triangle_frames frames[ENDS],
                        struct end end[ENDS]) {
    size_t to[ENDS], near = nearest_ends(fit, fan, from, to), count = 0;
    for (size_t i = 0; i < near; i++) {
        if (fit->he.locked[fit_rim_vertex(fit, fan->ring, fan->n, to[i])] == HALFEDGE_KNOTTED) continue;
        struct surface made = merged(fit, fan, to[i], &frames[count]);
        uint32_t h = to[i] < fan->n ? fan->ring[to[i]] : halfedge_prev(fan->ring[fan->n - 1]);
        if (merge_is_fair(fit, fan, to[i], &made)) end[count++] = (struct end){h, made};
    }
    return count;
}

/* Which end is collapsed into for the least; the loss. */
static double cheapest_end(const struct fit *fit, const struct fan *fan, const struct end *end, size_t ends,
                           size_t *which) {
    double loss = INFINITY;
    for (size_t i = 0; i < ends; i++) {
        double limit = loss + fan->cost, cost = fit_cost_with(fit, &fan->region, &end[i].made, limit);
        if (cost < limit) loss = cost - fan->cost, *which = i;
    }
    return loss;
}

/* Whether the surface stays is looked at last: that takes as long as finding what it costs.  Whether the edge may be
 * collapsed, which is hardly ever in doubt, is looked at when it is going to be. */
struct fit_candidate fit_collapse_cheapest(const struct fit *fit, uint32_t vertex) {
    struct fit_candidate none = {.value = INFINITY, .halfedge = NONE, .vertex = vertex, .source = NONE};
    struct fan fan;
    if (fit->he.locked[vertex] == HALFEDGE_KNOTTED || fit->he.out[vertex] == NONE || !fan_of(fit, vertex, &fan))
        return none;
    struct triangle_frames frames[ENDS];
    struct end end[ENDS];
    size_t ends = fair_ends(fit, &fan, fit->mesh->vertex[vertex], frames, end), i = 0;
    for (double loss; (loss = cheapest_end(fit, &fan, end, ends, &i)) < INFINITY;) {
        if (fit_stays(fit, &fan.region, &end[i].made))
            return (struct fit_candidate){.value = loss, .halfedge = end[i].h, .vertex = vertex, .source = NONE};
        memmove(&end[i], &end[i + 1], (--ends - i) * sizeof *end);
    }
    return none;
}

/* About the volume between the star and what would close the gap: a vertex amid a plane has none.  On a border it is
 * closed by the triangle to the two neighbours along it, which counts as if it were as far off as it is wide. */
double fit_collapse_estimate(const struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    if (fit->he.locked[vertex] == HALFEDGE_KNOTTED || fit->he.out[vertex] == NONE) return INFINITY;
    bool on_border = fit_is_on_border(fit, vertex);
    size_t n = fit_ring(fit, vertex, ring);
    if (n < (on_border ? 2 : 4)) return INFINITY;
    vec3 at = fit->mesh->vertex[vertex], area = {0}, spoke[FIT_MAX_RING];
    double part[FIT_MAX_RING], volume = 0;
    for (size_t i = 0; i < n + on_border; i++)
        spoke[i] = vec3_sub(fit->mesh->vertex[fit_rim_vertex(fit, ring, n, i)], at);
    for (size_t i = 0; i < n; i++) {
        vec3 normal = vec3_cross(spoke[i], spoke[i + 1 < n + on_border ? i + 1 : 0]);
        area = vec3_add(area, normal);
        part[i] = vec3_length(normal);
    }
    for (size_t i = 0; i < n; i++) volume += fabs(vec3_dot(spoke[i], area)) * part[i];
    double size = vec3_length(area), width = on_border ? vec3_distance(spoke[0], spoke[n]) : 0;
    double ear = on_border ? vec3_length(vec3_cross(spoke[0], spoke[n])) : 0;
    return (size > 0 ? volume / size : 0) + (width > 0 ? ear * ear / width : 0);
}
