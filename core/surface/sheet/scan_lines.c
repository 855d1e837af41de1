/* The points are thinned again and again, one for each cell of a grid twice as wide, until a point's neighbours among
 * those left are no line any more:
 *
 *     .............          .   .   .   .
 *                     ->                       the sixth neighbour is on another line
 *     .............          .   .   .   .
 *
 * Each grid leaves about half as many points of a line, so that all take little more than the first.
 *
 * Where that goes on until hardly any points are left they are those of curves, which bound no surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/scan_lines.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/knn.h"

enum {
    NEAR = 9,
    SIXTH = 6 /* the point itself comes before it, unless it was left out */,
    GRIDS = 7,
    FEW = 10,
    CHUNK = 4096,
    GRAIN = 1024
};
enum { CURVE_SAMPLES = 2000, CURVE_LEAST = 256 /* points, that are left of curves */ };
static const double CURVES = 0.9; /* of the samples */
static const double LINE = 0.02;  /* of the trace's square: below, the principal minors' sum is a line's */

struct thinning {
    vec3 *point;
    size_t count;
    uint64_t *cell; /* hash table; 0 = free */
    size_t mask;
};

static sym3 moment_add(sym3 moment, vec3 from, vec3 to) { return sym3_add(moment, sym3_outer(vec3_sub(to, from))); }

/* Whether second moments about a point are those of a line through it, as the neighbourhoods' own have it. */
static bool is_line(sym3 m) {
    double minors = m.xx * m.yy - m.xy * m.xy + m.xx * m.zz - m.xz * m.xz + m.yy * m.zz - m.yz * m.yz;
    return minors < LINE * sym3_trace(m) * sym3_trace(m);
}

/* Whether the neighbours of a point are all on a line. */
static bool is_on_line(const struct neighbourhood *neighbours, const vec3 *point, size_t p) {
    sym3 moment = {0};
    for (size_t i = 0; i < neighbours->count[p]; i++)
        moment = moment_add(moment, point[p], point[neighbours->id[p * neighbours->stride + i]]);
    return neighbours->count[p] && is_line(moment);
}

struct on_lines {
    const struct neighbourhood *neighbours;
    const vec3 *point;
    size_t samples;
    uint32_t *on_line;
};

static void find_on_line(void *ctx, size_t begin, size_t end) {
    const struct on_lines *lines = ctx;
    for (size_t i = begin; i < end; i++) {
        size_t p = i * lines->neighbours->n / lines->samples;
        lines->on_line[i] = is_on_line(lines->neighbours, lines->point, p) ? (uint32_t)p : NONE;
    }
}

/* Of so many points, evenly spread, those whose neighbours are all on a line; how many are. */
static size_t find_on_lines(const struct neighbourhood *neighbours, const vec3 *point, size_t samples, unsigned threads,
                            uint32_t *on_line) {
    struct on_lines lines = {neighbours, point, samples, on_line};
    size_t count = 0;
    par_for(threads, samples, GRAIN, find_on_line, &lines);
    for (size_t i = 0; i < samples; i++)
        if (on_line[i] != NONE) on_line[count++] = on_line[i];
    return count;
}

static uint64_t line_cell(vec3 p, double side) {
    const double at[] = {p.x, p.y, p.z};
    uint64_t key = 1;
    for (int k = 0; k < 3; k++) key = hash64(key ^ (uint64_t)(int64_t)fmax(-0x1p62, fmin(floor(at[k] / side), 0x1p62)));
    return key ? key : 1;
}

/* Leaves the first point of each cell.  Two cells of one hash are one, which is rare and does no harm. */
static void thin(struct thinning *left, double side) {
    size_t count = 0;
    memset(left->cell, 0, (left->mask + 1) * sizeof *left->cell);
    for (size_t i = 0; i < left->count; i++) {
        uint64_t key = line_cell(left->point[i], side);
        size_t slot = (size_t)key & left->mask;
        while (left->cell[slot] && left->cell[slot] != key) slot = (slot + 1) & left->mask;
        if (left->cell[slot]) continue;
        left->cell[slot] = key;
        left->point[count++] = left->point[i];
    }
    left->count = count;
}

/* Looks at so many points among those left; the ones that are still on a line come first, and *count is how many.
 * reach: NULL = of no use. */
