/* Local repair of a labelling.
 *
 * The cells around a vertex, seen from the vertex, tile a sphere of directions.  The surface passes through the vertex
 * once, as a disc, exactly when the inner cells are one connected region of that sphere and the outer ones another:
 * then the boundary between is one closed curve.  With no inner or no outer cell the point is lost; each further region
 * is a second sheet, or a pinch at an edge.
 *
 *     defect(v) = (inner regions - 1) + (outer regions - 1), or LOST where one of them is 0
 *
 * Flipping the label of one cell changes the defects of its four vertices alone.  The repair takes vertices with a
 * defect off a queue and tries every cell around each, later every such cell together with a neighbour, and then chains
 * of three; of the sets that take defects away the one that is worth most is flipped.  Moves that insert a point into a
 * facet, swap an edge, open or close a pinch are all among them.
 *
 * Points that are still lost in the end count as LOST_DEARLY, so that they come onto the surface at the price of
 * pinches, which are taken apart when it is extracted.
 *
 * Invariant: the sum of all defects falls with each move, so the repair ends; and as a vertex with a very large star
 * makes each try dear, the steps of all floods together have a limit in proportion to the cells, after which things
 * stay as they are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"

enum {
    LOST = 3,
    LOST_DEARLY = 12,
    MANY = 200, /* more defects at one vertex count as so many */
    STEPS_PER_CELL = 300,
    SET_MOST = 3,
    SET_VERTICES = 4 * SET_MOST,
    VERTICES_PER_TICK = 256,
    FAN_MOST = 32,
    GRAIN = 1024,
    STEPS_PER_TRIAL = 50000,
    TRIAL_STEPS_PER_CELL = 300 /* of all trials together */
};

#define DEFECT_WORTH (8 * (int64_t)COCONE_CUT_UNIT)

struct cocone_repair {
    const struct cocone_star *star;
    const struct cocone_cost *cost;
    uint8_t *inside;
    uint32_t *stamp, time; /* of each cell: the last flood that came by */
    uint32_t *stack;       /* as long as the largest star */
    uint32_t *queue;       /* n + 1, a ring */
    uint8_t *queued;
    uint8_t *known; /* of each vertex: its defect + 1; 0 = not known */
    size_t first, length;
    size_t flips;
    int lost;                          /* defects that a lost point counts as */
    uint64_t steps, step_limit;        /* of floods, from cell to cell */
    uint8_t *held;                     /* of each cell: not to be flipped */
    bool held_label[2];                /* nor those of this label */
    struct cocone_repair_trial *trial; /* that is going on, or NULL: its cells are those flipped so far */
};

/* The order of the repair: points first, then the manifold; small sets first; then points that nothing else brought. */
static const struct pass {
    bool lost_alone;
    int size; /* of the sets */
    int lost; /* defects that a lost point counts as */
} passes[] = {{true, 1, LOST},  {true, 2, LOST},  {true, 3, LOST},       {false, 1, LOST},
              {false, 2, LOST}, {false, 3, LOST}, {true, 1, LOST_DEARLY}};

/* Cells to be flipped together. */
struct set {
    uint32_t cell[SET_MOST];
    int count;
};

/* What a move takes away, and what it is worth: more defects less, and a labelling that costs less. */
struct gain {
    int defects;
    int64_t worth;
    struct set set;
};

/* ------------------------------------------------------------------------------------------------ defects */

/* Marks the region of equal label around v from cell on. */
static void flood_side(struct cocone_repair *r, uint32_t v, uint32_t cell) {
    const struct tets *tets = r->star->tets;
    size_t depth = 0;
    r->stack[depth++] = cell;
    r->stamp[cell] = r->time;
    while (depth > 0) {
        uint32_t c = r->stack[--depth];
        for (int i = 0; i < 4; i++) {
            uint32_t other = tets->neighbour[c][i];
            if (tets->vertex[c][i] == v || r->stamp[other] == r->time || r->inside[other] != r->inside[c]) continue;
            r->stamp[other] = r->time;
            r->stack[depth++] = other;
        }
    }
}

