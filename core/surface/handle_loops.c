/* Loops that don't bound.
 *
 * A spanning tree of the edges and one of the triangles, across edges that aren't in the first, leave two edges over
 * for each handle.  Such an edge closes a path through triangles, and these closed paths are a basis: a loop of edges
 * is the boundary of a piece of surface exactly when it crosses each of them an even number of times.  Each path gets a
 * random number; an edge's mark is the sum (exclusive or) of the numbers of the paths across it, and the class of a
 * loop is that of the marks along it, 0 for those that bound.
 *
 *     tree -> cotree -> marks -> from each marked vertex breadth first, paths with the marks along them
 *                                two paths that meet with different marks: a loop
 *
 * Invariant: every loop that doesn't bound has a marked edge, so all short ones are met from the ends of those.
 *
 * Two classes are taken for one with a probability of 2^-64; the numbers are the same in each run.
 *
 * Source: J. Erickson, K. Whittlesey, Greedy optimal homotopy and homology generators (2005), for the tree and cotree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/handle_loops.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"

enum { CLASSES_AT_ONCE = 8 };

/* A vertex as it is seen from the base. */
struct visit {
    uint32_t parent; /* half-edge to here; NONE at the base */
    uint32_t level;  /* edges from the base */
    uint64_t mark;   /* of the path */
    double length;
};

/* A loop before its vertices are written out: two paths from the base and the half-edge between their ends. */
struct found {
    uint64_t class;
    uint32_t base, closing, count;
    double length;
};

struct search {
    const struct mesh *mesh;
    struct halfedge he;
    uint64_t *mark;  /* of each half-edge, the same for its twin */
    uint8_t *tree;   /* of each half-edge */
    uint32_t *climb; /* of each triangle: its half-edge towards the root of the cotree; NONE at roots */
    uint32_t *queue; /* of triangles or vertices */
    uint8_t *seen;   /* of each of them */
    struct visit *visit;
    uint32_t *order; /* of visits, as long as all vertices; those of the last search are seen */
    uint32_t edges_most;
    size_t most, visited, steps; /* most: of vertices and of triangles */
    struct found *found;
    size_t found_count, found_room;
};

/* ------------------------------------------------------------------------------------------------ marks */

static void grow_tree(struct search *s, uint32_t root) {
    size_t first = 0, last = 0;
    s->queue[last++] = root;
    s->seen[root] = 1;
    while (first < last) {
        uint32_t v = s->queue[first++], start = s->he.out[v], h = start;
        do {
            uint32_t to = halfedge_to(&s->he, h);
            if (!s->seen[to]) {
                s->seen[to] = s->tree[h] = s->tree[s->he.twin[h]] = 1;
                s->queue[last++] = to;
            }
            h = halfedge_around(&s->he, h);
        } while (h != start);
    }
}

static void grow_cotree(struct search *s, uint32_t root) {
    size_t first = 0, last = 0;
    s->queue[last++] = root;
    s->seen[root] = 1;
    s->climb[root] = NONE;
    while (first < last) {
        uint32_t t = s->queue[first++];
        for (uint32_t h = 3 * t; h < 3 * t + 3; h++) {
            uint32_t twin = s->he.twin[h];
            if (s->tree[h] || s->seen[twin / 3]) continue;
            s->seen[twin / 3] = 1;
            s->climb[twin / 3] = twin;
            s->queue[last++] = twin / 3;
        }
    }
}

static void toggle(struct search *s, uint32_t h, uint64_t number) {
    s->mark[h] ^= number;
    s->mark[s->he.twin[h]] ^= number;
}

/* What two climbs have in common cancels. */
static void climb(struct search *s, uint32_t triangle, uint64_t number) {
    for (uint32_t h = s->climb[triangle]; h != NONE; h = s->climb[s->he.twin[h] / 3]) toggle(s, h, number);
}

static bool is_left_over(const struct search *s, uint32_t h) {
    uint32_t twin = s->he.twin[h];
    return h < twin && !s->tree[h] && s->climb[h / 3] != h && s->climb[twin / 3] != twin;
}

/* How many paths there are: two for each handle. */
static size_t mark_edges(struct search *s) {
    size_t paths = 0;
    for (uint32_t v = 0; v < s->he.vertex_count; v++)
        if (!s->seen[v]) grow_tree(s, v);
    memset(s->seen, 0, s->most);
    for (uint32_t t = 0; t < s->he.triangle_count; t++)
        if (!s->seen[t]) grow_cotree(s, t);
    for (uint32_t h = 0; h < 3 * s->he.triangle_count; h++) {
        if (!is_left_over(s, h)) continue;
        uint64_t number = hash64(++paths);
        toggle(s, h, number);
        climb(s, h / 3, number);
        climb(s, s->he.twin[h] / 3, number);
    }
    return paths;
}

