/* A room and a box are the same, but for what is in them.  What a surface sees is before it: nothing that was scanned
 * is behind the skin of a solid, nor behind walls.
 *
 *      +-----------+
 *      |           |       h: a chair, of a component of its own: it is seen from within, and hides what is behind it
 *      |  h   ___  |
 *      |  h  | t | |       t: a chest, of one piece with the floor: of that nothing can be told
 *      +-----+   +-+
 *
 * So rays go from places of the mesh through a grid of cells, of which those that hold some of the mesh stop them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/sight.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { CELLS = 96, RAYS = 64, GRAIN = 64, EACH = 8 /* looks from a component, at least */ };
enum { BLOCK = 4 /* cells along each side */, BLOCKS = CELLS / BLOCK + 1, FAR = BLOCKS };
static const double GRAZING = 0.25; /* cosine to the normal: rays along the surface tell nothing */
static const double AWAY = 2.5;     /* cells from the surface that rays begin */

struct grid {
    vec3 low;
    double cell;
    int count[3];
    uint32_t *holds;                      /* what of the mesh is in each: 0 = nothing, else 1 + one of the components */
    uint8_t away[BLOCKS][BLOCKS][BLOCKS]; /* of each block: how many blocks the next that holds something is away, along
                                             the axis where it is most; 0: itself */
};

/* A place in units of cells, from the corner of the grid. */
static vec3 in_cells(const struct grid *g, vec3 p) { return vec3_scale(vec3_sub(p, g->low), 1 / g->cell); }

/* NULL outside of the grid. */
static uint32_t *sight_cell_at(const struct grid *g, vec3 at) {
    bool within = at.x >= 0 && at.y >= 0 && at.z >= 0 && at.x < g->count[0] && at.y < g->count[1] && at.z < g->count[2];
    if (!within) return NULL;
    size_t x = (size_t)at.x, y = (size_t)at.y, z = (size_t)at.z;
    return &g->holds[(z * (size_t)g->count[1] + y) * (size_t)g->count[0] + x];
}

static uint8_t *away_at(struct grid *g, vec3 at) {
    return &g->away[(size_t)at.z / BLOCK][(size_t)at.y / BLOCK][(size_t)at.x / BLOCK];
}

/* How many steps of half a cell from a place in an empty cell on the next that may stop a ray is: nothing is between.
 */
static int free_steps(const struct grid *g, vec3 at) {
    int away = g->away[(size_t)at.z / BLOCK][(size_t)at.y / BLOCK][(size_t)at.x / BLOCK];
    return away > 1 ? 2 * BLOCK * (away - 1) : 1;
}

/* Rows along the longest side, half a cell apart at most, as places in them are: no ray passes between. */
static void fill(struct grid *g, const struct mesh *mesh, size_t t, uint32_t component) {
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
            uint32_t *cell = sight_cell_at(g, in_cells(g, vec3_add(a, along)));
            if (cell) *cell = 1 + component, *away_at(g, in_cells(g, vec3_add(a, along))) = 0;
        }
    }
}

/* From its neighbours on one side: those before it, or behind it (by = -1, 1). */
static void take_from_neighbours(struct grid *g, int z, int y, int x, int by) {
    uint8_t least = g->away[z][y][x];
    for (int n = 14; n < 27; n++) { /* of 27 cells around it, those behind the middle one */
        int k = z + by * (n / 9 - 1), j = y + by * (n / 3 % 3 - 1), i = x + by * (n % 3 - 1);
        bool within = k >= 0 && j >= 0 && i >= 0 && k < BLOCKS && j < BLOCKS && i < BLOCKS;
        if (within && g->away[k][j][i] < least) least = (uint8_t)(g->away[k][j][i] + 1);
    }
    g->away[z][y][x] = least;
}

/* The chessboard distance, by one sweep to and one fro (Rosenfeld and Pfaltz 1968). */
static void measure_away(struct grid *g) {
    enum { ALL = BLOCKS * BLOCKS * BLOCKS };
    for (int n = 0; n < ALL; n++) take_from_neighbours(g, n / (BLOCKS * BLOCKS), n / BLOCKS % BLOCKS, n % BLOCKS, -1);
    for (int n = ALL; n-- > 0;) take_from_neighbours(g, n / (BLOCKS * BLOCKS), n / BLOCKS % BLOCKS, n % BLOCKS, 1);
}

static enum status sight_grid_init(struct grid *g, const struct mesh *mesh, const uint32_t *component) {
    vec3 low = mesh->vertex[mesh->triangle[0][0]], high = low;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            low = vec3_min(low, mesh->vertex[mesh->triangle[t][k]]);
            high = vec3_max(high, mesh->vertex[mesh->triangle[t][k]]);
        }
    vec3 extent = vec3_sub(high, low);
    g->cell = fmax(extent.x, fmax(extent.y, extent.z)) / CELLS;
    g->low = low;
    if (!(g->cell > 0)) return STATUS_OK;
    g->count[0] = 1 + (int)(extent.x / g->cell);
    g->count[1] = 1 + (int)(extent.y / g->cell);
    g->count[2] = 1 + (int)(extent.z / g->cell);
    g->holds = alloc_zeroed((size_t)g->count[0] * (size_t)g->count[1] * (size_t)g->count[2], sizeof *g->holds);
    if (!g->holds) return STATUS_NO_MEMORY;
    memset(g->away, FAR, sizeof g->away);
    for (size_t t = 0; t < mesh->triangle_count; t++) fill(g, mesh, t, component[t]);
    measure_away(g);
    return STATUS_OK;
}

