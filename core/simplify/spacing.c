/* Dart throwing (Cook 1986) in the order of importance, so that features get their points first and what is left
 * between them is filled evenly.
 *
 * The points that stay are in cells of a hashed grid, over twice the spacing wide: whoever is too near to a point is in
 * its cell or in those on the side of the cell where it lies, eight in all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/spacing.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/cloud/cloud.h"

/* Wider than twice the spacing by more than rounding can move a point between cells; at most 2^40 cells side by side,
 * for the same reason. */
static const double WIDTH = 2.01, NARROWEST = 0x1p-40;

static void find_corners(const vec3 *position, size_t n, vec3 *low, vec3 *high) {
    *low = *high = position[0];
    for (size_t i = 1; i < n; i++) {
        vec3 p = position[i];
        *low = (vec3){fmin(low->x, p.x), fmin(low->y, p.y), fmin(low->z, p.z)};
        *high = (vec3){fmax(high->x, p.x), fmax(high->y, p.y), fmax(high->z, p.z)};
    }
}

enum status spacing_grid_init(struct spacing_grid *grid, const vec3 *position, size_t most, vec3 low, vec3 high,
                              double spacing) {
    vec3 size = vec3_sub(high, low);
    double extent = fmax(size.x, fmax(size.y, size.z));
    size_t places = 1;
    while (places < most) places *= 2;
    *grid =
        (struct spacing_grid){.position = position, .origin = low, .spacing_sq = spacing * spacing, .mask = places - 1};
    grid->width = fmax(WIDTH * spacing, NARROWEST * extent);
    grid->head = alloc_array(places, sizeof *grid->head);
    grid->next = alloc_array(most, sizeof *grid->next);
    if (!grid->head || !grid->next) return STATUS_NO_MEMORY;
    memset(grid->head, 0xff, places * sizeof *grid->head);
    return STATUS_OK;
}

void spacing_grid_done(struct spacing_grid *grid) {
    free(grid->head), free(grid->next);
    *grid = (struct spacing_grid){0};
}

static size_t cell_place(const struct spacing_grid *grid, const int64_t cell[3]) {
    uint64_t hash = 0;
    for (int k = 0; k < 3; k++) hash = hash64(hash ^ (uint64_t)cell[k]);
    return (size_t)hash & grid->mask;
}

/* The point's cell, and for each axis on which side of it the point lies: -1 or 1. */
static void find_cell(const struct spacing_grid *grid, vec3 p, int64_t cell[3], int64_t side[3]) {
    vec3 in = vec3_scale(vec3_sub(p, grid->origin), 1 / grid->width);
    double x[3] = {in.x, in.y, in.z};
    for (int k = 0; k < 3; k++) {
        double floor_of = floor(x[k]);
        cell[k] = (int64_t)floor_of;
        side[k] = x[k] - floor_of < 0.5 ? -1 : 1;
    }
}

uint32_t spacing_grid_near(const struct spacing_grid *grid, vec3 p) {
    int64_t cell[3], side[3];
    uint32_t nearest = NONE;
    double least = grid->spacing_sq;
    size_t seen[8];
    find_cell(grid, p, cell, side);
    for (unsigned corner = 0; corner < 8; corner++) {
        int64_t at[3];
        for (unsigned k = 0; k < 3; k++) at[k] = cell[k] + (corner >> k & 1 ? side[k] : 0);
        size_t place = seen[corner] = cell_place(grid, at);
        bool again = false;
        for (unsigned i = 0; i < corner; i++) again |= seen[i] == place;
        for (uint32_t q = again ? NONE : grid->head[place]; q != NONE; q = grid->next[q]) {
            double distance_sq = vec3_length_sq(vec3_sub(grid->position[q], p));
            if (distance_sq < least || (distance_sq == least && nearest != NONE && q < nearest))
                least = distance_sq, nearest = q;
        }
    }
    return nearest;
}

void spacing_grid_insert(struct spacing_grid *grid, uint32_t q) {
    int64_t cell[3], side[3];
    find_cell(grid, grid->position[q], cell, side);
    size_t place = cell_place(grid, cell);
    grid->next[q] = grid->head[place];
    grid->head[place] = q;
}

/* near[p] = whom p is too near to, NONE for those that stay; returns how many those are. */
static size_t throw_darts(const struct contraction *contraction, struct spacing_grid *grid, uint32_t *near) {
    size_t fits = 0;
    for (size_t i = contraction->n; i-- > 0;) {
        uint32_t p = contraction->order[i];
        near[p] = spacing_grid_near(grid, grid->position[p]);
        if (near[p] != NONE) continue;
        spacing_grid_insert(grid, p);
        fits++;
    }
    return fits;
}

/* Whom a point went into may be among those that don't stay: then whoever that one is too near to takes its place,
 * which ranks higher than both. */
static void reorder(struct contraction *contraction, const uint32_t *near, uint32_t *order, size_t fits) {
    size_t n = contraction->n, others = 0, stays = n - fits;
    for (size_t i = 0; i < n; i++) {
        uint32_t p = contraction->order[i], into = contraction->into[p];
        order[near[p] == NONE ? stays++ : others++] = p;
        if (near[p] == NONE && into != NONE && near[into] != NONE) contraction->into[p] = near[into];
    }
    for (size_t p = 0; p < n; p++)
        if (near[p] != NONE) contraction->into[p] = near[p];
}

/* error[i] belongs to order[i]: it goes along, as far as it still ascends. */
static void reorder_errors(struct contraction *contraction, const uint32_t *order, float *of_point) {
    float largest = 0;
    for (size_t i = 0; i < contraction->n; i++) of_point[contraction->order[i]] = contraction->error[i];
    for (size_t i = 0; i < contraction->n; i++) {
        if (of_point[order[i]] > largest) largest = of_point[order[i]];
        contraction->error[i] = largest;
    }
}

enum status spacing_apply(struct contraction *contraction, const vec3 *position, double spacing, size_t *fits) {
    struct spacing_grid grid;
    vec3 low, high;
    size_t n = contraction->n;
    uint32_t *near = alloc_array(n, sizeof *near), *order = alloc_array(n, sizeof *order);
    float *error = alloc_array(n, sizeof *error);
    find_corners(position, n, &low, &high);
    enum status status = spacing_grid_init(&grid, position, n, low, high, spacing);
    if (!near || !order || !error) status = STATUS_NO_MEMORY;
    if (!status) {
        *fits = throw_darts(contraction, &grid, near);
        reorder(contraction, near, order, *fits);
        reorder_errors(contraction, order, error);
        memcpy(contraction->order, order, n * sizeof *order);
    }
    spacing_grid_done(&grid);
    free(near), free(order), free(error);
    return status;
}
