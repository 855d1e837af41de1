/* What each vertex costs when it is merged into its best neighbour, and what each edge gains when a vertex is put on
 * it, is measured in parallel with nothing changed.  Then the cheapest loss pays for the greatest gain, the next for
 * the next, skipping whatever touches triangles that changed, until a gain no longer pays.  In order, so the result
 * doesn't depend on threads; what the trades do to samples is done afterwards, in parallel, since no triangle is in two
 * of them.
 *
 * Both are measured before flips and moves help, so a pair that breaks even now will gain.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/reallocate.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/refine/collapse.h"
#include "core/refine/prefetch.h"
#include "core/refine/split.h"

enum { GRAIN = 64, ESTIMATES = 4096, DEALS = 16 };

#define TELEPORT_PAYS 0.7 /* gain over loss, at least */
#define TELEPORT_MOST 0.2 /* of the vertices */

/* So many vertices are measured for leaving, and so many edges for being split, both for each vertex.  One that may
 * stand anywhere finds more that are worth it, and so does a surface with a border. */
static const struct parts {
    double cheap, dear;
} parts_of[] = {[PLACEMENT_SUBSET] = {0.2, 0.3}, [PLACEMENT_OPTIMAL] = {0.4, 0.6}};

static const struct parts *parts_for(const struct fit *fit) {
    return &parts_of[fit->borders ? PLACEMENT_OPTIMAL : fit->placement];
}

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

static void fetch_fan_links(void *ctx, size_t i) {
    const struct market *market = ctx;
    fit_fetch_links(market->fit, market->fit->he.out[radix_value(market->item[i])] / 3);
}

static void fetch_fan(void *ctx, size_t i) {
    const struct market *market = ctx;
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(market->fit, radix_value(market->item[i]), ring);
    for (size_t k = 0; k < n; k++) {
        fit_fetch_triangle(market->fit, ring[k] / 3);
        fit_fetch_around(market->fit, ring[k] / 3);
    }
}

static void fetch_fan_disks(void *ctx, size_t i) {
    const struct market *market = ctx;
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(market->fit, radix_value(market->item[i]), ring);
    for (size_t k = 0; k < n; k++) fit_fetch_disks(market->fit, ring[k] / 3);
}

static bool measure_merge(void *ctx, size_t i) {
    const struct market *market = ctx;
    market->offer[i] = fit_merge_cheapest(market->fit, radix_value(market->item[i]));
    return true;
}

static void measure_merges(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{4, fetch_fan_links}, {2, fetch_fan}, {1, fetch_fan_disks}};
    for_each_prefetched(ahead, ctx, begin, end, measure_merge);
}

/* The triangle on either side of an edge that is going to be measured; on a border there is one. */
static uint32_t side_of(const struct market *market, size_t i, int side) {
    uint32_t h = radix_value(market->item[i]), g = side ? market->fit->he.twin[h] : h;
    return (g == NONE ? h : g) / 3;
}

static void fetch_sides(void *ctx, size_t i) {
    const struct market *market = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_triangle(market->fit, side_of(market, i, side));
}

static void fetch_around_sides(void *ctx, size_t i) {
    const struct market *market = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_around(market->fit, side_of(market, i, side));
}

static void fetch_more_of_sides(void *ctx, size_t i) {
    const struct market *market = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_more(market->fit, side_of(market, i, side));
}

static void fetch_disks_of_sides(void *ctx, size_t i) {
    const struct market *market = ctx;
    for (int side = 0; side < 2; side++) fit_fetch_disks(market->fit, side_of(market, i, side));
}

static bool measure_split(void *ctx, size_t i) {
    const struct market *market = ctx;
    market->offer[i] = fit_split_best(market->fit, radix_value(market->item[i]));
    return true;
}

static void measure_splits(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {8, fetch_sides}, {6, fetch_around_sides}, {4, fetch_more_of_sides}, {2, fetch_disks_of_sides}};
    for_each_prefetched(ahead, ctx, begin, end, measure_split);
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

/* Whether an edge with one triangle is a border's, along which the surface can grow. */
static bool is_border(const struct fit *fit, uint32_t h) {
    return fit_is_on_border(fit, halfedge_from(&fit->he, h)) && fit_is_on_border(fit, halfedge_to(&fit->he, h));
}

