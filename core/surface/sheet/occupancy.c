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
#include "core/base/par.h"

enum { GRAIN = 512 };

static uint8_t *away_of(const struct occupancy *g, int z, int y, int x) {
    return &g->away[((size_t)z * (size_t)g->blocks + (size_t)y) * (size_t)g->blocks + (size_t)x];
}

/* Threads may write the same at once. */
static void set_byte(uint8_t *at, uint8_t value) { __atomic_store_n(at, value, __ATOMIC_RELAXED); }

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
                set_byte(&g->filled[cell], 1);
            set_byte(occupancy_away(g, at), 0);
        }
    }
}

struct fill {
    struct occupancy *grid;
    const struct mesh *mesh;
};

static void fill_range(void *ctx, size_t begin, size_t end) {
    const struct fill *f = ctx;
    for (size_t t = begin; t < end; t++) fill(f->grid, f->mesh, t, 0);
}

static uint8_t lesser(uint8_t a, uint8_t b) { return a < b ? a : b; }

/* One block farther than the nearest of three in a row of n, each in its turn. */
static void take_from_row(const uint8_t *from, uint8_t *to, int n) {
    to[0] = lesser(to[0], (uint8_t)(lesser(from[0], n > 1 ? from[1] : from[0]) + 1));
    for (int x = 1; x + 1 < n; x++)
        to[x] = lesser(to[x], (uint8_t)(lesser(from[x], lesser(from[x - 1], from[x + 1])) + 1));
    if (n > 1) to[n - 1] = lesser(to[n - 1], (uint8_t)(lesser(from[n - 1], from[n - 2]) + 1));
}

/* The chessboard distance, by one sweep to and one fro (Rosenfeld and Pfaltz 1968): from the rows before, or behind it
 * (by = -1, 1), and along its own.  Of blocks that have cells alone. */
static void sweep_row(const struct occupancy *g, const int n[3], int z, int y, int by) {
    uint8_t *row = away_of(g, z, y, 0);
    for (int j = y - 1; j <= y + 1; j++)
        if (z + by >= 0 && z + by < n[2] && j >= 0 && j < n[1]) take_from_row(away_of(g, z + by, j, 0), row, n[0]);
    if (y + by >= 0 && y + by < n[1]) take_from_row(away_of(g, z, y + by, 0), row, n[0]);
    for (int i = 1; i < n[0]; i++) {
        int x = by < 0 ? i : n[0] - 1 - i;
        row[x] = lesser(row[x], (uint8_t)(row[x + by] + 1));
    }
}

static void measure_away(const struct occupancy *g) {
    int n[3];
    for (int k = 0; k < 3; k++) n[k] = (g->count[k] - 1) / OCCUPANCY_BLOCK + 1;
    for (int i = 0; i < n[1] * n[2]; i++) sweep_row(g, n, i / n[1], i % n[1], -1);
    for (int i = n[1] * n[2]; i-- > 0;) sweep_row(g, n, i / n[1], i % n[1], 1);
}

enum status occupancy_init(struct occupancy *g, const struct mesh *mesh, const uint32_t *component, int along,
                           unsigned threads) {
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
    for (size_t t = 0; component && t < mesh->triangle_count; t++) fill(g, mesh, t, component[t]);
    struct fill all = {g, mesh};
    if (!component) par_for(threads, mesh->triangle_count, GRAIN, fill_range, &all);
    measure_away(g);
    return STATUS_OK;
}

void occupancy_done(struct occupancy *g) {
    free(g->filled), free(g->holds), free(g->away);
    *g = (struct occupancy){0};
}