static enum status look(const struct thinning *left, const struct knn *knn, const vec3 *point, unsigned threads,
                        uint32_t *on_line, size_t *count, float *reach) {
    vec3 *query = alloc_array(CHUNK, sizeof *query);
    uint32_t *id = alloc_array((size_t)CHUNK * NEAR, sizeof *id);
    double *distance_sq = alloc_array((size_t)CHUNK * NEAR, sizeof *distance_sq);
    enum status status = query && id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    size_t still = 0;
    for (size_t begin = 0; begin < *count && !status; begin += CHUNK) {
        size_t n = *count - begin < CHUNK ? *count - begin : CHUNK;
        for (size_t i = 0; i < n; i++) query[i] = point[on_line[begin + i]];
        status = knn_search(knn, query, n, NEAR, threads, id, distance_sq);
        for (size_t i = 0; i < n && !status; i++) {
            sym3 moment = {0};
            for (size_t k = i * NEAR; k < (i + 1) * NEAR; k++)
                if (id[k] != NONE) moment = moment_add(moment, query[i], left->point[id[k]]);
            uint32_t p = on_line[begin + i];
            if (is_line(moment))
                on_line[still++] = p;
            else if (reach && id[i * NEAR + SIXTH] != NONE)
                reach[p] = fmaxf(reach[p], (float)sqrt(distance_sq[i * NEAR + SIXTH]));
        }
    }
    if (!status) *count = still;
    free(query), free(id), free(distance_sq);
    return status;
}

static enum status widen(struct thinning *left, double side, const vec3 *point, unsigned threads, uint32_t *on_line,
                         size_t *count, float *reach) {
    for (int grid = 0; grid<GRIDS && * count> 0 && left->count > NEAR; grid++, side *= 2) {
        struct knn *knn = NULL;
        thin(left, side);
        enum status status = knn_new(left->point, left->count, threads, &knn, NULL);
        if (!status) status = look(left, knn, point, threads, on_line, count, reach);
        knn_free(knn);
        if (status) return status;
    }
    return STATUS_OK;
}

/* A copy of the points, to be thinned; the median of lengths, such as those to neighbours, is what to begin with. */
static enum status begin_thinning(const struct neighbourhood *neighbours, const vec3 *point, const float *length,
                                  struct thinning *left, double *side) {
    float *sorted = alloc_array(neighbours->n, sizeof *sorted);
    *left = (struct thinning){.count = neighbours->n, .mask = 1};
    while (left->mask + 1 < 2 * neighbours->n) left->mask = 2 * left->mask + 1;
    left->point = alloc_array(neighbours->n, sizeof *left->point);
    left->cell = alloc_array(left->mask + 1, sizeof *left->cell);
    bool room = sorted && left->point && left->cell;
    if (room) {
        memcpy(left->point, point, neighbours->n * sizeof *point);
        memcpy(sorted, length, neighbours->n * sizeof *sorted);
        *side = (double)quantile_of(sorted, neighbours->n, 0.5);
    }
    free(sorted);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

static void thinning_done(struct thinning *left) { free(left->point), free(left->cell); }

enum status scan_lines_reach(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads, float *reach,
                             size_t *found) {
    enum status status = STATUS_OK;
    size_t count = 0;
    uint32_t *on_line = alloc_array(neighbours->n, sizeof *on_line);
    if (!on_line) return STATUS_NO_MEMORY;
    *found = count = find_on_lines(neighbours, point, neighbours->n, threads, on_line);
    if (count > neighbours->n / FEW) {
        struct thinning left;
        double side;
        status = begin_thinning(neighbours, point, reach, &left, &side);
        if (!status && side > 0) status = widen(&left, side, point, threads, on_line, &count, reach);
        thinning_done(&left);
    }
    free(on_line);
    return status;
}

enum status scan_lines_are_curves(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads,
                                  bool *curves) {
    size_t samples = neighbours->n < CURVE_SAMPLES ? neighbours->n : CURVE_SAMPLES,
           least = (size_t)(CURVES * (double)samples);
    uint32_t on_line[CURVE_SAMPLES];
    size_t count = find_on_lines(neighbours, point, samples, threads, on_line);
    struct thinning left;
    double side;
    *curves = false;
    if (neighbours->n <= CURVE_LEAST || count < least) return STATUS_OK;
    enum status status = begin_thinning(neighbours, point, neighbours->spacing, &left, &side);
    for (; !status && side > 0 && count >= least && !*curves; side *= 2) {
        struct knn *knn = NULL;
        size_t before = left.count;
        thin(&left, side);
        *curves = left.count <= CURVE_LEAST;
        if (*curves || left.count == before) continue;
        status = knn_new(left.point, left.count, threads, &knn, NULL);
        if (!status) status = look(&left, knn, point, threads, on_line, &count, NULL);
        knn_free(knn);
    }
    thinning_done(&left);
    return status;
}
