/* Morton order: 21 bits of each coordinate interleaved to one 63-bit key.
 *
 * Every later stage visits points in this order, so that what is near in space is near in memory: neighbour queries
 * take half the time.  The upper half of the keys is sorted by radix, with the ids; then each run of points that share
 * it by the lower half.  Few points of a surface do, so that this costs half of what sorting whole keys does.  Points
 * that share all of their key are put in order by their exact coordinates, then by id, so that the order is total on
 * distinct positions and doesn't depend on the order of the input, and duplicates stand side by side.
 *
 * A crowd is more than a few different points in one cell, such as a scan beside a stray so far away that all of the
 * scan is a few cells.  It is put in order along a curve of its own, in its own box, and so are crowds within it.
 * Every step has cells smaller by 2^21, so a few of them see all that double can tell apart; DEEPEST bounds what
 * points made for the purpose could cost.
 *
 * The frame is that of all points, unless strays spoil it (core/cloud/most.h): then it is that of most points, in which
 * strays lie far out, but never farther than FARTHEST, so that squares stay numbers in float.  Beside strays that are
 * LOST times as far off, most points are one place.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/morton.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/most.h"
#include "core/math/exact.h"

enum { KEY_BITS = 21, LOW_BITS = 31, GRAIN = 1 << 14, SHORT_RUN = 24, DEEPEST = 6 };
static const double FARTHEST = 1e9, LOST = 1e15;

/* The cube that is divided into cells. */
struct cube {
    vec3 origin;
    double side;
};