/* An edge by its triangles' cost, the dearest first. */
static void estimate_splits(void *ctx, size_t begin, size_t end) {
    const struct market *market = ctx;
    const struct fit *fit = market->fit;
    for (size_t h = begin; h < end; h++) {
        uint32_t twin = fit->he.twin[h], g = twin == NONE ? (uint32_t)h : twin;
        uint32_t key = radix_key_of(fit->cost[h / 3] + fit->cost[g / 3]);
        bool offered = twin == NONE ? is_border(fit, (uint32_t)h) : g > h;
        market->item[h] = radix_item(NEVER - offered * key, (uint32_t)h);
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
    size_t count = shortlist(market->item, n, part_of(fit, parts_for(fit)->cheap));
    par_for(fit->threads, count, GRAIN, measure_merges, market);
    return rank_offers(market, count, false);
}

/* The edges whose triangles cost most, measured, most rewarding first. */
static struct ranking offer_splits(struct market *market) {
    struct fit *fit = market->fit;
    size_t n = 3 * fit->mesh->triangle_count;
    par_for(fit->threads, n, ESTIMATES, estimate_splits, market);
    size_t count = shortlist(market->item, n, part_of(fit, parts_for(fit)->dear));
    par_for(fit->threads, count, GRAIN, measure_splits, market);
    return rank_offers(market, count, true);
}

static size_t most_deals(const struct fit *fit) { return part_of(fit, TELEPORT_MOST); }

static bool has_changed_around(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t across = fit->he.twin[h];
    return changed[h / 3] || (across != NONE && changed[across / 3]);
}

/* Whether the vertex may still go as it was measured. */
static bool merge_holds(const struct fit *fit, const struct fit_offer *merge, const uint8_t *changed) {
    uint32_t ring[FIT_MAX_RING];
    size_t n = fit_ring(fit, merge->vertex, ring);
    for (size_t i = 0; i < n; i++)
        if (has_changed_around(fit, halfedge_next(ring[i]), changed)) return false;
    return n > 0 && halfedge_may_collapse(&fit->he, merge->halfedge, merge->vertex);
}

static bool has_changed_beside(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    return has_changed_around(fit, halfedge_next(h), changed) || has_changed_around(fit, halfedge_prev(h), changed);
}

static bool split_holds(const struct fit *fit, uint32_t h, const uint8_t *changed) {
    uint32_t g = fit->he.twin[h];
    return !has_changed_beside(fit, h, changed) && (g == NONE || !has_changed_beside(fit, g, changed));
}

static void mark(struct fit *fit, uint8_t *changed, const uint32_t *triangle, size_t n) {
    for (size_t i = 0; i < n; i++) {
        changed[triangle[i]] = fit->touched[triangle[i]] = 1;
        for (int k = 0; k < 3; k++) fit->stale[fit->mesh->triangle[triangle[i]][k]] = 1;
    }
}

/* A trade that was made: the star that the vertex left, the two triangles of it that were left over, the two of the
 * edge that it was put on, and the two that it took for that.  Where there is but one, at a border, the other is NONE.
 */
struct deal {
    size_t begin, n; /* of the star, in trade.star */
    uint32_t spare[2], edge[2], taken[2];
};

struct trade {
    struct fit *fit;
    uint8_t *changed; /* room */
    uint32_t *star;   /* triangle_count: the triangles of all stars that vertices left */
    struct deal *deal;
    uint32_t *free; /* room: triangles that are none, the one that was freed last at the end */
    size_t stars, deals, frees;
};

/* A deal's triangles that there are; their number. */
static size_t those_there(const uint32_t pair[2]) { return pair[1] == NONE ? 1 : 2; }

/* The vertex goes. */
static void take_out(struct trade *trade, const struct fit_offer *merge) {
    struct fit *fit = trade->fit;
    uint32_t ring[FIT_MAX_RING], *star = trade->star + trade->stars;
    size_t n = fit_ring(fit, merge->vertex, ring);
    for (size_t i = 0; i < n; i++) star[i] = ring[i] / 3;
    struct deal *deal = &trade->deal[trade->deals];
    *deal = (struct deal){.begin = trade->stars, .n = n};
    trade->stars += n;
    struct halfedge_spare spare = halfedge_collapse(&fit->he, merge->halfedge, merge->vertex);
    mark(fit, trade->changed, star, n);
    if (fit->mesh->source) fit_leave(fit, fit->mesh->source[merge->vertex]);
    memcpy(deal->spare, spare.triangle, sizeof deal->spare);
    for (size_t k = those_there(deal->spare); k-- > 0;) trade->free[trade->frees++] = deal->spare[k];
}

static uint32_t take_triangle(struct trade *trade) {
    if (trade->frees > 0) return trade->free[--trade->frees];
    uint32_t t = (uint32_t)trade->fit->mesh->triangle_count++;
    trade->fit->he.triangle_count++;
    trade->fit->cost[t] = 0;
    return t;
}

/* And is put in on the edge.  Room for a triangle more than there are was seen to. */
static void put_in(struct trade *trade, const struct fit_offer *offer, uint32_t vertex) {
    struct fit *fit = trade->fit;
    struct deal *deal = &trade->deal[trade->deals++];
    uint32_t h = offer->halfedge, g = fit->he.twin[h];
    deal->edge[0] = h / 3, deal->edge[1] = g == NONE ? NONE : g / 3;
    size_t n = those_there(deal->edge);
    deal->taken[1] = NONE;
    for (size_t k = 0; k < n; k++) deal->taken[k] = take_triangle(trade);
    fit->mesh->vertex[vertex] = offer->place;
    if (fit->mesh->source) fit->mesh->source[vertex] = offer->source;
    fit_take(fit, offer->source);
    for (size_t k = 0; k < n && fit->mesh->tag; k++) fit->mesh->tag[deal->taken[k]] = fit->mesh->tag[deal->edge[k]];
    fit->zones.of[vertex] = fit->zones.of[halfedge_from(&fit->he, h)];
    halfedge_split(&fit->he, h, (struct halfedge_spare){vertex, {deal->taken[0], deal->taken[1]}});
    mark(fit, trade->changed, deal->edge, n);
    mark(fit, trade->changed, deal->taken, n);
}

/* The triangles on both sides of the edges that are offered next. */
struct offers {
    const struct fit *fit;
    const struct ranking *ranking;
};

static void fetch_offer(void *ctx, size_t i) {
    const struct offers *offers = ctx;
    fit_fetch_links(offers->fit, offer_at(offers->ranking, i)->halfedge / 3);
}

static void fetch_offer_twins(void *ctx, size_t i) {
    const struct offers *offers = ctx;
    uint32_t h = offer_at(offers->ranking, i)->halfedge;
    for (uint32_t g = h - h % 3, end = g + 3; g < end; g++)
        if (offers->fit->he.twin[g] != NONE) fit_fetch_links(offers->fit, offers->fit->he.twin[g] / 3);
}

/* A merge at a border frees one triangle, and a split amid the surface takes two. */
static bool has_room(const struct trade *trade) {
    return trade->fit->room > trade->fit->mesh->triangle_count || trade->fit->borders == 0;
}

/* A merge is made only when the split that it pays for is known to hold, also after it. */
static void make_deals(struct trade *trade, const struct ranking *loss, const struct ranking *gain) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{8, fetch_offer}, {4, fetch_offer_twins}};
    struct fit *fit = trade->fit;
    struct offers losses = {fit, loss}, gains = {fit, gain};
    size_t i = 0, most = most_deals(fit);
    for (size_t j = 0; j < gain->n && trade->deals < most && has_room(trade); j++) {
        const struct fit_offer *split = offer_at(gain, j);
        prefetch_ahead(ahead, &gains, j, gain->n);
        if (!split_holds(fit, split->halfedge, trade->changed)) continue;
        uint32_t h = split->halfedge, g = fit->he.twin[h];
        trade->changed[h / 3] = trade->changed[(g == NONE ? h : g) / 3] = 1;
        for (; i < loss->n; i++) {
            prefetch_ahead(ahead, &losses, i, loss->n);
            if (merge_holds(fit, offer_at(loss, i), trade->changed)) break;
        }
        if (i == loss->n || split->value < TELEPORT_PAYS * offer_at(loss, i)->value) break;
        const struct fit_offer *merge = offer_at(loss, i++);
        take_out(trade, merge);
        put_in(trade, split, merge->vertex);
    }
}

