/* A mesh that is fitted to points alone bends between them where there are only a few for each triangle.  The middles
 * of the triangles between neighbours are near the surface, and on a sharp edge they tell the faces beside it, which
 * the points on it don't.
 *
 * Where there are few points for each triangle of the mesh, one middle is little: what lies at one side of an edge and
 * what at the other is one place's.  For a closer look the middles of a triangle's edges divide it into quarters, and
 * each has a middle.
 *
 * Weights are areas.  A point stands for a part of the square of its spacing, a middle for a part of its triangle, the
 * less the fewer of the triangle's corners have it: where neighbours see no triangles there are the points.
 *
 * A surface has two triangles for each point. Where points are no surface's, or many of them are on one circle, their
 * neighbours see more, and not the same ones: then those count that more of their corners have, so that samples take no
 * more memory than those of a surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/samples.h"

#include <assert.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/refine/face_samples.h"
#include "core/refine/local_delaunay.h"

enum { POINT_GRAIN = 1024 };

#define REACH 1.0f /* of the spacing */

#define LARGEST_WEIGHT 8

#define MOST_TRIANGLES 3.25 /* for each point */

struct filling {
    const struct refine_input *input;
    const struct local_delaunay *local_delaunay; /* NULL: points alone */
    unsigned parts, least_votes;
    struct samples *samples;
    double mean_area;
};

/* Areas have mean 1, but for a few lonely points that would count for too much. */
static void set_point(const struct filling *filling, uint32_t p) {
    const struct refine_input *input = filling->input;
    double spacing = (double)input->spacing[p];
    double area = filling->mean_area > 0 ? spacing * spacing / filling->mean_area : 1;
    double weight =
        samples_point_share(filling->input, filling->parts) * (area > LARGEST_WEIGHT ? LARGEST_WEIGHT : area);
    filling->samples->sample[p] = (struct sample){input->points[p], (float)weight, REACH * input->spacing[p]};
    filling->samples->normal[p] = input->normals[p];
}

/* The middle of the triangle, which is that of one of its quarters, too, and those of the other three. */
static void find_middles(const vec3 corner[3], vec3 middle[SAMPLES_QUARTERS]) {
    vec3 sum = vec3_add(vec3_add(corner[0], corner[1]), corner[2]);
    middle[0] = vec3_scale(sum, 1.0 / 3);
    for (int k = 0; k < 3; k++) middle[k + 1] = vec3_add(vec3_scale(sum, 1.0 / 6), vec3_scale(corner[k], 0.5));
}

static void set_middles(const struct filling *filling, size_t first, const uint32_t id[3], unsigned votes) {
    const struct refine_input *input = filling->input;
    vec3 corner[3] = {input->points[id[0]], input->points[id[1]], input->points[id[2]]}, middle[SAMPLES_QUARTERS];
    vec3 normal = vec3_triangle_normal(corner[0], corner[1], corner[2]);
    double share = (1 - samples_point_share(filling->input, filling->parts)) / filling->parts,
           area = vec3_length(normal) / 2 * votes / 3;
    float weight = filling->mean_area > 0 ? (float)(share * area / filling->mean_area) : 0;
    float widest = fmaxf(fmaxf(input->spacing[id[0]], input->spacing[id[1]]), input->spacing[id[2]]);
    find_middles(corner, middle);
    for (unsigned k = 0; k < filling->parts; k++) {
        filling->samples->sample[first + k] = (struct sample){middle[k], weight, REACH * widest};
        filling->samples->normal[first + k] = vec3_unit(normal);
    }
}

static void place_range(void *ctx, size_t begin, size_t end) {
    const struct filling *filling = ctx;
    const struct local_delaunay *local_delaunay = filling->local_delaunay;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        size_t at = filling->samples->middle[p];
        set_point(filling, p);
        for (uint32_t left = local_delaunay ? local_delaunay_triangles(local_delaunay, p, filling->least_votes) : 0;
             left; left &= left - 1) {
            unsigned i = (unsigned)__builtin_ctz(left) / 2;
            uint32_t corner[3] = {p, local_delaunay->rib[p][i], local_delaunay_after(local_delaunay, p, i)};
            set_middles(filling, at, corner, local_delaunay_votes(local_delaunay, p, i));
            at += filling->parts;
        }
    }
}

static unsigned count_triangles(const struct local_delaunay *local_delaunay, size_t p, unsigned least_votes) {
    return (unsigned)__builtin_popcount(local_delaunay_triangles(local_delaunay, p, least_votes));
}

/* How many corners have to have a triangle, so that there aren't too many: 1, 2 or 3; 4: there are too many. */
static unsigned votes_wanted(const struct local_delaunay *local_delaunay, size_t points) {
    for (unsigned votes = 1; votes <= 3; votes++) {
        size_t count = 0;
        for (size_t p = 0; p < points; p++) count += count_triangles(local_delaunay, p, votes);
        if ((double)count <= MOST_TRIANGLES * (double)points) return votes;
    }
    return 4;
}

/* Where the middles of each point go; no local Delaunay triangles: there are none. */
static enum status number_middles(struct samples *samples, size_t points, const struct local_delaunay *local_delaunay,
                                  unsigned parts, unsigned least_votes) {
    samples->points = points;
    samples->parts = local_delaunay ? parts : 0;
    samples->middle = alloc_array(points + 1, sizeof *samples->middle);
    if (!samples->middle) return STATUS_NO_MEMORY;
    samples->middle[0] = (uint32_t)points;
    for (size_t p = 0; p < points; p++)
        samples->middle[p + 1] =
            samples->middle[p] + (local_delaunay ? parts * count_triangles(local_delaunay, p, least_votes) : 0);
    samples->n = samples->middle[points];
    return STATUS_OK;
}

static double mean_area(const struct refine_input *input) {
    double sum = 0;
    for (size_t p = 0; p < input->n; p++) sum += (double)input->spacing[p] * (double)input->spacing[p];
    return sum / (double)input->n;
}

static enum status place_all(struct samples *samples, const struct refine_input *input,
                             const struct local_delaunay *local_delaunay, unsigned parts, unsigned threads) {
    unsigned votes = local_delaunay ? votes_wanted(local_delaunay, input->n) : 4;
    if (votes > 3) local_delaunay = NULL;
    if (number_middles(samples, input->n, local_delaunay, parts, votes)) return STATUS_NO_MEMORY;
    struct filling filling = {input, local_delaunay, samples->parts, votes, samples, mean_area(input)};
    samples->sample = alloc_array(samples->n, sizeof *samples->sample);
    samples->normal = alloc_array(samples->n, sizeof *samples->normal);
    if (!samples->sample || !samples->normal) return STATUS_NO_MEMORY;
    par_for(threads, input->n, POINT_GRAIN, place_range, &filling);
    return STATUS_OK;
}

enum status samples_init(struct samples *samples, const struct refine_input *input, unsigned parts, unsigned threads) {
    assert(parts <= 1 || parts == SAMPLES_QUARTERS);
    struct samples new = {0};
    struct local_delaunay mine = {0}, *local_delaunay = input->local_delaunay ? input->local_delaunay : &mine;
    enum status status = STATUS_OK;
    if (input->faces) return face_samples_init(samples, input, parts, threads);
    if (parts && local_delaunay->n == 0)
        status = local_delaunay_find(input->points, input->normals, input->neighbours, input->creases, threads,
                                     local_delaunay);
    if (status == STATUS_OK) status = place_all(&new, input, parts ? local_delaunay : NULL, parts, threads);
    local_delaunay_done(&mine);
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
