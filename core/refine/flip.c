/* A round measures what each edge would gain (in parallel, nothing changes), sorts, and flips the best that don't touch
 * each other (in order, so the result doesn't depend on threads).  Only then, in parallel again, are the samples shared
 * out, since no triangle is in two flips of a round.  Only edges of triangles that changed are measured again, and
 * those whose flip was put off because something changed around them.
 *
 * A flip must not fold the surface: the new pair turns by 90 degrees at most or by less than the old pair, each of the
 * two looks the way that the old pair did on average, neither folds onto the triangles around, and none gets thinner
 * than FIT_THIN unless the old pair was thinner still.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/refine/prefetch.h"

enum { TRIANGLE_GRAIN = 256, SHARE_GRAIN = 128 };

#define FLIP_LEAST_GAIN 1e-4 /* of what the two triangles cost */

struct candidate {
    double gain;
    uint32_t halfedge;
};

struct round {
    struct fit *fit;
    uint64_t *room; /* for radix_sort, and three items for each triangle */
    size_t *kept;   /* of each range of triangles: how many items it has there */
    uint64_t *item; /* in the room: edges that are flipped */
    size_t flips;
};

/* The two triangles that the flip of h would make. */
static void set_new_corners(const struct fit *fit, uint32_t h, struct triangle_corners corners[2]) {
    const vec3 *place = fit->mesh->vertex;
    uint32_t g = fit->he.twin[h];
    const vec3 *a = &place[halfedge_from(&fit->he, h)], *b = &place[halfedge_from(&fit->he, g)];
    const vec3 *c = &place[halfedge_apex(&fit->he, h)], *d = &place[halfedge_apex(&fit->he, g)];
    corners[0] = (struct triangle_corners){a, d, c};
    corners[1] = (struct triangle_corners){d, b, c};
}

/* Whether the edge g of old triangle `before` may be one of new triangle `after`. */
static bool border_is_fair(const struct fit *fit, uint32_t g, vec3 before, vec3 after) {
    uint32_t twin = fit->he.twin[g];
    if (twin == NONE) return true;
    vec3 outside = fit->facing[twin / 3].normal;
    return fit_fold_is_fair(fit, vec3_dot(outside, before), vec3_dot(outside, after));
}

static bool pair_faces_front(const struct fit *fit, const struct surface *made) {
    for (size_t k = 0; fit->has_front && k < 2; k++)
        if (!fit_faces_front(fit, surface_normal(made, k), surface_middle(made, k))) return false;
    return true;
}

static bool flip_is_fair(const struct fit *fit, uint32_t h, const struct surface *made) {
    const struct facing *left = &fit->facing[h / 3], *right = &fit->facing[fit->he.twin[h] / 3];
    vec3 old[2] = {left->normal, right->normal}, new[2] = {surface_normal(made, 0), surface_normal(made, 1)};
    vec3 mean = vec3_add(old[0], old[1]);
    if (!fit_fold_is_fair(fit, vec3_dot(old[0], old[1]), vec3_dot(new[0], new[1]))) return false;
    if (!fit->has_up && (vec3_dot(new[0], mean) <= 0 || vec3_dot(new[1], mean) <= 0)) return false;
    if (!pair_faces_front(fit, made)) return false;
    double before = triangle_frame_smaller(left->shape, right->shape);
    if (!fit_shape_is_fair(before, triangle_frame_smaller(surface_shape(made, 0), surface_shape(made, 1))))
        return false;
    uint32_t g = fit->he.twin[h];
    return border_is_fair(fit, halfedge_prev(h), old[0], new[0]) &&
           border_is_fair(fit, halfedge_next(h), old[0], new[1]) &&
           border_is_fair(fit, halfedge_next(g), old[1], new[0]) &&
           border_is_fair(fit, halfedge_prev(g), old[1], new[1]);
}

/* Whether the other diagonal isn't an edge yet. */
static bool flip_is_possible(const struct fit *fit, uint32_t h) {
    uint32_t c = halfedge_apex(&fit->he, h), d = halfedge_apex(&fit->he, fit->he.twin[h]);
    if (c == d) return false;
    if (fit->he.locked[c] == HALFEDGE_KNOTTED && fit->he.locked[d] == HALFEDGE_KNOTTED) return false;
    return fit->he.locked[c] == HALFEDGE_KNOTTED ? !halfedge_joined(&fit->he, d, c) : !halfedge_joined(&fit->he, c, d);
}