/* How many triangles a deal shares samples of: the star, then those beside the edge; and which is number k. */
static size_t dealt_count(const struct deal *deal) { return deal->n + those_there(deal->edge); }

static uint32_t dealt_triangle(const struct trade *trade, const struct deal *deal, size_t k) {
    return k < deal->n ? trade->star[deal->begin + k] : deal->edge[k - deal->n];
}

static void fetch_dealt_triangles(void *ctx, size_t i) {
    const struct trade *trade = ctx;
    const struct deal *deal = &trade->deal[i];
    for (size_t k = 0; k < dealt_count(deal); k++) fit_fetch_triangle(trade->fit, dealt_triangle(trade, deal, k));
}

static void fetch_dealt_around(void *ctx, size_t i) {
    const struct trade *trade = ctx;
    const struct deal *deal = &trade->deal[i];
    for (size_t k = 0; k < dealt_count(deal); k++) fit_fetch_around(trade->fit, dealt_triangle(trade, deal, k));
}

static void fetch_dealt_samples(void *ctx, size_t i) {
    const struct trade *trade = ctx;
    const struct deal *deal = &trade->deal[i];
    for (size_t k = 0; k < dealt_count(deal); k++) fit_fetch_samples(trade->fit, dealt_triangle(trade, deal, k));
}

