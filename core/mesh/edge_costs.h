/* What it costs to merge a vertex into each of its neighbours, and where what they become goes, several at once: by the
 * squares of volumes of Lindstrom, Turk: Fast and memory efficient polygonal simplification (1998).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_EDGE_COSTS_H
#define WHITTLE_CORE_MESH_EDGE_COSTS_H

#include <stdbool.h>

#include "core/math/sym3.h"
#include "core/math/vec3.h"

struct error_form { /* E(x) = x^T a x + 2 b . x + c */
    sym3 a;
    vec3 b;
    double c;
    vec3 area; /* where vertices move: area . x - volume is six times the volume that x has over the triangles */
    double volume;
};

/* The plane of a triangle: n . x + d = 0, where n is its normal, as long as twice its area. */
struct plane {
    vec3 normal;
    double d;
};

/* The other end of an edge. */
struct edge_end {
    const struct error_form *form; /* of its triangles */
    const vec3 *at;
    const struct plane *beside[2]; /* of the triangles that both ends have; the second NULL = there is none */
    bool stays;                    /* it, or the vertex, isn't to be moved */
};

enum { EDGE_COSTS_MOST = 30 };

/* For each of n edges (EDGE_COSTS_MOST at most) from a vertex with a form at a place: best[i] = half-way from where the
 * squares are least to where no volume is lost, no farther from the edge than that is long, or where the other end is,
 * if that costs less or it stays there; cost[i] = what it costs there. */
void edge_costs_find(const struct error_form *form, vec3 at, const struct edge_end *end, unsigned n, double *cost,
                     vec3 *best);

#endif
