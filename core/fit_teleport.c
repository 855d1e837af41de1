/* What each vertex costs when it is merged into its best neighbour, and what each edge gains when a vertex is put on
 * it, is measured in parallel with nothing changed.  Then the cheapest loss pays for the greatest gain, the next for
 * the next, skipping whatever touches triangles that changed, until a gain no longer pays.  In order, so the result
 * doesn't depend on threads; what the trades do to samples is done afterwards, in parallel, since no triangle is in two
 * of them.
 *
 * Both are measured before flips and moves help, so a pair that breaks even now will gain.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/fit_teleport.h"

#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"
#include "core/radix.h"

enum { GRAIN = 64, ESTIMATES = 4096, DEALS = 16, ENDS = 3, CACHE_LINE = 64 };

#define TELEPORT_PAYS 0.7 /* gain over loss, at least */
#define TELEPORT_MOST 0.2 /* of the vertices */
#define LEAST_TURN 0.2    /* smallest cosine between the normals of a triangle and what takes its place */

enum { PLACES = 6 };

/* So many vertices are measured for leaving, and so many edges for being split, both for each vertex, and in so many
 * places.  A vertex that may stand anywhere finds more that are worth it. */
static const struct parts {
    double cheap, dear;
    size_t places; /* at most PLACES */
} parts_of[] = {[PLACEMENT_SUBSET] = {0.2, 0.3, 4}, [PLACEMENT_OPTIMAL] = {0.4, 0.6, PLACES}};

static size_t part_of(const struct fit *fit, double part) {
    return (size_t)(part * (double)fit->mesh->vertex_count) + 1;
}

/* A vertex that may go: the half-edge to the neighbour that it merges into.  Or an edge that may be split, and where.
 */
struct offer {
    double value; /* loss, or gain */
    uint32_t halfedge, source;
    vec3 place;
};

/* What may be offered, by a key that is quick to find, and what of it is: items of radix_sort. */
struct market {
    struct fit *fit;
    uint64_t *item;      /* in the order of memory, in which they are read faster */
    struct offer *offer; /* of each item */
    uint64_t *order;     /* of offers */
};

#define NEVER UINT32_MAX /* key of what can't be offered */

/* ---------------------------------------------------------------------------------------------- taking out */

struct fan {
    size_t n;
    uint32_t ring[FIT_MAX_RING];
    struct fit_region region;
    double cost;
};

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
        size_t i = (to + 1 + j) % n;
        vec3 new = surface_normal(made, j);
        const struct facing *old = &fit->facing[fan->region.triangle[i]];
        if (vec3_dot(old->normal, new) < LEAST_TURN) return false;
        if (!fit_shape_is_fair(old->shape, surface_shape(made, j))) return false;
        vec3 outside = outside_normal(fit, halfedge_next(fan->ring[i]), new);
        if (!fit_fold_is_fair(vec3_dot(old->normal, outside), vec3_dot(new, outside))) return false;
        if (vec3_dot(before, new) < 0) return false;
        before = new;
    }
    vec3 last = outside_normal(fit, halfedge_next(fan->ring[(to + n - 1) % n]), before);
    return vec3_dot(last, before) >= 0;
}

