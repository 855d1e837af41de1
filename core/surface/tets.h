/* A tetrahedralisation as flat arrays: what the Delaunay shim hands over and Tight Cocone walks on.
 *
 * Cells 0 .. finite_count-1 are finite; cells finite_count .. cell_count-1 are infinite: one facet of the convex hull
 * and the vertex at infinity, which is NONE.  Facet i of a cell is the one opposite to its vertex i, and
 * neighbour[c][i] is the cell across it.  Finite cells are positively oriented: (v1-v0) x (v2-v0) . (v3-v0) > 0.
 * Infinite cells are oriented as if the vertex at infinity lay outside.
 *
 *          v3            facet 0 = (v1 v2 v3) ... facet 3 = (v0 v1 v2)
 *         /|\
 *       v0-|-v2          Invariant: neighbour is symmetric; both cells of a facet have the same three vertices.
 *         \|/
 *          v1
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_TETS_H
#define WHITTLE_CORE_SURFACE_TETS_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

struct tets {
    int dimension; /* of the points' affine hull: 3, or less and then there are no cells; 2: planar triangles below */
    size_t cell_count, finite_count;
    uint32_t (*vertex)[4];    /* owned */
    uint32_t (*neighbour)[4]; /* owned */
    vec3 *circumcentre;       /* finite_count; always finite numbers; owned */
    size_t planar_count;      /* dimension 2: the planar Delaunay triangulation */
    uint32_t (*planar)[3];    /* owned */
};

/* Frees everything that tets owns and zeroes it.  Accepts zeroed tets. */
void tets_done(struct tets *tets);

#endif