static int count_defect(struct cocone_repair *r, uint32_t v) {
    int regions[2] = {0, 0};
    r->time++;
    r->steps += r->star->begin[v + 1] - r->star->begin[v];
    for (uint32_t i = r->star->begin[v]; i < r->star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(r->star->corner[i]);
        if (r->stamp[cell] == r->time) continue;
        regions[r->inside[cell]]++;
        flood_side(r, v, cell);
    }
    return regions[0] == 0 || regions[1] == 0 ? r->lost : regions[0] + regions[1] - 2;
}

/* The half facet at which the surface goes on over the edge (v, w), through inner cells. */
static uint32_t next_facet(const struct cocone_repair *r, uint32_t half, uint32_t v, uint32_t w) {
    for (;;) {
        half = cocone_star_turn(r->star, half, v, w);
        uint32_t twin = cocone_star_twin(r->star, half);
        if (!r->inside[cocone_star_cell(twin)]) return half;
        half = twin;
    }
}

/* How many half facets of inner cells at v are surface, and one of them. */
static int count_facets(const struct cocone_repair *r, uint32_t v, uint32_t *half) {
    int count = 0;
    for (uint32_t i = r->star->begin[v]; i < r->star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(r->star->corner[i]);
        for (unsigned k = 0; k < 4 && r->inside[cell]; k++) {
            if (k == cocone_star_index(r->star->corner[i]) || r->inside[r->star->tets->neighbour[cell][k]]) continue;
            *half = cocone_star_pack(cell, k);
            count++;
        }
    }
    return count;
}

/* The vertex of a half facet that is neither v nor w. */
static uint32_t third(const struct cocone_repair *r, uint32_t half, uint32_t v, uint32_t w) {
    uint32_t vertex[3];
    cocone_star_vertices(r->star, half, vertex);
    int k = 0;
    while (vertex[k] == v || vertex[k] == w) k++;
    return vertex[k];
}

/* Whether all facets of the surface at v are one fan that comes to no edge twice: then there is no defect.  False also
 * where there are too many of them. */
static bool is_one_fan(const struct cocone_repair *r, uint32_t v) {
    uint32_t first = NONE, rim[FAN_MOST];
    int count = count_facets(r, v, &first);
    if (count == 0 || count > FAN_MOST) return false;
    uint32_t half = first, w = third(r, first, v, v);
    for (int n = 0; n < count; n++) {
        for (int k = 0; k < n; k++)
            if (rim[k] == w) return false;
        rim[n] = w;
        half = next_facet(r, half, v, w);
        w = third(r, half, v, w);
        if (half == first) return n + 1 == count;
    }
    return false;
}

static void know_range(void *ctx, size_t begin, size_t end) {
    const struct cocone_repair *r = ctx;
    for (uint32_t v = (uint32_t)begin; v < end; v++) r->known[v] = is_one_fan(r, v);
}

/* The defect with the labels as they are, remembered until a cell around v is flipped for good. */
static int defect(struct cocone_repair *r, uint32_t v) {
    if (r->known[v] == 0) {
        int count = count_defect(r, v);
        r->known[v] = (uint8_t)((count < MANY ? count : MANY) + 1);
    }
    return r->known[v] - 1;
}

static int vertices_of(const struct cocone_repair *r, const struct set *set, uint32_t vertex[SET_VERTICES]) {
    int count = 0;
    for (int s = 0; s < set->count; s++) {
        for (int i = 0; i < 4; i++) {
            uint32_t v = r->star->tets->vertex[set->cell[s]][i];
            int k = 0;
            while (k < count && vertex[k] != v) k++;
            if (k == count) vertex[count++] = v;
        }
    }
    return count;
}

/* ------------------------------------------------------------------------------------------------ flips */

/* The price of a half facet for its cell, or the one across, outside and the other one inside. */
static int64_t price(const struct cocone_repair *r, uint32_t half, bool cell_outside) {
    if (!cell_outside) half = cocone_star_twin(r->star, half);
    return r->cost->price[cocone_star_cell(half)][cocone_star_index(half)];
}

/* What flipping one cell adds to the cost. */
static int64_t flip_cost(const struct cocone_repair *r, uint32_t cell) {
    bool outside = !r->inside[cell];
    int64_t cost = outside ? r->cost->vote[cell] : -(int64_t)r->cost->vote[cell];
    for (unsigned i = 0; i < 4; i++) {
        uint32_t half = cocone_star_pack(cell, i);
        bool cut = r->inside[r->star->tets->neighbour[cell][i]] == outside;
        cost += cut ? -price(r, half, outside) : price(r, half, !outside);
    }
    return cost;
}