/* ------------------------------------------------------------------------------------------------ loops */

static double length_of(const struct search *s, uint32_t h) {
    return vec3_distance(s->mesh->vertex[halfedge_from(&s->he, h)], s->mesh->vertex[halfedge_to(&s->he, h)]);
}

/* Of both paths and the half-edge between their ends. */
static double length_with(const struct search *s, uint32_t h) {
    return s->visit[halfedge_from(&s->he, h)].length + s->visit[halfedge_to(&s->he, h)].length + length_of(s, h);
}

/* Remembers the loop, if it is the shortest of its class from this base, whose loops begin at `first`.  Lengths are
 * worked out where that is the question: most loops of a class have more edges than one that is known. */
static enum status remember(struct search *s, size_t first, struct found loop) {
    size_t i = first;
    while (i < s->found_count && s->found[i].class != loop.class) i++;
    bool is_known = i < s->found_count;
    if (is_known ? loop.count > s->found[i].count : i - first == CLASSES_AT_ONCE) return STATUS_OK;
    loop.length = length_with(s, loop.closing);
    if (is_known) {
        const struct found *so_far = &s->found[i];
        if (loop.count < so_far->count || loop.length < so_far->length) s->found[i] = loop;
        return STATUS_OK;
    }
    if (s->found_count == s->found_room) {
        size_t room = 2 * s->found_room + 64;
        struct found *grown = alloc_resize(s->found, room, sizeof *grown);
        if (!grown) return STATUS_NO_MEMORY;
        s->found = grown, s->found_room = room;
    }
    s->found[s->found_count++] = loop;
    return STATUS_OK;
}

/* Comes to the end of h from its start.  Of two paths with as many edges the shorter one is kept; lengths are worked
 * out where that is the question. */
static void step(struct search *s, uint32_t h) {
    uint32_t from = halfedge_from(&s->he, h), to = halfedge_to(&s->he, h);
    const struct visit *at = &s->visit[from];
    s->steps -= s->steps > 0;
    if (s->seen[to] && s->visit[to].level != at->level + 1) return;
    double length = at->length + length_of(s, h);
    if (s->seen[to] && length >= s->visit[to].length) return;
    s->visit[to] = (struct visit){h, at->level + 1, at->mark ^ s->mark[h], length};
    if (s->seen[to]) return;
    s->seen[to] = 1;
    s->order[s->visited++] = to;
}

/* Visits what is up to half of the most edges from the base.  A level is whole before the next one starts, so that a
 * path replaced by a shorter one of as many edges has nothing that hangs on it. */
static void look_around(struct search *s, uint32_t base) {
    for (size_t i = 0; i < s->visited; i++) s->seen[s->order[i]] = 0;
    s->visited = 1;
    s->order[0] = base;
    s->seen[base] = 1;
    s->visit[base] = (struct visit){NONE, 0, 0, 0};
    for (size_t i = 0; i < s->visited; i++) {
        uint32_t start = s->he.out[s->order[i]], h = start;
        if (s->visit[s->order[i]].level == s->edges_most / 2) break;
        do {
            step(s, h);
            h = halfedge_around(&s->he, h);
        } while (h != start);
    }
}

/* Remembers the loop that the half-edge closes, if it closes one that doesn't bound. */
static enum status close_loop(struct search *s, uint32_t base, size_t first, uint32_t h) {
    uint32_t from = halfedge_from(&s->he, h), to = halfedge_to(&s->he, h);
    if (!s->seen[to] || from > to) return STATUS_OK;
    const struct visit *a = &s->visit[from], *b = &s->visit[to];
    uint64_t class = a->mark ^ b->mark ^ s->mark[h];
    uint32_t count = a->level + b->level + 1;
    if (class == 0 || count > s->edges_most) return STATUS_OK;
    return remember(s, first, (struct found){class, base, h, count, 0});
}

static enum status close_loops(struct search *s, uint32_t base) {
    size_t first = s->found_count;
    enum status status = STATUS_OK;
    for (size_t i = 0; i < s->visited && !status; i++) {
        uint32_t start = s->he.out[s->order[i]], h = start;
        do {
            status = close_loop(s, base, first, h);
            h = halfedge_around(&s->he, h);
        } while (h != start && !status);
    }
    return status;
}

static bool is_marked(const struct search *s, uint32_t v) {
    uint32_t start = s->he.out[v], h = start;
    do {
        if (s->mark[h]) return true;
        h = halfedge_around(&s->he, h);
    } while (h != start);
    return false;
}

