/* The half-edges are put into lists by the vertex that they start at.  A half-edge's twin is the only one in the list
 * of its end that comes back, if it is alone on its way there, too.  Lists are short, so they are gone through from end
 * to end; the long ones of a mesh's hubs are sorted.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/halfedge.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/simd.h"

enum { MAX_RING = 256, FEW = 32, AT_ONCE = 8, VERTEX_GRAIN = 1024, HALFEDGE_GRAIN = 4096 };

struct leaving {
    uint32_t to, halfedge;
};

/* The half-edges that start at v: leaving[start[v] .. start[v + 1]), in order; where they aren't few, by their ends. */
struct fans {
    struct halfedge *he;
    struct leaving *leaving; /* with AT_ONCE more behind, that mean nothing */
    uint32_t *start;
    uint32_t *back; /* of each half-edge: the only one that comes back, or NONE where there are none or several */
};

/* start[v + 2] becomes the beginning of what follows v, and with each half-edge that is put there the end of v. */
static void sort_by_start(const struct fans *fans) {
    const struct halfedge *he = fans->he;
    uint32_t count = (uint32_t)(3 * he->triangle_count), *start = fans->start;
    for (uint32_t h = 0; h < count; h++) start[halfedge_from(he, h) + 2]++;
    for (size_t v = 2; v < he->vertex_count + 2; v++) start[v] += start[v - 1];
    for (uint32_t h = 0; h < count; h++)
        fans->leaving[start[halfedge_from(he, h) + 1]++] = (struct leaving){halfedge_to(he, h), h};
}

static int compare_leaving(const void *a, const void *b) {
    const struct leaving *x = a, *y = b;
    if (x->to != y->to) return x->to < y->to ? -1 : 1;
    return (x->halfedge > y->halfedge) - (x->halfedge < y->halfedge);
}

static void open_range(void *ctx, size_t begin, size_t end) {
    const struct fans *fans = ctx;
    for (size_t v = begin; v < end; v++) {
        uint32_t first = fans->start[v], n = fans->start[v + 1] - first;
        fans->he->out[v] = n ? fans->leaving[first + n - 1].halfedge : NONE;
        if (n > FEW) qsort(&fans->leaving[first], n, sizeof *fans->leaving, compare_leaving);
    }
}

/* Of n that are sorted by their ends, the first that doesn't end before b. */
static uint32_t first_to(const struct leaving *leaving, uint32_t n, uint32_t b) {
    uint32_t begin = 0;
    while (begin < n) {
        uint32_t middle = begin + (n - begin) / 2;
        if (leaving[middle].to < b)
            begin = middle + 1;
        else
            n = middle;
    }
    return begin;
}

/* The half-edge from a to b, or NONE where there are none or several.  No branch depends on which it is. */
static uint32_t only_one(const struct fans *fans, uint32_t a, uint32_t b) {
    const struct leaving *leaving = &fans->leaving[fans->start[a]];
    uint32_t n = fans->start[a + 1] - fans->start[a];
    uint64_t found = 0;
    if (n > FEW) {
        uint32_t first = first_to(leaving, n, b);
        leaving += first;
        n = n - first < 2 ? n - first : 2;
    }
    for (uint32_t i = 0; i < n; i += AT_ONCE) found |= (uint64_t)ids_equal_2(&leaving[i].to, AT_ONCE, b) << i;
    found &= ((uint64_t)1 << n) - 1;
    return found && !(found & (found - 1)) ? leaving[__builtin_ctzll(found)].halfedge : NONE;
}

static void look_back(void *ctx, size_t begin, size_t end) {
    const struct fans *fans = ctx;
    for (uint32_t h = (uint32_t)begin; h < end; h++) {
        uint32_t from = halfedge_from(fans->he, h), to = halfedge_to(fans->he, h);
        fans->back[h] = from == to ? NONE : only_one(fans, to, from);
    }
}

static void pair_range(void *ctx, size_t begin, size_t end) {
    const struct fans *fans = ctx;
    for (uint32_t h = (uint32_t)begin; h < end; h++) {
        uint32_t g = fans->back[h];
        fans->he->twin[h] = g != NONE && fans->back[g] == h ? g : NONE;
    }
}

/* The number of triangles met from out[v] around v both ways; *closed tells whether that comes back. */
static size_t fan_size(const struct halfedge *he, uint32_t v, bool *closed) {
    size_t count = 0;
    uint32_t h = he->out[v];
    *closed = false;
    do {
        count++;
        h = halfedge_around(he, h);
    } while (h != he->out[v] && h != NONE);
    if (h != NONE) {
        *closed = true;
        return count;
    }
    for (h = he->twin[he->out[v]]; h != NONE; h = he->twin[halfedge_next(h)]) count++;
    return count;
}

static void lock_range(void *ctx, size_t begin, size_t end) {
    const struct fans *fans = ctx;
    struct halfedge *he = fans->he;
    for (uint32_t v = (uint32_t)begin; v < end; v++) {
        bool closed = true;
        size_t uses = fans->start[v + 1] - fans->start[v];
        bool knotted = uses && fan_size(he, v, &closed) != uses;
        he->locked[v] = knotted ? HALFEDGE_KNOTTED : closed ? HALFEDGE_FREE : HALFEDGE_BORDER;
    }
}

