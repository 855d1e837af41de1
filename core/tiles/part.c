/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/part.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/clean/noise.h"
#include "core/pipeline/memory.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "core/simplify/point_quadrics.h"
#include "core/spatial/knn.h"
#include "core/spatial/neighbourhood.h"

static enum status part_no_memory(size_t points, struct error *error) {
    return error_set(error, STATUS_NO_MEMORY, "tiles", "not enough memory for %zu points", points);
}

static enum status find_hood(const struct part *part, bool find, struct part_whole *whole, struct neighbourhood *hood) {
    size_t n = part->points.count;
    struct knn *knn = NULL;
    const struct params *params = part->params;
    const struct neighbourhood_options options = {params->neighbourhood, (unsigned)params->neighbours_min,
                                                  (unsigned)params->neighbours_max, part->threads};
    enum status status = knn_new(part->points.point, n, part->threads, &knn, NULL);
    if (!status && find) status = neighbourhood_noisy(knn, part->points.point, n, part->threads, &whole->noisy, NULL);
    if (!status) status = neighbourhood_find_as(knn, part->points.point, n, &options, whole->noisy, hood);
    knn_free(knn);
    return status;
}

/* The quadrics of all points, from their neighbourhoods. */
static enum status assemble(struct part *part, const struct neighbourhood *hood, bool find, struct part_whole *whole) {
    size_t n = part->points.count;
    const vec3 *point = part->points.point;
    vec3 *normal = part->normal = alloc_array(n, sizeof *normal);
    float *dso = alloc_array(n, sizeof *dso);
    part->quadrics = alloc_array(n, sizeof *part->quadrics);
    enum status status = normal && dso && part->quadrics ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        const struct point_quadrics of = {part->params, point, normal, hood, dso, part->own, part->threads};
        normals_fit(point, hood, part->threads, normal, NULL);
        dso_compute(point, normal, hood, (enum dso_form)part->params->dso, part->threads, dso);
        if (find) whole->average = NAN;
        status = point_quadrics_make(&of, &whole->average, part->quadrics);
    }
    if (!status && find) {
        whole->length_bias = contract_length_bias(part->quadrics, part->own, n);
        status = noise_estimate(point, normal, hood, &whole->noise);
    }
    free(dso);
    return status;
}

enum status part_make(struct part *part, const struct scratch_points *points, bool find, struct part_whole *whole,
                      const struct progress *progress, struct error *error) {
    struct neighbourhood hood = {0};
    size_t given = points->count;
    enum status status = order_points_of(&whole->frame, points->position, given, part->threads, &part->points);
    if (status) return part_no_memory(given, error);
    size_t n = part->points.count;
    part->own = alloc_array(n, sizeof *part->own);
    if (!part->own) return part_no_memory(given, error);
    for (size_t i = 0; i < n; i++) part->own[i] = points->own[part->points.original[i]];
    if (progress_tick(progress, "neighbours", 0)) return STATUS_CANCELLED;
    status = find_hood(part, find, whole, &hood);
    alloc_give_back();
    if (!status && progress_tick(progress, "quadrics", 0)) status = STATUS_CANCELLED;
    if (!status) status = assemble(part, &hood, find, whole);
    if (!status) status = adjacency_from(&hood, part->threads, &part->near);
    neighbourhood_done(&hood);
    return status == STATUS_NO_MEMORY ? part_no_memory(given, error) : status;
}

void part_done(struct part *part) {
    if (!part) return;
    ordered_points_done(&part->points);
    adjacency_done(&part->near);
    free(part->own), free(part->normal), free(part->quadrics);
    part->own = NULL, part->normal = NULL, part->quadrics = NULL;
}
