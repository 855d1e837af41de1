/* A mesh that is fitted to points alone bends between them where there are only a few for each triangle.  The chord
 * between two neighbours is near the surface (at most by a quarter of what the mesh through all points is off anyway),
 * and Gabriel's rule takes only chords that any sensible mesh of the points has as edges.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/samples.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"

enum { POINT_GRAIN = 1024, MAX_MIDDLES = 8 };

#define REACH 1.0f /* of the spacing */

#define STEEPEST 0.5 /* sine of the angle between a chord and the tangent plane */
#define LARGEST_WEIGHT 8
#define POINT_SHARE 0.27 /* a point has 2.7 middles on average, and all count the same */
#define MIDDLE_SHARE 0.27

struct search {
    const struct refine_input *input;
    uint32_t *partner; /* MAX_MIDDLES for each point */
    uint8_t *count;
};

static bool list_has(const struct neighbourhood *hood, uint32_t p, uint32_t q) {
    for (unsigned i = 0; i < hood->count[p]; i++)
        if (hood->id[p * hood->stride + i] == q) return true;
    return false;
}

/* Whether no neighbour of p is as near to the middle of pq as p and q are: of a square's diagonals neither passes. */
static bool ball_is_empty(const struct refine_input *input, uint32_t p, uint32_t q) {
    const struct neighbourhood *hood = input->hood;
    vec3 middle = vec3_lerp(input->points[p], input->points[q], 0.5);
    double radius_sq = vec3_distance_sq(input->points[p], middle) * (1 + 1e-9);
    for (unsigned i = 0; i < hood->count[p]; i++) {
        uint32_t r = hood->id[p * hood->stride + i];
        if (r != q && vec3_distance_sq(input->points[r], middle) < radius_sq) return false;
    }
    return true;
}

/* Whether the chord pq runs along the surface at both of its ends, rather than across an edge or a gap. */
static bool chord_is_tangent(const struct refine_input *input, uint32_t p, uint32_t q) {
    vec3 along = vec3_unit(vec3_sub(input->points[q], input->points[p]));
    double off = fmax(fabs(vec3_dot(along, input->normals[p])), fabs(vec3_dot(along, input->normals[q])));
    return off < STEEPEST;
}

/* Each pair is found from its lower point, or from the other where only that one knows of the pair. */
static void find_partners(void *ctx, size_t begin, size_t end) {
    struct search *search = ctx;
    const struct neighbourhood *hood = search->input->hood;
    for (size_t p = begin; p < end; p++) {
        search->count[p] = 0;
        for (unsigned i = 0; i < hood->count[p] && search->count[p] < MAX_MIDDLES; i++) {
            uint32_t q = hood->id[p * hood->stride + i];
            if (q < p && list_has(hood, q, (uint32_t)p)) continue;
            if (!chord_is_tangent(search->input, (uint32_t)p, q)) continue;
            if (!ball_is_empty(search->input, (uint32_t)p, q) || !ball_is_empty(search->input, q, (uint32_t)p))
                continue;
            search->partner[p * MAX_MIDDLES + search->count[p]++] = q;
        }
    }
}

struct filling {
    const struct refine_input *input;
    const struct search *search; /* NULL: points alone */
    struct samples *samples;
    double mean_area;
};

/* With mean 1, but for a few lonely points that would count for too much. */
static double area_of(const struct filling *filling, uint32_t p) {
    double spacing = (double)filling->input->spacing[p];
    double relative = filling->mean_area > 0 ? spacing * spacing / filling->mean_area : 1;
    return relative > LARGEST_WEIGHT ? LARGEST_WEIGHT : relative;
}

static vec3 between(vec3 a, vec3 b) { return vec3_unit(vec3_dot(a, b) < 0 ? vec3_sub(a, b) : vec3_add(a, b)); }

/* Sample i is the middle of pq; p itself where q is p. */
static void set_sample(const struct filling *filling, size_t i, uint32_t p, uint32_t q, double share) {
    const struct refine_input *input = filling->input;
    struct samples *samples = filling->samples;
    double area = (area_of(filling, p) + area_of(filling, q)) / 2;
    samples->sample[i].place = p == q ? input->points[p] : vec3_lerp(input->points[p], input->points[q], 0.5);
    samples->sample[i].weight = (float)(share * area);
    samples->normal[i] = p == q ? input->normals[p] : between(input->normals[p], input->normals[q]);
    samples->sample[i].reach = REACH * fmaxf(input->spacing[p], input->spacing[q]);
}

static void place_range(void *ctx, size_t begin, size_t end) {
    const struct filling *filling = ctx;
    const struct search *search = filling->search;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        set_sample(filling, p, p, p, search ? POINT_SHARE : 1);
        for (unsigned i = 0; search && i < search->count[p]; i++)
            set_sample(filling, filling->samples->middle[p] + i, p, search->partner[(size_t)p * MAX_MIDDLES + i],
                       MIDDLE_SHARE);
    }
}

/* Where the middles of each point go. */
static enum status number_middles(struct samples *samples, size_t points, const struct search *search) {
    samples->points = points;
    samples->middle = alloc_array(points + 1, sizeof *samples->middle);
    if (!samples->middle) return STATUS_NO_MEMORY;
    samples->middle[0] = (uint32_t)points;
    for (size_t p = 0; p < points; p++) samples->middle[p + 1] = samples->middle[p] + (search ? search->count[p] : 0U);
    samples->n = samples->middle[points];
    return STATUS_OK;
}

static double mean_area(const struct refine_input *input) {
    double sum = 0;
    for (size_t p = 0; p < input->n; p++) sum += (double)input->spacing[p] * (double)input->spacing[p];
    return sum / (double)input->n;
}

static enum status place_all(struct samples *samples, const struct refine_input *input, const struct search *search,
                             unsigned threads) {
    if (number_middles(samples, input->n, search)) return STATUS_NO_MEMORY;
    struct filling filling = {input, search, samples, mean_area(input)};
    samples->sample = alloc_array(samples->n, sizeof *samples->sample);
    samples->normal = alloc_array(samples->n, sizeof *samples->normal);
    if (!samples->sample || !samples->normal) return STATUS_NO_MEMORY;
    par_for(threads, input->n, POINT_GRAIN, place_range, &filling);
    return STATUS_OK;
}

enum status samples_init(struct samples *samples, const struct refine_input *input, bool middles, unsigned threads) {
    struct samples new = {0};
    struct search search = {.input = input};
    enum status status = STATUS_NO_MEMORY;
    if (middles) {
        search.partner = alloc_array(input->n, MAX_MIDDLES * sizeof *search.partner);
        search.count = alloc_array(input->n, 1);
        if (!search.partner || !search.count) goto out;
        par_for(threads, input->n, POINT_GRAIN, find_partners, &search);
    }
    status = place_all(&new, input, middles ? &search : NULL, threads);
out:
    free(search.partner);
    free(search.count);
    if (status == STATUS_OK) {
        *samples = new;
    } else {
        samples_done(&new);
    }
    return status;
}

void samples_done(struct samples *samples) {
    free(samples->sample), free(samples->normal), free(samples->middle);
    *samples = (struct samples){0};
}