enum status halfedge_init(struct halfedge *he, const struct mesh *mesh, unsigned threads) {
    assert(mesh->triangle_count < (size_t)1 << 30);
    size_t count = 3 * mesh->triangle_count, vertices = mesh->vertex_count;
    struct halfedge new = {.vertex_count = vertices, .triangle_count = count / 3, .triangle = mesh->triangle};
    new.twin = alloc_array(count, sizeof *new.twin);
    new.out = alloc_array(vertices, sizeof *new.out);
    new.locked = alloc_array(vertices, 1);
    struct fans fans = {&new, alloc_zeroed(count + AT_ONCE, sizeof *fans.leaving),
                        alloc_zeroed(vertices + 2, sizeof *fans.start), alloc_array(count, sizeof *fans.back)};
    bool enough = new.twin &&new.out &&new.locked &&fans.leaving &&fans.start &&fans.back;
    if (enough) {
        sort_by_start(&fans);
        par_for(threads, vertices, VERTEX_GRAIN, open_range, &fans);
        par_for(threads, count, HALFEDGE_GRAIN, look_back, &fans);
        par_for(threads, count, HALFEDGE_GRAIN, pair_range, &fans);
        par_for(threads, vertices, VERTEX_GRAIN, lock_range, &fans);
        *he = new;
    } else {
        halfedge_done(&new);
    }
    free(fans.leaving), free(fans.start), free(fans.back);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

void halfedge_done(struct halfedge *he) {
    free(he->twin);
    free(he->out);
    free(he->locked);
    *he = (struct halfedge){0};
}

/* The first half-edge out of a vertex on a border. */
static uint32_t first_of_fan(const struct halfedge *he, uint32_t vertex) {
    uint32_t h = he->out[vertex];
    while (he->twin[h] != NONE) h = halfedge_next(he->twin[h]);
    return h;
}

size_t halfedge_ring(const struct halfedge *he, uint32_t vertex, uint32_t *ring, size_t max) {
    size_t count = 0;
    bool on_border = he->locked[vertex] == HALFEDGE_BORDER;
    uint32_t first = on_border ? first_of_fan(he, vertex) : he->out[vertex], h = first;
    do {
        if (count == max || h == NONE) return 0;
        ring[count++] = h;
        h = halfedge_around(he, h);
    } while (h != first && !(on_border && h == NONE));
    return count;
}

bool halfedge_joined(const struct halfedge *he, uint32_t a, uint32_t b) {
    uint32_t first = he->out[a], h = first;
    do {
        uint32_t last = halfedge_prev(h);
        if (halfedge_from(he, last) == b) return true;
        h = he->twin[last];
    } while (h != first && h != NONE);
    if (h != NONE) return false;
    for (h = first; halfedge_to(he, h) != b; h = halfedge_next(he->twin[h]))
        if (he->twin[h] == NONE) return false;
    return true;
}

static void join(struct halfedge *he, uint32_t g, uint32_t h) {
    if (g != NONE) he->twin[g] = h;
    if (h != NONE) he->twin[h] = g;
}

static void set_triangle(struct halfedge *he, uint32_t t, uint32_t a, uint32_t b, uint32_t c) {
    uint32_t *corner = he->triangle[t];
    corner[0] = a, corner[1] = b, corner[2] = c;
    he->out[a] = 3 * t, he->out[b] = 3 * t + 1, he->out[c] = 3 * t + 2;
}

void halfedge_flip(struct halfedge *he, uint32_t h) {
    uint32_t g = he->twin[h], t = h / 3, s = g / 3;
    uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h), c = halfedge_apex(he, h), d = halfedge_apex(he, g);
    uint32_t bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)];
    uint32_t ad = he->twin[halfedge_next(g)], db = he->twin[halfedge_prev(g)];
    set_triangle(he, t, a, d, c);
    set_triangle(he, s, d, b, c);
    join(he, 3 * t, ad);
    join(he, 3 * t + 2, ca);
    join(he, 3 * s, db);
    join(he, 3 * s + 1, bc);
    join(he, 3 * t + 1, 3 * s + 2);
}

/* The neighbours of a vertex that isn't knotted; their number, or 0 where there are more than max. */
static size_t find_neighbours(const struct halfedge *he, uint32_t vertex, uint32_t *near, size_t max) {
    size_t count = halfedge_ring(he, vertex, near, max - 1);
    uint32_t last = count ? near[count - 1] : NONE;
    for (size_t i = 0; i < count; i++) near[i] = halfedge_to(he, near[i]);
    if (count && he->locked[vertex] == HALFEDGE_BORDER) near[count++] = halfedge_apex(he, last);
    return count;
}

static size_t count_common(const struct halfedge *he, uint32_t v, uint32_t w) {
    enum { MOST = MAX_RING + 1 };
    uint32_t of_v[MOST], of_w[MOST];
    size_t m = find_neighbours(he, v, of_v, MOST), n = find_neighbours(he, w, of_w, MOST), common = 0;
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < n; j++) common += of_v[i] == of_w[j];
    return common;
}

