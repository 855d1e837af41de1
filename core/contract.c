/* Contraction in passes: near-greedy, parallel, and the same for any number of threads.
 *
 * The paper (Lee, Jong section 4.4) takes the cheapest pair from a heap, one at a time.  Here each pass
 *
 *     picks     for every live point the cheapest of its pairs            (parallel; costs are kept while valid)
 *     ranks     the picks by cost                                         (radix sort)
 *     performs  the cheapest ones that share no point, a fixed fraction   (sequential choice, parallel merging)
 *     updates   the lists of neighbours and marks what changed            (parallel)
 *
 * which removes the same points as the heap but for pairs that are close in cost.  A pass removes FRACTION of what is
 * live, whatever the goal, and contraction always goes on to one point: so the order is a ranking, and any number of
 * points can be taken from it afterwards.
 *
 * Invariants: into[p] == NONE for exactly the live points; the lists hold no dead points between passes; the quadric of
 * a live point is about that point.
 *
 * A pair's cost is E_p + E_q at the end that stays, the cheaper of both (placement "subset": survivors are original
 * points), and a trace of the squared length, so that flat regions contract their short edges first.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/contract.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/adjacency.h"
#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"

enum { GRAIN = 512, RELINK_K = 9, KEY_DIGIT_BITS = 11, KEY_DIGITS = 1 << KEY_DIGIT_BITS, KEY_PASSES = 3 };
static const double FRACTION = 1.0 / 5, SLACK = 1.5, FEWEST = 1.0 / 6, LENGTH_BIAS = 1e-9;

/* A pick of live point `owner`, sorted by key: the cost's float bits, which order as the cost does. */
struct pick {
    uint32_t key, owner;
};

struct contractor {
    const vec3 *point;
    struct packed_quadric *quadric;
    struct adjacency near;
    size_t live_count, removed;
    uint32_t *live;    /* ids of the live points, ascending */
    uint32_t *partner; /* by id: other end of the cheapest pair, NONE where there is none */
    float *cost;       /* by id: of that pair */
    uint8_t *dirty;    /* by id: the cheapest pair must be looked for again */
    uint8_t *changed;  /* by id: merged in this pass */
    struct pick *pick, *spare;
    uint32_t *kept; /* by number of the merge within the pass: the end that stays; the other is order[removed + i] */
    double length_bias;
    unsigned threads;
    struct contraction out;
};

/* ------------------------------------------------------------------------------------------------ pick */

/* Error of the pair (p, q) when q is moved to p. */
static double error_at(const struct contractor *c, uint32_t p, uint32_t q) {
    vec3 offset = vec3_sub(c->point[p], c->point[q]);
    quadric moved = quadric_unpack(&c->quadric[q]);
    return fmax((double)c->quadric[p].c, 0) + quadric_value(&moved, offset);
}

static double pair_error(const struct contractor *c, uint32_t p, uint32_t q) {
    return fmin(error_at(c, p, q), error_at(c, q, p));
}

/* The end of the pair that stays: the cheaper one; then the one with more weight; then the lower id. */
static uint32_t staying_end(const struct contractor *c, uint32_t p, uint32_t q) {
    double at_p = error_at(c, p, q), at_q = error_at(c, q, p);
    if (at_p != at_q) return at_p < at_q ? p : q;
    float wp = c->quadric[p].weight, wq = c->quadric[q].weight;
    if (wp != wq) return wp > wq ? p : q;
    return p < q ? p : q;
}

static float pair_cost(const struct contractor *c, uint32_t p, uint32_t q) {
    return (float)(pair_error(c, p, q) + c->length_bias * vec3_distance_sq(c->point[p], c->point[q]));
}

static void pick_for(struct contractor *c, uint32_t p) {
    struct link *list = &c->near.list[c->near.start[p]];
    float best = INFINITY;
    uint32_t partner = NONE;
    for (unsigned i = 0; i < c->near.degree[p]; i++) {
        if (isnan(list[i].cost)) list[i].cost = pair_cost(c, p, list[i].id);
        if (list[i].cost < best || partner == NONE) best = list[i].cost, partner = list[i].id;
    }
    c->partner[p] = partner;
    c->cost[p] = best;
}

static void pick_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    for (size_t i = begin; i < end; i++) pick_for(c, c->live[i]);
}