/* How far one sees from p, and *other where that is another component. */
static double distance_along(const struct grid *g, vec3 p, vec3 direction, uint32_t own, bool *other) {
    vec3 at = in_cells(g, p), step = vec3_scale(direction, 0.5);
    for (int i = 0; i < 4 * CELLS;) {
        const uint32_t *cell = sight_cell_at(g, at);
        if (!cell) break;
        if (*cell) {
            *other = *cell != 1 + own;
            return i * g->cell / 2;
        }
        int steps = free_steps(g, at);
        i += steps;
        at = vec3_add(at, vec3_scale(step, steps));
    }
    *other = false;
    return CELLS * g->cell;
}

/* Evenly over the sphere: equal steps of height, turned by the golden angle. */
static vec3 direction_of(int ray) {
    double z = 1 - (2 * ray + 1.0) / RAYS, angle = ray * 2.399963229728653, r = sqrt(1 - z * z);
    return (vec3){r * cos(angle), r * sin(angle), z};
}

struct looks {
    const struct grid *grid;
    const struct mesh *mesh;
    const uint32_t *component, *triangle; /* triangle: those that are looked from */
    struct sight (*from)[2];              /* each of them */
    vec3 ray[RAYS];
};

static void look_range(void *ctx, size_t begin, size_t end) {
    const struct looks *l = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t t = l->triangle[i];
        const uint32_t *v = l->mesh->triangle[t];
        vec3 sum = vec3_add(vec3_add(l->mesh->vertex[v[0]], l->mesh->vertex[v[1]]), l->mesh->vertex[v[2]]);
        vec3 middle = vec3_scale(sum, 1.0 / 3), normal = vec3_unit(mesh_triangle_normal(l->mesh, t));
        double rays[2] = {0, 0};
        for (int r = 0; r < RAYS; r++) {
            bool other;
            double along = vec3_dot(l->ray[r], normal);
            if (fabs(along) < GRAZING) continue;
            int side = along < 0 ? SIGHT_BACK : SIGHT_FRONT;
            vec3 from = vec3_add(middle, vec3_scale(normal, (along < 0 ? -AWAY : AWAY) * l->grid->cell));
            struct sight *sight = &l->from[i][side];
            sight->depth += distance_along(l->grid, from, l->ray[r], l->component[t], &other);
            sight->others += other;
            rays[side]++;
        }
        for (int side = 0; side < 2; side++) {
            if (rays[side] > 0) l->from[i][side].depth /= rays[side], l->from[i][side].others /= rays[side];
        }
    }
}

/* Every so many triangles, and the first ones of each component; how many.  seen: n of scratch, zeroed. */
static size_t choose_places(const uint32_t *component, size_t n, uint32_t *seen, uint32_t *triangle) {
    size_t count = 0, each = 1 + n / SIGHT_LOOKS;
    for (uint32_t t = 0; t < n; t++)
        if (seen[component[t]]++ < EACH || t % each == 0) triangle[count++] = t;
    return count;
}

/* Means by area. */
static void sum_up(const struct looks *looks, size_t count, double *area, struct sight (*sight)[2]) {
    for (size_t i = 0; i < count; i++) {
        uint32_t t = looks->triangle[i], c = looks->component[t];
        double own = vec3_length(mesh_triangle_normal(looks->mesh, t));
        area[c] += own;
        for (int side = 0; side < 2; side++) {
            sight[c][side].others += own * looks->from[i][side].others;
            sight[c][side].depth += own * looks->from[i][side].depth;
        }
    }
    for (size_t c = 0; c < looks->mesh->triangle_count; c++)
        for (int side = 0; side < 2 && area[c] > 0; side++)
            sight[c][side].others /= area[c], sight[c][side].depth /= area[c];
}

enum status sight_find(const struct mesh *mesh, const uint32_t *component, unsigned threads, struct sight (*sight)[2]) {
    size_t n = mesh->triangle_count, count = 0;
    struct grid grid = {0};
    uint32_t *seen = alloc_zeroed(n, sizeof *seen), *triangle = alloc_array(n, sizeof *triangle);
    double *area = alloc_zeroed(n, sizeof *area);
    struct looks looks = {.grid = &grid, .mesh = mesh, .component = component, .triangle = triangle};
    memset(sight, 0, n * sizeof *sight);
    enum status status = seen && triangle && area ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && n > 0) status = sight_grid_init(&grid, mesh, component);
    if (!status && grid.holds) count = choose_places(component, n, seen, triangle);
    looks.from = alloc_zeroed(count, sizeof *looks.from);
    if (!status && !looks.from) status = STATUS_NO_MEMORY;
    for (int r = 0; r < RAYS; r++) looks.ray[r] = direction_of(r);
    if (!status) par_for(threads, count, GRAIN, look_range, &looks);
    if (!status) sum_up(&looks, count, area, sight);
    free(grid.holds), free(seen), free(triangle), free(area), free(looks.from);
    return status;
}
