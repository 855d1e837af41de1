/* Flips, moves and reallocations look no farther than the triangles around them, so sheets that are near each other may
 * come to pass through each other, and so may what is folded more than once.  What crosses is looked for at the end,
 * with exact signs, and for each pair whatever leaves the fewest crossings is done, as long as there are fewer than
 * before: an edge of the two triangles is flipped, or a corner moved behind the other triangle, past an edge of it,
 * towards the middle of its neighbours or to one of the points of its star; among equals what costs least, and nothing
 * that costs very much if something else leaves fewer crossings at all.  Where nothing fair is left to do, triangles
 * may turn, and then fold: each round goes by what was left over.
 *
 * Where more pairs cross than there are triangles, two sheets lie at one place all over: no such changes part them, and
 * they are left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/intersect.h"

enum { ROUNDS = 8, POINTS_TRIED = 12, KNOWN_MOST = 16 };
enum { DEAR = 100 /* times what a triangle costs in the mean */ };
enum { TRIED_OF_EACH = 1, TRIED_LEAST = 30000 /* changes tried: for each triangle of the mesh, and in any case */ };

struct uncrossing {
    struct fit *fit;
    struct intersections *found;
    enum fit_fairness fairness;
    bool moves;
    uint8_t *stuck;   /* of each vertex: STUCK, HOPELESS */
    uint8_t *touched; /* of each triangle: changed since the pairs were looked for */
    bool unfair;      /* something would have left fewer crossings, but wasn't fair */
    bool changed;     /* something was done in this round */
    double dear;      /* what is done costs more than seldom */
    size_t tried, most;
};

/* No way out was found with a vertex: in this round, or, as long as nothing is done, in any, however unfair. */
enum { STUCK = 1, HOPELESS = 2 };

static bool is_stuck(const struct uncrossing *all, uint32_t vertex) {
    return all->stuck[vertex] & STUCK || (all->stuck[vertex] & HOPELESS && !all->changed);
}

/* What may be done: a flip of the edge of h, or vertex moved to place. */
struct way_out {
    uint32_t h, vertex, source;
    vec3 place;
    long crossings; /* more than before */
    double cost;    /* likewise */
};

/* Triangles that take the place of some of the mesh's. */
struct replacement {
    size_t n;
    size_t first; /* the one that is counted first */
    uint32_t triangle[FIT_MAX_RING];
    vec3 corner[FIT_MAX_RING][3];
    size_t known_count; /* triangles that crossed these lately: similar ones are likely to cross them too */
    uint32_t known[KNOWN_MOST];
};

static void set_corners(const struct fit *fit, uint32_t triangle, vec3 corner[3]) {
    for (int k = 0; k < 3; k++) corner[k] = fit->mesh->vertex[fit->mesh->triangle[triangle][k]];
}

static void remember(struct replacement *of, uint32_t triangle) {
    size_t i = 0;
    while (i < of->known_count && of->known[i] != triangle) i++;
    if (i == of->known_count && i < KNOWN_MOST) of->known[of->known_count++] = triangle;
}

/* Those of the triangle at i with all that stay, or `most` + 1, where they are more. */
static size_t find_crossings(const struct uncrossing *all, struct replacement *of, size_t i, size_t most) {
    uint32_t other[KNOWN_MOST + 1];
    size_t first = most < KNOWN_MOST ? most : KNOWN_MOST;
    size_t n = intersections_of(all->found, of->corner[i], of->triangle, of->n, other, first);
    for (size_t k = 0; k < n; k++) remember(of, other[k]);
    if (n <= first || first == most) return n;
    return intersections_of(all->found, of->corner[i], of->triangle, of->n, NULL, most);
}

/* Whether those that are known are more than `most` already. */
static bool known_exceed(const struct uncrossing *all, const struct replacement *of, long most) {
    long count = 0;
    for (size_t i = 0; i < of->n && count <= most && of->known_count; i++)
        count += (long)intersections_among(all->found, of->corner[i], of->known, of->known_count);
    return count > most;
}

/* Crossings of the triangles with each other and with all that stay; where they are more than `most`, some such number
 * tells that, and of->first becomes the triangle with which they were: similar ones are likely to have more there. */
static long count_crossings(const struct uncrossing *all, struct replacement *of, long most) {
    long count = 0;
    size_t first = of->first;
    if (known_exceed(all, of, most)) return most + 1;
    for (size_t j = 0; j < of->n && count <= most; j++) {
        size_t i = (first + j) % of->n;
        count += (long)find_crossings(all, of, i, (size_t)(most - count));
        for (size_t k = 0; k < i; k++) count += triangles_intersect(of->corner[i], of->corner[k]);
        if (count > most) of->first = i;
    }
    return count;
}

