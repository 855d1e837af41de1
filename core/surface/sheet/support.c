/* Triangles between few kept points are long where the surface is flat, so their length says nothing.  But the original
 * points do: wherever there is surface one of them is near, as near as they are to each other.
 *
 *     + . . . . +
 *      \ o o o /        o: places of the grid.  Each looks for the nearest original point; one that finds none within
 *       . o o .         a few times the distance of points there is over something that wasn't scanned.
 *        \ o /
 *         . .
 *          +            Corners are original points, and not looked at.
 *
 * The distance of points is that of the scan at the nearest one, but no less than usual in the scan: chance leaves gaps
 * in dense parts as large as those of others.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/support.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/quantile.h"
#include "core/cloud/cloud.h"

enum {
    SIXTH = 7,
    CHUNK = 4096,
    TRIANGLES = 1024,
    SIDES = 10,
    FEW_SIDES = SIDES / 2,
    PLACES = (SIDES + 1) * (SIDES + 2) / 2 - 3
};
static const double STEP = 1.5; /* of the grid, in medians */

static enum status reach_of_chunk(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, uint32_t *id,
                                  float *reach) {
    double *distance_sq = alloc_array(n * SIXTH, sizeof *distance_sq);
    if (!distance_sq) return STATUS_NO_MEMORY;
    enum status status = knn_search(knn, point, n, SIXTH, threads, id, distance_sq);
    for (size_t i = 0; !status && i < n; i++) {
        size_t last = SIXTH * (i + 1) - 1;
        while (last > SIXTH * i && id[last] == NONE) last--;
        reach[i] = (float)sqrt(distance_sq[last]);
    }
    free(distance_sq);
    return status;
}

/* No reach is below the median. */
static enum status lift_to_median(float *reach, size_t n, float *median) {
    float *sorted = alloc_array(n, sizeof *sorted);
    if (!sorted) return STATUS_NO_MEMORY;
    memcpy(sorted, reach, n * sizeof *sorted);
    *median = quantile_of(sorted, n, 0.5);
    for (size_t i = 0; i < n; i++) reach[i] = fmaxf(reach[i], *median);
    free(sorted);
    return STATUS_OK;
}

enum status sheet_reach(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, float *reach,
                        float *median) {
    uint32_t *id = alloc_array((size_t)CHUNK * SIXTH, sizeof *id);
    enum status status = id ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < n; begin += CHUNK) {
        size_t count = n - begin < CHUNK ? n - begin : CHUNK;
        status = reach_of_chunk(knn, &point[begin], count, threads, id, &reach[begin]);
    }
    if (!status) status = lift_to_median(reach, n, median);
    free(id);
    return status;
}

enum status sheet_reach_in(const struct neighbourhood *hood, const vec3 *point, float *reach, float *median) {
    for (size_t p = 0; p < hood->n; p++) {
        size_t last = hood->count[p] < SIXTH - 1 ? hood->count[p] : SIXTH - 1;
        reach[p] = last ? (float)vec3_distance(point[p], point[hood->id[p * hood->stride + last - 1]]) : 0;
    }
    return lift_to_median(reach, hood->n, median);
}

/* ------------------------------------------------------------------------------------------------ triangles */

/* Some triangles' places. */
struct places {
    int most_sides; /* of the grid; searches from far away are slow, and for a share fewer places will do */
    size_t count;
    vec3 *place;
    uint32_t *of; /* the triangle of each */
    uint32_t *nearest;
    double *distance_sq;
};

static double longest_side(const struct mesh *mesh, uint32_t t) {
    const uint32_t *v = mesh->triangle[t];
    vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
    return fmax(vec3_distance(a, b), fmax(vec3_distance(b, c), vec3_distance(c, a)));
}