static enum status search_all(struct search *s) {
    enum status status = STATUS_OK;
    memset(s->seen, 0, s->most);
    for (uint32_t v = 0; v < s->he.vertex_count && !status && s->steps > 0; v++) {
        if (!is_marked(s, v)) continue;
        look_around(s, v);
        status = close_loops(s, v);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ the result */

static int by_class(const void *x, const void *y) {
    const struct found *a = x, *b = y;
    if (a->class != b->class) return a->class < b->class ? -1 : 1;
    if (a->count != b->count) return a->count < b->count ? -1 : 1;
    if (a->length != b->length) return a->length < b->length ? -1 : 1;
    return a->base < b->base ? -1 : a->base > b->base;
}

static int by_length(const void *x, const void *y) {
    const struct found *a = x, *b = y;
    if (a->count != b->count) return a->count < b->count ? -1 : 1;
    if (a->length != b->length) return a->length < b->length ? -1 : 1;
    return a->base < b->base ? -1 : a->base > b->base;
}

/* One path from its end to the base, the other one from the base to its end.  The two may share a part near the base,
 * which is left out. */
static void write_out(const struct search *s, const struct found *found, struct loop *loop) {
    uint32_t path[2][LOOPS_MOST_EDGES], length[2];
    for (int side = 0; side < 2; side++) {
        uint32_t v = side ? halfedge_to(&s->he, found->closing) : halfedge_from(&s->he, found->closing);
        length[side] = s->visit[v].level + 1;
        for (uint32_t k = length[side]; k-- > 0;) {
            path[side][k] = v;
            if (k > 0) v = halfedge_from(&s->he, s->visit[v].parent);
        }
    }
    uint32_t shared = 0;
    while (shared + 1 < length[0] && shared + 1 < length[1] && path[0][shared + 1] == path[1][shared + 1]) shared++;
    *loop = (struct loop){.length = found->length, .homology = found->class};
    for (uint32_t k = length[0]; k-- > shared;) loop->vertex[loop->count++] = path[0][k];
    for (uint32_t k = shared + 1; k < length[1]; k++) loop->vertex[loop->count++] = path[1][k];
}

static enum status take_shortest(struct search *s, struct loops *out) {
    size_t classes = 0;
    if (s->found_count == 0) return STATUS_OK;
    qsort(s->found, s->found_count, sizeof *s->found, by_class);
    for (size_t i = 0; i < s->found_count; i++)
        if (i == 0 || s->found[i].class != s->found[i - 1].class) s->found[classes++] = s->found[i];
    qsort(s->found, classes, sizeof *s->found, by_length);
    struct loops loops = {alloc_array(classes, sizeof *loops.loop), classes};
    if (!loops.loop) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < classes; i++) {
        look_around(s, s->found[i].base);
        write_out(s, &s->found[i], &loops.loop[i]);
    }
    *out = loops;
    return STATUS_OK;
}

static enum status search_init(struct search *s) {
    size_t triangles = s->mesh->triangle_count, vertices = s->mesh->vertex_count;
    s->most = triangles > vertices ? triangles : vertices;
    enum status status = halfedge_init(&s->he, s->mesh, 1);
    s->mark = alloc_zeroed(3 * triangles, sizeof *s->mark);
    s->tree = alloc_zeroed(3 * triangles, 1);
    s->climb = alloc_array(triangles, sizeof *s->climb);
    s->queue = alloc_array(s->most, sizeof *s->queue);
    s->seen = alloc_zeroed(s->most, 1);
    s->visit = alloc_array(vertices, sizeof *s->visit);
    s->order = alloc_array(vertices, sizeof *s->order);
    if (!s->mark || !s->tree || !s->climb || !s->queue || !s->seen || !s->visit || !s->order) return STATUS_NO_MEMORY;
    return status;
}

enum status loops_find(const struct mesh *mesh, uint32_t edges_most, size_t *steps, struct loops *out) {
    struct search s = {.mesh = mesh, .edges_most = edges_most, .steps = *steps};
    struct loops loops = {0};
    enum status status = search_init(&s);
    if (!status && mark_edges(&s) > 0) {
        status = search_all(&s);
        *steps = s.steps;
        if (!status) status = take_shortest(&s, &loops);
    }
    free(s.mark), free(s.tree), free(s.climb), free(s.queue);
    free(s.seen), free(s.visit), free(s.order), free(s.found);
    halfedge_done(&s.he);
    if (!status) *out = loops;
    return status;
}

void loops_done(struct loops *loops) {
    free(loops->loop);
    *loops = (struct loops){0};
}