/* Whether the vertex across from an edge has triangles left when one of them goes. */
static bool can_spare_triangle(const struct halfedge *he, uint32_t vertex) {
    uint32_t ring[3];
    return halfedge_ring(he, vertex, ring, he->locked[vertex] == HALFEDGE_BORDER ? 1 : 3) == 0;
}

/* Whether anything lies across from the two edges that h's triangle leaves as one: a lone triangle of a knotted vertex,
 * whose fans can't be counted, has nothing. */
static bool can_close(const struct halfedge *he, uint32_t h) {
    return he->twin[halfedge_next(h)] != NONE || he->twin[halfedge_prev(h)] != NONE;
}

/* The ends may share no neighbour but the apexes, and these need another triangle to live on.  Two vertices of a border
 * are merged only along it, or it would be pinched. */
bool halfedge_may_collapse(const struct halfedge *he, uint32_t h, uint32_t gone) {
    uint32_t g = he->twin[h], from = halfedge_from(he, h), to = halfedge_to(he, h), c = halfedge_apex(he, h);
    if (he->locked[from] == HALFEDGE_KNOTTED || he->locked[to] == HALFEDGE_KNOTTED) return false;
    if (!can_close(he, h) || (g != NONE && !can_close(he, g))) return false;
    if (g == NONE) return count_common(he, from, to) == 1 && can_spare_triangle(he, c);
    uint32_t d = halfedge_apex(he, g);
    if (he->locked[gone] || c == d || count_common(he, from, to) != 2) return false;
    return can_spare_triangle(he, c) && can_spare_triangle(he, d);
}

/* Joins what lies across from the two edges that h's triangle leaves as one when the edge of h is gone. */
static void close_triangle(struct halfedge *he, uint32_t h, uint32_t kept) {
    uint32_t apex = halfedge_apex(he, h), bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)];
    join(he, bc, ca);
    he->out[kept] = ca != NONE ? ca : halfedge_next(bc);
    he->out[apex] = bc != NONE ? bc : halfedge_next(ca);
}

struct halfedge_spare halfedge_collapse(struct halfedge *he, uint32_t h, uint32_t gone) {
    uint32_t g = he->twin[h], from = halfedge_from(he, h), kept = gone == from ? halfedge_to(he, h) : from;
    uint32_t ring[MAX_RING];
    size_t count = halfedge_ring(he, gone, ring, MAX_RING);
    assert(count > 0);
    for (size_t i = 0; i < count; i++) he->triangle[ring[i] / 3][ring[i] % 3] = kept;
    if (g != NONE) close_triangle(he, g, kept);
    close_triangle(he, h, kept);
    he->out[gone] = NONE;
    return (struct halfedge_spare){gone, {h / 3, g == NONE ? NONE : g / 3}};
}

static void split_border(struct halfedge *he, uint32_t h, struct halfedge_spare spare) {
    uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h), c = halfedge_apex(he, h), t = h / 3;
    uint32_t bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)], u = spare.triangle[0];
    set_triangle(he, t, a, spare.vertex, c);
    set_triangle(he, u, spare.vertex, b, c);
    he->twin[3 * t] = he->twin[3 * u] = NONE;
    join(he, 3 * t + 2, ca);
    join(he, 3 * u + 1, bc);
    join(he, 3 * t + 1, 3 * u + 2);
    he->locked[spare.vertex] = HALFEDGE_BORDER;
}

void halfedge_split(struct halfedge *he, uint32_t h, struct halfedge_spare spare) {
    if (he->twin[h] == NONE) {
        split_border(he, h, spare);
        return;
    }
    uint32_t g = he->twin[h], t = h / 3, s = g / 3, v = spare.vertex;
    uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h), c = halfedge_apex(he, h), d = halfedge_apex(he, g);
    uint32_t bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)];
    uint32_t ad = he->twin[halfedge_next(g)], db = he->twin[halfedge_prev(g)];
    uint32_t t2 = spare.triangle[0], s2 = spare.triangle[1];
    set_triangle(he, t, a, v, c);
    set_triangle(he, t2, v, b, c);
    set_triangle(he, s, v, a, d);
    set_triangle(he, s2, b, v, d);
    he->locked[v] = HALFEDGE_FREE;
    join(he, 3 * t + 2, ca);
    join(he, 3 * t2 + 1, bc);
    join(he, 3 * s + 1, ad);
    join(he, 3 * s2 + 2, db);
    join(he, 3 * t, 3 * s);
    join(he, 3 * t2, 3 * s2);
    join(he, 3 * t + 1, 3 * t2 + 2);
    join(he, 3 * s + 2, 3 * s2 + 1);
}

void halfedge_renumber(struct halfedge *he, uint32_t from, uint32_t to) {
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t vertex = he->triangle[from][k], twin = he->twin[3 * from + k];
        he->triangle[to][k] = vertex;
        he->twin[3 * to + k] = twin;
        if (twin != NONE) he->twin[twin] = 3 * to + k;
        if (he->out[vertex] == 3 * from + k) he->out[vertex] = 3 * to + k;
    }
}
