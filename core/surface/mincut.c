/* Augmenting paths between two search trees that are kept from one path to the next.
 *
 * One tree grows from the source, the other from the sink.  Where they touch there is a path with capacity left; it is
 * filled, some of its arcs become full and cut subtrees off, whose roots are orphans.  An orphan looks for a new parent
 * in its own tree, the nearest to the terminal; one that finds none leaves the tree and orphans its children.  When
 * neither tree can grow the flow is at its maximum.
 *
 *     source -> S tree ... s ==arc==> t ... T tree -> sink          free nodes are in neither
 *
 * Invariant between phases: each node of a tree reaches its terminal along parents through arcs that have capacity left
 * (in the direction of flow); every node on the rim that might grow is active.
 *
 * Distances to the terminal are remembered with the time of their computation, so that tracing to the root stops at
 * what is known of this phase.
 *
 * Capacities may change after a search.  What flows stays, as far as there is room, and so do the trees: the next
 * search begins with the nodes that were touched, as orphans or as new roots.
 *
 * Sources: Y. Boykov, V. Kolmogorov, An experimental comparison of min-cut/max-flow algorithms (2004).  P. Kohli, P.
 * Torr, Dynamic graph cuts for efficient inference in Markov random fields (2007), for the changes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/mincut.h"

#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

enum tree { FREE, SOURCE, SINK };

/* A parent is an arc 0 .. 3, or one of these. */
enum { TERMINAL = 4, ORPHAN = 5, ROOTLESS = 6 };

/* Steps count along paths, too.  Scans take up to five for each node, a forest's volume 17; points of lines hundreds.
 */
enum { STEPS_PER_NODE = 200, PHASES_PER_TICK = 1024 };

struct queue {
    uint32_t first, last;
    uint32_t *next; /* of each node; NONE = last; its own id = not queued */
};

struct node {
    uint32_t distance, stamp; /* to the terminal, and the phase in which that was true */
    uint8_t tree, parent;
};

struct mincut_search {
    struct mincut *graph;
    struct node *node;
    uint32_t phase;
    struct queue active, orphans, changed;
    uint64_t steps;
};

static void queue_init(struct queue *queue, size_t n) {
    queue->first = queue->last = NONE;
    for (uint32_t i = 0; i < n; i++) queue->next[i] = i;
}

static void queue_push(struct queue *queue, uint32_t node) {
    if (queue->next[node] != node) return;
    queue->next[node] = NONE;
    if (queue->last == NONE)
        queue->first = node;
    else
        queue->next[queue->last] = node;
    queue->last = node;
}

static uint32_t queue_pop(struct queue *queue) {
    uint32_t node = queue->first;
    if (node == NONE) return NONE;
    queue->first = queue->next[node];
    if (queue->first == NONE) queue->last = NONE;
    queue->next[node] = node;
    return node;
}

/* Capacity left between a node and its neighbour across arc i, in the direction from the tree's root outwards or, for
 * outwards = false, back to it.  Flow runs away from the source and towards the sink. */
static int32_t residual(const struct mincut_search *s, uint32_t node, unsigned i, bool outwards) {
    const struct mincut *g = s->graph;
    bool forward = (s->node[node].tree == SOURCE) == outwards;
    return forward ? g->capacity[node][i] : g->capacity[g->neighbour[node][i]][g->mirror[node][i]];
}

static void plant(struct mincut_search *s) {
    for (uint32_t c = 0; c < s->graph->node_count; c++) {
        int32_t terminal = s->graph->terminal[c];
        s->node[c].tree = terminal > 0 ? SOURCE : terminal < 0 ? SINK : FREE;
        s->node[c].parent = terminal ? TERMINAL : ROOTLESS;
        s->node[c].distance = terminal ? 1 : 0;
        if (terminal) queue_push(&s->active, c);
    }
}

/* A node takes a free neighbour into its tree, or becomes the parent of one that would be nearer to the root so. */
static void take(struct mincut_search *s, uint32_t node, unsigned i) {
    uint32_t at = s->graph->neighbour[node][i];
    const struct node *from = &s->node[node];
    struct node *to = &s->node[at];
    bool is_new = to->tree == FREE;
    if (!is_new && (to->stamp > from->stamp || to->parent >= TERMINAL)) return;
    *to = (struct node){from->distance + 1, from->stamp, from->tree, s->graph->mirror[node][i]};
    if (is_new) queue_push(&s->active, at);
}

/* Grows from the node until the trees touch: the arc over which they do, or 4.  Most neighbours are in the same tree,
 * and as near to the root. */
