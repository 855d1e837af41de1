/* Half-edges with a twin agree already.  Of those without, two that run the same way between the same points are an
 * edge whose triangles face against each other.  Connected triangles are gone through from one to the next, each turned
 * or not as the one that it was reached from says.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/given/sides.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/mesh/halfedge.h"

struct lone { /* a half-edge without a twin */
    uint32_t low, high, halfedge;
};

struct sides {
    struct faces *faces;
    struct halfedge he;
    uint32_t *against; /* of each half-edge the other one of an edge whose triangles disagree, or NONE */
    uint8_t *turned;   /* of each triangle: 0 not reached, 1 as it is, 2 to be turned */
    uint32_t *queue;
    size_t disagreements;
};

static int compare_lone(const void *a, const void *b) {
    const struct lone *x = a, *y = b;
    if (x->low != y->low) return x->low < y->low ? -1 : 1;
    if (x->high != y->high) return x->high < y->high ? -1 : 1;
    return (x->halfedge > y->halfedge) - (x->halfedge < y->halfedge);
}

static enum status find_disagreements(struct sides *s) {
    size_t n = 3 * s->faces->count, count = 0, i = 0;
    for (size_t h = 0; h < n; h++) count += s->he.twin[h] == NONE;
    struct lone *lone = alloc_array(count, sizeof *lone);
    if (!lone) return STATUS_NO_MEMORY;
    for (uint32_t h = 0; h < n; h++) {
        if (s->he.twin[h] != NONE) continue;
        uint32_t from = halfedge_from(&s->he, h), to = halfedge_to(&s->he, h);
        lone[i++] = (struct lone){from < to ? from : to, from < to ? to : from, h};
    }
    qsort(lone, count, sizeof *lone, compare_lone);
    for (size_t begin = 0, end; begin < count; begin = end) {
        for (end = begin + 1; end < count; end++)
            if (lone[end].low != lone[begin].low || lone[end].high != lone[begin].high) break;
        if (end - begin != 2) continue;
        s->against[lone[begin].halfedge] = lone[begin + 1].halfedge;
        s->against[lone[begin + 1].halfedge] = lone[begin].halfedge;
        s->disagreements++;
    }
    free(lone);
    return STATUS_OK;
}

/* Goes through all triangles connected with the first one; the queue holds them then.  Their number. */
static size_t spread_from(struct sides *s, uint32_t first) {
    size_t done = 0, count = 0;
    s->queue[count++] = first;
    s->turned[first] = 1;
    while (done < count) {
        uint32_t t = s->queue[done++];
        for (uint32_t h = 3 * t; h < 3 * t + 3; h++) {
            bool differs = s->he.twin[h] == NONE;
            uint32_t g = differs ? s->against[h] : s->he.twin[h];
            if (g == NONE || s->turned[g / 3]) continue;
            s->turned[g / 3] = differs ? 3 - s->turned[t] : s->turned[t];
            s->queue[count++] = g / 3;
        }
    }
    return count;
}

static void turn_over(struct faces *faces, uint32_t t) {
    uint32_t corner = faces->triangle[t][1], record = faces->record[t][1];
    faces->triangle[t][1] = faces->triangle[t][2], faces->triangle[t][2] = corner;
    faces->record[t][1] = faces->record[t][2], faces->record[t][2] = record;
}

static size_t turn_fewer(struct sides *s, size_t count) {
    size_t to_turn = 0, turned = 0;
    for (size_t i = 0; i < count; i++) to_turn += s->turned[s->queue[i]] == 2;
    uint8_t which = 2 * to_turn > count ? 1 : 2;
    for (size_t i = 0; i < count; i++)
        if (s->turned[s->queue[i]] == which) turn_over(s->faces, s->queue[i]), turned++;
    return turned;
}

static enum status agree(struct sides *s, struct faces_facts *facts) {
    size_t n = s->faces->count;
    s->turned = alloc_zeroed(n, 1), s->queue = alloc_array(n, sizeof *s->queue);
    if (!s->turned || !s->queue) return STATUS_NO_MEMORY;
    for (uint32_t t = 0; t < n; t++)
        if (!s->turned[t]) facts->turned += turn_fewer(s, spread_from(s, t));
    return STATUS_OK;
}

enum status sides_agree(struct faces *faces, size_t points, unsigned threads, struct faces_facts *facts) {
    struct sides s = {.faces = faces};
    const struct mesh mesh = {.vertex_count = points, .triangle_count = faces->count, .triangle = faces->triangle};
    enum status status = halfedge_init(&s.he, &mesh, threads);
    s.against = alloc_array(3 * faces->count, sizeof *s.against);
    if (!status && !s.against) status = STATUS_NO_MEMORY;
    if (!status) {
        memset(s.against, 0xff, 3 * faces->count * sizeof *s.against);
        status = find_disagreements(&s);
    }
    if (!status && s.disagreements) status = agree(&s, facts);
    halfedge_done(&s.he);
    free(s.against), free(s.turned), free(s.queue);
    return status;
}