/* Gathers the samples of the two triangles. */
static void gather_sides(const struct fit *fit, uint32_t h, struct fit_region *region) {
    region->n = 2;
    region->triangle[0] = h / 3, region->triangle[1] = fit->he.twin[h] / 3;
    fit_gather(fit, region);
}

/* How much the flip of h lowers the cost; 0 when it doesn't, or isn't fair.  Sets the middles of what it makes, but
 * not in an unsampled area, where there are no samples to deviate from. */
static double flip_gain(const struct fit *fit, uint32_t h, const struct surface *made, struct fit_place middle[2]) {
    double cost = fit->cost[h / 3] + fit->cost[fit->he.twin[h] / 3];
    middle[0].nearest = middle[1].nearest = NONE;
    if (!flip_is_fair(fit, h, made)) return 0;
    struct fit_region region;
    gather_sides(fit, h, &region);
    double weight = sample_batch_weight(&region.batch), unsampled = fit_unsampled_gain(fit, &region, weight, h, made);
    if (fit_is_exact(weight, cost) && !(unsampled > 0)) return 0;
    double gain = cost + unsampled - fit_cost_with(fit, &region, made, cost + unsampled);
    if (!(gain > FLIP_LEAST_GAIN * cost)) return 0;
    for (size_t k = 0; k < 2; k++) middle[k].at = surface_middle(made, k);
    if (!(unsampled > 0)) fit_find_nearest(fit, &region, middle, 2);
    return gain;
}

/* Whether the flip leaves the surface where the data are. */
static bool flip_stays(const struct fit *fit, uint32_t h, const struct surface *made,
                       const struct fit_place middle[2]) {
    if (fit_deviation_sq(fit, middle, 2) <= fit->deviation_sq) return true;
    struct fit_region region;
    gather_sides(fit, h, &region);
    return fit_stays(fit, &region, made);
}

double fit_flip_cost(const struct fit *fit, uint32_t h, enum fit_fairness fairness) {
    struct triangle_corners corners[2];
    struct triangle_frames frames;
    struct fit_region region;
    set_new_corners(fit, h, corners);
    struct surface made = triangle_frames_make(&frames, corners, 2);
    if (!flip_is_possible(fit, h) || (fairness != FIT_REGARDLESS && !flip_is_fair(fit, h, &made))) return INFINITY;
    if (!pair_faces_front(fit, &made)) return INFINITY;
    gather_sides(fit, h, &region);
    if (fairness != FIT_REGARDLESS && !fit_stays(fit, &region, &made)) return INFINITY;
    return fit_cost_with(fit, &region, &made, INFINITY) - fit->cost[h / 3] - fit->cost[fit->he.twin[h] / 3];
}

enum { BATCH = 8 }; /* edges whose triangles are made together */

/* Whether the new triangles stay with the data is looked at last, when their nearest samples have come. */
static void measure_batch(const struct fit *fit, struct candidate *candidate, size_t n) {
    struct triangle_corners corners[2 * BATCH];
    struct triangle_frames frames;
    struct fit_place middle[BATCH][2];
    assert(n > 0 && n <= BATCH);
    for (size_t i = 0; i < n; i++) set_new_corners(fit, candidate[i].halfedge, &corners[2 * i]);
    struct surface all = triangle_frames_make(&frames, corners, 2 * n);
    for (size_t i = 0; i < n; i++) {
        struct surface made = {all.four, 2 * i, 2};
        candidate[i].gain = flip_gain(fit, candidate[i].halfedge, &made, middle[i]);
    }
    for (size_t i = 0; i < n; i++) {
        struct surface made = {all.four, 2 * i, 2};
        if (candidate[i].gain > 0 && !flip_stays(fit, candidate[i].halfedge, &made, middle[i])) candidate[i].gain = 0;
    }
}

struct span {
    size_t begin, end;
};

/* Candidates that are measured batch by batch. */
struct measuring {
    const struct fit *fit;
    struct candidate *candidate;
    size_t count;
};

static struct span span_of(const struct measuring *m, size_t batch) {
    size_t begin = batch * BATCH, left = m->count - begin;
    return (struct span){begin, begin + (left < BATCH ? left : BATCH)};
}

/* The triangle on either side of a candidate. */
static uint32_t flip_side(const struct measuring *m, size_t i, int side) {
    uint32_t h = m->candidate[i].halfedge;
    return (side ? m->fit->he.twin[h] : h) / 3;
}

