/* Contraction in passes: near-greedy, parallel, and the same for any number of threads.
 *
 * The paper (Lee, Jong section 4.4) takes the cheapest pair from a heap, one at a time.  Here each pass
 *
 *     gathers   for every live point the cheapest of its pairs             (parallel)
 *     ranks     them by cost                                               (radix sort, parallel)
 *     chooses   the cheapest ones that share no point, a fixed fraction    (one thread, marks alone)
 *     merges    the quadrics of the chosen pairs                           (parallel)
 *     updates   lists of neighbours, and the cheapest pair of who is near  (parallel)
 *
 * which removes the same points as the heap but for pairs that are close in cost.  A pass removes FRACTION of what is
 * live, whatever the goal, and contraction goes on to one point: so the order is a ranking, and any number of points
 * can be taken from it afterwards.  Where as many as are left needn't be ranked it ends with the pass before.
 *
 * Points stand in slots, in ascending order of their ids.  A slot whose point is gone stays empty until half of all
 * are; then the live ones move together, so that what is near in space stays near in memory.  Lists are written anew by
 * each update, from one pool into another.
 *
 * Invariants between passes: target[s] == s for exactly the live slots; their lists hold live slots alone;
 * partner[s] and cost[s] are of the cheapest pair of s; the quadric of a live point is about that point.
 *
 * A pair's cost is E_p + E_q at the end that stays, the cheaper of both (placement "subset": survivors are original
 * points), and a trace of the squared length, so that flat regions contract their short edges first.  Costs aren't kept
 * but for the cheapest: unless that pair itself has changed, only pairs with neighbours that have can be cheaper.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/contract.h"

#include <assert.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/simplify/pair_cost.h"
#include "core/simplify/rank_sort.h"
#include "core/spatial/knn.h"

enum { GRAIN = 1024, RELINK_K = 9, MOST_LINKS = 24, CHOOSER = 2, WAITING = 256, FEW_LINKS = 64 };
static const double FRACTION = 1.0 / 5, SLACK = 1.5, FEWEST = 1.0 / 6, LENGTH_BIAS = 1e-9;

struct contractor {
    size_t slots, live_count, removed;
    const vec3 *point; /* by slot, as all that follow */
    vec3 *own_point;   /* the same, once points have moved; else NULL */
    struct packed_quadric *quadric;
    uint32_t *id;      /* the point that stands there */
    uint32_t *target;  /* itself, or where its point went */
    uint32_t *partner; /* other end of the cheapest pair, NONE where there is none; merged slots: the end that went */
    float *cost;       /* of that pair */
    uint8_t *changed;  /* its pair was chosen in this pass, and CHOOSER: by this end of it */
    struct adjacency near;
    uint32_t *spare_list; /* the pool that the next update writes */
    size_t spare_capacity;
    size_t *chunk;         /* by range of GRAIN slots: how many picks it has; where its lists begin; where it goes */
    size_t wave;           /* the first of the slots that are moved side by side */
    uint64_t *pick, *swap; /* keyed by the cost's float bits, which order as costs do, with the slot that picked */
    float most_cost;       /* pairs that cost more aren't looked at */
    double length_bias;
    float *gone_cost;  /* by place in the order: of the pair that went; NULL: nobody asks */
    float first_error; /* of what was contracted before */
    bool untouched;    /* the quadrics are as they were given, and of planes through their points alone */
    unsigned threads;
    struct contraction out;
};

static int is_live(const struct contractor *c, size_t s) { return c->target[s] == s; }

/* ------------------------------------------------------------------------------------------------ costs */

static struct pair_field field_of(const struct contractor *c) {
    return (struct pair_field){c->point, c->quadric, c->untouched, c->length_bias};
}

/* Items are in the order of costs, which are not negative, as their bits are. */
static uint64_t item_of(float cost, uint32_t slot) {
    uint32_t key;
    memcpy(&key, &cost, sizeof key);
    return radix_item(key, slot);
}

static float cost_of(uint64_t item) {
    uint32_t key = radix_key(item);
    float cost;
    memcpy(&cost, &key, sizeof cost);
    return cost;
}

/* ------------------------------------------------------------------------------------------------ gather, rank */