/* n - 2 triangles, from the corner at ring[to] over those behind it. */
static struct surface merged(const struct fit *fit, const struct fan *fan, size_t to, struct triangle_frames *frames) {
    struct triangle_corners corners[FIT_MAX_RING];
    const vec3 *place = fit->mesh->vertex, *end = &place[halfedge_to(&fit->he, fan->ring[to])];
    for (size_t j = 0; j + 2 < fan->n; j++) {
        uint32_t h = fan->ring[(to + 1 + j) % fan->n];
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
static struct offer cheapest_merge(const struct fit *fit, uint32_t vertex) {
    struct offer none = {.value = INFINITY, .halfedge = NONE, .source = NONE};
    struct fan fan;
    if (fit->he.locked[vertex] || fit->he.out[vertex] == NONE || !fan_of(fit, vertex, &fan)) return none;
    struct triangle_frames frames[ENDS];
    struct end end[ENDS];
    size_t ends = fair_ends(fit, &fan, fit->mesh->vertex[vertex], frames, end), i = 0;
    for (double loss; (loss = cheapest_end(fit, &fan, end, ends, &i)) < INFINITY;) {
        if (fit_stays(fit, &fan.region, &end[i].made))
            return (struct offer){.value = loss, .halfedge = end[i].h, .source = NONE};
        memmove(&end[i], &end[i + 1], (--ends - i) * sizeof *end);
    }
    return none;
}

/* Asks for what is going to be read: the samples of a star lie all over memory. */
static void fetch_fan(const struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = halfedge_ring(&fit->he, vertex, ring, FIT_MAX_RING);
    for (size_t i = 0; i < n; i++) {
        uint32_t triangle = ring[i] / 3, first = fit->lists.first[triangle];
        __builtin_prefetch(&fit->facing[triangle]);
        if (first == NONE) continue;
        const char *block = (const char *)&fit->lists.block[first];
        for (size_t k = 0; k < sizeof(struct sample_block); k += CACHE_LINE) __builtin_prefetch(block + k);
    }
}

static void measure_merges(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    for (size_t i = begin; i < end; i++) {
        if (i + 1 < end) fetch_fan(market->fit, radix_value(market->item[i + 1]));
        market->offer[i] = cheapest_merge(market->fit, radix_value(market->item[i]));
    }
}

/* About the volume between the star and what would close the gap: a vertex amid a plane has none. */
static double merge_estimate(const struct fit *fit, uint32_t vertex) {
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

/* ---------------------------------------------------------------------------------------------- putting in */

struct gap {
    struct fit_region region;
    const vec3 *a, *b, *c, *d;
    struct triangle_frames frames;
    double cost;
};

static void gap_of(const struct fit *fit, uint32_t h, struct gap *gap) {
    uint32_t g = fit->he.twin[h];
    const vec3 *place = fit->mesh->vertex;
    gap->a = &place[halfedge_from(&fit->he, h)];
    gap->b = &place[halfedge_from(&fit->he, g)];
    gap->c = &place[halfedge_apex(&fit->he, h)];
    gap->d = &place[halfedge_apex(&fit->he, g)];
    gap->cost = fit->cost[h / 3] + fit->cost[g / 3];
    gap->region.n = 2;
    gap->region.triangle[0] = h / 3;
    gap->region.triangle[1] = g / 3;
    fit_gather(fit, &gap->region);
}

static bool split_is_fair(const struct fit *fit, const struct gap *gap, uint32_t h, const struct surface *made) {
    static const uint8_t old_of[4] = {0, 0, 1, 1}, beside[4] = {1, 3, 0, 2};
    uint32_t g = fit->he.twin[h];
    uint32_t border[4] = {halfedge_prev(h), halfedge_next(h), halfedge_next(g), halfedge_prev(g)};
    double across = vec3_dot(fit->facing[h / 3].normal, fit->facing[g / 3].normal);
    for (int i = 0; i < 4; i++) {
        vec3 old = fit->facing[gap->region.triangle[old_of[i]]].normal, new = surface_normal(made, (size_t)i);
        vec3 outside = outside_normal(fit, border[i], new);
        if (vec3_dot(old, new) < LEAST_TURN || surface_shape(made, (size_t)i) < FIT_THIN) return false;
        if (!fit_fold_is_fair(vec3_dot(old, outside), vec3_dot(new, outside))) return false;
        if (!fit_fold_is_fair(across, vec3_dot(new, surface_normal(made, beside[i])))) return false;
    }
    return true;
}

struct place {
    float distance_sq;
    uint32_t sample;
};

/* Puts the samples of a cluster among the places as far as they are farther off; the number of places. */
static size_t farthest_among(const struct fit *fit, const struct cluster *cluster, const float *distance_sq,
                             struct place place[PLACES], size_t count) {
    size_t most = parts_of[fit->placement].places;
    for (size_t i = 0; i < cluster->n; i++) {
        if (count == most && distance_sq[i] <= place[count - 1].distance_sq) continue;
        uint32_t point = samples_point(&fit->samples, cluster->sample[i]);
        if (fit->placement == PLACEMENT_SUBSET && (point == NONE || fit->taken[point])) continue;
        size_t at = count < most ? count++ : count - 1;
        for (; at > 0 && place[at - 1].distance_sq < distance_sq[i]; at--) place[at] = place[at - 1];
        place[at] = (struct place){distance_sq[i], cluster->sample[i]};
    }
    return count;
}

/* The samples of the two triangles that are farthest off, the farthest first; of the free points alone for a subset. */
static size_t farthest(const struct fit *fit, struct gap *gap, struct place place[PLACES]) {
    const struct triangle_corners corners[2] = {{gap->a, gap->b, gap->c}, {gap->b, gap->a, gap->d}};
    struct surface old = triangle_frames_make(&gap->frames, corners, 2);
    uint8_t owner[CLUSTER_ROOM];
    float distance_sq[CLUSTER_ROOM];
    struct fit_region more;
    size_t count = 0;
    for (const struct fit_region *part = &gap->region; part; part = fit_next_part(fit, part, &more)) {
        cluster_owners(&part->cluster, &old, owner, distance_sq);
        count = farthest_among(fit, &part->cluster, distance_sq, place, count);
    }
    return count;
}

/* A place that the new vertex may take, and what the two triangles become. */
struct split {
    vec3 at;
    uint32_t sample;
    struct surface made;
};

/* Puts a vertex on the edge at each of the places (at least one). */
static struct surface splits_at(const struct gap *gap, const struct split *split, size_t n,
                                struct triangle_frames *frames) {
    struct triangle_corners corners[4 * PLACES], *out = corners;
    for (size_t i = 0; i < n; i++) {
        const vec3 *p = &split[i].at;
        *out++ = (struct triangle_corners){gap->a, p, gap->c};
        *out++ = (struct triangle_corners){p, gap->b, gap->c};
        *out++ = (struct triangle_corners){p, gap->a, gap->d};
        *out++ = (struct triangle_corners){gap->b, p, gap->d};
    }
    return triangle_frames_make(frames, corners, 4 * n);
}

/* The farthest places, without those where something folds; their number. */
static size_t fair_splits(const struct fit *fit, struct gap *gap, uint32_t h, struct split split[PLACES]) {
    struct place place[PLACES];
    size_t places = farthest(fit, gap, place), count = 0;
    if (places == 0) return 0;
    for (size_t i = 0; i < places; i++) {
        split[i].sample = place[i].sample;
        split[i].at = fit->samples.sample[place[i].sample].place;
    }
    struct surface all = splits_at(gap, split, places, &gap->frames);
    for (size_t i = 0; i < places; i++) {
        split[i].made = (struct surface){all.four, 4 * i, 4};
        if (split_is_fair(fit, gap, h, &split[i].made)) split[count++] = split[i];
    }
    return count;
}

/* Which split gains most; the gain. */
static double dearest_split(const struct fit *fit, const struct gap *gap, const struct split *split, size_t splits,
                            size_t *which) {
    double gain = 0;
    for (size_t i = 0; i < splits; i++) {
        double limit = gap->cost - gain, cost = fit_cost_with(fit, &gap->region, &split[i].made, limit);
        if (cost < limit) gain = gap->cost - cost, *which = i;
    }
    return gain;
}

static struct offer best_split(const struct fit *fit, uint32_t h) {
    struct offer none = {.value = 0, .halfedge = NONE, .source = NONE};
    struct gap gap;
    gap_of(fit, h, &gap);
    if (fit_is_exact(cluster_weight(&gap.region.cluster), gap.cost)) return none;
    struct split split[PLACES];
    size_t splits = fair_splits(fit, &gap, h, split), i = 0;
    for (double gain; (gain = dearest_split(fit, &gap, split, splits, &i)) > 0;) {
        bool is_point = fit->placement == PLACEMENT_SUBSET;
        if (fit_stays(fit, &gap.region, &split[i].made))
            return (struct offer){gain, h, is_point ? samples_point(&fit->samples, split[i].sample) : NONE,
                                  split[i].at};
        memmove(&split[i], &split[i + 1], (--splits - i) * sizeof *split);
    }
    return none;
}

static void measure_splits(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    for (size_t i = begin; i < end; i++) market->offer[i] = best_split(market->fit, radix_value(market->item[i]));
}

/* ---------------------------------------------------------------------------------------------- the trade */

static bool is_before(const struct offer *a, const struct offer *b) {
    return a->value != b->value ? a->value < b->value : a->halfedge < b->halfedge;
}

/* Puts items that lie in order by their keys in that of their offers: float isn't as exact as they are. */
static void order_equals(const struct offer *offer, uint64_t *order, size_t n, bool falling) {
    for (size_t i = 1; i < n; i++) {
        uint64_t moving = order[i];
        size_t at = i;
        for (; at > 0 && radix_key(order[at - 1]) == radix_key(moving); at--) {
            const struct offer *before = &offer[radix_value(order[at - 1])], *after = &offer[radix_value(moving)];
            if (falling ? is_before(after, before) : is_before(before, after)) break;
            order[at] = order[at - 1];
        }
        order[at] = moving;
    }
}

/* The offers that stand, by their values. */
struct ranking {
    const struct offer *offer;
    const uint64_t *order;
    size_t n;
};

static const struct offer *offer_at(const struct ranking *ranking, size_t i) {
    return &ranking->offer[radix_value(ranking->order[i])];
}

static struct ranking rank_offers(const struct market *market, size_t count, bool falling) {
    uint64_t *order = market->order;
    size_t n = 0;
    for (size_t i = 0; i < count; i++) {
        if (market->offer[i].halfedge == NONE) continue;
        uint32_t key = radix_key_of_signed(market->offer[i].value);
        order[n++] = radix_item(falling ? ~key : key, (uint32_t)i);
    }
    order = radix_sort(order, order + n, n, 1);
    order_equals(market->offer, order, n, falling);
    return (struct ranking){market->offer, order, n};
}

static void estimate_merges(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    for (size_t v = begin; v < end; v++) {
        double estimate = merge_estimate(market->fit, (uint32_t)v);
        market->item[v] = radix_item(estimate < INFINITY ? radix_key_of(estimate) : NEVER, (uint32_t)v);
    }
}

/* An edge by its triangles' cost, the dearest first. */
static void estimate_splits(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    const struct fit *fit = market->fit;
    for (size_t h = begin; h < end; h++) {
        uint32_t g = fit->he.twin[h];
        bool counts = g != NONE && g > h;
        uint32_t key = counts ? radix_key_of(fit->cost[h / 3] + fit->cost[g / 3]) : 0;
        market->item[h] = radix_item(NEVER - key, (uint32_t)h);
    }
}

/* Keeps the lowest of n items, `most` of them, as far as they can be offered; their number. */
static size_t shortlist(uint64_t *item, size_t n, size_t most) {
    size_t count = radix_keep_lowest(item, item + n, n, most), kept = 0;
    for (size_t i = 0; i < count; i++)
        if (radix_key(item[i]) != NEVER) item[kept++] = item[i];
    return kept;
}

/* The vertices whose estimate is lowest, measured, cheapest first. */
static struct ranking offer_merges(struct market *market) {
    struct fit *fit = market->fit;
    size_t n = fit->mesh->vertex_count;
    par_for(fit->threads, n, ESTIMATES, estimate_merges, market);
    size_t count = shortlist(market->item, n, part_of(fit, parts_of[fit->placement].cheap));
    par_for(fit->threads, count, GRAIN, measure_merges, market);
    return rank_offers(market, count, false);
}

/* The edges whose triangles cost most, measured, most rewarding first. */
static struct ranking offer_splits(struct market *market) {
    struct fit *fit = market->fit;
    size_t n = 3 * fit->mesh->triangle_count;
    par_for(fit->threads, n, ESTIMATES, estimate_splits, market);
    size_t count = shortlist(market->item, n, part_of(fit, parts_of[fit->placement].dear));
    par_for(fit->threads, count, GRAIN, measure_splits, market);
    return rank_offers(market, count, true);
}

static size_t most_deals(const struct fit *fit) { return part_of(fit, TELEPORT_MOST); }

static bool has_changed_around(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t across = fit->he.twin[h];
    return changed[h / 3] || (across != NONE && changed[across / 3]);
}

/* Whether the vertex at the start of h may still go as it was measured. */
static bool merge_holds(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t e = h;
    do {
        if (has_changed_around(fit, halfedge_next(e), changed)) return false;
        e = halfedge_around(&fit->he, e);
    } while (e != h);
    return halfedge_may_collapse(&fit->he, h);
}

static bool split_holds(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t g = fit->he.twin[h];
    return !has_changed_around(fit, halfedge_next(h), changed) && !has_changed_around(fit, halfedge_prev(h), changed) &&
           !has_changed_around(fit, halfedge_next(g), changed) && !has_changed_around(fit, halfedge_prev(g), changed);
}

static void mark(struct fit *fit, uint8_t *changed, const uint32_t *triangle, size_t n) {
    for (size_t i = 0; i < n; i++) {
        changed[triangle[i]] = fit->touched[triangle[i]] = 1;
        for (int k = 0; k < 3; k++) fit->stale[fit->mesh->triangle[triangle[i]][k]] = 1;
    }
}

/* A trade that was made: the star that the vertex left, the two triangles of it that were left over, and the two of
 * the edge that it was put on. */
struct deal {
    size_t begin, n; /* of the star, in trade.star */
    uint32_t spare[2], edge[2];
};

struct trade {
    struct fit *fit;
    uint8_t *changed; /* triangle_count */
    uint32_t *star;   /* triangle_count: the triangles of all stars that vertices left */
    struct deal *deal;
    size_t stars, deals;
};

static struct halfedge_spare take_out(struct trade *trade, uint32_t h) {
    struct fit *fit = trade->fit;
    uint32_t ring[FIT_MAX_RING], vertex = halfedge_from(&fit->he, h), *star = trade->star + trade->stars;
    size_t n = halfedge_ring(&fit->he, vertex, ring, FIT_MAX_RING);
    for (size_t i = 0; i < n; i++) star[i] = ring[i] / 3;
    trade->deal[trade->deals].begin = trade->stars;
    trade->deal[trade->deals].n = n;
    trade->stars += n;
    struct halfedge_spare spare = halfedge_collapse(&fit->he, h);
    mark(fit, trade->changed, star, n);
    if (fit->mesh->source) fit_leave(fit, fit->mesh->source[vertex]);
    return spare;
}

static void put_in(struct trade *trade, const struct offer *offer, struct halfedge_spare spare) {
    struct fit *fit = trade->fit;
    uint32_t h = offer->halfedge;
    uint32_t triangle[4] = {h / 3, fit->he.twin[h] / 3, spare.triangle[0], spare.triangle[1]};
    fit->mesh->vertex[spare.vertex] = offer->place;
    if (fit->mesh->source) fit->mesh->source[spare.vertex] = offer->source;
    fit_take(fit, offer->source);
    if (fit->mesh->tag) {
        fit->mesh->tag[triangle[2]] = fit->mesh->tag[triangle[0]];
        fit->mesh->tag[triangle[3]] = fit->mesh->tag[triangle[1]];
    }
    fit->zones.of[spare.vertex] = fit->zones.of[halfedge_from(&fit->he, h)];
    halfedge_split(&fit->he, h, spare);
    mark(fit, trade->changed, triangle, 4);
    struct deal *deal = &trade->deal[trade->deals++];
    memcpy(deal->edge, triangle, sizeof deal->edge);
    memcpy(deal->spare, spare.triangle, sizeof deal->spare);
}

/* A merge is made only when the split that it pays for is known to hold, also after it. */
static void make_deals(struct trade *trade, const struct ranking *loss, const struct ranking *gain) {
    struct fit *fit = trade->fit;
    size_t i = 0, most = most_deals(fit);
    for (size_t j = 0; j < gain->n && trade->deals < most; j++) {
        const struct offer *split = offer_at(gain, j);
        if (!split_holds(fit, split->halfedge, trade->changed)) continue;
        uint32_t quad[2] = {split->halfedge / 3, fit->he.twin[split->halfedge] / 3};
        trade->changed[quad[0]] = trade->changed[quad[1]] = 1;
        while (i < loss->n && !merge_holds(fit, offer_at(loss, i)->halfedge, trade->changed)) i++;
        if (i == loss->n || split->value < TELEPORT_PAYS * offer_at(loss, i)->value) break;
        struct halfedge_spare spare = take_out(trade, offer_at(loss, i++)->halfedge);
        put_in(trade, split, spare);
    }
}

static void share_dealt(void *ctx, size_t begin, size_t end) {
    const struct trade *trade = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct deal *deal = &trade->deal[i];
        const uint32_t *star = trade->star + deal->begin, *spare = deal->spare, *edge = deal->edge;
        uint32_t left[FIT_MAX_RING], after[4] = {edge[0], edge[1], spare[0], spare[1]};
        size_t n = 0;
        for (size_t k = 0; k < deal->n; k++)
            if (star[k] != spare[0] && star[k] != spare[1]) left[n++] = star[k];
        fit_share(trade->fit, star, deal->n, left, n);
        fit_share(trade->fit, edge, 2, after, 4);
    }
}

static enum status trade_offers(struct fit *fit, const struct ranking *loss, const struct ranking *gain,
                                size_t *teleports) {
    size_t triangles = fit->mesh->triangle_count;
    struct trade trade = {.fit = fit};
    trade.changed = alloc_zeroed(triangles, 1);
    trade.star = alloc_array(triangles, sizeof *trade.star);
    trade.deal = alloc_array(most_deals(fit), sizeof *trade.deal);
    bool enough = trade.changed && trade.star && trade.deal;
    if (enough) {
        make_deals(&trade, loss, gain);
        par_for(fit->threads, trade.deals, DEALS, share_dealt, &trade);
        *teleports += trade.deals;
    }
    free(trade.changed), free(trade.star), free(trade.deal);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status fit_teleport(struct fit *fit, size_t *teleports) {
    const struct parts *parts = &parts_of[fit->placement];
    size_t vertices = fit->mesh->vertex_count, halfedges = 3 * fit->mesh->triangle_count;
    size_t merges = part_of(fit, parts->cheap), splits = part_of(fit, parts->dear);
    struct market out = {.fit = fit}, in = {.fit = fit};
    out.item = in.item = alloc_array(2 * (vertices > halfedges ? vertices : halfedges), sizeof *out.item);
    out.offer = alloc_array(merges + splits, sizeof *out.offer);
    out.order = alloc_array(2 * (merges + splits), sizeof *out.order);
    enum status status = STATUS_NO_MEMORY;
    if (out.item && out.offer && out.order) {
        in.offer = out.offer + merges, in.order = out.order + 2 * merges;
        struct ranking loss = offer_merges(&out), gain = offer_splits(&in);
        status = trade_offers(fit, &loss, &gain, teleports);
    }
    free(out.item), free(out.offer), free(out.order);
    return status;
}