/* Whether a set may have the cell. */
static bool may_flip(const struct cocone_repair *r, uint32_t cell) {
    return cocone_star_is_finite(r->star, cell) && !r->held[cell] && !r->held_label[r->inside[cell]];
}

static int64_t flip(struct cocone_repair *r, const struct set *set) {
    int64_t cost = 0;
    for (int s = 0; s < set->count; s++) {
        cost += flip_cost(r, set->cell[s]);
        r->inside[set->cell[s]] ^= 1;
    }
    return cost;
}

/* Whether a move is better than the best one so far.  One that brings no point back has to be worth its cost. */
static bool is_better_gain(int defects, int64_t cost, const struct gain *best) {
    int64_t worth = defects * DEFECT_WORTH - cost;
    if (defects <= 0 || (worth < 0 && defects < LOST)) return false;
    return best->defects == 0 || worth > best->worth;
}

static void try_set(struct cocone_repair *r, const struct set *set, struct gain *best) {
    uint32_t vertex[SET_VERTICES];
    int count = vertices_of(r, set, vertex), before = 0, after = 0;
    for (int k = 0; k < count; k++) before += defect(r, vertex[k]);
    int64_t cost = flip(r, set);
    if (is_better_gain(before, cost, best)) {
        for (int k = 0; k < count; k++) after += count_defect(r, vertex[k]);
        int defects = before - after;
        if (is_better_gain(defects, cost, best)) *best = (struct gain){defects, defects * DEFECT_WORTH - cost, *set};
    }
    flip(r, set);
}

/* Tries the set, and the set with each neighbour of its last cell, up to size cells. */
static void try_grown(struct cocone_repair *r, const struct set *set, int size, struct gain *best) {
    if (set->count == size) {
        try_set(r, set, best);
        return;
    }
    for (int i = 0; i < 4; i++) {
        uint32_t other = r->star->tets->neighbour[set->cell[set->count - 1]][i];
        if (!may_flip(r, other)) continue;
        if (other == set->cell[0] || (set->count > 1 && other == set->cell[1])) continue;
        struct set grown = *set;
        grown.cell[grown.count++] = other;
        try_grown(r, &grown, size, best);
    }
}

static struct gain best_move(struct cocone_repair *r, uint32_t v, int size) {
    struct gain best = {0};
    for (uint32_t i = r->star->begin[v]; i < r->star->begin[v + 1]; i++) {
        struct set set = {{cocone_star_cell(r->star->corner[i])}, 1};
        if (may_flip(r, set.cell[0])) try_grown(r, &set, size, &best);
    }
    return best;
}

/* ------------------------------------------------------------------------------------------------ the queue */

static void enqueue(struct cocone_repair *r, uint32_t v) {
    if (r->queued[v]) return;
    r->queued[v] = 1;
    r->queue[(r->first + r->length++) % (r->star->n + 1)] = v;
}

static uint32_t dequeue(struct cocone_repair *r) {
    uint32_t v = r->queue[r->first];
    r->first = (r->first + 1) % (r->star->n + 1);
    r->length--;
    r->queued[v] = 0;
    return v;
}

static bool is_due(struct cocone_repair *r, uint32_t v, const struct pass *pass) {
    if (r->star->begin[v] == r->star->begin[v + 1]) return false;
    return defect(r, v) >= (pass->lost_alone ? r->lost : 1);
}

/* Adds the set to the cells of the trial; those that are there already are taken out.  False, and the end of the trial,
 * where there is no room. */
static bool note_flips(struct cocone_repair *r, const struct set *set) {
    struct cocone_repair_trial *trial = r->trial;
    if (trial->count + (size_t)set->count > COCONE_REPAIR_TRIAL_CELLS) r->step_limit = 0;
    for (int s = 0; s < set->count && r->step_limit > 0; s++) {
        size_t k = 0;
        while (k < trial->count && trial->cell[k] != set->cell[s]) k++;
        if (k == trial->count)
            trial->cell[trial->count++] = set->cell[s];
        else
            trial->cell[k] = trial->cell[--trial->count];
    }
    return r->step_limit > 0;
}

