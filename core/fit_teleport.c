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
#include "core/fit_fetch.h"
#include "core/fit_merge.h"
#include "core/fit_split.h"
#include "core/par.h"
#include "core/radix.h"

enum { GRAIN = 64, ESTIMATES = 4096, DEALS = 16 };

/* How far ahead things are asked for. */
enum {
    RINGS_AHEAD = 4,
    FANS_AHEAD = 2,
    TRIANGLES_AHEAD = 8,
    AROUND_AHEAD = 6,
    MORE_AHEAD = 4,
    DISKS_AHEAD = 2,
    OFFERS_AHEAD = 8,
    TWINS_AHEAD = 4
};

#define TELEPORT_PAYS 0.7 /* gain over loss, at least */
#define TELEPORT_MOST 0.2 /* of the vertices */

/* So many vertices are measured for leaving, and so many edges for being split, both for each vertex.  One that may
 * stand anywhere finds more that are worth it. */
static const struct parts {
    double cheap, dear;
} parts_of[] = {[PLACEMENT_SUBSET] = {0.2, 0.3}, [PLACEMENT_OPTIMAL] = {0.4, 0.6}};

static size_t part_of(const struct fit *fit, double part) {
    return (size_t)(part * (double)fit->mesh->vertex_count) + 1;
}

/* What may be offered, by a key that is quick to find, and what of it is: items of radix_sort. */
struct market {
    struct fit *fit;
    uint64_t *item;          /* in the order of memory, in which they are read faster */
    struct fit_offer *offer; /* of each item */
    uint64_t *order;         /* of offers */
};

#define NEVER UINT32_MAX /* key of what can't be offered */

INLINE void fetch_fan(const struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = halfedge_ring(&fit->he, vertex, ring, FIT_MAX_RING);
    for (size_t i = 0; i < n; i++) {
        fit_fetch_triangle(fit, ring[i] / 3);
        fit_fetch_around(fit, ring[i] / 3);
    }
}

INLINE void fetch_fan_disks(const struct fit *fit, uint32_t vertex) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = halfedge_ring(&fit->he, vertex, ring, FIT_MAX_RING);
    for (size_t i = 0; i < n; i++) fit_fetch_disks(fit, ring[i] / 3);
}

INLINE void fetch_fans(const struct market *market, size_t i, size_t end) {
    const struct fit *fit = market->fit;
    if (i + RINGS_AHEAD < end) fit_fetch_links(fit, fit->he.out[radix_value(market->item[i + RINGS_AHEAD])] / 3);
    if (i + FANS_AHEAD < end) fetch_fan(fit, radix_value(market->item[i + FANS_AHEAD]));
    if (i + 1 < end) fetch_fan_disks(fit, radix_value(market->item[i + 1]));
}

static void measure_merges(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    for (size_t i = begin; i < end; i++) {
        fetch_fans(market, i, end);
        market->offer[i] = fit_merge_cheapest(market->fit, radix_value(market->item[i]));
    }
}

/* The triangle on either side of an edge that is going to be measured. */
INLINE uint32_t side_of(const struct market *market, size_t i, int side) {
    uint32_t h = radix_value(market->item[i]);
    return (side ? market->fit->he.twin[h] : h) / 3;
}

INLINE void fetch_gaps(const struct market *market, size_t i, size_t end) {
    const struct fit *fit = market->fit;
    for (int side = 0; side < 2; side++) {
        if (i + TRIANGLES_AHEAD < end) fit_fetch_triangle(fit, side_of(market, i + TRIANGLES_AHEAD, side));
        if (i + AROUND_AHEAD < end) fit_fetch_around(fit, side_of(market, i + AROUND_AHEAD, side));
        if (i + MORE_AHEAD < end) fit_fetch_more(fit, side_of(market, i + MORE_AHEAD, side));
        if (i + DISKS_AHEAD < end) fit_fetch_disks(fit, side_of(market, i + DISKS_AHEAD, side));
    }
}

static void measure_splits(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    for (size_t i = begin; i < end; i++) {
        fetch_gaps(market, i, end);
        market->offer[i] = fit_split_best(market->fit, radix_value(market->item[i]));
    }
}

struct measured {
    const struct fit_offer *offer;
    bool falling;
};

static int compare_exact(const void *a, const void *b, void *ctx) {
    const struct measured *by = ctx;
    const struct fit_offer *x = &by->offer[radix_value(*(const uint64_t *)a)];
    const struct fit_offer *y = &by->offer[radix_value(*(const uint64_t *)b)];
    int order = x->value != y->value ? (x->value > y->value) - (x->value < y->value)
                                     : (x->halfedge > y->halfedge) - (x->halfedge < y->halfedge);
    return by->falling ? -order : order;
}