/* Moves the picks of a range of slots to where its places begin; no branch to guess wrong. */
static void gather_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    size_t count = 0;
    memset(&c->changed[begin], 0, end - begin);
    for (size_t s = begin; s < end; s++) {
        uint32_t q = c->partner[s], other = q == NONE ? (uint32_t)s : q;
        int is_second = (c->partner[other] == s) & (other < s); /* the other end has the same pick */
        c->pick[begin + count] = item_of(c->cost[s], (uint32_t)s);
        count += (size_t)(is_live(c, s) & (q != NONE) & !is_second & !(c->cost[s] > c->most_cost));
    }
    c->chunk[begin / GRAIN] = count;
}

static size_t gather_picks(struct contractor *c) {
    size_t count = 0;
    par_for(c->threads, c->slots, GRAIN, gather_range, c);
    for (size_t begin = 0; begin < c->slots; begin += GRAIN) {
        size_t n = c->chunk[begin / GRAIN];
        memmove(&c->pick[count], &c->pick[begin], n * sizeof *c->pick);
        count += n;
    }
    return count;
}

static void rank_picks(struct contractor *c, size_t count) {
    uint64_t *sorted = radix_sort(c->pick, c->swap, count, c->threads);
    if (sorted == c->pick) return;
    c->swap = c->pick;
    c->pick = sorted;
}

/* ------------------------------------------------------------------------------------------------ choose */

static void fetch_pick(void *ctx, size_t i) {
    const struct contractor *c = ctx;
    prefetch(&c->partner[radix_value(c->pick[i])]);
    prefetch(&c->changed[radix_value(c->pick[i])]);
}

/* Takes picks from the cheapest on until enough are taken; those that share a point with one taken before must wait.
 * Returns how many are chosen; the swap, of no use until the next sorting, holds each one's rank. */
static size_t choose(struct contractor *c, size_t count) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{24, fetch_pick}};
    size_t goal = (size_t)ceil((double)c->live_count * FRACTION), done = 0;
    uint64_t *rank = c->swap;
    if (goal >= c->live_count) goal = c->live_count - 1;
    double limit = SLACK * (double)cost_of(c->pick[goal < count ? goal : count - 1]);
    for (size_t i = 0; i < count && done < goal; i++) {
        if ((double)cost_of(c->pick[i]) > limit && (double)done > FEWEST * (double)goal) break;
        prefetch_ahead(ahead, c, i, count);
        uint32_t p = radix_value(c->pick[i]), q = c->partner[p];
        if (c->changed[p] || c->changed[q]) continue;
        c->changed[p] = CHOOSER;
        c->changed[q] = 1;
        rank[p] = done++;
    }
    return done;
}

/* ------------------------------------------------------------------------------------------------ merge */

/* Moves a pair's quadrics into one. */
static void merge_pair(struct contractor *c, uint32_t stays, uint32_t goes, size_t place) {
    quadric there = quadric_unpack(&c->quadric[stays]), moved = quadric_unpack(&c->quadric[goes]);
    quadric sum = quadric_add(there, quadric_shift(moved, vec3_sub(c->point[goes], c->point[stays])));
    double error = sum.weight > 0 ? sqrt((sum.c > 0 ? sum.c : 0) / sum.weight) : 0;
    c->quadric[stays] = quadric_pack(&sum);
    c->target[goes] = stays;
    c->partner[stays] = goes;
    if (c->out.into) c->out.into[c->id[goes]] = c->id[stays];
    c->out.order[place] = c->id[goes];
    c->out.error[place] = (float)error;
}

/* The end that stays is the cheaper one; then the one with more weight; then the lower id. */
static int first_stays(const struct contractor *c, uint32_t p, uint32_t q, double p_stays, double q_stays) {
    if (p_stays != q_stays) return p_stays < q_stays;
    float wp = c->quadric[p].weight, wq = c->quadric[q].weight;
    return wp != wq ? wp > wq : p < q;
}

