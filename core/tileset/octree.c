/* The tree is made from the top: of the points of a cube, the first by rank are the node's own, and the others go to
 * the eight parts, in the order of their ranks.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/octree.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"

enum { PARTS = OCTREE_PARTS, CURVE_BITS = 10 };

struct growing {
    const vec3 *point; /* by rank */
    unsigned threads;
    bool whole;
    uint32_t *spare; /* owned, as what follows */
    uint64_t *item, *spare_item;
    size_t capacity; /* of nodes */
    struct octree *tree;
};

unsigned octree_part_of(const struct octree_cube *cube, vec3 p) {
    return (unsigned)(p.x >= cube->centre.x) | (unsigned)(p.y >= cube->centre.y) << 1 |
           (unsigned)(p.z >= cube->centre.z) << 2;
}

struct octree_cube octree_cube_part(const struct octree_cube *cube, unsigned part) {
    double half = cube->half / 2;
    return (struct octree_cube){{cube->centre.x + (part & 1 ? half : -half), cube->centre.y + (part & 2 ? half : -half),
                                 cube->centre.z + (part & 4 ? half : -half)},
                                half};
}

/* A node more, zeroed; NULL: no memory.  Nodes move. */
static struct octree_node *add_node(struct growing *g) {
    if (g->tree->count == g->capacity) {
        size_t capacity = 2 * g->capacity + 64;
        struct octree_node *node = alloc_resize(g->tree->node, capacity, sizeof *node);
        if (!node) return NULL;
        g->tree->node = node;
        g->capacity = capacity;
    }
    struct octree_node *added = &g->tree->node[g->tree->count++];
    *added = (struct octree_node){0};
    return added;
}

/* Divides the ranks of a cube: to the front come those that are the node's own, which are the first ones and those of
 * parts that have few, then those of each part.  sizes: of each part, and of the node's own. */
static void divide(const struct growing *g, const struct octree_cube *cube, uint32_t *rank, size_t n, bool whole,
                   size_t sizes[PARTS + 1]) {
    size_t kept = whole || n < OCTREE_TILE_POINTS ? n : OCTREE_TILE_POINTS, own = kept, at[PARTS + 1];
    memset(sizes, 0, (PARTS + 1) * sizeof *sizes);
    for (size_t i = kept; i < n; i++) sizes[octree_part_of(cube, g->point[rank[i]])]++;
    bool is_own[PARTS];
    for (unsigned p = 0; p < PARTS; p++) {
        is_own[p] = sizes[p] < OCTREE_LEAST_POINTS;
        if (is_own[p]) own += sizes[p], sizes[p] = 0;
    }
    sizes[PARTS] = own;
    at[PARTS] = kept;
    at[0] = own;
    for (unsigned p = 1; p < PARTS; p++) at[p] = at[p - 1] + sizes[p - 1];
    memcpy(g->spare, rank, kept * sizeof *rank);
    for (size_t i = kept; i < n; i++) {
        unsigned p = octree_part_of(cube, g->point[rank[i]]);
        g->spare[at[is_own[p] ? PARTS : p]++] = rank[i];
    }
    memcpy(rank, g->spare, n * sizeof *rank);
}

uint32_t octree_curve_place(const struct octree_cube *cube, vec3 p) {
    uint32_t key = 0, at[3];
    for (int axis = 0; axis < 3; axis++) {
        double t = ((&p.x)[axis] - ((&cube->centre.x)[axis] - cube->half)) / (2 * cube->half) * (1 << CURVE_BITS);
        at[axis] = t > 0 ? t < (1 << CURVE_BITS) ? (uint32_t)t : (1 << CURVE_BITS) - 1 : 0;
    }
    for (int bit = CURVE_BITS - 1; bit >= 0; bit--)
        for (int axis = 2; axis >= 0; axis--) key = key << 1 | (at[axis] >> bit & 1);
    return key;
}

/* Puts a node's own points along a curve. */
static void sort_own(const struct growing *g, const struct octree_cube *cube, uint32_t *rank, size_t n) {
    for (size_t i = 0; i < n; i++) g->item[i] = radix_item(octree_curve_place(cube, g->point[rank[i]]), rank[i]);
    const uint64_t *sorted = radix_sort(g->item, g->spare_item, n, g->threads);
    for (size_t i = 0; i < n; i++) rank[i] = radix_value(sorted[i]);
}

static void bound(const vec3 *point, const uint32_t *rank, size_t n, vec3 *low, vec3 *high) {
    *low = *high = point[rank[0]];
    for (size_t i = 1; i < n; i++) {
        *low = vec3_min(*low, point[rank[i]]);
        *high = vec3_max(*high, point[rank[i]]);
    }
}

static enum status grow_node(struct growing *g, struct octree_cube cube, size_t first, size_t n, unsigned depth) {
    struct octree_node *node = add_node(g);
    size_t sizes[PARTS + 1], number = g->tree->count - 1;
    uint32_t *rank = g->tree->rank + first;
    if (!node) return STATUS_NO_MEMORY;
    divide(g, &cube, rank, n, g->whole || depth == OCTREE_DEEPEST, sizes);
    sort_own(g, &cube, rank, sizes[PARTS]);
    *node = (struct octree_node){.first = first, .own = sizes[PARTS], .count = n, .depth = depth};
    bound(g->point, rank, node->own, &node->own_low, &node->own_high);
    bound(g->point, rank, n, &node->low, &node->high);
    enum status status = STATUS_OK;
    size_t at = first + sizes[PARTS];
    for (unsigned p = 0; p < PARTS && !status; p++) {
        if (!sizes[p]) continue;
        status = grow_node(g, octree_cube_part(&cube, p), at, sizes[p], depth + 1);
        at += sizes[p];
    }
    g->tree->node[number].next = (uint32_t)g->tree->count;
    return status;
}

static enum status put_points(const struct growing *g) {
    struct octree *tree = g->tree;
    tree->point = alloc_array(tree->points, sizeof *tree->point);
    if (!tree->point) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < tree->points; i++) tree->point[i] = g->point[tree->rank[i]];
    return STATUS_OK;
}

struct octree_cube octree_cube_around(vec3 low, vec3 high) {
    vec3 half = vec3_scale(vec3_sub(high, low), 0.5);
    double most = fmax(half.x, fmax(half.y, half.z));
    return (struct octree_cube){vec3_add(low, half), most > 0 ? most : 1};
}

enum status octree_make(const vec3 *point, size_t n, struct octree_cube cube, unsigned depth, bool whole,
                        unsigned threads, struct octree *tree) {
    struct octree made = {.points = n};
    struct growing g = {.point = point, .threads = threads, .whole = whole, .tree = &made};
    g.spare = alloc_array(n, sizeof *g.spare);
    g.item = alloc_array(n, sizeof *g.item);
    g.spare_item = alloc_array(n, sizeof *g.spare_item);
    made.rank = alloc_array(n, sizeof *made.rank);
    enum status status = g.spare && g.item && g.spare_item && made.rank ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < n; i++) made.rank[i] = (uint32_t)i;
    if (!status) status = grow_node(&g, cube, 0, n, depth);
    free(g.spare), free(g.item), free(g.spare_item);
    if (!status) status = put_points(&g);
    if (status)
        octree_done(&made);
    else
        *tree = made;
    return status;
}

void octree_done(struct octree *tree) {
    free(tree->node), free(tree->rank), free(tree->point);
    *tree = (struct octree){0};
}