static void add_places(const struct mesh *mesh, uint32_t t, double step, struct places *places) {
    const uint32_t *v = mesh->triangle[t];
    vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
    double longest = longest_side(mesh, t);
    int most = places->most_sides, sides = longest < most * step ? (int)ceil(longest / step) : most;
    for (int i = 0; i <= sides; i++)
        for (int j = 0; i + j <= sides; j++) {
            if (i == sides || j == sides || i + j == 0) continue;
            double u = (double)i / sides, w = (double)j / sides;
            vec3 along = vec3_add(vec3_scale(vec3_sub(b, a), u), vec3_scale(vec3_sub(c, a), w));
            places->place[places->count] = vec3_add(a, along);
            places->of[places->count++] = t;
        }
}

/* Counts the places of each triangle, and those that are far. */
struct tally {
    uint8_t far, all;
};

static enum status judge(const struct sheet_points *points, double times, unsigned threads, struct places *places,
                         struct tally *tally) {
    enum status status = knn_nearest(points->knn, points->spacing, places->place, places->count, threads,
                                     places->nearest, places->distance_sq);
    for (size_t i = 0; !status && i < places->count; i++) {
        double most = times * (double)points->reach[places->nearest[i]];
        struct tally *t = &tally[places->of[i]];
        if (places->distance_sq[i] > most * most) t->far++;
        t->all++;
    }
    return status;
}

/* Looks at the triangles whose longest side is at least `least` and that have no tally yet. */
static enum status count_far(const struct mesh *mesh, const struct sheet_points *points, double times, int most_sides,
                             double least, unsigned threads, const struct progress *progress, struct tally *tally) {
    size_t room = (size_t)TRIANGLES * PLACES, n = mesh->triangle_count;
    struct places places = {most_sides,
                            0,
                            alloc_array(room, sizeof *places.place),
                            alloc_array(room, sizeof *places.of),
                            alloc_array(room, sizeof *places.nearest),
                            alloc_array(room, sizeof *places.distance_sq)};
    enum status status =
        places.place && places.of && places.nearest && places.distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t begin = 0; !status && begin < n; begin += TRIANGLES) {
        size_t end = n - begin < TRIANGLES ? n : begin + TRIANGLES;
        if (progress_tick(progress, "support", (double)begin / (double)n)) status = STATUS_CANCELLED;
        places.count = 0;
        for (size_t t = begin; t < end; t++)
            if (!tally[t].all && longest_side(mesh, (uint32_t)t) >= least)
                add_places(mesh, (uint32_t)t, STEP * (double)points->median, &places);
        if (!status) status = judge(points, times, threads, &places, tally);
    }
    free(places.place), free(places.of), free(places.nearest), free(places.distance_sq);
    return status;
}

/* Tallies of triangles, for the caller to free.  Large ones are looked at in a few places first, since searches from
 * far away are slow; the whole grid is for those that this leaves open: at least `some` of the places are far, at most
 * `most`. */
static enum status tally_all(const struct mesh *mesh, const struct sheet_points *points, double times, double some,
                             double most, unsigned threads, const struct progress *progress, struct tally **out) {
    double large = SIDES * STEP * (double)points->median;
    struct tally *tally = *out = alloc_zeroed(mesh->triangle_count, sizeof *tally);
    enum status status = tally ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = count_far(mesh, points, times, FEW_SIDES, large, threads, progress, tally);
    for (size_t t = 0; !status && t < mesh->triangle_count; t++)
        if (tally[t].far >= some * tally[t].all && tally[t].far <= most * tally[t].all) tally[t] = (struct tally){0, 0};
    if (!status) status = count_far(mesh, points, times, SIDES, 0, threads, progress, tally);
    return status;
}

enum status sheet_unsupported(const struct mesh *mesh, const struct sheet_points *points, double times,
                              unsigned threads, const struct progress *progress, uint8_t *out) {
    struct tally *tally;
    enum status status = tally_all(mesh, points, times, 0, 0, threads, progress, &tally); /* one far place is enough */
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) out[t] = tally[t].far > 0;
    free(tally);
    return status;
}

enum status sheet_mostly_far(const struct mesh *mesh, const struct sheet_points *points, double times, unsigned threads,
                             uint8_t *out) {
    struct tally *tally;
    enum status status = tally_all(mesh, points, times, 0.25, 0.75, threads, NULL, &tally);
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) out[t] = 2 * tally[t].far > tally[t].all;
    free(tally);
    return status;
}
