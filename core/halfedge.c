/* Twins are found by sorting: each half-edge's key is its two vertices, smaller first, so the half-edges of an edge end
 * up side by side, and a group of exactly two that run in opposite directions is a regular edge.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/halfedge.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/cloud.h"

enum { MAX_RING = 256, FEW = 32 };

struct keyed {
    uint32_t low, high, halfedge;
};

static int compare_keyed(const void *a, const void *b) {
    const struct keyed *x = a, *y = b;
    if (x->low != y->low) return x->low < y->low ? -1 : 1;
    if (x->high != y->high) return x->high < y->high ? -1 : 1;
    return (x->halfedge > y->halfedge) - (x->halfedge < y->halfedge);
}

/* The half-edges of one vertex: a few as a rule. */
static void sort_bucket(struct keyed *key, size_t n) {
    if (n > FEW) {
        qsort(key, n, sizeof *key, compare_keyed);
        return;
    }
    for (size_t i = 1; i < n; i++) {
        struct keyed moving = key[i];
        size_t at = i;
        for (; at > 0 && compare_keyed(&key[at - 1], &moving) > 0; at--) key[at] = key[at - 1];
        key[at] = moving;
    }
}

/* Buckets by the smaller vertex first, so that only a few half-edges are sorted at a time. */
static void sort_keys(const struct halfedge *he, struct keyed *key, size_t *start) {
    size_t count = 3 * he->triangle_count;
    for (uint32_t h = 0; h < count; h++) {
        uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h);
        start[(a < b ? a : b) + 1]++;
    }
    for (size_t v = 0; v < he->vertex_count; v++) start[v + 1] += start[v];
    for (uint32_t h = 0; h < count; h++) {
        uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h), low = a < b ? a : b;
        key[start[low]++] = (struct keyed){low, a < b ? b : a, h};
    }
    for (size_t v = he->vertex_count; v > 0; v--) start[v] = start[v - 1];
    start[0] = 0;
    for (size_t v = 0; v < he->vertex_count; v++) sort_bucket(key + start[v], start[v + 1] - start[v]);
}

static void pair_group(struct halfedge *he, const struct keyed *group, size_t length) {
    uint32_t g = group[0].halfedge, h = group[length - 1].halfedge;
    if (length == 2 && halfedge_from(he, g) != halfedge_from(he, h)) {
        he->twin[g] = h;
        he->twin[h] = g;
    }
}

