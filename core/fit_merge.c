/* A vertex is merged into a neighbour: its fan becomes one around that neighbour, with two triangles less.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/fit_merge.h"

#include <string.h>

#include "core/cloud.h"

enum { ENDS = 3 };

struct fan {
    size_t n;
    uint32_t ring[FIT_MAX_RING];
    struct fit_region region;
    double cost;
};

/* i modulo n, for i < 2 n: a division takes longer than all else that is done with it. */
static size_t wrapped(size_t i, size_t n) { return i < n ? i : i - n; }

static bool fan_of(const struct fit *fit, uint32_t vertex, struct fan *fan) {
    fan->n = halfedge_ring(&fit->he, vertex, fan->ring, FIT_MAX_RING);
    fan->cost = 0;
    for (size_t i = 0; i < fan->n; i++) {
        fan->region.triangle[i] = fan->ring[i] / 3;
        fan->cost += fit->cost[fan->region.triangle[i]];
        __builtin_prefetch(&fit->facing[fan->region.triangle[i]]);
        uint32_t across = fit->he.twin[halfedge_next(fan->ring[i])];
        if (across != NONE) __builtin_prefetch(&fit->facing[across / 3]);
    }
    if (fan->n <= 3) return false;
    fan->region.n = fan->n;
    fit_gather(fit, &fan->region);
    return true;
}

static vec3 outside_normal(const struct fit *fit, uint32_t h, vec3 otherwise) {
    uint32_t across = fit->he.twin[h];
    return across == NONE ? otherwise : fit->facing[across / 3].normal;
}

/* Whether the fan without its vertex, all corners joined to the one at ring[to], folds nowhere. */
static bool merge_is_fair(const struct fit *fit, const struct fan *fan, size_t to, const struct surface *made) {
    size_t n = fan->n;
    vec3 before = outside_normal(fit, halfedge_next(fan->ring[to]), surface_normal(made, 0));
    for (size_t j = 0; j + 2 < n; j++) {
        size_t i = wrapped(to + 1 + j, n);
        vec3 new = surface_normal(made, j);
        const struct facing *old = &fit->facing[fan->region.triangle[i]];
        if (vec3_dot(old->normal, new) < FIT_OFFER_LEAST_TURN) return false;
        if (!fit_shape_is_fair(old->shape, surface_shape(made, j))) return false;
        vec3 outside = outside_normal(fit, halfedge_next(fan->ring[i]), new);
        if (!fit_fold_is_fair(vec3_dot(old->normal, outside), vec3_dot(new, outside))) return false;
        if (vec3_dot(before, new) < 0) return false;
        before = new;
    }
    vec3 last = outside_normal(fit, halfedge_next(fan->ring[wrapped(to + n - 1, n)]), before);
    return vec3_dot(last, before) >= 0;
}

/* n - 2 triangles, from the corner at ring[to] over those behind it. */
static struct surface merged(const struct fit *fit, const struct fan *fan, size_t to, struct triangle_frames *frames) {
    struct triangle_corners corners[FIT_MAX_RING];
    const vec3 *place = fit->mesh->vertex, *end = &place[halfedge_to(&fit->he, fan->ring[to])];
    for (size_t j = 0; j + 2 < fan->n; j++) {
        uint32_t h = fan->ring[wrapped(to + 1 + j, fan->n)];
        corners[j] =
            (struct triangle_corners){end, &place[halfedge_to(&fit->he, h)], &place[halfedge_apex(&fit->he, h)]};
    }
    return triangle_frames_make(frames, corners, fan->n - 2);
}

/* The neighbours that the vertex is nearest to, the nearest first; their number.  Farther ones are hardly ever worth
 * merging into, and measuring them takes half the time. */
static size_t nearest_ends(const struct fit *fit, const struct fan *fan, vec3 from, size_t end[ENDS]) {
    double distance_sq[ENDS];
    size_t count = 0;
    for (size_t i = 0; i < fan->n; i++) {
        double d_sq = vec3_distance_sq(from, fit_corner(fit, halfedge_next(fan->ring[i])));
        if (count == ENDS && d_sq >= distance_sq[ENDS - 1]) continue;
        size_t at = count < ENDS ? count++ : ENDS - 1;
        for (; at > 0 && distance_sq[at - 1] > d_sq; at--) distance_sq[at] = distance_sq[at - 1], end[at] = end[at - 1];
        distance_sq[at] = d_sq, end[at] = i;
    }
    return count;
}

/* A neighbour that the vertex may be merged into, and what the fan becomes. */
struct end {
    uint32_t h;
    struct surface made;
};

/* The nearest of those that aren't locked, and fold nothing; their number. */
static size_t fair_ends(const struct fit *fit, const struct fan *fan, vec3 from, struct triangle_frames frames[ENDS],
                        struct end end[ENDS]) {
    size_t to[ENDS], near = nearest_ends(fit, fan, from, to), count = 0;
    for (size_t i = 0; i < near; i++) {
        if (fit->he.locked[halfedge_to(&fit->he, fan->ring[to[i]])]) continue;
        struct surface made = merged(fit, fan, to[i], &frames[count]);
        if (merge_is_fair(fit, fan, to[i], &made)) end[count++] = (struct end){fan->ring[to[i]], made};
    }
    return count;
}

/* Which end is merged into for the least; the loss. */
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
struct fit_offer fit_merge_cheapest(const struct fit *fit, uint32_t vertex) {
    struct fit_offer none = {.value = INFINITY, .halfedge = NONE, .source = NONE};
    struct fan fan;
    if (fit->he.locked[vertex] || fit->he.out[vertex] == NONE || !fan_of(fit, vertex, &fan)) return none;
    struct triangle_frames frames[ENDS];
    struct end end[ENDS];
    size_t ends = fair_ends(fit, &fan, fit->mesh->vertex[vertex], frames, end), i = 0;
    for (double loss; (loss = cheapest_end(fit, &fan, end, ends, &i)) < INFINITY;) {
        if (fit_stays(fit, &fan.region, &end[i].made))
            return (struct fit_offer){.value = loss, .halfedge = end[i].h, .source = NONE};
        memmove(&end[i], &end[i + 1], (--ends - i) * sizeof *end);
    }
    return none;
}

/* About the volume between the star and what would close the gap: a vertex amid a plane has none. */
double fit_merge_estimate(const struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    if (fit->he.locked[vertex] || fit->he.out[vertex] == NONE) return INFINITY;
    size_t n = halfedge_ring(&fit->he, vertex, ring, FIT_MAX_RING);
    if (n < 4) return INFINITY;
    vec3 at = fit->mesh->vertex[vertex], area = {0}, spoke[FIT_MAX_RING];
    double part[FIT_MAX_RING], volume = 0;
    for (size_t i = 0; i < n; i++) spoke[i] = vec3_sub(fit_corner(fit, halfedge_next(ring[i])), at);
    for (size_t i = 0; i < n; i++) {
        vec3 normal = vec3_cross(spoke[i], spoke[i + 1 < n ? i + 1 : 0]);
        area = vec3_add(area, normal);
        part[i] = vec3_length(normal);
    }
    for (size_t i = 0; i < n; i++) volume += fabs(vec3_dot(spoke[i], area)) * part[i];
    double size = vec3_length(area);
    return size > 0 ? volume / size : 0;
}
