/* Rows of places along each triangle mark the cells that they are in.  Coarse blocks know how far the next marked one
 * is, so that rays pass what is empty at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/occupancy.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"

static uint8_t *away_of(const struct occupancy *g, int z, int y, int x) {
    return &g->away[((size_t)z * (size_t)g->blocks + (size_t)y) * (size_t)g->blocks + (size_t)x];
}

/* Rows along the longest side, half a cell apart at most, as places in them are: no ray passes between. */
static void fill(struct occupancy *g, const struct mesh *mesh, size_t t, uint32_t component) {
    const uint32_t *v = mesh->triangle[t];
    int first = 0;
    double longest = -1;
    for (int k = 0; k < 3; k++) {
        double length = vec3_distance(mesh->vertex[v[k]], mesh->vertex[v[(k + 1) % 3]]);
        if (length > longest) longest = length, first = k;
    }
    vec3 a = mesh->vertex[v[first]], ab = vec3_sub(mesh->vertex[v[(first + 1) % 3]], a);
    vec3 ac = vec3_sub(mesh->vertex[v[(first + 2) % 3]], a);
    double across = longest > 0 ? vec3_length(vec3_cross(ab, ac)) / longest : 0;
    int rows = 1 + (int)(2 * across / g->cell), steps = 1 + (int)(2 * longest / g->cell);
    for (int j = 0; j <= rows; j++) {
        double w = (double)j / rows;
        for (int i = 0; i <= steps; i++) {
            vec3 along = vec3_add(vec3_scale(ab, (1 - w) * i / steps), vec3_scale(ac, w));
            vec3 at = occupancy_in_cells(g, vec3_add(a, along));
            ptrdiff_t cell = occupancy_at(g, at);
            if (cell < 0) continue;
            if (g->holds)
                g->holds[cell] = 1 + component;
            else
                g->filled[cell] = 1;
            *occupancy_away(g, at) = 0;
        }
    }
}

/* From its neighbours on one side: those before it, or behind it (by = -1, 1). */
static void take_from_neighbours(const struct occupancy *g, int block, int by) {
    int z = block / (g->blocks * g->blocks), y = block / g->blocks % g->blocks, x = block % g->blocks;
    uint8_t least = *away_of(g, z, y, x);
    for (int n = 14; n < 27; n++) { /* of 27 cells around it, those behind the middle one */
        int k = z + by * (n / 9 - 1), j = y + by * (n / 3 % 3 - 1), i = x + by * (n % 3 - 1);
        bool within = k >= 0 && j >= 0 && i >= 0 && k < g->blocks && j < g->blocks && i < g->blocks;
        if (within && *away_of(g, k, j, i) < least) least = (uint8_t)(*away_of(g, k, j, i) + 1);
    }
    *away_of(g, z, y, x) = least;
}

/* The chessboard distance, by one sweep to and one fro (Rosenfeld and Pfaltz 1968). */
static void measure_away(const struct occupancy *g) {
    int all = g->blocks * g->blocks * g->blocks;
    for (int n = 0; n < all; n++) take_from_neighbours(g, n, -1);
    for (int n = all; n-- > 0;) take_from_neighbours(g, n, 1);
}

enum status occupancy_init(struct occupancy *g, const struct mesh *mesh, const uint32_t *component, int along) {
    *g = (struct occupancy){.blocks = along / OCCUPANCY_BLOCK + 1};
    if (mesh->triangle_count == 0) return STATUS_OK;
    vec3 low = mesh->vertex[mesh->triangle[0][0]], high = low;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            low = vec3_min(low, mesh->vertex[mesh->triangle[t][k]]);
            high = vec3_max(high, mesh->vertex[mesh->triangle[t][k]]);
        }
    vec3 extent = vec3_sub(high, low);
    g->cell = fmax(extent.x, fmax(extent.y, extent.z)) / along;
    g->low = low;
    if (!(g->cell > 0)) return STATUS_OK;
    g->count[0] = 1 + (int)(extent.x / g->cell);
    g->count[1] = 1 + (int)(extent.y / g->cell);
    g->count[2] = 1 + (int)(extent.z / g->cell);
    size_t blocks = (size_t)g->blocks * (size_t)g->blocks * (size_t)g->blocks;
    size_t cells = (size_t)g->count[0] * (size_t)g->count[1] * (size_t)g->count[2];
    if (component)
        g->holds = alloc_zeroed(cells, sizeof *g->holds);
    else
        g->filled = alloc_zeroed(cells, 1);
    g->away = alloc_array(blocks, sizeof *g->away);
    if (occupancy_is_empty(g) || !g->away) return STATUS_NO_MEMORY;
    memset(g->away, g->blocks, blocks);
    for (size_t t = 0; t < mesh->triangle_count; t++) fill(g, mesh, t, component ? component[t] : 0);
    measure_away(g);
    return STATUS_OK;
}

void occupancy_done(struct occupancy *g) {
    free(g->filled), free(g->holds), free(g->away);
    *g = (struct occupancy){0};
}