static void repair_point(struct cocone_repair *r, uint32_t v, const struct pass *pass) {
    if (r->steps > r->step_limit || !is_due(r, v, pass)) return;
    struct gain gain = best_move(r, v, pass->size);
    if (gain.defects == 0) return;
    if (r->trial && !note_flips(r, &gain.set)) return;
    flip(r, &gain.set);
    r->flips += (size_t)gain.set.count;
    uint32_t vertex[SET_VERTICES];
    int count = vertices_of(r, &gain.set, vertex);
    for (int k = 0; k < count; k++) r->known[vertex[k]] = 0;
    for (int k = 0; k < count; k++)
        if (is_due(r, vertex[k], pass)) enqueue(r, vertex[k]);
}

static enum status repair_all(struct cocone_repair *r, const struct pass *pass, const struct progress *progress) {
    int lost = pass->lost;
    for (uint32_t v = 0; v < r->star->n && lost != r->lost; v++)
        if (r->known[v] == r->lost + 1) r->known[v] = 0;
    r->lost = lost;
    for (uint32_t v = 0; v < r->star->n; v++)
        if (is_due(r, v, pass)) enqueue(r, v);
    for (size_t i = 0; r->length > 0; i++) {
        if (i % VERTICES_PER_TICK == 0 && progress_tick(progress, "cocone", 0.8)) return STATUS_CANCELLED;
        repair_point(r, dequeue(r), pass);
    }
    return STATUS_OK;
}

static size_t largest_star(const struct cocone_star *star) {
    size_t largest = 0;
    for (size_t v = 0; v < star->n; v++) {
        size_t size = star->begin[v + 1] - star->begin[v];
        if (size > largest) largest = size;
    }
    return largest;
}

enum status cocone_repair_new(const struct cocone_star *star, const struct cocone_cost *cost, uint8_t *inside,
                              struct cocone_repair **out) {
    struct cocone_repair *r = alloc_zeroed(1, sizeof *r);
    if (!r) return STATUS_NO_MEMORY;
    r->star = star, r->cost = cost, r->inside = inside, r->lost = LOST;
    r->stamp = alloc_zeroed(star->tets->cell_count, sizeof *r->stamp);
    r->held = alloc_zeroed(star->tets->cell_count, sizeof *r->held);
    r->stack = alloc_array(largest_star(star), sizeof *r->stack);
    r->queue = alloc_array(star->n + 1, sizeof *r->queue);
    r->queued = alloc_zeroed(star->n, sizeof *r->queued);
    r->known = alloc_zeroed(star->n, sizeof *r->known);
    r->step_limit = (uint64_t)star->tets->cell_count * STEPS_PER_CELL;
    if (!r->stamp || !r->held || !r->stack || !r->queue || !r->queued || !r->known) {
        cocone_repair_free(r);
        return STATUS_NO_MEMORY;
    }
    *out = r;
    return STATUS_OK;
}

void cocone_repair_free(struct cocone_repair *r) {
    if (!r) return;
    free(r->stamp), free(r->held), free(r->stack);
    free(r->queue), free(r->queued), free(r->known);
    free(r);
}

enum status cocone_repair(const struct cocone_star *star, const struct cocone_cost *cost,
                          const struct progress *progress, unsigned threads, uint8_t *inside, size_t *flips) {
    struct cocone_repair *r;
    enum status status = cocone_repair_new(star, cost, inside, &r);
    if (status) return status;
    par_for(threads, star->n, GRAIN, know_range, r);
    for (size_t i = 0; i < sizeof passes / sizeof *passes && !status; i++) status = repair_all(r, &passes[i], progress);
    if (!status) *flips = r->flips;
    cocone_repair_free(r);
    return status;
}

/* ------------------------------------------------------------------------------------------------ trials */

/* Flips a cell for good: how many facets more the surface has. */
static int flip_one(struct cocone_repair *r, uint32_t cell, int64_t *cost) {
    int facets = 0;
    for (int i = 0; i < 4; i++) {
        facets += r->inside[r->star->tets->neighbour[cell][i]] == r->inside[cell] ? 1 : -1;
        r->known[r->star->tets->vertex[cell][i]] = 0;
    }
    *cost += flip_cost(r, cell);
    r->inside[cell] ^= 1;
    return facets;
}