static unsigned grow(struct mincut_search *s, uint32_t node) {
    for (unsigned i = 0; i < 4; i++) {
        const struct node *from = &s->node[node], *to = &s->node[s->graph->neighbour[node][i]];
        if (to->tree == from->tree && to->distance <= from->distance + 1) continue;
        if (!residual(s, node, i, true)) continue;
        if (to->tree != FREE && to->tree != from->tree) return i;
        take(s, node, i);
    }
    return 4;
}

static void orphan(struct mincut_search *s, uint32_t node) {
    s->node[node].parent = ORPHAN;
    queue_push(&s->orphans, node);
}

/* The capacity left along the parents of a node and at its terminal. */
static int32_t bottleneck(struct mincut_search *s, uint32_t node, int32_t least) {
    for (; s->node[node].parent != TERMINAL; s->steps++) {
        unsigned i = s->node[node].parent;
        int32_t left = residual(s, node, i, false);
        if (left < least) least = left;
        node = s->graph->neighbour[node][i];
    }
    int32_t end = abs(s->graph->terminal[node]);
    return end < least ? end : least;
}

static void push(struct mincut_search *s, uint32_t node, int32_t flow) {
    struct mincut *g = s->graph;
    int32_t sign = s->node[node].tree == SOURCE ? 1 : -1;
    while (s->node[node].parent != TERMINAL) {
        unsigned i = s->node[node].parent, j = g->mirror[node][i];
        uint32_t up = g->neighbour[node][i];
        g->capacity[node][i] += sign * flow;
        g->capacity[up][j] -= sign * flow;
        if (!residual(s, node, i, false)) orphan(s, node);
        node = up;
    }
    g->terminal[node] -= sign * flow;
    if (!g->terminal[node]) orphan(s, node);
}

/* Fills the path over arc i of a node where the trees touch. */
static void augment(struct mincut_search *s, uint32_t node, unsigned i) {
    struct mincut *g = s->graph;
    if (s->node[node].tree == SINK) {
        uint32_t other = g->neighbour[node][i];
        i = g->mirror[node][i];
        node = other;
    }
    uint32_t other = g->neighbour[node][i];
    int32_t flow = bottleneck(s, other, bottleneck(s, node, g->capacity[node][i]));
    g->capacity[node][i] -= flow;
    g->capacity[other][g->mirror[node][i]] += flow;
    push(s, node, flow);
    push(s, other, flow);
}

/* Distance of a node to its terminal along parents, UINT32_MAX where it hangs on an orphan; remembered on the way. */
static uint32_t trace(struct mincut_search *s, uint32_t node) {
    uint32_t length = 0, at = node;
    while (s->node[at].stamp != s->phase && s->node[at].parent < TERMINAL) {
        at = s->graph->neighbour[at][s->node[at].parent];
        length++;
    }
    s->steps += length + 1;
    if (s->node[at].parent > TERMINAL) return UINT32_MAX;
    length += s->node[at].stamp == s->phase ? s->node[at].distance : 1;
    if (s->node[at].stamp != s->phase) s->node[at].distance = 1, s->node[at].stamp = s->phase;
    for (uint32_t d = length; s->node[node].stamp != s->phase;
         node = s->graph->neighbour[node][s->node[node].parent], d--) {
        s->node[node].distance = d;
        s->node[node].stamp = s->phase;
    }
    return length;
}

static bool find_parent(struct mincut_search *s, uint32_t node) {
    uint32_t best = UINT32_MAX;
    unsigned best_arc = 4;
    for (unsigned i = 0; i < 4; i++) {
        uint32_t other = s->graph->neighbour[node][i];
        if (s->node[other].tree != s->node[node].tree || s->node[other].parent == ROOTLESS) continue;
        if (!residual(s, node, i, false)) continue;
        uint32_t distance = trace(s, other);
        if (distance < best) best = distance, best_arc = i;
    }
    if (best_arc == 4) return false;
    s->node[node].parent = (uint8_t)best_arc;
    s->node[node].distance = best + 1;
    s->node[node].stamp = s->phase;
    return true;
}

/* Its children become orphans; neighbours that could take it in again become active. */
static void leave(struct mincut_search *s, uint32_t node) {
    for (unsigned i = 0; i < 4; i++) {
        uint32_t other = s->graph->neighbour[node][i];
        if (s->node[other].tree != s->node[node].tree) continue;
        if (residual(s, node, i, false)) queue_push(&s->active, other);
        if (s->node[other].parent == s->graph->mirror[node][i]) orphan(s, other);
    }
    s->node[node].tree = FREE;
    s->node[node].parent = ROOTLESS;
}

