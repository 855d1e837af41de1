/* Lee, Jong: Point-based Simplification Algorithm, section 4.4, step by step.
 *
 *     section 4.1   N_p, Gopi's neighbours within m times the distance to the nearest   core/spatial/neighbourhood.c
 *     section 4.2   n_p, the least-squares normal over N_p                               core/simplify/normals.c
 *     sections 3,   the discrete shape operator sqrt(k^2 + tau^2) of n_p over N_p        core/simplify/dso.c
 *     4.3
 *     section 4.4   step 1: Q_p = DSO_p x the sum of K over the planes of the virtual    core/simplify/quadric.c
 *                   triangles (p, q_i, q_i+1)
 *                   steps 2 to 6: below
 *
 * Q_p is a quadric error function: E_p(x) = the weighted sum of squared distances of x to the planes of p (Garland,
 * Heckbert 1997).  A virtual edge (p, q) joins neighbours, whichever of the two names the other.  Contracting it to p'
 * costs E_p(p') + E_q(p'), and p' gets Q_p + Q_q.
 *
 * Where the paper leaves a choice it is taken as in contract.c: p' is the cheaper end, so that a subset of the points
 * is left, and a trace of the squared length makes flat regions, where all costs are 0, contract their short edges
 * first.  Normals and operators aren't found anew.
 *
 * The heap is the simplest one that is right: whenever a point changes, its pairs are pushed again with new costs, and
 * a pair that is popped counts only where neither end has changed since it was pushed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/reference/contract.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/simplify/adjacency.h"

static const double LENGTH_BIAS = 1e-9; /* of the mean weight of the quadrics */

/* A virtual edge with its cost, as both ends were when it was pushed. */
struct edge {
    double cost, length_sq;
    uint32_t p, q, version_p, version_q;
};

struct links {
    uint32_t *id;
    size_t count, room;
};

struct greedy {
    const vec3 *point;
    size_t n;
    quadric *quadric;    /* n: Q_p about p */
    struct links *links; /* n: the other ends of the virtual edges at each point */
    uint32_t *version;   /* n: how often a point was contracted into */
    uint8_t *gone;       /* n */
    struct edge *heap;
    size_t used, room;
    double bias;
};

/* ------------------------------------------------------------------------------------------------ the heap */

/* The cheapest first; of equal ones the shorter, then the lower ids. */
static bool is_before(const struct edge *a, const struct edge *b) {
    if (a->cost != b->cost) return a->cost < b->cost;
    if (a->length_sq != b->length_sq) return a->length_sq < b->length_sq;
    return a->p != b->p ? a->p < b->p : a->q < b->q;
}

static enum status heap_push(struct greedy *g, struct edge edge) {
    if (g->used == g->room) {
        size_t room = 2 * g->room + 1024;
        struct edge *heap = alloc_resize(g->heap, room, sizeof *heap);
        if (!heap) return STATUS_NO_MEMORY;
        g->heap = heap, g->room = room;
    }
    size_t i = g->used++;
    for (; i > 0 && is_before(&edge, &g->heap[(i - 1) / 2]); i = (i - 1) / 2) g->heap[i] = g->heap[(i - 1) / 2];
    g->heap[i] = edge;
    return STATUS_OK;
}

static struct edge heap_pop(struct greedy *g) {
    struct edge top = g->heap[0], last = g->heap[--g->used];
    size_t i = 0;
    for (size_t child; (child = 2 * i + 1) < g->used; i = child) {
        if (child + 1 < g->used && is_before(&g->heap[child + 1], &g->heap[child])) child++;
        if (!is_before(&g->heap[child], &last)) break;
        g->heap[i] = g->heap[child];
    }
    g->heap[i] = last;
    return top;
}

/* ------------------------------------------------------------------------------------------------ virtual edges */

static void unlink_from(struct greedy *g, uint32_t p, uint32_t q) {
    struct links *links = &g->links[p];
    for (size_t i = 0; i < links->count; i++)
        if (links->id[i] == q) links->id[i--] = links->id[--links->count];
}

static enum status link_to(struct greedy *g, uint32_t p, uint32_t q) {
    struct links *links = &g->links[p];
    unlink_from(g, p, q);
    if (links->count == links->room) {
        size_t room = 2 * links->room + 8;
        uint32_t *id = alloc_resize(links->id, room, sizeof *id);
        if (!id) return STATUS_NO_MEMORY;
        links->id = id, links->room = room;
    }
    links->id[links->count++] = q;
    return STATUS_OK;
}

