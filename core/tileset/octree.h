/* Ranked points as a tree of tiles: each has the most important points of its cube that no tile above it has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_OCTREE_H
#define WHITTLE_CORE_TILESET_OCTREE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

enum {
    OCTREE_TILE_POINTS = 1 << 15, /* that a tile takes of its cube, where there are more */
    OCTREE_LEAST_POINTS = 1 << 10 /* of an eighth of its cube; fewer are the tile's own, too */
};

/* Children follow their parent: the first is the next node, each other one the `next` of that before it, and those up
 * to the parent's own `next` are below it. */
struct octree_node {
    size_t first, own; /* its points, along a curve */
    size_t count;      /* of these and all below, which come behind */
    uint32_t next;
    unsigned depth;
    vec3 low, high;         /* of all count points */
    vec3 own_low, own_high; /* of its own */
    double error;           /* core/tileset/node_error.h */
};

struct octree {
    size_t count;
    struct octree_node *node; /* count; owned */
    size_t points;
    uint32_t *rank; /* of each point; owned */
    vec3 *point;    /* owned */
};

enum { OCTREE_PARTS = 8, OCTREE_DEEPEST = 30 };

struct octree_cube {
    vec3 centre;
    double half;
};

/* The cube around a box, and an eighth of a cube; which of them a point is in. */
struct octree_cube octree_cube_around(vec3 low, vec3 high);
struct octree_cube octree_cube_part(const struct octree_cube *cube, unsigned part);
unsigned octree_part_of(const struct octree_cube *cube, vec3 p);

/* Where it is along a curve through the cube, in 30 bits. */
uint32_t octree_curve_place(const struct octree_cube *cube, vec3 p);

/* point: n >= 1 of them by rank, the most important first; depth is the first node's, whose cube it is.  whole: all of
 * them are that node's own.  STATUS_NO_MEMORY.  O(n depth), with 30 bytes a point beside the result. */
enum status octree_make(const vec3 *point, size_t n, struct octree_cube cube, unsigned depth, bool whole,
                        unsigned threads, struct octree *tree) MUST_CHECK;

/* Accepts a zeroed one. */
void octree_done(struct octree *tree);

#endif