static void adopt(struct mincut_search *s) {
    for (uint32_t node = queue_pop(&s->orphans); node != NONE; node = queue_pop(&s->orphans)) {
        s->steps++;
        if (!find_parent(s, node)) leave(s, node);
    }
}

/* ------------------------------------------------------------------------------------------------ changes */

/* A node whose terminal has changed sides starts anew: its children lose it, and the other tree may have it. */
static void plant_anew(struct mincut_search *s, uint32_t node) {
    s->node[node].tree = s->graph->terminal[node] > 0 ? SOURCE : SINK;
    for (unsigned i = 0; i < 4; i++) {
        uint32_t other = s->graph->neighbour[node][i];
        if (s->changed.next[other] != other || s->node[other].tree == FREE) continue;
        if (s->node[other].parent == s->graph->mirror[node][i]) orphan(s, other);
        if (s->node[other].tree != s->node[node].tree && residual(s, node, i, true)) queue_push(&s->active, other);
    }
}

/* Where terminals or arcs have changed, trees are mended before they grow on. */
static void mend(struct mincut_search *s) {
    s->phase++;
    for (uint32_t node = queue_pop(&s->changed); node != NONE; node = queue_pop(&s->changed)) {
        int32_t terminal = s->graph->terminal[node];
        queue_push(&s->active, node);
        if (!terminal) {
            if (s->node[node].tree != FREE) orphan(s, node);
            continue;
        }
        if (s->node[node].tree != (terminal > 0 ? SOURCE : SINK)) plant_anew(s, node);
        s->node[node].parent = TERMINAL;
        s->node[node].distance = 1;
        s->node[node].stamp = s->phase;
    }
    adopt(s);
}

void mincut_add_terminal(struct mincut_search *s, uint32_t node, int32_t by) {
    s->graph->terminal[node] += by;
    queue_push(&s->changed, node);
}

/* Flow that an arc has no room for any more goes back: its tail has it left over, its head wants it. */
void mincut_add_arc(struct mincut_search *s, uint32_t node, unsigned i, int32_t by) {
    struct mincut *g = s->graph;
    uint32_t other = g->neighbour[node][i];
    int32_t *capacity = &g->capacity[node][i], excess = -(*capacity + by);
    *capacity += by;
    if (excess > 0) {
        *capacity = 0;
        g->capacity[other][g->mirror[node][i]] -= excess;
        g->terminal[node] += excess;
        g->terminal[other] -= excess;
    }
    queue_push(&s->changed, node);
    queue_push(&s->changed, other);
}

/* ------------------------------------------------------------------------------------------------ the search */

enum status mincut_flow(struct mincut_search *s, const char *stage, const struct progress *progress) {
    uint64_t phases = 0, step_limit = s->steps + (uint64_t)s->graph->node_count * STEPS_PER_NODE;
    if (s->phase == 0) plant(s);
    mend(s);
    for (uint32_t node = queue_pop(&s->active); node != NONE && s->steps < step_limit; node = queue_pop(&s->active)) {
        while (s->node[node].tree != FREE) {
            unsigned arc = grow(s, node);
            if (arc == 4) break;
            s->phase++;
            augment(s, node, arc);
            adopt(s);
            if (++phases % PHASES_PER_TICK == 0 && progress_tick(progress, stage, 0.5)) return STATUS_CANCELLED;
            if (s->steps >= step_limit) break;
        }
    }
    return STATUS_OK;
}

bool mincut_is_source(const struct mincut_search *s, uint32_t node) { return s->node[node].tree == SOURCE; }

enum status mincut_new(struct mincut *graph, struct mincut_search **out) {
    size_t n = graph->node_count;
    struct mincut_search *s = alloc_zeroed(1, sizeof *s);
    if (!s) return STATUS_NO_MEMORY;
    *s = (struct mincut_search){.graph = graph,
                                .node = alloc_zeroed(n, sizeof *s->node),
                                .active.next = alloc_array(n, sizeof(uint32_t)),
                                .orphans.next = alloc_array(n, sizeof(uint32_t)),
                                .changed.next = alloc_array(n, sizeof(uint32_t))};
    if (!s->node || !s->active.next || !s->orphans.next || !s->changed.next) {
        mincut_free(s);
        return STATUS_NO_MEMORY;
    }
    queue_init(&s->active, n), queue_init(&s->orphans, n), queue_init(&s->changed, n);
    *out = s;
    return STATUS_OK;
}

void mincut_free(struct mincut_search *s) {
    if (!s) return;
    free(s->node);
    free(s->active.next), free(s->orphans.next), free(s->changed.next);
    free(s);
}