/* In the order of slots, not of costs, so that what is near in memory is merged together. */
static void merge_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    struct pair_field field = field_of(c);
    uint32_t p[GRAIN + PAIR_COST_ROOM], q[GRAIN + PAIR_COST_ROOM];
    double p_stays[GRAIN + PAIR_COST_ROOM], q_stays[GRAIN + PAIR_COST_ROOM];
    size_t count = 0;
    for (size_t s = begin; s < end; s++) { /* no branch to guess wrong */
        p[count] = (uint32_t)s;
        count += c->changed[s] == CHOOSER;
    }
    for (size_t i = 0; i < count; i++) q[i] = c->partner[p[i]]; /* those of others may be written meanwhile */
    pair_errors(&field, p, q, count, p_stays, q_stays);
    for (size_t i = 0; i < count; i++) {
        size_t place = c->removed + c->swap[p[i]];
        if (c->gone_cost) c->gone_cost[place] = c->cost[p[i]];
        if (first_stays(c, p[i], q[i], p_stays[i], q_stays[i]))
            merge_pair(c, p[i], q[i], place);
        else
            merge_pair(c, q[i], p[i], place);
    }
}

static void merge(struct contractor *c, size_t count) {
    par_for(c->threads, c->slots, GRAIN, merge_range, c);
    float largest = c->removed ? c->out.error[c->removed - 1] : c->first_error;
    for (float *error = &c->out.error[c->removed], *end = error + count; error < end; error++) {
        if (*error > largest) largest = *error;
        *error = largest;
    }
    c->removed += count;
    c->live_count -= count;
    c->untouched = false;
}

/* ------------------------------------------------------------------------------------------------ update */

/* Drops the farthest until MOST_LINKS are left (ties: the higher id goes). */
static unsigned keep_nearest(const struct contractor *c, uint32_t p, uint32_t *link, unsigned n) {
    while (n > MOST_LINKS) {
        unsigned farthest = 0;
        double farthest_sq = -1;
        for (unsigned i = 0; i < n; i++) {
            double d = vec3_distance_sq(c->point[p], c->point[link[i]]);
            if (d >= farthest_sq) farthest = i, farthest_sq = d;
        }
        n--;
        for (unsigned i = farthest; i < n; i++) link[i] = link[i + 1];
    }
    return n;
}

/* Appends the links of `of` as they are now, NONE for p itself; tells which of them, of the first 64, have gone. */
static uint64_t take_links(const struct contractor *c, uint32_t of, uint32_t p, uint32_t *link, unsigned *n) {
    const uint32_t *list = &c->near.list[c->near.start[of]];
    unsigned degree = c->near.degree[of];
    uint64_t gone = 0;
    uint32_t *to = link + *n;
    for (unsigned i = 0; i < degree; i++) {
        uint32_t now = c->target[list[i]];
        gone |= (uint64_t)(now != list[i]) << i % FEW_LINKS;
        to[i] = now == p ? NONE : now;
    }
    *n += degree;
    return gone;
}

/* Leaves out of p's links those that have gone to a point which was among them already: the last takes their place. */
static unsigned drop_repeated(const struct contractor *c, uint32_t p, uint32_t *link, uint64_t gone) {
    const uint32_t *list = &c->near.list[c->near.start[p]];
    unsigned degree = c->near.degree[p], n = degree;
    while (gone) {
        unsigned i = FEW_LINKS - 1 - (unsigned)__builtin_clzll(gone), was_there = 0;
        for (unsigned j = 0; j < degree; j++) was_there |= list[j] == link[i];
        link[i] = was_there ? link[n - 1] : link[i];
        n -= was_there;
        gone ^= (uint64_t)1 << i;
    }
    return n;
}

/* In no order; those of merged points ascend. */
static unsigned links_of(const struct contractor *c, uint32_t p, uint32_t *link) {
    unsigned n = 0;
    uint64_t gone = take_links(c, p, p, link, &n);
    if (!c->changed[p]) return n <= FEW_LINKS ? drop_repeated(c, p, link, gone) : rank_sort_ids(link, n);
    take_links(c, c->partner[p], p, link, &n);
    return keep_nearest(c, p, link, rank_sort_ids(link, n));
}

/* Whether all of p's pairs must be looked at again. */
static int pair_is_stale(const struct contractor *c, uint32_t p) {
    uint32_t q = c->partner[p];
    return q == NONE || c->changed[p] || c->changed[q] || !is_live(c, q);
}

