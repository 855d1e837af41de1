/* Area-uniform samples of the mesh, and for each the input points around it.  Such a point supports the sample if its
 * own projection to the mesh lies near the sample and on the same side of the surface.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/support.h"

#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/triangle.h"
#include "core/measure/sampler.h"

enum { SAMPLES = 20000, NEAREST = 8, GRAIN = 256 };
static const double FAR = 64, NEARLY = 0.25; /* struct knn_slack: nothing so far off supports a sample */

struct search {
    const struct mesh *mesh;
    const struct support_points *points;
    const struct sampler *sampler;
    vec3 *sample;
    uint32_t *near; /* NEAREST points of each sample */
    uint8_t *supported;
};

static bool supports(const struct search *s, uint32_t p, vec3 sample, vec3 normal) {
    const struct mesh *mesh = s->mesh;
    uint32_t t = s->points->nearest[p];
    const uint32_t *v = mesh->triangle[t];
    if (vec3_dot(normal, mesh_triangle_normal(mesh, t)) < 0) return false;
    vec3 foot = triangle_closest(s->points->point[p], mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]);
    return vec3_distance(sample, foot) <= SUPPORT_REACH * (double)s->points->spacing[p];
}

static void fill_range(void *ctx, size_t begin, size_t end) {
    struct search *s = ctx;
    sampler_fill(s->sampler, begin, end, &s->sample[begin]);
}

static void judge_range(void *ctx, size_t begin, size_t end) {
    struct search *s = ctx;
    for (size_t i = begin; i < end; i++) {
        vec3 normal = mesh_triangle_normal(s->mesh, (uint32_t)sampler_element(s->sampler, i));
        s->supported[i] = false;
        for (size_t k = i * NEAREST; k < (i + 1) * NEAREST && s->near[k] != NONE && !s->supported[i]; k++)
            s->supported[i] = supports(s, s->near[k], s->sample[i], normal);
    }
}

static enum status judge(struct search *s, unsigned threads, double *share) {
    size_t n = s->sampler->count, missing = 0;
    double *distance_sq = alloc_array(n * NEAREST, sizeof *distance_sq);
    if (!distance_sq) return STATUS_NO_MEMORY;
    par_for(threads, n, GRAIN, fill_range, s);
    struct knn_slack slack = {s->points->spacing, FAR, NEARLY};
    enum status status =
        knn_search_nearly(s->points->knn, &slack, s->sample, n, NEAREST, threads, s->near, distance_sq);
    free(distance_sq);
    if (status) return status;
    par_for(threads, n, GRAIN, judge_range, s);
    for (size_t i = 0; i < n; i++) missing += !s->supported[i];
    *share = n ? (double)missing / (double)n : 0;
    return STATUS_OK;
}

enum status support_missing(const struct mesh *mesh, const struct support_points *points, uint64_t seed,
                            unsigned threads, double *share) {
    struct sampler sampler = {0};
    struct search s = {.mesh = mesh, .points = points, .sampler = &sampler};
    s.sample = alloc_array(SAMPLES, sizeof *s.sample);
    s.near = alloc_array((size_t)SAMPLES * NEAREST, sizeof *s.near);
    s.supported = alloc_array(SAMPLES, sizeof *s.supported);
    enum status status = s.sample && s.near && s.supported ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = sampler_uniform(mesh, SAMPLES, seed, &sampler);
    if (!status) status = judge(&s, threads, share);
    sampler_done(&sampler);
    free(s.sample), free(s.near), free(s.supported);
    return status;
}