static bool is_dear(const struct uncrossing *all, const struct way_out *way) { return way->cost > all->dear; }

/* What leaves the fewest crossings is best, and among equals what costs least, but nothing that is dear beside what
 * isn't. */
static void take(const struct uncrossing *all, struct way_out *best, struct way_out way) {
    bool dear = is_dear(all, &way), is_cheaper = way.crossings == best->crossings && way.cost < best->cost;
    bool better = way.crossings < best->crossings || is_cheaper;
    if (way.crossings < 0 && (dear == is_dear(all, best) ? better : !dear)) *best = way;
}

/* More crossings than before, at most, for what is taken in place of the best. */
static long crossings_to_beat(const struct uncrossing *all, const struct way_out *best) {
    return is_dear(all, best) ? -1 : best->crossings;
}

/* ------------------------------------------------------------------------------------------------ flips */

static void try_flip(struct uncrossing *all, uint32_t h, struct way_out *best) {
    const struct fit *fit = all->fit;
    struct replacement now = {.n = 2};
    if (fit->he.twin[h] == NONE) return;
    double cost = fit_flip_cost(fit, h, all->fairness);
    all->tried++;
    if (!(cost < INFINITY)) return;
    now.triangle[0] = h / 3, now.triangle[1] = fit->he.twin[h] / 3;
    for (int i = 0; i < 2; i++) set_corners(fit, now.triangle[i], now.corner[i]);
    struct replacement then = now;
    vec3 a = fit_corner(fit, h), b = fit_corner(fit, fit->he.twin[h]);
    vec3 c = fit_corner(fit, halfedge_prev(h)), d = fit_corner(fit, halfedge_prev(fit->he.twin[h]));
    then.corner[0][0] = a, then.corner[0][1] = d, then.corner[0][2] = c;
    then.corner[1][0] = d, then.corner[1][1] = b, then.corner[1][2] = c;
    long before = count_crossings(all, &now, LONG_MAX), most = crossings_to_beat(all, best) + before;
    long crossings = count_crossings(all, &then, most) - before;
    take(all, best, (struct way_out){.h = h, .vertex = NONE, .crossings = crossings, .cost = cost});
}

/* ------------------------------------------------------------------------------------------------ moves */

/* A vertex that may move. */
struct mover {
    uint32_t vertex;
    struct replacement now;
    int corner[FIT_MAX_RING]; /* which of each triangle's it is */
    long crossings;
};

static bool mover_of(const struct uncrossing *all, uint32_t vertex, struct mover *mover) {
    const struct fit *fit = all->fit;
    uint32_t ring[FIT_MAX_RING];
    if (fit->he.locked[vertex] != HALFEDGE_FREE) return false;
    mover->vertex = vertex;
    mover->now.n = fit_ring(fit, vertex, ring);
    mover->now.first = mover->now.known_count = 0;
    for (size_t i = 0; i < mover->now.n; i++) {
        mover->now.triangle[i] = ring[i] / 3;
        mover->corner[i] = (int)(ring[i] % 3);
        set_corners(fit, ring[i] / 3, mover->now.corner[i]);
    }
    mover->crossings = mover->now.n ? count_crossings(all, &mover->now, LONG_MAX) : 0;
    return mover->crossings > 0;
}

static void try_place(struct uncrossing *all, struct mover *mover, vec3 place, uint32_t source, struct way_out *best) {
    struct replacement then = mover->now;
    all->tried++;
    if (vec3_equal(place, all->fit->mesh->vertex[mover->vertex])) return; /* as behind a triangle of its own */
    for (size_t i = 0; i < then.n; i++) then.corner[i][mover->corner[i]] = place;
    long most = crossings_to_beat(all, best);
    long crossings = count_crossings(all, &then, most + mover->crossings) - mover->crossings;
    mover->now.first = then.first, mover->now.known_count = then.known_count;
    memcpy(mover->now.known, then.known, sizeof then.known);
    if (crossings > most) return;
    double cost = fit_move_cost(all->fit, mover->vertex, place, all->fairness);
    if (cost < INFINITY)
        take(all, best, (struct way_out){NONE, mover->vertex, source, place, crossings, cost});
    else
        all->unfair = true;
}

