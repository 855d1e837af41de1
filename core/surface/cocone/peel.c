/* Marking and peeling.
 *
 * The umbrella of a good point splits the cells around it in two: a cell on the outer side is marked out, and the mark
 * walks from point to point over the surface.  Then cells are peeled off from infinity: the ones marked out, and the
 * ones with no good point that was visited, which are transparent but for their opaque facet, the one with the smallest
 * circumcircle.  A good point that is met for the first time while peeling starts a walk of its own: it belongs to
 * another component.
 *
 * Source: T. K. Dey, S. Goswami, Tight Cocone (2003), section 4.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

struct peel {
    const struct cocone_star *star;
    const struct cocone_facets *facets;
    uint8_t *good, *visited; /* of each point */
    uint8_t *out, *reached;  /* of each cell */
    uint32_t *cells;         /* reached cells whose neighbours are to be tried: a stack of cell_count */
    size_t cell_depth;
    uint32_t *corners; /* corners at visited points whose side is known: a stack of at most n */
    size_t corner_depth;
    uint32_t *flood;       /* cells of one star: a stack */
    uint32_t *stamp, time; /* of each cell: the last flood that came by */
};

static bool is_surface(const struct peel *peel, uint32_t half) {
    uint32_t f = peel->facets->of_half[half];
    return f != NONE && peel->facets->alive[f];
}

static void reach(struct peel *peel, uint32_t cell) {
    if (peel->reached[cell]) return;
    peel->reached[cell] = 1;
    peel->cells[peel->cell_depth++] = cell;
}

/* A cell next to one that was reached is reached itself as soon as it is out. */
static void mark_out(struct peel *peel, uint32_t cell) {
    peel->out[cell] = 1;
    for (int i = 0; i < 4; i++)
        if (peel->reached[peel->star->tets->neighbour[cell][i]]) reach(peel, cell);
}

/* ------------------------------------------------------------------------------------------------ marking */

static void visit(struct peel *peel, uint32_t cell, unsigned index) {
    uint32_t v = peel->star->tets->vertex[cell][index];
    if (v == NONE || !peel->good[v] || peel->visited[v]) return;
    peel->visited[v] = 1;
    peel->corners[peel->corner_depth++] = cocone_star_pack(cell, index);
}

static void flood_into(struct peel *peel, uint32_t cell, size_t *depth) {
    if (peel->stamp[cell] == peel->time) return;
    peel->stamp[cell] = peel->time;
    if (!peel->out[cell]) mark_out(peel, cell);
    peel->flood[(*depth)++] = cell;
}

/* Marks the cells around the corner's vertex on the corner's side of the surface; hands over to points beside. */
static void mark_side(struct peel *peel, uint32_t corner) {
    const struct tets *tets = peel->star->tets;
    uint32_t start = cocone_star_cell(corner), v = tets->vertex[start][cocone_star_index(corner)];
    size_t depth = 0;
    peel->time++;
    flood_into(peel, start, &depth);
    while (depth > 0) {
        uint32_t cell = peel->flood[--depth];
        for (unsigned i = 0; i < 4; i++) {
            if (tets->vertex[cell][i] == v) continue;
            if (!is_surface(peel, cocone_star_pack(cell, i))) {
                flood_into(peel, tets->neighbour[cell][i], &depth);
                continue;
            }
            for (unsigned k = 0; k < 4; k++)
                if (k != i) visit(peel, cell, k);
        }
    }
}

static void mark_all(struct peel *peel) {
    while (peel->corner_depth > 0) mark_side(peel, peel->corners[--peel->corner_depth]);
}

/* ------------------------------------------------------------------------------------------------ peeling */

static bool is_transparent(const struct peel *peel, uint32_t cell) {
    for (int i = 0; i < 4; i++) {
        uint32_t v = peel->star->tets->vertex[cell][i];
        if (v != NONE && peel->good[v] && peel->visited[v]) return false;
    }
    return true;
}

