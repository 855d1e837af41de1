/* A grid of cells over a mesh, for rays that its triangles stop.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_OCCUPANCY_H
#define WHITTLE_CORE_SURFACE_SHEET_OCCUPANCY_H

#include "core/mesh/mesh.h"

/* Cells are cubes, `along` of them along the mesh's longest side. */
struct occupancy {
    vec3 low;
    double cell;
    int count[3];
    uint32_t *holds; /* what of the mesh is in each: 0 = nothing, else 1 + one of the components; NULL = no extent */
    int blocks;      /* of some cells along each side, as many along each axis */
    uint8_t *away;   /* of each block: how many blocks the next that holds something is away, along the axis where it is
                        most; 0: itself */
};

/* component[t] is that of each triangle; borrowed.  To be done with in any case.  O(triangles + along^3).
 * STATUS_NO_MEMORY. */
enum status occupancy_init(struct occupancy *grid, const struct mesh *mesh, const uint32_t *component,
                           int along) MUST_CHECK;

void occupancy_done(struct occupancy *grid);

/* A place in units of cells, from the corner of the grid. */
static inline vec3 occupancy_in_cells(const struct occupancy *g, vec3 p) {
    return vec3_scale(vec3_sub(p, g->low), 1 / g->cell);
}

/* What the cell at such a place holds; NULL outside of the grid. */
uint32_t *occupancy_at(const struct occupancy *grid, vec3 at);

/* How many steps of half a cell from a place in an empty cell on the next that may stop a ray is: nothing is between.
 */
int occupancy_free_steps(const struct occupancy *grid, vec3 at);

#endif