/* Behind the other triangle's plane, a little farther and farther. */
static void try_behind(struct uncrossing *all, struct mover *mover, uint32_t other, struct way_out *best) {
    static const double part[] = {1.05, 1.3, 2};
    const struct fit *fit = all->fit;
    vec3 corner[3], at = fit->mesh->vertex[mover->vertex];
    set_corners(fit, other, corner);
    vec3 normal = vec3_unit(vec3_triangle_normal(corner[0], corner[1], corner[2]));
    double deepest = vec3_dot(normal, vec3_sub(at, corner[0]));
    for (size_t i = 0; i < sizeof part / sizeof *part; i++)
        try_place(all, mover, vec3_sub(at, vec3_scale(normal, part[i] * deepest)), NONE, best);
}

static void try_towards_neighbours(struct uncrossing *all, struct mover *mover, struct way_out *best) {
    static const double part[] = {0.25, 0.5, 1};
    const struct fit *fit = all->fit;
    vec3 sum = {0}, at = fit->mesh->vertex[mover->vertex];
    for (size_t i = 0; i < mover->now.n; i++) sum = vec3_add(sum, mover->now.corner[i][(mover->corner[i] + 1) % 3]);
    vec3 middle = vec3_scale(sum, 1 / (double)mover->now.n);
    for (size_t i = 0; i < sizeof part / sizeof *part; i++)
        try_place(all, mover, vec3_lerp(at, middle, part[i]), NONE, best);
}

/* Points of the star, evenly from among them. */
static void try_points(struct uncrossing *all, struct mover *mover, struct way_out *best) {
    const struct fit *fit = all->fit;
    struct fit_region region = {.n = mover->now.n};
    for (size_t i = 0; i < region.n; i++) region.triangle[i] = mover->now.triangle[i];
    fit_gather(fit, &region);
    size_t step = region.batch.n / POINTS_TRIED + 1;
    for (size_t i = 0; i < region.batch.n; i += step) {
        uint32_t point = samples_point(&fit->samples, region.batch.sample[i]);
        if (point == NONE || fit->taken[point]) continue;
        try_place(all, mover, fit->input->points[point], point, best);
    }
}

static void try_moves(struct uncrossing *all, uint32_t vertex, const uint32_t other[2], struct way_out *best) {
    struct mover mover;
    if (!mover_of(all, vertex, &mover)) return;
    try_points(all, &mover, best);
    if (all->fit->placement != PLACEMENT_OPTIMAL) return;
    try_behind(all, &mover, other[0], best);
    try_behind(all, &mover, other[1], best);
    try_towards_neighbours(all, &mover, best);
}

/* Past the edges of the other triangle that the vertex lies beside, as where two sheets that lie in one plane overlap.
 */
static void try_past_edges(struct uncrossing *all, struct mover *mover, uint32_t other, struct way_out *best) {
    static const double part[] = {1.05, 1.3, 2};
    const struct fit *fit = all->fit;
    vec3 corner[3], at = fit->mesh->vertex[mover->vertex];
    set_corners(fit, other, corner);
    for (int k = 0; k < 3; k++) {
        vec3 edge = vec3_sub(corner[(k + 1) % 3], corner[k]), from = vec3_sub(at, corner[k]);
        double along = vec3_dot(from, edge) / vec3_dot(edge, edge);
        if (!(along > 0 && along < 1)) continue;
        vec3 off = vec3_sub(from, vec3_scale(edge, along));
        for (size_t i = 0; i < sizeof part / sizeof *part; i++)
            try_place(all, mover, vec3_sub(at, vec3_scale(off, part[i])), NONE, best);
    }
}

static void try_small_moves(struct uncrossing *all, uint32_t vertex, const uint32_t other[2], struct way_out *best) {
    struct mover mover;
    if (all->fit->placement != PLACEMENT_OPTIMAL || !mover_of(all, vertex, &mover)) return;
    for (int i = 0; i < 2; i++) try_past_edges(all, &mover, other[i], best);
}

/* ------------------------------------------------------------------------------------------------ pairs */

static void update(struct uncrossing *all, uint32_t triangle) {
    intersections_update(all->found, triangle);
    all->touched[triangle] = 1;
}

static void make_way(struct uncrossing *all, const struct way_out *way) {
    struct fit *fit = all->fit;
    if (way->vertex == NONE) {
        uint32_t triangle[2] = {way->h / 3, fit->he.twin[way->h] / 3};
        fit_flip_one(fit, way->h);
        for (int i = 0; i < 2; i++) update(all, triangle[i]);
        return;
    }
    uint32_t ring[FIT_MAX_RING], before = fit->mesh->source ? fit->mesh->source[way->vertex] : NONE;
    size_t n = fit_ring(fit, way->vertex, ring);
    fit_leave(fit, before);
    fit_take(fit, way->source);
    fit_move_one(fit, way->vertex, way->place, way->source);
    for (size_t i = 0; i < n; i++) update(all, ring[i] / 3);
}