static double circumradius_sq(const struct cocone_star *star, uint32_t half) {
    uint32_t v[3];
    cocone_star_vertices(star, half, v);
    vec3 a = star->point[v[0]], b = star->point[v[1]], c = star->point[v[2]];
    double area_sq = vec3_length_sq(vec3_triangle_normal(a, b, c));
    double sides_sq = vec3_distance_sq(a, b) * vec3_distance_sq(b, c) * vec3_distance_sq(c, a);
    return area_sq > 0 ? sides_sq / (4 * area_sq) : INFINITY;
}

static unsigned opaque_facet(const struct peel *peel, uint32_t cell) {
    unsigned best = 0;
    double least = INFINITY;
    for (unsigned i = 0; i < 4; i++) {
        double radius_sq = circumradius_sq(peel->star, cocone_star_pack(cell, i));
        if (radius_sq < least) least = radius_sq, best = i;
    }
    return best;
}

static bool is_opaque(const struct peel *peel, uint32_t half) {
    uint32_t cell = cocone_star_cell(half);
    return cocone_star_is_finite(peel->star, cell) && !peel->out[cell] && is_transparent(peel, cell) &&
           opaque_facet(peel, cell) == cocone_star_index(half);
}

static void enter(struct peel *peel, uint32_t half) {
    uint32_t twin = cocone_star_twin(peel->star, half), cell = cocone_star_cell(twin);
    if (peel->reached[cell]) return;
    bool open = peel->out[cell] || (is_transparent(peel, cell) && !is_opaque(peel, twin) && !is_opaque(peel, half));
    if (!open) return;
    reach(peel, cell);
    for (unsigned i = 0; i < 4; i++) visit(peel, cell, i);
    mark_all(peel);
}

static void peel_off(struct peel *peel) {
    const struct tets *tets = peel->star->tets;
    memset(peel->visited, 0, peel->star->n);
    memset(peel->out, 0, tets->cell_count);
    memset(peel->reached, 0, tets->cell_count);
    for (uint32_t c = (uint32_t)tets->finite_count; c < tets->cell_count; c++) {
        peel->out[c] = 1;
        reach(peel, c);
    }
    for (uint32_t c = (uint32_t)tets->finite_count; c < tets->cell_count; c++)
        for (unsigned i = 0; i < 4; i++) visit(peel, c, i);
    mark_all(peel);
    while (peel->cell_depth > 0) {
        uint32_t cell = peel->cells[--peel->cell_depth];
        for (unsigned i = 0; i < 4; i++) enter(peel, cocone_star_pack(cell, i));
    }
}

static enum status peel_init(struct peel *peel) {
    const struct cocone_star *star = peel->star;
    size_t cells = star->tets->cell_count;
    peel->visited = alloc_array(star->n, 1);
    peel->out = alloc_array(cells, 1);
    peel->reached = alloc_array(cells, 1);
    peel->cells = alloc_array(cells, sizeof *peel->cells);
    peel->corners = alloc_array(star->n, sizeof *peel->corners);
    peel->flood = alloc_array(cells, sizeof *peel->flood);
    peel->stamp = alloc_zeroed(cells, sizeof *peel->stamp);
    bool ok = peel->visited && peel->out && peel->reached && peel->cells && peel->corners;
    return ok && peel->flood && peel->stamp ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status cocone_peel(const struct cocone_star *star, const struct cocone_facets *facets, uint8_t *good,
                        uint8_t *inside) {
    struct peel peel = {.star = star, .facets = facets, .good = good};
    enum status status = peel_init(&peel);
    if (!status) {
        peel_off(&peel);
        for (size_t v = 0; v < star->n; v++) good[v] &= peel.visited[v];
        peel_off(&peel);
        for (size_t c = 0; c < star->tets->cell_count; c++) inside[c] = !peel.reached[c];
    }
    free(peel.visited), free(peel.out), free(peel.reached);
    free(peel.cells), free(peel.corners), free(peel.flood), free(peel.stamp);
    return status;
}
