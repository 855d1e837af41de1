/* Orientation by the most certain links.
 *
 * A normal is a line until it is known which end points out.  A cell is in or out, as a whole; so it ties the normals
 * of its four vertices together: if it lies above the one and below the other, one of the two has to be turned.  The
 * infinite cells are out: they are one node, OUT.
 *
 *     vertex --(side, weight)-- cell --(side, weight)-- vertex -- ... -- OUT
 *
 * All pairs of a cell and a vertex of it are links, taken in descending order of weight into a forest that keeps the
 * parity of each node to its root (Kruskal); a link that closes a loop is left out.  The weight is the product of two
 * cosines with the normal, the dual's (circumcentre) and the cell's own (centroid), where their signs agree, else 0: a
 * long cell that stands on the surface is certain, a flat one that lies in it isn't, and neither is one that pokes
 * through a thin sheet.  As every cell has its links, the graph is connected, whatever the number of surfaces.
 *
 * Invariant: ties go by the order of the corners, so the result is a function of the arrays alone.
 *
 * Source: R. Kolluri, J. Shewchuk, J. O'Brien, Spectral surface reconstruction from noisy point clouds (2004) ties
 * poles the same way; H. Hoppe et al. (1992) orient along a spanning tree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cocone_orient.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"

enum { KEYS = 1 << 16 };

#define CERTAIN 0.5

/* A forest of nodes with parities: union by size, paths halved. */
struct forest {
    uint32_t *parent; /* of a root: itself */
    uint8_t *parity;  /* to the parent */
    uint32_t *size;
};

static uint32_t find(struct forest *forest, uint32_t node, uint8_t *parity) {
    uint8_t p = 0;
    while (forest->parent[node] != node) {
        uint32_t up = forest->parent[node];
        forest->parity[node] ^= forest->parity[up] & (uint8_t)(forest->parent[up] != up);
        forest->parent[node] = forest->parent[up];
        p ^= forest->parity[node];
        node = forest->parent[node];
    }
    *parity = p;
    return node;
}

static void join(struct forest *forest, uint32_t a, uint32_t b, uint8_t parity) {
    uint8_t to_a, to_b;
    uint32_t ra = find(forest, a, &to_a), rb = find(forest, b, &to_b);
    if (ra == rb) return;
    if (forest->size[ra] < forest->size[rb]) {
        uint32_t swap = ra;
        ra = rb;
        rb = swap;
    }
    forest->parent[rb] = ra;
    forest->parity[rb] = to_a ^ to_b ^ parity;
    forest->size[ra] += forest->size[rb];
}

static vec3 centroid_direction(const struct cocone_star *star, uint32_t cell, uint32_t vertex) {
    const uint32_t *v = star->tets->vertex[cell];
    vec3 sum = {0, 0, 0};
    for (int i = 0; i < 4; i++) sum = vec3_add(sum, vec3_sub(star->point[v[i]], star->point[vertex]));
    return vec3_unit(sum);
}

struct cocone_lie cocone_orient_lie(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                                    uint32_t vertex) {
    struct cocone_lie lie = {cocone_frame_cosine(star, frame, cell, vertex), 0};
    double own = cocone_star_is_finite(star, cell)
                     ? vec3_dot(centroid_direction(star, cell, vertex), frame->normal[vertex])
                     : lie.dual;
    if (own * lie.dual > 0) lie.weight = own * lie.dual;
    return lie;
}

static uint32_t corner_vertex(const struct cocone_star *star, uint32_t corner) {
    return star->tets->vertex[cocone_star_cell(corner)][cocone_star_index(corner)];
}

/* All corners in descending order of weight, by counting. */
static void sort_links(const struct cocone_star *star, const struct cocone_frame *frame, uint16_t *key,
                       uint32_t *sorted, uint32_t *begin) {
    uint32_t count = star->begin[star->n];
    for (uint32_t i = 0; i < count; i++) {
        struct cocone_lie lie =
            cocone_orient_lie(star, frame, cocone_star_cell(star->corner[i]), corner_vertex(star, star->corner[i]));
        key[i] = (uint16_t)((KEYS - 1) * (1 - fmin(lie.weight, 1)));
        begin[key[i] + 1]++;
    }
    for (uint32_t k = 0; k < KEYS; k++) begin[k + 1] += begin[k];
    for (uint32_t i = 0; i < count; i++) sorted[begin[key[i]]++] = star->corner[i];
}