/* Points that choose among pairs whose costs are still to be worked out: many at a time is faster. */
struct choosing {
    uint32_t point[WAITING];
    uint16_t end[WAITING]; /* of the point's pairs */
    unsigned points, pairs;
    uint32_t p[WAITING + UINT8_MAX], q[WAITING + UINT8_MAX];
    float cost[WAITING + UINT8_MAX];
};

/* The cheapest pair, and of the same cost the lower id: the least item of cost and id. */
static void choose_cheapest(struct contractor *c, uint32_t p, const uint32_t *q, const float *cost, unsigned n) {
    uint64_t best = item_of(c->cost[p], c->partner[p]);
    for (unsigned i = 0; i < n; i++) {
        uint64_t item = item_of(cost[i], q[i]);
        best = item < best ? item : best;
    }
    c->partner[p] = radix_value(best);
    c->cost[p] = cost_of(best);
}

static void settle(struct contractor *c, struct choosing *w) {
    struct pair_field field = field_of(c);
    pair_costs(&field, w->p, w->q, w->pairs, w->cost);
    for (unsigned i = 0, from = 0; i < w->points; from = w->end[i++])
        choose_cheapest(c, w->point[i], &w->q[from], &w->cost[from], w->end[i] - from);
    w->points = w->pairs = 0;
}

/* Lets p choose among all of its pairs, or, where the present one still is as it was, among those that have changed. */
static void let_choose(struct contractor *c, struct choosing *w, uint32_t p, const uint32_t *link, unsigned n,
                       int anew) {
    struct pair_field field = field_of(c);
    unsigned count = w->pairs;
    for (unsigned i = 0; i < n; i++) { /* no branch to guess wrong */
        w->p[count] = p;
        w->q[count] = link[i];
        pair_fetch(&field, link[i]);
        count += (unsigned)(anew | (c->changed[link[i]] != 0));
    }
    if (anew) c->partner[p] = NONE, c->cost[p] = INFINITY;
    if (count == w->pairs) return;
    w->point[w->points] = p;
    w->end[w->points++] = (uint16_t)count;
    w->pairs = count;
    if (count >= WAITING - PAIR_COST_ROOM || w->points == WAITING) settle(c, w);
}

static void pick_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    struct choosing waiting = {.points = 0, .pairs = 0};
    for (size_t p = begin; p < end; p++)
        let_choose(c, &waiting, (uint32_t)p, &c->near.list[c->near.start[p]], c->near.degree[p], 1);
    settle(c, &waiting);
}

/* How long the lists of live slots can get.  What they don't take of it isn't touched. */
static void measure_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    unsigned links = 0;
    for (size_t s = begin; s < end; s++) { /* no branch to guess wrong */
        unsigned merged = c->changed[s] != 0, live = (unsigned)is_live(c, s);
        links += live * (merged * MOST_LINKS + (1 - merged) * c->near.degree[s]);
    }
    c->chunk[begin / GRAIN] = links;
}

/* Live slots, those whose points have merged last: few branches on that are guessed wrong then.  Returns how many. */
static unsigned live_of(const struct contractor *c, size_t begin, size_t end, uint32_t *slot) {
    unsigned count = 0;
    for (unsigned merged = 0; merged < 2; merged++)
        for (size_t s = begin; s < end; s++) {
            slot[count] = (uint32_t)s;
            count += (unsigned)is_live(c, s) & (unsigned)((c->changed[s] != 0) == merged);
        }
    return count;
}

/* Lists of merged points and of who had merged neighbours; then the cheapest pairs of both. */
static void update_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    uint32_t link[2 * UINT8_MAX], *list = c->spare_list + c->chunk[begin / GRAIN];
    struct choosing waiting = {.points = 0, .pairs = 0};
    uint32_t order[GRAIN + 1];
    unsigned live = live_of(c, begin, end, order);
    for (unsigned i = 0; i < live; i++) {
        uint32_t p = order[i];
        unsigned n = links_of(c, p, link);
        memcpy(list, link, n * sizeof *link);
        c->near.start[p] = (uint32_t)(list - c->spare_list);
        c->near.degree[p] = (uint8_t)n;
        list += n;
        let_choose(c, &waiting, p, link, n, pair_is_stale(c, p));
    }
    settle(c, &waiting);
}