static enum status pair_twins(struct halfedge *he) {
    size_t count = 3 * he->triangle_count;
    enum status status = STATUS_NO_MEMORY;
    struct keyed *key = alloc_array(count, sizeof *key);
    size_t *start = alloc_zeroed(he->vertex_count + 1, sizeof *start);
    if (!key || !start) goto out;
    sort_keys(he, key, start);
    for (size_t begin = 0, end; begin < count; begin = end) {
        for (end = begin + 1; end < count && key[end].low == key[begin].low && key[end].high == key[begin].high;) end++;
        pair_group(he, key + begin, end - begin);
    }
    status = STATUS_OK;
out:
    free(key);
    free(start);
    return status;
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

static enum status find_locks(struct halfedge *he) {
    uint32_t *uses = alloc_zeroed(he->vertex_count, sizeof *uses);
    if (!uses) return STATUS_NO_MEMORY;
    for (uint32_t h = 0; h < 3 * he->triangle_count; h++) uses[halfedge_from(he, h)]++;
    for (uint32_t v = 0; v < he->vertex_count; v++) {
        bool closed = true;
        if (he->out[v] == NONE) continue;
        if (fan_size(he, v, &closed) != uses[v])
            he->locked[v] = HALFEDGE_KNOTTED;
        else if (!closed)
            he->locked[v] = HALFEDGE_BORDER;
    }
    free(uses);
    return STATUS_OK;
}

enum status halfedge_init(struct halfedge *he, const struct mesh *mesh) {
    assert(mesh->triangle_count < (size_t)1 << 30);
    struct halfedge new = {
        .vertex_count = mesh->vertex_count, .triangle_count = mesh->triangle_count, .triangle = mesh->triangle};
    new.twin = alloc_array(3 * mesh->triangle_count, sizeof *new.twin);
    new.out = alloc_array(mesh->vertex_count, sizeof *new.out);
    new.locked = alloc_zeroed(mesh->vertex_count, 1);
    enum status status = STATUS_NO_MEMORY;
    if (!new.twin || !new.out || !new.locked) goto fail;
    memset(new.twin, 0xff, 3 * mesh->triangle_count * sizeof *new.twin);
    memset(new.out, 0xff, mesh->vertex_count * sizeof *new.out);
    for (uint32_t h = 0; h < 3 * mesh->triangle_count; h++) new.out[halfedge_from(&new, h)] = h;
    status = pair_twins(&new);
    if (status == STATUS_OK) status = find_locks(&new);
    if (status != STATUS_OK) goto fail;
    *he = new;
    return STATUS_OK;
fail:
    halfedge_done(&new);
    return status;
}

void halfedge_done(struct halfedge *he) {
    free(he->twin);
    free(he->out);
    free(he->locked);
    *he = (struct halfedge){0};
}

size_t halfedge_ring(const struct halfedge *he, uint32_t vertex, uint32_t *ring, size_t max) {
    size_t count = 0;
    uint32_t h = he->out[vertex];
    do {
        if (count == max || h == NONE) return 0;
        ring[count++] = h;
        h = halfedge_around(he, h);
    } while (h != he->out[vertex]);
    return count;
}

bool halfedge_joined(const struct halfedge *he, uint32_t a, uint32_t b) {
    uint32_t h = he->out[a];
    do {
        if (halfedge_to(he, h) == b || halfedge_apex(he, h) == b) return true;
        h = halfedge_around(he, h);
    } while (h != he->out[a] && h != NONE);
    if (h != NONE) return false;
    for (h = he->twin[he->out[a]]; h != NONE; h = he->twin[halfedge_next(h)])
        if (halfedge_apex(he, h) == b) return true;
    return false;
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

/* The ends may share no neighbour but the two apexes, and these need a third edge to live on. */
bool halfedge_may_collapse(const struct halfedge *he, uint32_t h) {
    uint32_t from = halfedge_from(he, h), to = halfedge_to(he, h);
    if (he->twin[h] == NONE || he->locked[from] || he->locked[to]) return false;
    uint32_t c = halfedge_apex(he, h), d = halfedge_apex(he, he->twin[h]), ring[MAX_RING];
    size_t common = 0, count = halfedge_ring(he, to, ring, MAX_RING);
    if (count == 0 || c == d) return false;
    uint32_t e = h;
    do {
        uint32_t other = halfedge_to(he, e);
        for (size_t i = 0; i < count; i++) common += halfedge_to(he, ring[i]) == other;
        e = halfedge_around(he, e);
    } while (e != h);
    if (common != 2) return false;
    return halfedge_ring(he, c, ring, 3) == 0 && halfedge_ring(he, d, ring, 3) == 0;
}

struct halfedge_spare halfedge_collapse(struct halfedge *he, uint32_t h) {
    uint32_t g = he->twin[h], from = halfedge_from(he, h), to = halfedge_to(he, h);
    uint32_t c = halfedge_apex(he, h), d = halfedge_apex(he, g);
    uint32_t bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)];
    uint32_t ad = he->twin[halfedge_next(g)], db = he->twin[halfedge_prev(g)];
    uint32_t ring[MAX_RING];
    uint32_t e = h;
    size_t count = 0;
    do {
        assert(count < MAX_RING);
        ring[count++] = e;
        e = halfedge_around(he, e);
    } while (e != h);
    for (size_t i = 0; i < count; i++) he->triangle[ring[i] / 3][ring[i] % 3] = to;
    join(he, bc, ca);
    join(he, ad, db);
    he->out[to] = ca;
    he->out[c] = bc;
    he->out[d] = ad;
    he->out[from] = NONE;
    return (struct halfedge_spare){from, {h / 3, g / 3}};
}

void halfedge_split(struct halfedge *he, uint32_t h, struct halfedge_spare spare) {
    uint32_t g = he->twin[h], t = h / 3, s = g / 3, v = spare.vertex;
    uint32_t a = halfedge_from(he, h), b = halfedge_to(he, h), c = halfedge_apex(he, h), d = halfedge_apex(he, g);
    uint32_t bc = he->twin[halfedge_next(h)], ca = he->twin[halfedge_prev(h)];
    uint32_t ad = he->twin[halfedge_next(g)], db = he->twin[halfedge_prev(g)];
    uint32_t t2 = spare.triangle[0], s2 = spare.triangle[1];
    set_triangle(he, t, a, v, c);
    set_triangle(he, t2, v, b, c);
    set_triangle(he, s, v, a, d);
    set_triangle(he, s2, b, v, d);
    join(he, 3 * t + 2, ca);
    join(he, 3 * t2 + 1, bc);
    join(he, 3 * s + 1, ad);
    join(he, 3 * s2 + 2, db);
    join(he, 3 * t, 3 * s);
    join(he, 3 * t2, 3 * s2);
    join(he, 3 * t + 1, 3 * t2 + 2);
    join(he, 3 * s + 2, 3 * s2 + 1);
}