/* Where no way out was found: a vertex with which none was unfair either is without hope. */
static void set_stuck(struct uncrossing *all, const uint32_t vertex[6], const bool unfair[6]) {
    for (int i = 0; i < 6; i++) {
        bool is_new = !is_stuck(all, vertex[i]);
        all->stuck[vertex[i]] |= STUCK;
        if (is_new && !unfair[i]) all->stuck[vertex[i]] |= HOPELESS;
    }
}

/* Whether the pair crossed, and something was done about it. */
static bool part_pair(struct uncrossing *all, const uint32_t pair[2]) {
    const struct fit *fit = all->fit;
    vec3 a[3], b[3];
    uint32_t vertex[6];
    bool unfair[6];
    struct way_out best = {.h = NONE, .vertex = NONE, .crossings = -1, .cost = INFINITY};
    set_corners(fit, pair[0], a), set_corners(fit, pair[1], b);
    if (!triangles_intersect(a, b)) return false;
    for (uint32_t i = 0; i < 6; i++) {
        uint32_t h = 3 * pair[i / 3] + i % 3;
        vertex[i] = fit->mesh->triangle[pair[i / 3]][i % 3];
        all->unfair = false;
        try_flip(all, h, &best);
        if (all->moves && !is_stuck(all, vertex[i])) try_moves(all, vertex[i], pair, &best);
        unfair[i] = all->unfair;
    }
    bool is_last = all->moves && all->fairness == FIT_REGARDLESS;
    for (size_t i = 0; i < 6 && is_last && is_dear(all, &best); i++) {
        all->unfair = false;
        if (!is_stuck(all, vertex[i])) try_small_moves(all, vertex[i], pair, &best);
        unfair[i] |= all->unfair;
    }
    if (best.h == NONE && best.vertex == NONE) {
        set_stuck(all, vertex, unfair);
        return false;
    }
    make_way(all, &best);
    all->changed = true;
    return true;
}

/* What was stuck may be so no more in the next round, but for the hopeless, where nothing was done in this one. */
static void begin_round(struct uncrossing *all) {
    for (size_t v = 0; v < all->fit->mesh->vertex_count; v++) all->stuck[v] &= all->changed ? 0 : HOPELESS;
    all->changed = false;
}

/* The pairs are looked for again only where something was done about them. */
static enum status part_all(struct uncrossing *all, size_t *changes) {
    struct fit *fit = all->fit;
    enum status status = STATUS_OK;
    uint32_t(*pair)[2] = NULL;
    size_t n = 0, parted = 1;
    for (int i = 0; i < ROUNDS && !status; i++) {
        if (parted > 0) {
            status = pair ? intersections_list_again(all->found, all->touched, &pair, &n)
                          : intersections_list(all->found, fit->threads, &pair, &n);
            if (status || n == 0 || n > fit->mesh->triangle_count) break;
            memset(all->touched, 0, fit->mesh->triangle_count);
        }
        begin_round(all);
        parted = 0;
        for (size_t k = 0; k < n && all->tried < all->most; k++) parted += part_pair(all, pair[k]);
        *changes += parted;
        if (all->tried >= all->most || (parted == 0 && all->fairness == FIT_REGARDLESS)) break;
        if (parted == 0) all->fairness++;
    }
    free(pair);
    return status;
}

enum status fit_uncross(struct fit *fit, bool moves, size_t *changes) {
    struct uncrossing all = {.fit = fit, .moves = moves};
    for (size_t t = 0; t < fit->mesh->triangle_count; t++)
        all.dear += DEAR * fit->cost[t] / (double)fit->mesh->triangle_count;
    all.most = TRIED_OF_EACH * fit->mesh->triangle_count + TRIED_LEAST;
    all.stuck = alloc_zeroed(fit->mesh->vertex_count, 1);
    all.touched = alloc_zeroed(fit->mesh->triangle_count, 1);
    enum status status = STATUS_NO_MEMORY;
    if (all.stuck && all.touched) status = intersections_new(fit->mesh, fit->threads, &all.found);
    if (!status) status = part_all(&all, changes);
    intersections_free(all.found);
    free(all.stuck), free(all.touched);
    return status;
}