/* Turns what each chunk has into where it begins; returns the sum, which the one after the last gets too. */
static size_t add_up(size_t *chunk, size_t n) {
    size_t sum = 0;
    for (size_t i = 0; i < n; i++) {
        size_t count = chunk[i];
        chunk[i] = sum;
        sum += count;
    }
    return chunk[n] = sum;
}

/* Gives every range of slots its part of the other pool, which is made as large as that takes. */
static enum status place_live_lists(struct contractor *c) {
    par_for(c->threads, c->slots, GRAIN, measure_range, c);
    size_t needed = add_up(c->chunk, (c->slots + GRAIN - 1) / GRAIN);
    if (needed <= c->spare_capacity) return STATUS_OK;
    free(c->spare_list);
    c->spare_list = alloc_array(needed, sizeof *c->spare_list);
    c->spare_capacity = c->spare_list ? needed : 0;
    return c->spare_list && needed < UINT32_MAX ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status update(struct contractor *c) {
    if (place_live_lists(c)) return STATUS_NO_MEMORY;
    par_for(c->threads, c->slots, GRAIN, update_range, c);
    uint32_t *list = c->near.list;
    size_t capacity = c->near.capacity;
    c->near.list = c->spare_list, c->near.capacity = c->spare_capacity;
    c->spare_list = list, c->spare_capacity = capacity;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ move together */

static uint32_t point_of_slot(const struct contractor *c, uint32_t slot) { return (uint32_t)c->pick[slot]; }

static void count_live(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    size_t count = 0;
    for (size_t s = begin; s < end; s++) count += (size_t)is_live(c, s);
    c->chunk[begin / GRAIN] = count;
}

static void place_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    size_t place = c->chunk[begin / GRAIN];
    for (size_t s = begin; s < end; s++) {
        c->pick[s] = place;
        place += (size_t)is_live(c, s);
    }
}

static void rename_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    for (size_t s = begin; s < end; s++) {
        if (!is_live(c, s)) continue;
        uint32_t *list = &c->near.list[c->near.start[s]];
        for (unsigned i = 0; i < c->near.degree[s]; i++) list[i] = point_of_slot(c, list[i]);
        if (c->partner[s] != NONE) c->partner[s] = point_of_slot(c, c->partner[s]);
    }
}

static void move_slot(struct contractor *c, size_t from, size_t to) {
    c->own_point[to] = c->point[from];
    c->quadric[to] = c->quadric[from];
    c->id[to] = c->id[from];
    c->partner[to] = c->partner[from];
    c->cost[to] = c->cost[from];
    c->near.start[to] = c->near.start[from];
    c->near.degree[to] = c->near.degree[from];
    c->target[to] = (uint32_t)to;
}

static void move_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    for (size_t s = c->wave + begin; s < c->wave + end; s++)
        if (is_live(c, s)) move_slot(c, s, c->pick[s]);
}

/* In waves of ranges, each as long as what it goes to is before its beginning, where all slots have gone already: twice
 * as many each time where half of the slots are live. */
static void move_all(struct contractor *c, size_t ranges) {
    for (size_t begin = 0, end; begin < ranges; begin = end) {
        for (end = begin + 1; end < ranges && c->chunk[end + 1] <= begin * GRAIN;) end++;
        c->wave = begin * GRAIN;
        par_for(c->threads, (end < ranges ? end * GRAIN : c->slots) - c->wave, GRAIN, move_range, c);
    }
}

