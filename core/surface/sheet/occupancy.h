/* A grid of cells over a mesh, for rays that its triangles stop.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_OCCUPANCY_H
#define WHITTLE_CORE_SURFACE_SHEET_OCCUPANCY_H

#include <stdbool.h>
#include <stddef.h>

#include "core/mesh/mesh.h"

enum { OCCUPANCY_BLOCK = 4 /* cells along each side */ };

/* Cells are cubes, `along` of them along the mesh's longest side. */
struct occupancy {
    vec3 low;
    double cell;
    int count[3];
    uint8_t *filled; /* whether something of the mesh is in each; NULL = no extent, or: */
    uint32_t *holds; /* 0 = nothing, else 1 + one of the components; NULL where these aren't told apart */
    int blocks;      /* of some cells along each side, as many along each axis */
    uint8_t *away;   /* of each block: how many blocks the next that holds something is away, along the axis where it is
                        most; 0: itself */
};

/* component[t] is that of each triangle, or NULL; borrowed.  To be done with in any case.  O(triangles + along^3); four
 * bytes for each cell, or one.  STATUS_NO_MEMORY. */
enum status occupancy_init(struct occupancy *grid, const struct mesh *mesh, const uint32_t *component, int along,
                           unsigned threads) MUST_CHECK;

void occupancy_done(struct occupancy *grid);

/* A place in units of cells, from the corner of the grid. */
static inline vec3 occupancy_in_cells(const struct occupancy *g, vec3 p) {
    return vec3_scale(vec3_sub(p, g->low), 1 / g->cell);
}

static inline bool occupancy_is_empty(const struct occupancy *g) { return !g->filled && !g->holds; }

/* The number of the cell at such a place; -1 outside of the grid. */
static inline ptrdiff_t occupancy_at(const struct occupancy *g, vec3 at) {
    bool within = at.x >= 0 && at.y >= 0 && at.z >= 0 && at.x < g->count[0] && at.y < g->count[1] && at.z < g->count[2];
    if (!within) return -1;
    ptrdiff_t x = (ptrdiff_t)at.x, y = (ptrdiff_t)at.y, z = (ptrdiff_t)at.z;
    return (z * g->count[1] + y) * g->count[0] + x;
}

static inline uint8_t *occupancy_away(const struct occupancy *g, vec3 at) {
    ptrdiff_t x = (int)at.x / OCCUPANCY_BLOCK, y = (int)at.y / OCCUPANCY_BLOCK, z = (int)at.z / OCCUPANCY_BLOCK;
    return &g->away[(z * g->blocks + y) * g->blocks + x];
}

/* What a cell at such a place holds: 0 = nothing; where components are told apart 1 + one of them.  Most rays are in
 * blocks that hold nothing, and these are few enough to stay in the cache. */
static inline uint32_t occupancy_held(const struct occupancy *g, vec3 at, ptrdiff_t cell) {
    if (*occupancy_away(g, at) > 0) return 0;
    return g->holds ? g->holds[cell] : g->filled[cell];
}

/* How many steps of half a cell from a place in an empty cell on the next that may stop a ray is: nothing is between.
 */
static inline int occupancy_free_steps(const struct occupancy *g, vec3 at) {
    int away = *occupancy_away(g, at);
    return away > 1 ? 2 * OCCUPANCY_BLOCK * (away - 1) : 1;
}

#endif