static void fetch_batch_triangles(void *ctx, size_t batch) {
    const struct measuring *m = ctx;
    struct span span = span_of(m, batch);
    for (int side = 0; side < 2; side++)
        for (size_t i = span.begin; i < span.end; i++) fit_fetch_triangle(m->fit, flip_side(m, i, side));
}

static void fetch_batch_around(void *ctx, size_t batch) {
    const struct measuring *m = ctx;
    struct span span = span_of(m, batch);
    for (int side = 0; side < 2; side++)
        for (size_t i = span.begin; i < span.end; i++) fit_fetch_around(m->fit, flip_side(m, i, side));
}

static void fetch_batch_more(void *ctx, size_t batch) {
    const struct measuring *m = ctx;
    struct span span = span_of(m, batch);
    for (int side = 0; side < 2; side++)
        for (size_t i = span.begin; i < span.end; i++) fit_fetch_more(m->fit, flip_side(m, i, side));
}

static bool measure_one_batch(void *ctx, size_t batch) {
    const struct measuring *m = ctx;
    struct span span = span_of(m, batch);
    measure_batch(m->fit, &m->candidate[span.begin], span.end - span.begin);
    return true;
}

/* touched[t] & 1 stands for all edges of a triangle, the bits above it for those of its half-edges one by one. */
static uint8_t due_bit(uint32_t h) { return (uint8_t)(2 << h % 3); }

static bool is_due(const struct fit *fit, uint32_t h) { return fit->touched[h / 3] & (1 | due_bit(h)); }

/* The edges of a range of triangles that are due, once each in all ranges, and each by the lower of its half-edges. */
static size_t collect(const struct fit *fit, struct span range, struct candidate *candidate) {
    size_t count = 0;
    for (uint32_t t = (uint32_t)range.begin; t < range.end; t++) {
        if (!fit->touched[t]) continue;
        for (uint32_t h = 3 * t; h < 3 * t + 3; h++) {
            uint32_t g = fit->he.twin[h];
            if (g == NONE || (g < h && fit->touched[g / 3]) || !(is_due(fit, h) || is_due(fit, g))) continue;
            candidate[count++].halfedge = g < h ? g : h;
        }
    }
    return count;
}

/* The edges of a range that gain are left in the range's own part of the room. */
static void measure(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {4, fetch_batch_triangles}, {2, fetch_batch_around}, {1, fetch_batch_more}};
    const struct round *round = ctx;
    struct candidate candidate[3 * TRIANGLE_GRAIN];
    size_t count = collect(round->fit, (struct span){begin, end}, candidate), kept = 0;
    struct measuring measuring = {round->fit, candidate, count};
    for_each_prefetched(ahead, &measuring, 0, (count + BATCH - 1) / BATCH, measure_one_batch);
    for (size_t i = 0; i < count; i++)
        if (candidate[i].gain > 0)
            round->room[3 * begin + kept++] =
                radix_item(UINT32_MAX - radix_key_of(candidate[i].gain), candidate[i].halfedge);
    round->kept[begin / TRIANGLE_GRAIN] = kept;
}

/* The edges that gain, the most rewarding first, are set as the values of round->item; their number. */
static size_t sort_rewarding(struct round *round) {
    size_t kept = 0, triangles = round->fit->mesh->triangle_count;
    for (size_t begin = 0; begin < triangles; begin += TRIANGLE_GRAIN) {
        size_t n = round->kept[begin / TRIANGLE_GRAIN];
        memmove(&round->room[kept], &round->room[3 * begin], n * sizeof *round->room);
        kept += n;
    }
    round->item = radix_sort(round->room, round->room + kept, kept, round->fit->threads);
    return kept;
}

/* Whether any of the two triangles and the four around has changed in this round: then the gain isn't known. */
static bool is_outdated(const struct fit *fit, uint32_t h) {
    uint32_t side[2] = {h, fit->he.twin[h]};
    for (int i = 0; i < 2; i++) {
        if (fit->touched[side[i] / 3]) return true;
        uint32_t next = fit->he.twin[halfedge_next(side[i])], prev = fit->he.twin[halfedge_prev(side[i])];
        if ((next != NONE && fit->touched[next / 3]) || (prev != NONE && fit->touched[prev / 3])) return true;
    }
    return false;
}