/* Afterwards every slot is live.  The picks, of no use between passes, hold where each slot goes. */
static enum status move_together(struct contractor *c) {
    size_t ranges = (c->slots + GRAIN - 1) / GRAIN;
    if (!c->own_point) c->own_point = alloc_array(c->live_count, sizeof *c->own_point);
    if (!c->own_point) return STATUS_NO_MEMORY;
    free(c->spare_list);
    c->spare_list = NULL, c->spare_capacity = 0;
    par_for(c->threads, c->slots, GRAIN, count_live, c);
    size_t count = add_up(c->chunk, ranges);
    par_for(c->threads, c->slots, GRAIN, place_range, c);
    par_for(c->threads, c->slots, GRAIN, rename_range, c);
    move_all(c, ranges);
    c->point = c->own_point;
    c->slots = count;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ relink */

/* Every slot's nearest others. */
static enum status neighbours_anew(const struct contractor *c, struct neighbourhood *neighbours) {
    struct knn *knn = NULL;
    size_t n = c->slots;
    uint32_t *found = alloc_array(n, RELINK_K * sizeof *found);
    double *distance_sq = alloc_array(n, RELINK_K * sizeof *distance_sq);
    *neighbours = (struct neighbourhood){.n = n, .stride = RELINK_K};
    neighbours->id = alloc_array(n, RELINK_K * sizeof *neighbours->id);
    neighbours->count = alloc_zeroed(n, sizeof *neighbours->count);
    enum status status = found && distance_sq && neighbours->id && neighbours->count ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = knn_new(c->point, n, c->threads, &knn, NULL);
    if (!status) status = knn_search(knn, c->point, n, RELINK_K, c->threads, found, distance_sq);
    for (size_t i = 0; !status && i < n * RELINK_K; i++) {
        size_t p = i / RELINK_K;
        if (found[i] != NONE && found[i] != p) neighbours->id[p * RELINK_K + neighbours->count[p]++] = found[i];
    }
    knn_free(knn);
    free(found), free(distance_sq);
    return status;
}

/* When no pairs are left but several points are (components that were far apart), joins the live points anew. */
static enum status relink(struct contractor *c) {
    struct neighbourhood neighbours = {0};
    enum status status = move_together(c);
    if (!status) status = neighbours_anew(c, &neighbours);
    adjacency_done(&c->near);
    if (!status) status = adjacency_from(&neighbours, c->threads, &c->near);
    if (!status) par_for(c->threads, c->slots, GRAIN, pick_range, c);
    neighbourhood_done(&neighbours);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static void contractor_done(struct contractor *c) {
    adjacency_done(&c->near);
    free(c->own_point), free(c->id), free(c->target), free(c->partner), free(c->cost), free(c->changed);
    free(c->spare_list), free(c->chunk), free(c->pick), free(c->swap), free(c->gone_cost);
}

double contract_length_bias(const struct packed_quadric *quadrics, const uint8_t *counted, size_t n) {
    double weight = 0;
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        if (counted && !counted[i]) continue;
        weight += (double)quadrics[i].weight;
        count++;
    }
    return count ? LENGTH_BIAS * weight / (double)count : 0;
}

static void name_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    for (size_t s = begin; s < end; s++) c->id[s] = c->target[s] = (uint32_t)s;
}

static enum status contractor_init(struct contractor *c) {
    size_t n = c->slots;
    c->id = alloc_array(n, sizeof *c->id);
    c->target = alloc_array(n, sizeof *c->target);
    c->partner = alloc_array(n, sizeof *c->partner);
    c->cost = alloc_array(n, sizeof *c->cost);
    c->changed = alloc_zeroed(n, sizeof *c->changed);
    c->chunk = alloc_array(n / GRAIN + 2, sizeof *c->chunk);
    c->pick = alloc_array(n, sizeof *c->pick);
    c->swap = alloc_array(n, sizeof *c->swap);
    c->out.order = alloc_array(n, sizeof *c->out.order);
    c->out.into = alloc_array(n, sizeof *c->out.into);
    c->out.error = alloc_array(n, sizeof *c->out.error);
    if (!c->id || !c->target || !c->partner || !c->cost || !c->changed || !c->chunk || !c->pick || !c->swap ||
        !c->out.order || !c->out.into || !c->out.error)
        return STATUS_NO_MEMORY;
    c->untouched = true;
    for (size_t i = 0; i < n; i++) {
        const struct packed_quadric *q = &c->quadric[i];
        c->untouched &= (q->b[0] == 0) & (q->b[1] == 0) & (q->b[2] == 0) & (q->c == 0);
    }
    c->live_count = n;
    par_for(c->threads, n, GRAIN, name_range, c);
    par_for(c->threads, n, GRAIN, pick_range, c);
    return STATUS_OK;
}

static enum status pass(struct contractor *c) {
    size_t count = gather_picks(c);
    if (count == 0) return relink(c);
    rank_picks(c, count);
    merge(c, choose(c, count));
    enum status status = update(c);
    return !status && c->live_count <= c->slots / 2 ? move_together(c) : status;
}

