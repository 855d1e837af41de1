/* Stars: which cells are around a vertex, and how to walk from cell to cell.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_STAR_H
#define WHITTLE_CORE_SURFACE_COCONE_STAR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/surface/tets.h"

/* A half facet or a corner: cell * 4 + (index of a facet or of a vertex in it). */
static inline uint32_t cocone_star_pack(uint32_t cell, unsigned index) { return cell << 2 | index; }
static inline uint32_t cocone_star_cell(uint32_t packed) { return packed >> 2; }
static inline unsigned cocone_star_index(uint32_t packed) { return packed & 3; }

struct cocone_star {
    const struct tets *tets; /* borrowed */
    const vec3 *point;       /* borrowed */
    size_t n;                /* points */
    uint8_t (*mirror)[4];    /* cell_count: facet i of cell c is facet mirror[c][i] of neighbour[c][i]; owned */
    uint32_t *begin;         /* n + 1: where the corners at each vertex begin; owned */
    uint32_t *corner;        /* 4 for each finite cell, 3 for each infinite one; in ascending order of cells; owned */
};

/* Facet i as vertex indices, turning counter-clockwise seen from vertex i: its normal points into the cell. */
extern const uint8_t cocone_star_facet[4][3];

/* Builds the tables over tets of dimension 3 with n points, both borrowed.  At most 2^30 cells, else STATUS_LIMIT;
 * STATUS_NO_MEMORY.  O(cells). */
enum status cocone_star_build(const struct tets *tets, const vec3 *point, size_t n, unsigned threads,
                              struct cocone_star *star) MUST_CHECK;

/* Accepts a zeroed star. */
void cocone_star_done(struct cocone_star *star);

static inline bool cocone_star_is_finite(const struct cocone_star *star, uint32_t cell) {
    return cell < star->tets->finite_count;
}

/* The same facet seen from the other side. */
static inline uint32_t cocone_star_twin(const struct cocone_star *star, uint32_t half) {
    uint32_t cell = cocone_star_cell(half);
    unsigned i = cocone_star_index(half);
    return cocone_star_pack(star->tets->neighbour[cell][i], star->mirror[cell][i]);
}

/* The three vertices of a half facet, counter-clockwise seen from inside its cell. */
static inline void cocone_star_vertices(const struct cocone_star *star, uint32_t half, uint32_t vertex[3]) {
    const uint32_t *v = star->tets->vertex[cocone_star_cell(half)];
    const uint8_t *facet = cocone_star_facet[cocone_star_index(half)];
    for (int k = 0; k < 3; k++) vertex[k] = v[facet[k]];
}

/* From a half facet across its cell to the cell's other half facet at the edge (a, b). */
static inline uint32_t cocone_star_turn(const struct cocone_star *star, uint32_t half, uint32_t a, uint32_t b) {
    uint32_t cell = cocone_star_cell(half);
    const uint32_t *v = star->tets->vertex[cell];
    for (unsigned i = 0; i < 4; i++)
        if (i != cocone_star_index(half) && v[i] != a && v[i] != b) return cocone_star_pack(cell, i);
    return half;
}

/* The unit normal of the hull facet of an infinite cell, outwards. */
vec3 cocone_star_hull_normal(const struct cocone_star *star, uint32_t cell);

/* The direction in which a cell's dual lies from its vertex: circumcentre - point, or the outward normal of an infinite
 * cell.  Not normalised. */
static inline vec3 cocone_star_dual(const struct cocone_star *star, uint32_t cell, uint32_t vertex) {
    if (!cocone_star_is_finite(star, cell)) return cocone_star_hull_normal(star, cell);
    return vec3_sub(star->tets->circumcentre[cell], star->point[vertex]);
}

#endif
