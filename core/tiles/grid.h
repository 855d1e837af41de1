/* Cells of a cube grid that are counted while points come in, and tiles of them.
 *
 * The side of a cell is a power of two, the finest of which there are at most GRID_MOST_CELLS; which that is shows as
 * points come, so cells are joined by eights whenever there are more.  Places are told from the first point.  The
 * result depends on the points alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_GRID_H
#define WHITTLE_CORE_TILES_GRID_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"

enum { GRID_MOST_CELLS = 1 << 19, GRID_CELL_POINTS = 16 /* on average, or more */ };

/* Of a cell or a box of them: x, y, z. */
struct grid_place {
    int32_t at[3];
};

struct grid_cell {
    struct grid_place place;
    uint32_t tile;
    uint64_t first; /* of its points in the file of its tile */
    uint64_t count;
};

struct grid {
    vec3 anchor;
    int level; /* the side is 2^level */
    size_t count;
    struct grid_cell *cell; /* count; owned */
    uint32_t *slot;         /* of a table, by hash: which cell, NONE = none; owned */
    size_t slots;           /* a power of two */
};

/* STATUS_NO_MEMORY.  The first points tell where the grid begins, and how fine. */
enum status grid_init(struct grid *grid, const vec3 *point, size_t n) MUST_CHECK;

/* Adds n points.  cell: room for n numbers, which say nothing afterwards. */
void grid_count(struct grid *grid, const vec3 *point, size_t n, unsigned threads, uint32_t *cell);

/* After counting: cells are joined until they have enough points on average to tell how dense these are. */
void grid_ripen(struct grid *grid);

/* Of cells that are known, which are copied: nothing is found by its place there. */
enum status grid_from(struct grid *grid, vec3 anchor, int level, const struct grid_cell *cell, size_t n) MUST_CHECK;

/* Accepts a zeroed one. */
void grid_done(struct grid *grid);

double grid_side(const struct grid *grid);
struct grid_place grid_place_of(const struct grid *grid, vec3 p);

/* Of n points. */
void grid_places_of(const struct grid *grid, const vec3 *point, size_t n, struct grid_place *place);

/* The cell of each of n points that have been counted; NONE for any other one's.  On up to `threads` threads. */
void grid_find(const struct grid *grid, const vec3 *point, size_t n, unsigned threads, uint32_t *cell);

/* Cells of a box [from, to), which are first .. first + cells - 1 of the grid's. */
struct grid_tile {
    struct grid_place from, to;
    size_t first, cells;
    uint64_t points;
};

/* Divides the cells first .. first + n - 1 into boxes of at most `most` points (more where one cell has them), about
 * equal, by halves across the longest side; the cells are put in the order of the tiles.  *tile has *count more
 * appended; owned by the caller.  STATUS_NO_MEMORY. */
enum status grid_divide(struct grid *grid, size_t first, size_t n, uint64_t most, struct grid_tile **tile,
                        size_t *count) MUST_CHECK;

/* After dividing: finding by place works again, and in each tile cells are in order of their places.  Numbers them. */
void grid_settle(struct grid *grid, const struct grid_tile *tile, size_t tiles);

/* How far apart points of these cells are, if they are of a surface: the quantile of points that are no farther. */
enum status grid_spacing(const struct grid *grid, const struct grid_tile *tile, double quantile,
                         double *spacing) MUST_CHECK;

#endif