static bool share_one_merge(void *ctx, size_t i) {
    const struct trade *trade = ctx;
    const struct deal *deal = &trade->deal[i];
    const uint32_t *star = trade->star + deal->begin, *spare = deal->spare;
    uint32_t left[FIT_MAX_RING];
    size_t n = 0;
    for (size_t k = 0; k < deal->n; k++)
        if (star[k] != spare[0] && star[k] != spare[1]) left[n++] = star[k];
    fit_share(trade->fit, star, deal->n, left, n);
    return true;
}

static void share_merged(void *ctx, size_t begin, size_t end) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {
        {3, fetch_dealt_triangles}, {2, fetch_dealt_around}, {1, fetch_dealt_samples}};
    for_each_prefetched(ahead, ctx, begin, end, share_one_merge);
}

static void share_split(void *ctx, size_t begin, size_t end) {
    const struct trade *trade = ctx;
    for (size_t i = begin; i < end; i++) {
        const struct deal *deal = &trade->deal[i];
        size_t n = those_there(deal->edge);
        uint32_t after[4];
        memcpy(after, deal->edge, n * sizeof *after);
        memcpy(after + n, deal->taken, n * sizeof *after);
        fit_share(trade->fit, deal->edge, n, after, 2 * n);
    }
}

static int compare_ids(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x < y) - (x > y);
}

/* The last triangles take the places of those that are none, from the last on. */
static void close_up(struct trade *trade) {
    qsort(trade->free, trade->frees, sizeof *trade->free, compare_ids);
    for (size_t i = 0; i < trade->frees; i++) fit_drop_triangle(trade->fit, trade->free[i]);
}

/* Triangles that one vertex left may be another's: so all are left before any is taken. */
static void share_dealt(struct trade *trade) {
    par_for(trade->fit->threads, trade->deals, DEALS, share_merged, trade);
    par_for(trade->fit->threads, trade->deals, DEALS, share_split, trade);
    close_up(trade);
}

static enum status trade_offers(struct fit *fit, const struct ranking *loss, const struct ranking *gain,
                                size_t *teleports) {
    struct trade trade = {.fit = fit};
    trade.changed = alloc_zeroed(fit->room, 1);
    trade.star = alloc_array(fit->mesh->triangle_count, sizeof *trade.star);
    trade.deal = alloc_array(most_deals(fit), sizeof *trade.deal);
    trade.free = alloc_array(fit->room, sizeof *trade.free);
    bool enough = trade.changed && trade.star && trade.deal && trade.free;
    if (enough) {
        make_deals(&trade, loss, gain);
        share_dealt(&trade);
        *teleports += trade.deals;
    }
    free(trade.changed), free(trade.star), free(trade.deal), free(trade.free);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status fit_teleport(struct fit *fit, size_t *teleports) {
    const struct parts *parts = parts_for(fit);
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
