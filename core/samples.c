/* A mesh that is fitted to points alone bends between them where there are only a few for each triangle.  The middles
 * of the triangles between neighbours are near the surface, and on a sharp edge they tell the faces beside it, which
 * the points on it don't.
 *
 * Weights are areas.  A point stands for a part of the square of its spacing, a middle for a part of its triangle, the
 * less the fewer of the triangle's corners have it: where neighbours see no triangles there are the points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/samples.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/par.h"
#include "core/umbrella.h"

enum { POINT_GRAIN = 1024 };

#define REACH 1.0f /* of the spacing */

#define LARGEST_WEIGHT 8
#define POINT_SHARE 0.25
#define MIDDLE_SHARE 0.75

struct filling {
    const struct refine_input *input;
    const struct umbrellas *umbrellas; /* NULL: points alone */
    struct samples *samples;
    double mean_area;
};

/* With mean 1, but for a few lonely points that would count for too much. */
static double area_of(const struct filling *filling, uint32_t p) {
    double spacing = (double)filling->input->spacing[p];
    double relative = filling->mean_area > 0 ? spacing * spacing / filling->mean_area : 1;
    return relative > LARGEST_WEIGHT ? LARGEST_WEIGHT : relative;
}

static void set_point(const struct filling *filling, uint32_t p) {
    const struct refine_input *input = filling->input;
    double share = filling->umbrellas ? POINT_SHARE : 1;
    filling->samples->sample[p] =
        (struct sample){input->points[p], (float)(share * area_of(filling, p)), REACH * input->spacing[p]};
    filling->samples->normal[p] = input->normals[p];
}

static void set_middle(const struct filling *filling, size_t i, const uint32_t corner[3], unsigned votes) {
    const struct refine_input *input = filling->input;
    vec3 a = input->points[corner[0]], b = input->points[corner[1]], c = input->points[corner[2]];
    vec3 normal = vec3_triangle_normal(a, b, c);
    double area = vec3_length(normal) / 2 * votes / 3;
    float widest = fmaxf(fmaxf(input->spacing[corner[0]], input->spacing[corner[1]]), input->spacing[corner[2]]);
    filling->samples->sample[i] =
        (struct sample){vec3_scale(vec3_add(vec3_add(a, b), c), 1.0 / 3),
                        filling->mean_area > 0 ? (float)(MIDDLE_SHARE * area / filling->mean_area) : 0, REACH * widest};
    filling->samples->normal[i] = vec3_unit(normal);
}

static void place_range(void *ctx, size_t begin, size_t end) {
    const struct filling *filling = ctx;
    const struct umbrellas *umbrellas = filling->umbrellas;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        size_t at = filling->samples->middle[p];
        set_point(filling, p);
        for (unsigned i = 0; umbrellas && i < UMBRELLA_RIBS; i++) {
            unsigned votes = umbrella_votes(umbrellas, p, i);
            if (votes == 0) continue;
            set_middle(filling, at++, (uint32_t[3]){p, umbrellas->rib[p][i], umbrella_after(umbrellas, p, i)}, votes);
        }
    }
}

static unsigned count_middles(const struct umbrellas *umbrellas, size_t p) {
    unsigned count = 0;
    for (unsigned i = 0; i < UMBRELLA_RIBS; i++) count += umbrella_votes(umbrellas, p, i) > 0;
    return count;
}

/* Where the middles of each point go. */
static enum status number_middles(struct samples *samples, size_t points, const struct umbrellas *umbrellas) {
    samples->points = points;
    samples->middle = alloc_array(points + 1, sizeof *samples->middle);
    if (!samples->middle) return STATUS_NO_MEMORY;
    samples->middle[0] = (uint32_t)points;
    for (size_t p = 0; p < points; p++)
        samples->middle[p + 1] = samples->middle[p] + (umbrellas ? count_middles(umbrellas, p) : 0);
    samples->n = samples->middle[points];
    return STATUS_OK;
}

static double mean_area(const struct refine_input *input) {
    double sum = 0;
    for (size_t p = 0; p < input->n; p++) sum += (double)input->spacing[p] * (double)input->spacing[p];
    return sum / (double)input->n;
}

static enum status place_all(struct samples *samples, const struct refine_input *input,
                             const struct umbrellas *umbrellas, unsigned threads) {
    if (number_middles(samples, input->n, umbrellas)) return STATUS_NO_MEMORY;
    struct filling filling = {input, umbrellas, samples, mean_area(input)};
    samples->sample = alloc_array(samples->n, sizeof *samples->sample);
    samples->normal = alloc_array(samples->n, sizeof *samples->normal);
    if (!samples->sample || !samples->normal) return STATUS_NO_MEMORY;
    par_for(threads, input->n, POINT_GRAIN, place_range, &filling);
    return STATUS_OK;
}

enum status samples_init(struct samples *samples, const struct refine_input *input, bool middles, unsigned threads) {
    struct samples new = {0};
    struct umbrellas umbrellas = {0};
    enum status status = STATUS_OK;
    if (input->umbrellas) umbrellas = *input->umbrellas, *input->umbrellas = (struct umbrellas){0};
    if (middles && umbrellas.n == 0)
        status = umbrella_find(input->points, input->normals, input->hood, threads, &umbrellas);
    if (status == STATUS_OK) status = place_all(&new, input, middles ? &umbrellas : NULL, threads);
    umbrella_done(&umbrellas);
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
