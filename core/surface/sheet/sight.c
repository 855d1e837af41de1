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
#include "core/surface/sheet/occupancy.h"

enum { CELLS = 96, RAYS = 64, GRAIN = 64, EACH = 16 /* looks from a component, at least */ };
static const double GRAZING = 0.25; /* cosine to the normal: rays along the surface tell nothing */
static const double AWAY = 2.5;     /* cells from the surface that rays begin */

/* How far one sees from p, and *other where that is another component. */
static double distance_along(const struct occupancy *g, vec3 p, vec3 direction, uint32_t own, bool *other) {
    vec3 at = occupancy_in_cells(g, p), step = vec3_scale(direction, 0.5);
    for (int i = 0; i < 4 * CELLS;) {
        ptrdiff_t cell = occupancy_at(g, at);
        if (cell < 0) break;
        if (occupancy_held(g, at, cell)) {
            *other = occupancy_held(g, at, cell) != 1 + own;
            return i * g->cell / 2;
        }
        int steps = occupancy_free_steps(g, at);
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
    const struct occupancy *grid;
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
    struct occupancy grid = {0};
    uint32_t *seen = alloc_zeroed(n, sizeof *seen), *triangle = alloc_array(n, sizeof *triangle);
    double *area = alloc_zeroed(n, sizeof *area);
    struct looks looks = {.grid = &grid, .mesh = mesh, .component = component, .triangle = triangle};
    memset(sight, 0, n * sizeof *sight);
    enum status status = seen && triangle && area ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status && n > 0) status = occupancy_init(&grid, mesh, component, CELLS, threads);
    if (!status && !occupancy_is_empty(&grid)) count = choose_places(component, n, seen, triangle);
    looks.from = alloc_zeroed(count, sizeof *looks.from);
    if (!status && !looks.from) status = STATUS_NO_MEMORY;
    for (int r = 0; r < RAYS; r++) looks.ray[r] = direction_of(r);
    if (!status) par_for(threads, count, GRAIN, look_range, &looks);
    if (!status) sum_up(&looks, count, area, sight);
    occupancy_done(&grid);
    free(seen), free(triangle), free(area), free(looks.from);
    return status;
}
