/* Morton order: 21 bits of each coordinate interleaved to one 63-bit key.
 *
 * Every later stage visits points in this order, so that what is near in space is near in memory: neighbour queries
 * take half the time.  The upper half of the keys is sorted by radix, with the ids; then each run of points that share
 * it by the lower half.  Few points of a surface do, so that this costs half of what sorting whole keys does.  Points
 * that share all of their key are put in order by their exact coordinates, then by id, so that the order is total on
 * distinct positions and doesn't depend on the order of the input, and duplicates stand side by side.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/order.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/par.h"
#include "core/radix.h"

enum { KEY_BITS = 21, LOW_BITS = 31, GRAIN = 1 << 14, SHORT_RUN = 24 };

struct ordering {
    const vec3 *position;
    size_t n;
    vec3 origin;
    double side;           /* of the cube of cells */
    uint64_t *item, *swap; /* half a key and the point's id */
    size_t *first;         /* by range of GRAIN items: the first run that begins there or later */
    struct ordered_points *out;
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

static uint64_t key_of(const struct ordering *o, uint32_t id) {
    vec3 d = vec3_sub(o->position[id], o->origin);
    return spread(cell(d.x, o->side)) << 2 | spread(cell(d.y, o->side)) << 1 | spread(cell(d.z, o->side));
}

static void key_range(void *ctx, size_t begin, size_t end) {
    struct ordering *o = ctx;
    for (size_t i = begin; i < end; i++)
        o->item[i] = radix_item((uint32_t)(key_of(o, (uint32_t)i) >> LOW_BITS), (uint32_t)i);
}

/* ------------------------------------------------------------------------------------------------ runs */

static int compare_double(double a, double b) { return (a > b) - (a < b); }

static int compare_exact(const void *a, const void *b, void *ctx) {
    const vec3 *position = ctx;
    uint32_t i = radix_value(*(const uint64_t *)a), j = radix_value(*(const uint64_t *)b);
    vec3 p = position[i], q = position[j];
    int c = compare_double(p.x, q.x);
    if (!c) c = compare_double(p.y, q.y);
    if (!c) c = compare_double(p.z, q.z);
    return c ? c : (i > j) - (i < j);
}

/* The end of the run of equal keys that begins at i. */
static size_t run_end(const uint64_t *item, size_t i, size_t n) {
    size_t end = i + 1;
    while (end < n && radix_key(item[end]) == radix_key(item[i])) end++;
    return end;
}

static void sort_few(uint64_t *item, size_t n) {
    for (size_t i = 1; i < n; i++) {
        uint64_t x = item[i];
        size_t j = i;
        for (; j > 0 && item[j - 1] > x; j--) item[j] = item[j - 1];
        item[j] = x;
    }
}

/* Puts n points whose keys have the same upper half in order.  spare: for n more. */
static void sort_run(const struct ordering *o, uint64_t *item, uint64_t *spare, size_t n) {
    for (size_t i = 0; i < n; i++) {
        uint64_t low = key_of(o, radix_value(item[i])) & (((uint64_t)1 << LOW_BITS) - 1);
        item[i] = radix_item((uint32_t)low, radix_value(item[i]));
    }
    uint64_t *sorted = item;
    if (n <= SHORT_RUN)
        sort_few(item, n);
    else
        sorted = radix_sort(item, spare, n, 1);
    if (sorted != item) memcpy(item, sorted, n * sizeof *item);
    for (size_t i = 0, end; i < n; i = end) {
        end = run_end(item, i, n);
        if (end - i > 1) qsort_r(&item[i], end - i, sizeof *item, compare_exact, (void *)(uintptr_t)o->position);
    }
}

static void find_runs(const struct ordering *o) {
    size_t at = 0;
    for (size_t begin = 0; begin < o->n + GRAIN; begin += GRAIN) {
        if (at < begin) at = begin < o->n ? begin : o->n;
        while (at > 0 && at < o->n && radix_key(o->item[at]) == radix_key(o->item[at - 1])) at++;
        o->first[begin / GRAIN] = at;
    }
}

static void sort_range(void *ctx, size_t begin, size_t end) {
    const struct ordering *o = ctx;
    (void)end;
    size_t last = o->first[begin / GRAIN + 1];
    for (size_t i = o->first[begin / GRAIN], next; i < last; i = next) {
        next = run_end(o->item, i, last);
        if (next - i > 1) sort_run(o, &o->item[i], &o->swap[i], next - i);
    }
}

/* ------------------------------------------------------------------------------------------------ the frame */

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

static void normalise_range(void *ctx, size_t begin, size_t end) {
    const struct ordering *o = ctx;
    for (size_t i = begin; i < end; i++) o->out->point[i] = normalised(o->position[radix_value(o->item[i])], o->out);
}

/* Moves distinct points together; items then tell which of them each input point is. */
static void keep_distinct(const struct ordering *o) {
    struct ordered_points *out = o->out;
    for (size_t i = 0; i < o->n; i++) {
        uint32_t id = radix_value(o->item[i]);
        if (out->count == 0 || !vec3_equal(out->point[i], out->point[out->count - 1])) {
            out->original[out->count] = id;
            out->point[out->count++] = out->point[i];
        }
        o->item[i] = radix_item((uint32_t)(out->count - 1), id);
    }
}

static void tell_range(void *ctx, size_t begin, size_t end) {
    const struct ordering *o = ctx;
    for (size_t i = begin; i < end; i++) o->out->distinct[radix_value(o->item[i])] = radix_key(o->item[i]);
}

static void put_in_order(struct ordering *o, unsigned threads) {
    bounding_box(o->position, o->n, o->out);
    vec3 extent = vec3_sub(o->out->box_max, o->out->box_min);
    double side = fmax(extent.x, fmax(extent.y, extent.z));
    o->origin = o->out->box_min;
    o->side = side > 0 ? side : 1;
    par_for(threads, o->n, GRAIN, key_range, o);
    uint64_t *sorted = radix_sort(o->item, o->swap, o->n, threads);
    if (sorted != o->item) o->swap = o->item, o->item = sorted;
    find_runs(o);
    par_for(threads, o->n, GRAIN, sort_range, o);
    par_for(threads, o->n, GRAIN, normalise_range, o);
    keep_distinct(o);
    par_for(threads, o->n, GRAIN, tell_range, o);
}

enum status order_points(const vec3 *position, size_t n, unsigned threads, struct ordered_points *out) {
    assert(n > 0 && n < UINT32_MAX);
    struct ordered_points points = {0};
    struct ordering o = {.position = position, .n = n, .out = &points};
    o.item = alloc_array(n, sizeof *o.item);
    o.swap = alloc_array(n, sizeof *o.swap);
    o.first = alloc_array(n / GRAIN + 3, sizeof *o.first);
    points.point = alloc_array(n, sizeof *points.point);
    points.original = alloc_array(n, sizeof *points.original);
    points.distinct = alloc_array(n, sizeof *points.distinct);
    bool ok = o.item && o.swap && o.first && points.point && points.original && points.distinct;
    if (ok) put_in_order(&o, threads);
    free(o.item), free(o.swap), free(o.first);
    if (ok)
        *out = points;
    else
        ordered_points_done(&points);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

void ordered_points_done(struct ordered_points *points) {
    if (!points) return;
    free(points->point);
    free(points->original);
    free(points->distinct);
    *points = (struct ordered_points){0};
}