/* The four edges around the flipped one are due, which isn't itself: it would only be flipped back. */
static void flip(struct fit *fit, uint32_t h) {
    uint32_t triangle[2] = {h / 3, fit->he.twin[h] / 3};
    halfedge_flip(&fit->he, h);
    uint8_t *tag = fit->mesh->tag;
    if (tag && tag[triangle[0]] != tag[triangle[1]]) tag[triangle[0]] = tag[triangle[1]] = MESH_SUPPORTED;
    for (int i = 0; i < 2; i++)
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t g = 3 * triangle[i] + k;
            if (fit->he.twin[g] == NONE || fit->he.twin[g] / 3 != triangle[1 - i])
                fit->touched[triangle[i]] |= due_bit(g);
            fit->stale[fit->mesh->triangle[triangle[i]][k]] = 1;
        }
}

void fit_flip_one(struct fit *fit, uint32_t h) {
    uint32_t triangle[2] = {h / 3, fit->he.twin[h] / 3};
    flip(fit, h);
    fit_share(fit, triangle, 2, triangle, 2);
}

static void fetch_edge(void *ctx, size_t i) {
    const struct round *round = ctx;
    fit_fetch_links(round->fit, radix_value(round->item[i]) / 3);
}

static void fetch_across(void *ctx, size_t i) {
    const struct round *round = ctx;
    uint32_t twin = round->fit->he.twin[radix_value(round->item[i])];
    if (twin != NONE) fit_fetch_links(round->fit, twin / 3);
}

static bool flip_if_fresh(void *ctx, size_t i) {
    struct round *round = ctx;
    uint32_t h = radix_value(round->item[i]);
    if (is_outdated(round->fit, h)) {
        round->fit->postponed[h / 3] |= due_bit(h);
    } else if (flip_is_possible(round->fit, h)) {
        flip(round->fit, h);
        round->item[round->flips++] = radix_item(h, h);
    }
    return true;
}

/* Flips the edges that are still what they were measured as, and keeps those, in the order of memory, in which their
 * samples are handed out faster; their number. */
static size_t flip_fresh(struct round *round, size_t count) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{16, fetch_edge}, {8, fetch_across}};
    round->flips = 0;
    for_each_prefetched(ahead, round, 0, count, flip_if_fresh);
    memmove(round->room, round->item, round->flips * sizeof *round->item);
    round->item = radix_sort(round->room, round->room + round->flips, round->flips, round->fit->threads);
    return round->flips;
}

/* The triangle on either side of the diagonal that a flip made. */
static uint32_t flipped_side(const struct round *round, size_t i, int side) {
    uint32_t t = radix_value(round->item[i]) / 3;
    return side ? round->fit->he.twin[3 * t + 1] / 3 : t;
}

static void fetch_flipped_triangles(void *ctx, size_t i) {
    const struct round *round = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_triangle(round->fit, flipped_side(round, i, side));
}

static void fetch_flipped_around(void *ctx, size_t i) {
    const struct round *round = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_around(round->fit, flipped_side(round, i, side));
}

static void fetch_flipped_samples(void *ctx, size_t i) {
    const struct round *round = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_samples(round->fit, flipped_side(round, i, side));
}

static bool share_one_flip(void *ctx, size_t i) {
    const struct round *round = ctx;
    uint32_t triangle[2] = {flipped_side(round, i, 0), flipped_side(round, i, 1)};
    fit_share(round->fit, triangle, 2, triangle, 2);
    return true;
}

static void share_flipped(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {6, fetch_flipped_triangles}, {4, fetch_flipped_around}, {2, fetch_flipped_samples}};
    for_each_prefetched(ahead, ctx, begin, end, share_one_flip);
}

static size_t flip_round(struct round *round) {
    struct fit *fit = round->fit;
    par_for(fit->threads, fit->mesh->triangle_count, TRIANGLE_GRAIN, measure, round);
    memset(fit->touched, 0, fit->mesh->triangle_count);
    size_t flips = flip_fresh(round, sort_rewarding(round));
    par_for(fit->threads, flips, SHARE_GRAIN, share_flipped, round);
    for (size_t t = 0; t < fit->mesh->triangle_count; t++) {
        fit->touched[t] |= fit->postponed[t];
        fit->postponed[t] = 0;
    }
    return flips;
}

enum status fit_flip(struct fit *fit, size_t rounds, size_t *flips) {
    size_t triangles = fit->mesh->triangle_count;
    struct round round = {.fit = fit};
    round.room = alloc_array(3 * triangles, sizeof *round.room);
    round.kept = alloc_array(triangles / TRIANGLE_GRAIN + 1, sizeof *round.kept);
    bool enough = round.room && round.kept;
    for (size_t i = 0; enough && i < rounds; i++) {
        size_t made = flip_round(&round);
        *flips += made;
        if (made == 0) break;
    }
    free(round.room), free(round.kept);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}