/* ------------------------------------------------------------------------------------------------ rank */

static uint32_t key_of(float cost) {
    uint32_t bits;
    memcpy(&bits, &cost, sizeof bits);
    return bits; /* costs are not negative */
}

static size_t gather_picks(struct contractor *c) {
    size_t count = 0;
    for (size_t i = 0; i < c->live_count; i++) {
        uint32_t p = c->live[i], q = c->partner[p];
        if (q == NONE) continue;
        if (c->partner[q] == p && q < p) continue; /* the other end has the same pick */
        c->pick[count++] = (struct pick){key_of(c->cost[p]), p};
    }
    return count;
}

static void sort_picks(struct contractor *c, size_t count) {
    for (int pass = 0; pass < KEY_PASSES; pass++) {
        size_t start[KEY_DIGITS] = {0}, sum = 0;
        int shift = pass * KEY_DIGIT_BITS;
        for (size_t i = 0; i < count; i++) start[c->pick[i].key >> shift & (KEY_DIGITS - 1)]++;
        for (size_t d = 0; d < KEY_DIGITS; d++) {
            size_t here = start[d];
            start[d] = sum;
            sum += here;
        }
        for (size_t i = 0; i < count; i++) c->spare[start[c->pick[i].key >> shift & (KEY_DIGITS - 1)]++] = c->pick[i];
        struct pick *swap = c->pick;
        c->pick = c->spare;
        c->spare = swap;
    }
}

/* ------------------------------------------------------------------------------------------------ perform */

static void record(struct contractor *c, uint32_t stays, uint32_t goes) {
    quadric there = quadric_unpack(&c->quadric[stays]), moved = quadric_unpack(&c->quadric[goes]);
    quadric sum = quadric_add(there, quadric_shift(moved, vec3_sub(c->point[goes], c->point[stays])));
    double error = sum.weight > 0 ? sqrt(fmax(sum.c, 0) / sum.weight) : 0;
    float before = c->removed ? c->out.error[c->removed - 1] : 0;
    c->quadric[stays] = quadric_pack(&sum);
    c->out.into[goes] = stays;
    c->out.order[c->removed] = goes;
    c->out.error[c->removed++] = fmaxf((float)error, before);
    c->changed[stays] = 1;
}

/* Takes picks from the cheapest on until enough are taken; those that share a point with one taken before must wait.
 * Returns how many were performed; kept[i] is the end that stays of the i-th. */
static size_t perform(struct contractor *c, size_t count) {
    size_t goal = (size_t)ceil((double)c->live_count * FRACTION), done = 0;
    if (goal >= c->live_count) goal = c->live_count - 1;
    size_t pivot = goal < count ? goal : count - 1;
    double limit = SLACK * (double)c->cost[c->pick[pivot].owner];
    for (size_t i = 0; i < count && done < goal; i++) {
        uint32_t p = c->pick[i].owner, q = c->partner[p];
        if ((double)c->cost[p] > limit && (double)done > FEWEST * (double)goal) break;
        if (c->changed[p] || c->changed[q] || c->out.into[p] != NONE || c->out.into[q] != NONE) continue;
        uint32_t stays = staying_end(c, p, q);
        record(c, stays, stays == p ? q : p);
        c->kept[done++] = stays;
    }
    return done;
}

/* ------------------------------------------------------------------------------------------------ update */

/* Where p's neighbour q is now: itself, or what it was contracted into in this pass. */
static uint32_t current(const struct contractor *c, uint32_t q) { return c->out.into[q] == NONE ? q : c->out.into[q]; }

static void sort_links(struct link *link, unsigned n) {
    for (unsigned i = 1; i < n; i++) {
        struct link x = link[i];
        unsigned j = i;
        for (; j > 0 && link[j - 1].id > x.id; j--) link[j] = link[j - 1];
        link[j] = x;
    }
}

/* Sorted links without repetitions and without p itself. */
static unsigned unique_links(struct link *link, unsigned n, uint32_t p) {
    unsigned count = 0;
    for (unsigned i = 0; i < n; i++)
        if (link[i].id != p && (count == 0 || link[count - 1].id != link[i].id)) link[count++] = link[i];
    return count;
}

