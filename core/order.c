/* Morton order: 21 bits of each coordinate interleaved to one 63-bit key, sorted by radix.
 *
 * Every later stage visits points in this order, so that what is near in space is near in memory: neighbour queries
 * take half the time.  Points that share a key are put in order by their exact coordinates, then by id, so that the
 * order is total on distinct positions and doesn't depend on the order of the input, and duplicates stand side by side.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/order.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/par.h"

enum { KEY_BITS = 21, DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS, DIGIT_PASSES = 6, GRAIN = 1 << 16 };

struct item {
    uint64_t key;
    uint32_t id;
};

struct keys {
    const vec3 *position;
    vec3 origin;
    double side; /* of the cube of cells */
    struct item *item;
};

/* Spreads the low 21 bits of x so that two zero bits follow each. */
static uint64_t spread(uint64_t x) {
    x &= 0x1fffff;
    x = (x | x << 32) & 0x001f00000000ffff;
    x = (x | x << 16) & 0x001f0000ff0000ff;
    x = (x | x << 8) & 0x100f00f00f00f00f;
    x = (x | x << 4) & 0x10c30c30c30c30c3;
    return (x | x << 2) & 0x1249249249249249;
}

static uint64_t cell(double offset, double side) {
    double c = offset / side * (1 << KEY_BITS);
    return c >= (1 << KEY_BITS) - 1 ? (1 << KEY_BITS) - 1 : (uint64_t)c;
}

static void key_range(void *ctx, size_t begin, size_t end) {
    struct keys *keys = ctx;
    for (size_t i = begin; i < end; i++) {
        vec3 d = vec3_sub(keys->position[i], keys->origin);
        keys->item[i].id = (uint32_t)i;
        keys->item[i].key =
            spread(cell(d.x, keys->side)) << 2 | spread(cell(d.y, keys->side)) << 1 | spread(cell(d.z, keys->side));
    }
}

/* Least significant digit first; returns which of the two arrays holds the result. */
static struct item *radix_sort(struct item *from, struct item *to, size_t n) {
    for (int pass = 0; pass < DIGIT_PASSES; pass++) {
        size_t start[DIGITS] = {0}, sum = 0;
        int shift = pass * DIGIT_BITS;
        for (size_t i = 0; i < n; i++) start[from[i].key >> shift & (DIGITS - 1)]++;
        if (start[from[0].key >> shift & (DIGITS - 1)] == n) continue;
        for (size_t d = 0; d < DIGITS; d++) {
            size_t count = start[d];
            start[d] = sum;
            sum += count;
        }
        for (size_t i = 0; i < n; i++) to[start[from[i].key >> shift & (DIGITS - 1)]++] = from[i];
        struct item *swap = from;
        from = to;
        to = swap;
    }
    return from;
}

static int compare_double(double a, double b) { return (a > b) - (a < b); }

static int compare_exact(const void *a, const void *b, void *ctx) {
    const vec3 *position = ctx;
    const struct item *i = a, *j = b;
    vec3 p = position[i->id], q = position[j->id];
    int c = compare_double(p.x, q.x);
    if (!c) c = compare_double(p.y, q.y);
    if (!c) c = compare_double(p.z, q.z);
    return c ? c : (i->id > j->id) - (i->id < j->id);
}

static void sort_runs(struct item *item, size_t n, const vec3 *position) {
    for (size_t i = 0, end; i < n; i = end) {
        for (end = i + 1; end < n && item[end].key == item[i].key; end++) {
        }
        if (end - i > 1) qsort_r(&item[i], end - i, sizeof *item, compare_exact, (void *)(uintptr_t)position);
    }
}

static void bounding_box(const vec3 *position, size_t n, struct ordered_points *out) {
    out->box_min = out->box_max = position[0];
    for (size_t i = 1; i < n; i++) {
        out->box_min = vec3_min(out->box_min, position[i]);
        out->box_max = vec3_max(out->box_max, position[i]);
    }
    /* Halves first, so that coordinates near the largest double don't overflow. */
    out->centre = vec3_add(vec3_scale(out->box_min, 0.5), vec3_scale(out->box_max, 0.5));
    vec3 half = vec3_sub(vec3_scale(out->box_max, 0.5), vec3_scale(out->box_min, 0.5));
    out->scale = 2 * hypot(hypot(half.x, half.y), half.z);
    if (!(out->scale > 0)) out->scale = 1;
}

static vec3 normalised(vec3 p, const struct ordered_points *frame) {
    vec3 d = vec3_sub(p, frame->centre);
    return (vec3){d.x / frame->scale, d.y / frame->scale, d.z / frame->scale};
}

static void keep_distinct(const struct item *item, const vec3 *position, size_t n, struct ordered_points *out) {
    out->count = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 p = normalised(position[item[i].id], out);
        if (out->count == 0 || !vec3_equal(p, out->point[out->count - 1])) {
            out->original[out->count] = item[i].id;
            out->point[out->count++] = p;
        }
        out->distinct[item[i].id] = (uint32_t)(out->count - 1);
    }
}

enum status order_points(const vec3 *position, size_t n, unsigned threads, struct ordered_points *out) {
    assert(n > 0 && n < UINT32_MAX);
    struct ordered_points points = {0};
    struct item *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare);
    points.point = alloc_array(n, sizeof *points.point);
    points.original = alloc_array(n, sizeof *points.original);
    points.distinct = alloc_array(n, sizeof *points.distinct);
    if (!item || !spare || !points.point || !points.original || !points.distinct) {
        free(item), free(spare);
        ordered_points_done(&points);
        return STATUS_NO_MEMORY;
    }
    bounding_box(position, n, &points);
    vec3 extent = vec3_sub(points.box_max, points.box_min);
    double side = fmax(extent.x, fmax(extent.y, extent.z));
    struct keys keys = {position, points.box_min, side > 0 ? side : 1, item};
    par_for(threads, n, GRAIN, key_range, &keys);
    struct item *sorted = radix_sort(item, spare, n);
    sort_runs(sorted, n, position);
    keep_distinct(sorted, position, n, &points);
    free(item), free(spare);
    *out = points;
    return STATUS_OK;
}

void ordered_points_done(struct ordered_points *points) {
    if (!points) return;
    free(points->point);
    free(points->original);
    free(points->distinct);
    *points = (struct ordered_points){0};
}
