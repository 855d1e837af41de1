/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/grid.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/base/prefetch.h"
#include "core/cloud/cloud.h"

enum { SLOTS = 2 * GRID_MOST_CELLS, FIRST_BITS = 12, MOST_BITS = 30 };

double grid_side(const struct grid *grid) { return ldexp(1, grid->level); }

static bool same_place(struct grid_place a, struct grid_place b) {
    return a.at[0] == b.at[0] && a.at[1] == b.at[1] && a.at[2] == b.at[2];
}

static size_t slot_of(const struct grid *grid, struct grid_place place) {
    const uint64_t x = (uint32_t)place.at[0], y = (uint32_t)place.at[1], z = (uint32_t)place.at[2];
    return (size_t)hash64(x * 0x9E3779B97F4A7C15u + y * 0xC2B2AE3D27D4EB4Fu + z * 0x165667B19E3779F9u) &
           (grid->slots - 1);
}

/* From a place's slot on: where the cell is in the table, or where it would be. */
static size_t probe_from(const struct grid *grid, struct grid_place place, size_t s) {
    while (grid->slot[s] != NONE && !same_place(grid->cell[grid->slot[s]].place, place))
        s = (s + 1) & (grid->slots - 1);
    return s;
}

static size_t probe(const struct grid *grid, struct grid_place place) {
    return probe_from(grid, place, slot_of(grid, place));
}

static bool is_within(const struct grid *grid, vec3 p) {
    double most = ldexp(1, grid->level + MOST_BITS);
    vec3 d = vec3_sub(p, grid->anchor);
    return fabs(d.x) < most && fabs(d.y) < most && fabs(d.z) < most;
}

static int32_t floor_of(double value) {
    int32_t whole = (int32_t)value;
    return whole - ((double)whole > value);
}

static struct grid_place place_at(vec3 anchor, double scale, vec3 p) {
    vec3 d = vec3_sub(p, anchor);
    return (struct grid_place){{floor_of(d.x * scale), floor_of(d.y * scale), floor_of(d.z * scale)}};
}

struct grid_place grid_place_of(const struct grid *grid, vec3 p) {
    return place_at(grid->anchor, ldexp(1, -grid->level), p);
}

void grid_places_of(const struct grid *grid, const vec3 *point, size_t n, struct grid_place *place) {
    const double scale = ldexp(1, -grid->level);
    for (size_t i = 0; i < n; i++) place[i] = place_at(grid->anchor, scale, point[i]);
}

/* Adds to the cell at a place; the table has room. */
static void add_to(struct grid *grid, struct grid_place place, uint64_t count) {
    size_t s = probe(grid, place);
    if (grid->slot[s] == NONE) {
        grid->slot[s] = (uint32_t)grid->count;
        grid->cell[grid->count++] = (struct grid_cell){.place = place};
    }
    grid->cell[grid->slot[s]].count += count;
}

/* Cells of twice the side. */
static void coarsen(struct grid *grid) {
    size_t n = grid->count;
    memset(grid->slot, -1, grid->slots * sizeof *grid->slot);
    grid->count = 0;
    grid->level++;
    for (size_t i = 0; i < n; i++) { /* in place: never more than have been looked at */
        struct grid_cell cell = grid->cell[i];
        for (int axis = 0; axis < 3; axis++)
            cell.place.at[axis] = cell.place.at[axis] >= 0 ? cell.place.at[axis] / 2 : -((1 - cell.place.at[axis]) / 2);
        add_to(grid, cell.place, cell.count);
    }
}

static enum status make_room(struct grid *grid) {
    grid->slots = SLOTS;
    grid->cell = alloc_array(GRID_MOST_CELLS + 1, sizeof *grid->cell);
    grid->slot = alloc_array(grid->slots, sizeof *grid->slot);
    if (!grid->cell || !grid->slot) return STATUS_NO_MEMORY;
    memset(grid->slot, -1, grid->slots * sizeof *grid->slot);
    return STATUS_OK;
}

enum status grid_init(struct grid *grid, const vec3 *point, size_t n) {
    vec3 least = point[0], most = point[0];
    for (size_t i = 1; i < n; i++) least = vec3_min(least, point[i]), most = vec3_max(most, point[i]);
    vec3 extent = vec3_sub(most, least);
    double side = fmax(extent.x, fmax(extent.y, extent.z));
    double size = fmax(fabs(point[0].x), fmax(fabs(point[0].y), fabs(point[0].z)));
    if (!(side > 0)) side = size > 0 ? size : 1;
    *grid = (struct grid){.anchor = point[0], .level = ilogb(side) - FIRST_BITS};
    return make_room(grid);
}