/* E_p + E_q at p. */
static double error_at(const struct greedy *g, uint32_t p, uint32_t q) {
    return fmax(g->quadric[p].c, 0) + quadric_value(&g->quadric[q], vec3_sub(g->point[p], g->point[q]));
}

/* Section 4.4: the cost of the edge at the cheaper end, and its place in the heap. */
static enum status push_edge(struct greedy *g, uint32_t p, uint32_t q) {
    double length_sq = vec3_distance_sq(g->point[p], g->point[q]);
    double cost = fmin(error_at(g, p, q), error_at(g, q, p)) + g->bias * length_sq;
    return heap_push(g, (struct edge){cost, length_sq, p, q, g->version[p], g->version[q]});
}

/* Section 4.4: the point that stays is p', with Q_p + Q_q and the virtual edges of both, whose costs are found anew. */
static enum status contract_edge(struct greedy *g, uint32_t stays, uint32_t goes) {
    enum status status = STATUS_OK;
    const struct links *links = &g->links[goes];
    quadric moved = quadric_shift(g->quadric[goes], vec3_sub(g->point[goes], g->point[stays]));
    g->quadric[stays] = quadric_add(g->quadric[stays], moved);
    g->gone[goes] = 1;
    g->version[stays]++;
    unlink_from(g, stays, goes);
    for (size_t i = 0; !status && i < links->count; i++) {
        uint32_t j = links->id[i];
        if (j == stays) continue;
        unlink_from(g, j, goes);
        status = link_to(g, j, stays);
        if (!status) status = link_to(g, stays, j);
    }
    links = &g->links[stays];
    for (size_t i = 0; !status && i < links->count; i++) status = push_edge(g, stays, links->id[i]);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the method */

static enum status link_neighbours(struct greedy *g, const struct neighbourhood *neighbours) {
    struct adjacency near = {0};
    enum status status = adjacency_from(neighbours, 1, &near);
    for (uint32_t p = 0; !status && p < g->n; p++)
        for (unsigned i = 0; !status && i < near.degree[p]; i++) status = link_to(g, p, near.list[near.start[p] + i]);
    if (!status) adjacency_done(&near);
    return status;
}

static enum status greedy_init(struct greedy *g, const vec3 *point, const struct neighbourhood *neighbours,
                               const struct packed_quadric *quadrics) {
    *g = (struct greedy){.point = point, .n = neighbours->n};
    g->quadric = alloc_array(g->n, sizeof *g->quadric);
    g->links = alloc_zeroed(g->n, sizeof *g->links);
    g->version = alloc_zeroed(g->n, sizeof *g->version);
    g->gone = alloc_zeroed(g->n, sizeof *g->gone);
    if (!g->quadric || !g->links || !g->version || !g->gone) return STATUS_NO_MEMORY;
    double weight = 0;
    for (size_t p = 0; p < g->n; p++) {
        g->quadric[p] = quadric_unpack(&quadrics[p]);
        weight += g->quadric[p].weight;
    }
    g->bias = LENGTH_BIAS * weight / (double)g->n;
    enum status status = link_neighbours(g, neighbours);
    for (uint32_t p = 0; !status && p < g->n; p++)
        for (size_t i = 0; !status && i < g->links[p].count; i++)
            if (p < g->links[p].id[i]) status = push_edge(g, p, g->links[p].id[i]);
    return status;
}

static void greedy_done(struct greedy *g) {
    for (size_t p = 0; g->links && p < g->n; p++) free(g->links[p].id);
    free(g->quadric), free(g->links), free(g->version), free(g->gone), free(g->heap);
}

static bool is_current(const struct greedy *g, const struct edge *edge) {
    return !g->gone[edge->p] && !g->gone[edge->q] && g->version[edge->p] == edge->version_p &&
           g->version[edge->q] == edge->version_q;
}

enum status reference_contract(const vec3 *point, const struct neighbourhood *neighbours,
                               const struct packed_quadric *quadrics, size_t k, uint32_t *kept) {
    struct greedy g;
    enum status status = greedy_init(&g, point, neighbours, quadrics);
    for (size_t left = g.n; !status && left > k;) { /* the required number */
        if (g.used == 0) {
            status = STATUS_DEGENERATE;
            break;
        }
        struct edge edge = heap_pop(&g);
        if (!is_current(&g, &edge)) continue;
        bool p_stays = error_at(&g, edge.p, edge.q) <= error_at(&g, edge.q, edge.p);
        status = contract_edge(&g, p_stays ? edge.p : edge.q, p_stays ? edge.q : edge.p);
        left--;
    }
    for (uint32_t p = 0; !status && p < g.n; p++)
        if (!g.gone[p]) *kept++ = p;
    greedy_done(&g);
    return status;
}