struct ordering {
    const vec3 *position;
    size_t n;
    struct cube cube;
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

static uint64_t key_of(const struct cube *cube, vec3 p) {
    vec3 d = vec3_sub(p, cube->origin);
    return spread(cell(d.x, cube->side)) << 2 | spread(cell(d.y, cube->side)) << 1 | spread(cell(d.z, cube->side));
}

static uint32_t high_half(uint64_t key) { return (uint32_t)(key >> LOW_BITS); }
static uint32_t low_half(uint64_t key) { return (uint32_t)(key & (((uint64_t)1 << LOW_BITS) - 1)); }

static void key_range(void *ctx, size_t begin, size_t end) {
    struct ordering *o = ctx;
    for (size_t i = begin; i < end; i++)
        o->item[i] = radix_item(high_half(key_of(&o->cube, o->position[i])), (uint32_t)i);
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

static void sort_exactly(const struct ordering *o, uint64_t *item, size_t n) {
    if (n > 1) qsort_r(item, n, sizeof *item, compare_exact, (void *)(uintptr_t)o->position);
}

static struct cube cube_of(vec3 least, vec3 most) {
    vec3 extent = vec3_sub(most, least);
    double side = fmax(extent.x, fmax(extent.y, extent.z));
    return (struct cube){least, side > 0 ? side : 1};
}

static void sort_crowd(const struct ordering *o, uint64_t *item, uint64_t *spare, size_t n, int depth);

/* Puts n points whose keys have the same upper half in order.  spare: for n more. */
static void sort_run(const struct ordering *o, const struct cube *cube, uint64_t *item, uint64_t *spare, size_t n,
                     int depth) {
    for (size_t i = 0; i < n; i++) {
        uint32_t id = radix_value(item[i]);
        item[i] = radix_item(low_half(key_of(cube, o->position[id])), id);
    }
    uint64_t *sorted = item;
    if (n <= SHORT_RUN)
        sort_few(item, n);
    else
        sorted = radix_sort(item, spare, n, 1);
    if (sorted != item) memcpy(item, sorted, n * sizeof *item);
    for (size_t i = 0, end; i < n; i = end) {
        end = run_end(item, i, n);
        if (end - i <= SHORT_RUN)
            sort_exactly(o, &item[i], end - i);
        else
            sort_crowd(o, &item[i], &spare[i], end - i, depth + 1);
    }
}

/* The same for n points that share a cell. */
static void sort_crowd(const struct ordering *o, uint64_t *item, uint64_t *spare, size_t n, int depth) {
    vec3 least = o->position[radix_value(item[0])], most = least;
    for (size_t i = 1; i < n; i++) {
        vec3 p = o->position[radix_value(item[i])];
        least = vec3_min(least, p), most = vec3_max(most, p);
    }
    if (depth > DEEPEST || vec3_equal(least, most)) {
        sort_exactly(o, item, n);
        return;
    }
    struct cube cube = cube_of(least, most);
    for (size_t i = 0; i < n; i++) {
        uint32_t id = radix_value(item[i]);
        item[i] = radix_item(high_half(key_of(&cube, o->position[id])), id);
    }
    uint64_t *sorted = radix_sort(item, spare, n, 1);
    if (sorted != item) memcpy(item, sorted, n * sizeof *item);
    for (size_t i = 0, end; i < n; i = end) {
        end = run_end(item, i, n);
        if (end - i > 1) sort_run(o, &cube, &item[i], &spare[i], end - i, depth);
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
        if (next - i > 1) sort_run(o, &o->cube, &o->item[i], &o->swap[i], next - i, 0);
    }
}

/* ------------------------------------------------------------------------------------------------ the frame */

/* Halves first, so that coordinates near the largest double don't overflow. */
static double diagonal_of(vec3 least, vec3 most) {
    vec3 half = vec3_sub(vec3_scale(most, 0.5), vec3_scale(least, 0.5));
    return 2 * exact_hypotenuse(exact_hypotenuse(half.x, half.y), half.z);
}

static vec3 middle_of(vec3 least, vec3 most) { return vec3_add(vec3_scale(least, 0.5), vec3_scale(most, 0.5)); }

void order_frame_of(vec3 box_min, vec3 box_max, struct ordered_points *whole) {
    whole->box_min = box_min;
    whole->box_max = box_max;
    whole->centre = middle_of(box_min, box_max);
    whole->diagonal = diagonal_of(box_min, box_max);
    if (!(whole->diagonal > 0)) whole->diagonal = 1;
    whole->scale = whole->diagonal;
}

static void bounding_box(const vec3 *position, size_t n, struct ordered_points *out) {
    vec3 least = position[0], most = least;
    for (size_t i = 1; i < n; i++) {
        least = vec3_min(least, position[i]);
        most = vec3_max(most, position[i]);
    }
    order_frame_of(least, most, out);
}

static bool is_stray(vec3 p, vec3 centre, double diagonal) {
    const double room = 64 * diagonal;
    return fabs(p.x - centre.x) > room || fabs(p.y - centre.y) > room || fabs(p.z - centre.z) > room;
}

/* Where strays spoil the box, the frame is that of most points.  Points are sampled along the curve, so that it doesn't
 * depend on their order. */
static void choose_frame(const struct ordering *o) {
    vec3 sample[MOST_SAMPLES], least, most;
    size_t taken = o->n < MOST_SAMPLES ? o->n : MOST_SAMPLES;
    for (size_t i = 0; i < taken; i++) sample[i] = o->position[radix_value(o->item[i * o->n / taken])];
    if (!most_of(sample, taken, &least, &most)) return;
    double diagonal = diagonal_of(least, most);
    if (diagonal >= o->out->diagonal / MOST_SPOILT) return;
    vec3 centre = middle_of(least, most);
    for (size_t i = 0; i < o->n; i++) o->out->strays += is_stray(o->position[i], centre, diagonal);
    if (diagonal < o->out->diagonal / LOST) return;
    o->out->centre = centre;
    o->out->scale = fmax(diagonal, o->out->diagonal / FARTHEST);
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

static void put_in_order(struct ordering *o, const struct ordered_points *whole, unsigned threads) {
    if (!whole) bounding_box(o->position, o->n, o->out);
    o->cube = cube_of(o->out->box_min, o->out->box_max);
    par_for(threads, o->n, GRAIN, key_range, o);
    uint64_t *sorted = radix_sort(o->item, o->swap, o->n, threads);
    if (sorted != o->item) o->swap = o->item, o->item = sorted;
    find_runs(o);
    par_for(threads, o->n, GRAIN, sort_range, o);
    if (!whole) choose_frame(o);
    par_for(threads, o->n, GRAIN, normalise_range, o);
    keep_distinct(o);
    par_for(threads, o->n, GRAIN, tell_range, o);
}

static enum status order(const struct ordered_points *whole, const vec3 *position, size_t n, unsigned threads,
                         struct ordered_points *out) {
    assert(n > 0 && n < UINT32_MAX);
    struct ordered_points points = {0};
    if (whole) {
        points = *whole;
        points.count = points.strays = 0;
    }
    struct ordering o = {.position = position, .n = n, .out = &points};
    o.item = alloc_array(n, sizeof *o.item);
    o.swap = alloc_array(n, sizeof *o.swap);
    o.first = alloc_array(n / GRAIN + 3, sizeof *o.first);
    points.point = alloc_array(n, sizeof *points.point);
    points.original = alloc_array(n, sizeof *points.original);
    points.distinct = alloc_array(n, sizeof *points.distinct);
    bool ok = o.item && o.swap && o.first && points.point && points.original && points.distinct;
    if (ok) put_in_order(&o, whole, threads);
    free(o.item), free(o.swap), free(o.first);
    if (ok)
        *out = points;
    else
        ordered_points_done(&points);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status order_points(const vec3 *position, size_t n, unsigned threads, struct ordered_points *out) {
    return order(NULL, position, n, threads, out);
}

enum status order_points_of(const struct ordered_points *whole, const vec3 *position, size_t n, unsigned threads,
                            struct ordered_points *out) {
    return order(whole, position, n, threads, out);
}

void ordered_points_done(struct ordered_points *points) {
    if (!points) return;
    free(points->point);
    free(points->original);
    free(points->distinct);
    *points = (struct ordered_points){0};
}