static uint32_t cell_node(const struct cocone_star *star, uint32_t cell) {
    return (uint32_t)star->n + (cocone_star_is_finite(star, cell) ? cell : (uint32_t)star->tets->finite_count);
}

static void link_all(const struct cocone_star *star, const struct cocone_frame *frame, const uint32_t *sorted,
                     struct forest *forest) {
    for (uint32_t i = 0; i < star->begin[star->n]; i++) {
        uint32_t cell = cocone_star_cell(sorted[i]), v = corner_vertex(star, sorted[i]);
        join(forest, v, cell_node(star, cell), cocone_frame_cosine(star, frame, cell, v) < 0);
    }
}

static void turn(struct cocone_frame *frame, uint32_t v) {
    frame->normal[v] = vec3_scale(frame->normal[v], -1);
    double above = frame->above[v];
    frame->above[v] = frame->below[v];
    frame->below[v] = above;
}

static void turn_normals(const struct cocone_star *star, struct forest *forest, struct cocone_frame *frame) {
    uint8_t out, parity;
    find(forest, (uint32_t)(star->n + star->tets->finite_count), &out);
    for (uint32_t v = 0; v < star->n; v++) {
        if (star->begin[v] == star->begin[v + 1]) continue;
        find(forest, v, &parity);
        if (parity != out) turn(frame, v);
    }
}

static size_t count_conflicts(const struct cocone_star *star, const struct cocone_frame *frame) {
    size_t conflicts = 0;
    for (uint32_t c = 0; c < star->tets->finite_count; c++) {
        int seen = 0;
        for (int i = 0; i < 4; i++) {
            struct cocone_lie lie = cocone_orient_lie(star, frame, c, star->tets->vertex[c][i]);
            if (lie.weight > CERTAIN) seen |= lie.dual > 0 ? 1 : 2;
        }
        conflicts += seen == 3;
    }
    return conflicts;
}

enum status cocone_orient(const struct cocone_star *star, struct cocone_frame *frame, size_t *conflicts) {
    size_t links = star->begin[star->n], nodes = star->n + star->tets->finite_count + 1;
    uint16_t *key = alloc_array(links, sizeof *key);
    uint32_t *sorted = alloc_array(links, sizeof *sorted), *begin = alloc_zeroed(KEYS + 1, sizeof *begin);
    struct forest forest = {alloc_array(nodes, sizeof(uint32_t)), alloc_zeroed(nodes, 1),
                            alloc_array(nodes, sizeof(uint32_t))};
    enum status status = STATUS_NO_MEMORY;
    if (!key || !sorted || !begin || !forest.parent || !forest.parity || !forest.size) goto out;
    for (uint32_t i = 0; i < nodes; i++) forest.parent[i] = i, forest.size[i] = 1;
    sort_links(star, frame, key, sorted, begin);
    link_all(star, frame, sorted, &forest);
    turn_normals(star, &forest, frame);
    *conflicts = count_conflicts(star, frame);
    status = STATUS_OK;
out:
    free(key), free(sorted), free(begin);
    free(forest.parent), free(forest.parity), free(forest.size);
    return status;
}

size_t cocone_orient_by_labels(const struct cocone_star *star, const uint8_t *inside, struct cocone_frame *frame) {
    size_t turned = 0;
    for (uint32_t v = 0; v < star->n; v++) {
        double agreement = 0;
        for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
            uint32_t cell = cocone_star_cell(star->corner[i]);
            struct cocone_lie lie = cocone_orient_lie(star, frame, cell, v);
            agreement += (lie.dual < 0) == inside[cell] ? lie.weight : -lie.weight;
        }
        if (agreement >= 0) continue;
        turn(frame, v);
        turned++;
    }
    return turned;
}