/* Puts items that lie in order by their keys in that of their offers: float isn't as exact as they are.  On a plane
 * there may be many equal ones. */
static void order_equals(const struct fit_offer *offer, uint64_t *order, size_t n, bool falling) {
    struct measured by = {offer, falling};
    for (size_t begin = 0, end; begin < n; begin = end) {
        for (end = begin + 1; end < n && radix_key(order[end]) == radix_key(order[begin]);) end++;
        if (end - begin > 1) qsort_r(&order[begin], end - begin, sizeof *order, compare_exact, &by);
    }
}

/* The offers that stand, by their values. */
struct ranking {
    const struct fit_offer *offer;
    const uint64_t *order;
    size_t n;
};

static const struct fit_offer *offer_at(const struct ranking *ranking, size_t i) {
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
        double estimate = fit_merge_estimate(market->fit, (uint32_t)v);
        market->item[v] = radix_item(estimate < INFINITY ? radix_key_of(estimate) : NEVER, (uint32_t)v);
    }
}

/* An edge by its triangles' cost, the dearest first. */
static void estimate_splits(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    const struct fit *fit = market->fit;
    for (size_t h = begin; h < end; h++) {
        uint32_t twin = fit->he.twin[h], g = twin == NONE ? (uint32_t)h : twin;
        uint32_t key = radix_key_of(fit->cost[h / 3] + fit->cost[g / 3]);
        market->item[h] = radix_item(NEVER - (g > h) * key, (uint32_t)h);
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

static void put_in(struct trade *trade, const struct fit_offer *offer, struct halfedge_spare spare) {
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

/* Asks for the triangles on both sides of the edges that are offered next. */
INLINE void fetch_offers(const struct trade *trade, const struct ranking *ranking, size_t i) {
    const struct fit *fit = trade->fit;
    if (i + OFFERS_AHEAD < ranking->n) fit_fetch_links(fit, offer_at(ranking, i + OFFERS_AHEAD)->halfedge / 3);
    if (i + TWINS_AHEAD >= ranking->n) return;
    uint32_t h = offer_at(ranking, i + TWINS_AHEAD)->halfedge;
    for (uint32_t g = h - h % 3, end = g + 3; g < end; g++)
        if (fit->he.twin[g] != NONE) fit_fetch_links(fit, fit->he.twin[g] / 3);
}

/* A merge is made only when the split that it pays for is known to hold, also after it. */
static void make_deals(struct trade *trade, const struct ranking *loss, const struct ranking *gain) {
    struct fit *fit = trade->fit;
    size_t i = 0, most = most_deals(fit);
    for (size_t j = 0; j < gain->n && trade->deals < most; j++) {
        const struct fit_offer *split = offer_at(gain, j);
        fetch_offers(trade, gain, j);
        if (!split_holds(fit, split->halfedge, trade->changed)) continue;
        uint32_t quad[2] = {split->halfedge / 3, fit->he.twin[split->halfedge] / 3};
        trade->changed[quad[0]] = trade->changed[quad[1]] = 1;
        for (; i < loss->n; i++) {
            fetch_offers(trade, loss, i);
            if (merge_holds(fit, offer_at(loss, i)->halfedge, trade->changed)) break;
        }
        if (i == loss->n || split->value < TELEPORT_PAYS * offer_at(loss, i)->value) break;
        struct halfedge_spare spare = take_out(trade, offer_at(loss, i++)->halfedge);
        put_in(trade, split, spare);
    }
}

/* Asks for what is known of the triangles that are shared out next. */
INLINE void fetch_deals(const struct trade *trade, size_t i, size_t end) {
    const struct fit *fit = trade->fit;
    for (size_t stage = 0; stage < 3; stage++) {
        if (i + 3 - stage >= end) continue;
        const struct deal *deal = &trade->deal[i + 3 - stage];
        for (size_t k = 0; k < deal->n + 2; k++) {
            uint32_t t = k < deal->n ? trade->star[deal->begin + k] : deal->edge[k - deal->n];
            if (stage == 0) fit_fetch_triangle(fit, t);
            if (stage == 1) fit_fetch_around(fit, t);
            if (stage == 2) fit_fetch_samples(fit, t);
        }
    }
}

static void share_dealt(void *ctx, size_t begin, size_t end) {
    const struct trade *trade = ctx;
    for (size_t i = begin; i < end; i++) {
        fetch_deals(trade, i, end);
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