/* Drops the farthest until ADJACENCY_MAX are left (ties: the higher id goes). */
static unsigned keep_nearest(const struct contractor *c, uint32_t p, struct link *link, unsigned n) {
    while (n > ADJACENCY_MAX) {
        unsigned farthest = 0;
        double farthest_sq = -1;
        for (unsigned i = 0; i < n; i++) {
            double d = vec3_distance_sq(c->point[p], c->point[link[i].id]);
            if (d >= farthest_sq) farthest = i, farthest_sq = d;
        }
        memmove(&link[farthest], &link[farthest + 1], (n - farthest - 1) * sizeof *link);
        n--;
    }
    return n;
}

struct merging {
    struct contractor *c;
    size_t first_removed; /* order[first_removed + i] went into kept[i] */
    size_t pool_start;    /* the i-th merged list goes to pool_start + i * ADJACENCY_MAX */
};

/* Appends p's links, their costs unknown, to n others. */
static unsigned take_links(const struct contractor *c, uint32_t p, struct link *link, unsigned n) {
    for (unsigned i = 0; i < c->near.degree[p]; i++)
        link[n++] = (struct link){current(c, c->near.list[c->near.start[p] + i].id), NAN};
    return n;
}

static void merge_range(void *ctx, size_t begin, size_t end) {
    const struct merging *merging = ctx;
    struct contractor *c = merging->c;
    for (size_t i = begin; i < end; i++) {
        uint32_t stays = c->kept[i], goes = c->out.order[merging->first_removed + i];
        struct link link[2 * UINT8_MAX];
        unsigned n = take_links(c, goes, link, take_links(c, stays, link, 0));
        sort_links(link, n);
        n = keep_nearest(c, stays, link, unique_links(link, n, stays));
        c->near.start[stays] = merging->pool_start + i * ADJACENCY_MAX;
        c->near.degree[stays] = (uint8_t)n;
        memcpy(&c->near.list[c->near.start[stays]], link, n * sizeof *link);
    }
}

/* Points that merely have merged neighbours: their lists stay in place with the dead replaced. */
static void rename_range(void *ctx, size_t begin, size_t end) {
    struct contractor *c = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t p = c->live[i];
        struct link *link = &c->near.list[c->near.start[p]];
        unsigned renamed = 0;
        for (unsigned j = 0; j < c->near.degree[p]; j++) {
            uint32_t q = current(c, link[j].id);
            if (c->changed[q]) link[j].cost = NAN;
            renamed |= q != link[j].id;
            link[j].id = q;
        }
        if (!renamed) continue;
        sort_links(link, c->near.degree[p]);
        c->near.degree[p] = (uint8_t)unique_links(link, c->near.degree[p], p);
    }
}

static void drop_dead(struct contractor *c) {
    size_t count = 0;
    for (size_t i = 0; i < c->live_count; i++)
        if (c->out.into[c->live[i]] == NONE) c->live[count++] = c->live[i];
    c->live_count = count;
}