/* How many facets more. */
static int flip_trial(struct cocone_repair *r, struct cocone_repair_trial *trial) {
    int facets = 0;
    trial->cost = 0;
    for (size_t k = 0; k < trial->count; k++) facets += flip_one(r, trial->cell[k], &trial->cost);
    return facets;
}

static bool has_no_facet(const struct cocone_repair *r, uint32_t v) {
    uint8_t first = r->inside[cocone_star_cell(r->star->corner[r->star->begin[v]])];
    for (uint32_t i = r->star->begin[v]; i < r->star->begin[v + 1]; i++)
        if (r->inside[cocone_star_cell(r->star->corner[i])] != first) return false;
    return true;
}

struct tally {
    int defects, lost, vertices;
};

/* At the points of a trial's cells, each counted once.  Nothing is queued, so the marks of the queue are free. */
static struct tally count_at(struct cocone_repair *r, const struct cocone_repair_trial *trial) {
    const struct tets *tets = r->star->tets;
    struct tally tally = {0, 0, 0};
    for (size_t k = 0; k < 4 * trial->count; k++) {
        uint32_t v = tets->vertex[trial->cell[k / 4]][k % 4];
        if (r->queued[v]) continue;
        bool lost = has_no_facet(r, v);
        r->queued[v] = 1;
        tally.defects += defect(r, v);
        tally.lost += lost;
        tally.vertices += lost ? 0 : defect(r, v) + 1;
    }
    for (size_t k = 0; k < 4 * trial->count; k++) r->queued[tets->vertex[trial->cell[k / 4]][k % 4]] = 0;
    return tally;
}

static void enqueue_defects(struct cocone_repair *r, const struct cocone_repair_trial *trial, const struct pass *pass) {
    for (size_t k = 0; k < trial->count; k++) {
        for (int i = 0; i < 4; i++) {
            uint32_t v = r->star->tets->vertex[trial->cell[k]][i];
            if (is_due(r, v, pass)) enqueue(r, v);
        }
    }
}

static void hold(struct cocone_repair *r, const struct cocone_repair_trial *trial, bool held) {
    for (size_t k = 0; k < trial->count; k++) r->held[trial->cell[k]] = held;
}

static void repair_trial_points(struct cocone_repair *r, struct cocone_repair_trial *trial) {
    for (size_t i = 0; i < sizeof passes / sizeof *passes; i++) {
        enqueue_defects(r, trial, &passes[i]);
        while (r->length > 0) repair_point(r, dequeue(r), &passes[i]);
    }
}

bool cocone_repair_may_try(const struct cocone_repair *r) {
    return r->steps < TRIAL_STEPS_PER_CELL * r->star->tets->cell_count;
}

void cocone_repair_try(struct cocone_repair *r, const uint32_t *seed, size_t count, struct cocone_repair_trial *trial) {
    *trial = (struct cocone_repair_trial){0};
    if (count > COCONE_REPAIR_TRIAL_CELLS) return;
    uint8_t label = r->inside[seed[0]];
    int64_t cost = 0;
    for (size_t k = 0; k < count; k++) {
        trial->cell[trial->count++] = seed[k];
        flip_one(r, seed[k], &cost);
    }
    hold(r, trial, true);
    r->trial = trial;
    r->step_limit = r->steps + STEPS_PER_TRIAL;
    /* What is flipped one way is held before other cells may be flipped back. */
    r->held_label[!label] = true;
    repair_trial_points(r, trial);
    r->held_label[!label] = false;
    hold(r, trial, true);
    repair_trial_points(r, trial);
    r->trial = NULL;
    hold(r, trial, false);
    struct tally after = count_at(r, trial);
    int facets = -flip_trial(r, trial);
    struct tally before = count_at(r, trial);
    trial->cost = -trial->cost;
    trial->defects = after.defects - before.defects;
    trial->lost = after.lost - before.lost;
    trial->euler = after.vertices - before.vertices - facets / 2;
    if (r->step_limit == 0) trial->count = 0;
}

void cocone_repair_forget(struct cocone_repair *r, const struct cocone_repair_trial *trial) {
    for (size_t k = 0; k < trial->count; k++)
        for (int i = 0; i < 4; i++) r->known[r->star->tets->vertex[trial->cell[k]][i]] = 0;
}