/* What was never removed comes last. */
static void list_left(struct contractor *c) {
    size_t place = c->removed;
    for (uint32_t s = 0; s < c->slots; s++) {
        if (!is_live(c, s)) continue;
        c->out.order[place] = c->id[s];
        c->out.into[c->id[s]] = NONE;
        c->out.error[place++] = INFINITY;
    }
}

/* Takes near. */
static struct contractor contractor_of(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                                       double length_bias, unsigned threads) {
    size_t n = near->n;
    assert(n >= 1 && n < NONE);
    struct contractor c = {.slots = n,
                           .point = point,
                           .quadric = quadrics,
                           .near = *near,
                           .most_cost = INFINITY,
                           .length_bias = length_bias,
                           .threads = threads,
                           .out = {.n = n}};
    *near = (struct adjacency){0};
    return c;
}

enum status contract_rest(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                          double length_bias, float error, const struct contract_options *options,
                          const struct progress *progress, struct contraction *out) {
    size_t n = near->n;
    struct contractor c = contractor_of(point, near, quadrics, length_bias, options->threads);
    c.first_error = error;
    enum status status = contractor_init(&c);
    while (!status && c.live_count > 1 && c.live_count > options->least) {
        status = pass(&c);
        if (!status && progress_tick(progress, "contract", (double)c.removed / (double)n)) status = STATUS_CANCELLED;
    }
    if (!status) {
        list_left(&c);
        *out = c.out;
    } else {
        contraction_done(&c.out);
    }
    contractor_done(&c);
    return status;
}

enum status contract(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                     const struct contract_options *options, const struct progress *progress, struct contraction *out) {
    return contract_rest(point, near, quadrics, contract_length_bias(quadrics, NULL, near->n), 0, options, progress,
                         out);
}

/* ------------------------------------------------------------------------------------------------ parts */

/* 0 to 1, of the point that picked: the same wherever it is looked at from. */
static float share_of(const struct contractor *c, uint32_t slot) {
    uint64_t bits[3], hash = 0;
    memcpy(bits, &c->point[slot], sizeof bits);
    for (int axis = 0; axis < 3; axis++) hash = hash64(hash + bits[axis]);
    return (float)(hash >> 40) / (float)(1 << 24);
}

static bool is_free(const struct contractor *c, uint32_t p) { return !c->changed[p] && !c->changed[c->partner[p]]; }

static void take_pick(struct contractor *c, uint32_t p, size_t *done) {
    c->changed[p] = CHOOSER;
    c->changed[c->partner[p]] = 1;
    c->swap[p] = (*done)++;
}

/* Takes all picks within a limit that share no point with a cheaper one. */
static size_t choose_within(struct contractor *c, size_t count, struct contract_limit limit) {
    static const struct prefetch ahead[PREFETCH_STAGES] = {{24, fetch_pick}};
    size_t done = 0;
    for (size_t i = 0; i < count && cost_of(c->pick[i]) <= limit.cost && done + 1 < c->live_count; i++) {
        prefetch_ahead(ahead, c, i, count);
        uint32_t p = radix_value(c->pick[i]);
        if (!is_free(c, p) || (cost_of(c->pick[i]) == limit.cost && share_of(c, p) > limit.share)) continue;
        take_pick(c, p, &done);
    }
    return done;
}

/* The same as choose, of the picks that count: what it comes to as a limit. */
static struct contract_limit find_limit(const struct contractor *c, size_t count, const uint8_t *counted, size_t live,
                                        uint8_t *taken) {
    size_t done = 0, seen = 0;
    memset(taken, 0, c->slots);
    size_t goal = (size_t)ceil((double)live * FRACTION);
    if (goal >= live) goal = live ? live - 1 : 0;
    double limit = 0;
    for (size_t i = 0; i < count && seen <= goal; i++)
        if (counted[c->id[radix_value(c->pick[i])]]) seen++, limit = SLACK * (double)cost_of(c->pick[i]);
    struct contract_limit found = {-1, 1};
    size_t of_cost = 0, taken_of_cost = 0; /* among the picks that cost as much as the last one taken */
    for (size_t i = 0; i < count; i++) {
        float cost = cost_of(c->pick[i]);
        uint32_t p = radix_value(c->pick[i]), q = c->partner[p];
        if (done == goal && cost > found.cost) break;
        if ((double)cost > limit && (double)done > FEWEST * (double)goal) break;
        if (taken[p] || taken[q]) continue;
        if (counted[c->id[p]]) {
            if (cost > found.cost) found.cost = cost, of_cost = taken_of_cost = 0;
            of_cost++;
            if (done == goal) continue;
            done++, taken_of_cost++;
        }
        taken[p] = taken[q] = 1;
    }
    if (of_cost) found.share = (float)taken_of_cost / (float)of_cost;
    return found;
}