static enum status update(struct contractor *c, size_t merged) {
    enum status status = adjacency_reserve(&c->near, c->live, c->live_count, merged * ADJACENCY_MAX);
    if (status) return status;
    struct merging merging = {c, c->removed - merged, c->near.used};
    c->near.used += merged * ADJACENCY_MAX;
    par_for(c->threads, merged, GRAIN, merge_range, &merging);
    drop_dead(c);
    par_for(c->threads, c->live_count, GRAIN, rename_range, c);
    for (size_t i = 0; i < merged; i++) c->changed[c->kept[i]] = 0;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ relink */

/* When no pairs are left but several points are (components that were far apart), joins the live points anew. */
static enum status relink(struct contractor *c) {
    struct knn *knn = NULL;
    struct neighbourhood hood = {.n = c->near.n, .stride = RELINK_K};
    vec3 *point = alloc_array(c->live_count, sizeof *point);
    uint32_t *found = alloc_array(c->live_count * RELINK_K, sizeof *found);
    double *distance_sq = alloc_array(c->live_count * RELINK_K, sizeof *distance_sq);
    hood.id = alloc_array(hood.n, RELINK_K * sizeof *hood.id);
    hood.count = alloc_zeroed(hood.n, sizeof *hood.count);
    enum status status = point && found && distance_sq && hood.id && hood.count ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < c->live_count; i++) point[i] = c->point[c->live[i]];
    if (!status) status = knn_new(point, c->live_count, &knn, NULL);
    if (!status) status = knn_search(knn, point, c->live_count, RELINK_K, c->threads, found, distance_sq);
    for (size_t i = 0; !status && i < c->live_count; i++)
        for (unsigned j = 0; j < RELINK_K; j++) {
            uint32_t p = c->live[i], q = found[i * RELINK_K + j];
            if (q != NONE && q != i) hood.id[(size_t)p * RELINK_K + hood.count[p]++] = c->live[q];
        }
    adjacency_done(&c->near);
    if (!status) status = adjacency_from(&hood, &c->near);
    knn_free(knn);
    free(point), free(found), free(distance_sq);
    neighbourhood_done(&hood);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static void contractor_done(struct contractor *c) {
    adjacency_done(&c->near);
    free(c->live), free(c->partner), free(c->cost), free(c->changed);
    free(c->pick), free(c->spare), free(c->kept);
}

static enum status contractor_init(struct contractor *c, const struct neighbourhood *hood) {
    size_t n = hood->n;
    enum status status = adjacency_from(hood, &c->near);
    if (status) return status;
    c->live = alloc_array(n, sizeof *c->live);
    c->partner = alloc_array(n, sizeof *c->partner);
    c->cost = alloc_array(n, sizeof *c->cost);
    c->changed = alloc_zeroed(n, sizeof *c->changed);
    c->pick = alloc_array(n, sizeof *c->pick);
    c->spare = alloc_array(n, sizeof *c->spare);
    c->kept = alloc_array(n, sizeof *c->kept);
    c->out.order = alloc_array(n, sizeof *c->out.order);
    c->out.into = alloc_array(n, sizeof *c->out.into);
    c->out.error = alloc_array(n, sizeof *c->out.error);
    if (!c->live || !c->partner || !c->cost || !c->changed || !c->pick || !c->spare || !c->kept || !c->out.order ||
        !c->out.into || !c->out.error)
        return STATUS_NO_MEMORY;
    double weight = 0;
    for (size_t i = 0; i < n; i++) {
        c->live[i] = (uint32_t)i;
        c->out.into[i] = NONE;
        weight += (double)c->quadric[i].weight;
    }
    c->live_count = n;
    c->length_bias = LENGTH_BIAS * weight / (double)n;
    return STATUS_OK;
}

static enum status pass(struct contractor *c) {
    par_for(c->threads, c->live_count, GRAIN, pick_range, c);
    size_t count = gather_picks(c);
    if (count == 0) return relink(c);
    sort_picks(c, count);
    return update(c, perform(c, count));
}

enum status contract(const vec3 *point, const struct neighbourhood *neighbourhood, struct packed_quadric *quadrics,
                     unsigned threads, const struct progress *progress, struct contraction *out) {
    size_t n = neighbourhood->n;
    assert(n >= 1 && n < NONE);
    struct contractor c = {.point = point, .quadric = quadrics, .threads = threads, .out = {.n = n}};
    enum status status = contractor_init(&c, neighbourhood);
    while (!status && c.live_count > 1) {
        status = pass(&c);
        if (!status && progress_tick(progress, "contract", (double)c.removed / (double)n)) status = STATUS_CANCELLED;
    }
    if (!status) {
        c.out.order[n - 1] = c.live[0];
        c.out.error[n - 1] = INFINITY;
        *out = c.out;
    } else {
        contraction_done(&c.out);
    }
    contractor_done(&c);
    return status;
}

size_t contraction_count_for_error(const struct contraction *contraction, double max_error) {
    size_t low = 0, high = contraction->n - 1; /* errors ascend: the first one that is over */
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if ((double)contraction->error[middle] > max_error)
            high = middle;
        else
            low = middle + 1;
    }
    return contraction->n - low;
}

void contraction_representatives(const struct contraction *contraction, size_t k, uint32_t *representative) {
    size_t n = contraction->n;
    for (size_t i = n; i-- > 0;) { /* whoever a point went into was removed later: its own answer is there already */
        uint32_t p = contraction->order[i];
        representative[p] = n - i <= k ? p : representative[contraction->into[p]];
    }
}

void contraction_done(struct contraction *contraction) {
    if (!contraction) return;
    free(contraction->order);
    free(contraction->into);
    free(contraction->error);
    *contraction = (struct contraction){0};
}