enum status grid_from(struct grid *grid, vec3 anchor, int level, const struct grid_cell *cell, size_t n) {
    *grid = (struct grid){.anchor = anchor, .level = level};
    if (n > GRID_MOST_CELLS) return STATUS_MALFORMED;
    grid->cell = alloc_array(n, sizeof *grid->cell);
    if (!grid->cell) return STATUS_NO_MEMORY;
    memcpy(grid->cell, cell, n * sizeof *cell);
    grid->count = n;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ find */

struct finding {
    const struct grid *grid;
    const vec3 *point;
    uint32_t *cell;
};

/* Slots, and then cells, are far apart in memory: those of a block of points are fetched before they are looked at. */
static void find_range(void *ctx, size_t begin, size_t end) {
    enum { BLOCK = 64 };
    const struct finding *f = ctx;
    const struct grid *grid = f->grid;
    const double scale = ldexp(1, -grid->level), most = ldexp(1, MOST_BITS);
    struct grid_place place[BLOCK];
    size_t slot[BLOCK];
    for (size_t first = begin; first < end; first += BLOCK) {
        size_t n = end - first < BLOCK ? end - first : BLOCK;
        for (size_t i = 0; i < n; i++) {
            vec3 d = vec3_scale(vec3_sub(f->point[first + i], grid->anchor), scale);
            bool within = fabs(d.x) < most && fabs(d.y) < most && fabs(d.z) < most;
            slot[i] = SLOTS;
            if (!within) continue;
            place[i] = place_at(grid->anchor, scale, f->point[first + i]);
            slot[i] = slot_of(grid, place[i]);
            prefetch(&grid->slot[slot[i]]);
        }
        for (size_t i = 0; i < n; i++)
            if (slot[i] < SLOTS && grid->slot[slot[i]] != NONE) prefetch(&grid->cell[grid->slot[slot[i]]]);
        for (size_t i = 0; i < n; i++)
            f->cell[first + i] = slot[i] < SLOTS ? grid->slot[probe_from(grid, place[i], slot[i])] : NONE;
    }
}

void grid_find(const struct grid *grid, const vec3 *point, size_t n, unsigned threads, uint32_t *cell) {
    enum { GRAIN = 1 << 14 };
    struct finding f = {grid, point, cell};
    par_for(threads, n, GRAIN, find_range, &f);
}

void grid_count(struct grid *grid, const vec3 *point, size_t n, unsigned threads, uint32_t *cell) {
    enum { AHEAD = 16 };
    int level = grid->level;
    grid_find(grid, point, n, threads, cell);
    for (size_t i = 0; i < n; i++) {
        if (i + AHEAD < n && cell[i + AHEAD] != NONE) prefetch(&grid->cell[cell[i + AHEAD]]);
        if (cell[i] != NONE && grid->level == level) {
            grid->cell[cell[i]].count++;
            continue;
        }
        while (!is_within(grid, point[i])) coarsen(grid);
        add_to(grid, grid_place_of(grid, point[i]), 1);
        while (grid->count > GRID_MOST_CELLS) coarsen(grid);
    }
}

/* Whether no two cells ever become one: each lies at the anchor, in one of the eight octants. */
static bool is_coarsest(const struct grid *grid) {
    for (size_t i = 0; i < grid->count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (grid->cell[i].place.at[axis] != 0 && grid->cell[i].place.at[axis] != -1) return false;
    return true;
}

void grid_ripen(struct grid *grid) {
    uint64_t points = 0;
    for (size_t i = 0; i < grid->count; i++) points += grid->cell[i].count;
    while (grid->count > 1 && points < GRID_CELL_POINTS * (uint64_t)grid->count && !is_coarsest(grid)) coarsen(grid);
}

void grid_done(struct grid *grid) {
    if (!grid) return;
    free(grid->cell), free(grid->slot);
    *grid = (struct grid){0};
}

/* ------------------------------------------------------------------------------------------------ tiles */

static int compare_places(const struct grid_place *a, const struct grid_place *b) {
    for (int axis = 0; axis < 3; axis++)
        if (a->at[axis] != b->at[axis]) return a->at[axis] < b->at[axis] ? -1 : 1;
    return 0;
}

static int compare_along(const void *a, const void *b, void *ctx) {
    const struct grid_cell *p = a, *q = b;
    int axis = *(const int *)ctx, i = p->place.at[axis], j = q->place.at[axis];
    return i != j ? (i < j ? -1 : 1) : compare_places(&p->place, &q->place);
}

static int compare_cells(const void *a, const void *b) {
    return compare_places(&((const struct grid_cell *)a)->place, &((const struct grid_cell *)b)->place);
}

static struct grid_tile box_of(const struct grid *grid, size_t first, size_t n) {
    const struct grid_cell *cell = grid->cell + first;
    struct grid_tile box = {cell->place, cell->place, first, n, 0};
    for (size_t i = 0; i < n; i++) {
        box.points += cell[i].count;
        for (int axis = 0; axis < 3; axis++) {
            int32_t at = cell[i].place.at[axis];
            if (at < box.from.at[axis]) box.from.at[axis] = at;
            if (at >= box.to.at[axis]) box.to.at[axis] = at + 1;
        }
    }
    return box;
}

static enum status append(struct grid_tile **tile, size_t *count, struct grid_tile box) {
    struct grid_tile *grown = alloc_resize(*tile, *count + 1, sizeof **tile);
    if (!grown) return STATUS_NO_MEMORY;
    *tile = grown;
    grown[(*count)++] = box;
    return STATUS_OK;
}

/* How many cells, in order along the axis, hold this share of the points, as nearly as whole layers can; 0 or n where
 * none can be parted off. */
static size_t cut_at(const struct grid_cell *cell, size_t n, int axis, double wanted) {
    size_t best = 0;
    double sum = 0, off = INFINITY;
    for (size_t i = 0; i + 1 < n; i++) {
        sum += (double)cell[i].count;
        if (cell[i].place.at[axis] == cell[i + 1].place.at[axis] || fabs(sum - wanted) >= off) continue;
        off = fabs(sum - wanted);
        best = i + 1;
    }
    return best;
}

enum status grid_divide(struct grid *grid, size_t first, size_t n, uint64_t most, struct grid_tile **tile,
                        size_t *count) {
    struct grid_tile box = box_of(grid, first, n);
    if (box.points <= most || n == 1) return append(tile, count, box);
    int axis = 0;
    for (int i = 1; i < 3; i++)
        if (box.to.at[i] - box.from.at[i] > box.to.at[axis] - box.from.at[axis]) axis = i;
    qsort_r(grid->cell + first, n, sizeof *grid->cell, compare_along, &axis);
    uint64_t parts = (box.points + most - 1) / most;
    size_t left = cut_at(grid->cell + first, n, axis, (double)(parts / 2) / (double)parts * (double)box.points);
    enum status status = grid_divide(grid, first, left, most, tile, count);
    return status ? status : grid_divide(grid, first + left, n - left, most, tile, count);
}

void grid_settle(struct grid *grid, const struct grid_tile *tile, size_t tiles) {
    for (size_t t = 0; t < tiles; t++) {
        struct grid_cell *cell = grid->cell + tile[t].first;
        uint64_t at = 0;
        qsort(cell, tile[t].cells, sizeof *cell, compare_cells);
        for (size_t i = 0; i < tile[t].cells; i++) {
            cell[i].tile = (uint32_t)t;
            cell[i].first = at;
            at += cell[i].count;
        }
    }
    memset(grid->slot, -1, grid->slots * sizeof *grid->slot);
    for (size_t i = 0; i < grid->count; i++) grid->slot[probe(grid, grid->cell[i].place)] = (uint32_t)i;
}

static int compare_doubles(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* A cell with n points of a surface that goes through it holds about side^2 of that. */
enum status grid_spacing(const struct grid *grid, const struct grid_tile *tile, double quantile, double *spacing) {
    struct {
        double spacing, points;
    } *of = alloc_array(tile->cells, sizeof *of);
    double sum = 0;
    if (!of) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < tile->cells; i++) {
        of[i].points = (double)grid->cell[tile->first + i].count;
        of[i].spacing = grid_side(grid) / sqrt(of[i].points);
    }
    qsort(of, tile->cells, sizeof *of, compare_doubles);
    size_t i = 0;
    for (; i + 1 < tile->cells && (sum += of[i].points) < quantile * (double)tile->points;) i++;
    *spacing = of[i].spacing;
    free(of);
    return STATUS_OK;
}