static size_t count_counted(const struct contractor *c, const uint8_t *counted) {
    size_t live = 0;
    for (size_t s = 0; s < c->slots; s++) live += (size_t)(is_live(c, s) && counted[c->id[s]]);
    return live;
}

static enum status part_pass(struct contractor *c, const struct contract_part *part, size_t i, size_t live,
                             uint8_t *taken) {
    c->most_cost = part->counted ? INFINITY : part->limit[i].cost;
    size_t count = gather_picks(c);
    if (count) rank_picks(c, count);
    if (part->counted) part->limit[i] = find_limit(c, count, part->counted, live, taken);
    merge(c, choose_within(c, count, part->limit[i]));
    enum status status = update(c);
    return !status && c->live_count <= c->slots / 2 ? move_together(c) : status;
}

static void gone_done(struct contract_gone *gone) {
    free(gone->id), free(gone->cost), free(gone->error), free(gone->end);
    *gone = (struct contract_gone){0};
}

/* Room for what part->keeps_gone asks for. */
static enum status begin_gone(struct contractor *c, const struct contract_part *part, struct contract_gone *gone) {
    if (!part->keeps_gone) return STATUS_OK;
    free(c->out.into), c->out.into = NULL; /* which nobody asks for: costs take its room */
    c->gone_cost = alloc_array(c->slots, sizeof *c->gone_cost);
    gone->end = alloc_array(part->passes, sizeof *gone->end);
    return c->gone_cost && gone->end ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Takes what the contractor has of them. */
static void take_gone(struct contractor *c, struct contract_gone *gone) {
    gone->n = c->removed;
    gone->id = c->out.order, c->out.order = NULL;
    gone->error = c->out.error, c->out.error = NULL;
    gone->cost = c->gone_cost, c->gone_cost = NULL;
}

enum status contract_some(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                          const struct contract_part *part, const struct progress *progress,
                          struct contract_left *left) {
    size_t n = near->n;
    struct contractor c = contractor_of(point, near, quadrics, part->length_bias, part->threads);
    uint8_t *taken = part->counted ? alloc_array(n, sizeof *taken) : NULL;
    enum status status = part->counted && !taken ? STATUS_NO_MEMORY : contractor_init(&c);
    size_t passes = 0, of = 0, live = 0;
    struct contract_gone gone = {0};
    if (!status) status = begin_gone(&c, part, &gone);
    if (!status && taken) of = live = count_counted(&c, part->counted);
    for (size_t i = 0; !status && i < part->passes; i++) {
        if (taken && (double)live <= part->least_share * (double)of) break;
        status = part_pass(&c, part, i, live, taken);
        if (taken) live = count_counted(&c, part->counted);
        if (part->keeps_gone) gone.end[passes] = c.removed;
        passes++;
        if (!status && progress_tick(progress, "contract", (double)(i + 1) / (double)part->passes))
            status = STATUS_CANCELLED;
    }
    if (!status) status = move_together(&c);
    if (!status) {
        *left = (struct contract_left){.n = c.slots,
                                       .id = c.id,
                                       .quadric = quadrics,
                                       .near = c.near,
                                       .error = c.removed ? c.out.error[c.removed - 1] : 0,
                                       .passes = passes,
                                       .share = of ? (double)live / (double)of : 1};
        left->near.n = c.slots;
        c.id = NULL;
        c.near = (struct adjacency){0};
        if (part->keeps_gone) take_gone(&c, &gone);
        left->gone = gone;
    } else {
        gone_done(&gone);
    }
    free(taken);
    contraction_done(&c.out);
    contractor_done(&c);
    return status;
}

void contract_left_done(struct contract_left *left) {
    if (!left) return;
    free(left->id);
    adjacency_done(&left->near);
    gone_done(&left->gone);
    *left = (struct contract_left){0};
}
