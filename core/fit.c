/* The lists of points, and what a surface costs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/fit.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/bvh.h"
#include "core/cloud.h"
#include "core/par.h"

enum { TRIANGLE_GRAIN = 512 };

struct triangle_frame fit_frame(const struct fit *fit, uint32_t triangle) {
    const uint32_t *corner = fit->mesh->triangle[triangle];
    const vec3 *vertex = fit->mesh->vertex;
    return triangle_frame_of(vertex[corner[0]], vertex[corner[1]], vertex[corner[2]]);
}

double fit_cost_with(const struct fit *fit, const uint32_t *triangle, size_t triangles,
                     const struct triangle_frame *frame, size_t frames, double limit) {
    const vec3 *points = fit->samples.place;
    double sum = 0;
    for (size_t k = 0; k < triangles; k++) {
        for (uint32_t i = fit->first[triangle[k]]; i != NONE; i = fit->link[i]) {
            double nearest_sq = INFINITY;
            for (size_t j = 0; j < frames; j++)
                nearest_sq = triangle_frame_nearer_sq(&frame[j], points[i], nearest_sq);
            sum += fit->samples.weight[i] * fit_cost_of(fit, nearest_sq);
            if (sum > limit) return sum;
        }
    }
    return sum;
}

double fit_stray_sq(const struct fit *fit, const uint32_t *triangle, size_t triangles,
                    const struct triangle_frame *frame, size_t frames) {
    vec3 middle[FIT_MAX_RING];
    double nearest_sq[FIT_MAX_RING], farthest_sq = 0;
    uint32_t nearest[FIT_MAX_RING];
    for (size_t j = 0; j < frames; j++) {
        middle[j] = triangle_frame_middle(&frame[j]);
        nearest_sq[j] = INFINITY, nearest[j] = NONE;
    }
    for (size_t k = 0; k < triangles; k++) {
        for (uint32_t i = fit->first[triangle[k]]; i != NONE; i = fit->link[i]) {
            for (size_t j = 0; j < frames; j++) {
                double d_sq = vec3_distance_sq(middle[j], fit->samples.place[i]);
                if (d_sq < nearest_sq[j]) nearest_sq[j] = d_sq, nearest[j] = i;
            }
        }
    }
    for (size_t j = 0; j < frames; j++) {
        uint32_t i = nearest[j];
        if (i == NONE) continue;
        double d_sq = nearest_sq[j], reach = (double)fit->samples.reach[i];
        if (d_sq <= reach * reach) {
            double height = vec3_dot(vec3_sub(middle[j], fit->samples.place[i]), fit->samples.normal[i]);
            d_sq = height * height;
        }
        if (d_sq > farthest_sq) farthest_sq = d_sq;
    }
    return farthest_sq;
}

/* Takes the points out of the lists, as one list in the order of the triangles. */
static uint32_t take_points(struct fit *fit, const uint32_t *triangle, size_t n) {
    uint32_t chain = NONE;
    for (size_t k = n; k-- > 0;) {
        uint32_t i = fit->first[triangle[k]];
        fit->first[triangle[k]] = NONE;
        fit->cost[triangle[k]] = 0;
        while (i != NONE) {
            uint32_t next = fit->link[i];
            fit->link[i] = chain;
            chain = i;
            i = next;
        }
    }
    return chain;
}

void fit_share(struct fit *fit, const uint32_t *from, size_t n, const uint32_t *to, size_t m) {
    assert(m <= FIT_MAX_RING);
    struct triangle_frame frame[FIT_MAX_RING];
    for (size_t k = 0; k < m; k++) frame[k] = fit_frame(fit, to[k]);
    for (uint32_t i = take_points(fit, from, n), next; i != NONE; i = next) {
        next = fit->link[i];
        double nearest_sq = INFINITY;
        size_t owner = 0;
        for (size_t k = 0; k < m; k++) {
            double d_sq = triangle_frame_nearer_sq(&frame[k], fit->samples.place[i], nearest_sq);
            if (d_sq < nearest_sq) nearest_sq = d_sq, owner = k;
        }
        fit->link[i] = fit->first[to[owner]];
        fit->first[to[owner]] = i;
        fit->cost[to[owner]] += fit->samples.weight[i] * fit_cost_of(fit, nearest_sq);
    }
}

double fit_total(const struct fit *fit) {
    double sum = 0;
    for (size_t t = 0; t < fit->mesh->triangle_count; t++) sum += fit->cost[t];
    return sum;
}

static enum status assign_points(struct fit *fit) {
    struct bvh *bvh = NULL;
    struct bvh_hit *hit = alloc_array(fit->samples.n, sizeof *hit);
    enum status status = hit ? bvh_new(fit->mesh, &bvh) : STATUS_NO_MEMORY;
    if (status != STATUS_OK) goto out;
    bvh_closest_all(bvh, fit->samples.place, fit->samples.n, fit->threads, hit);
    for (uint32_t i = (uint32_t)fit->samples.n; i-- > 0;) {
        uint32_t t = hit[i].triangle;
        fit->link[i] = fit->first[t];
        fit->first[t] = i;
        fit->cost[t] += fit->samples.weight[i] * fit_cost_of(fit, hit[i].distance_sq);
    }
out:
    bvh_free(bvh);
    free(hit);
    return status;
}

static enum status allocate(struct fit *fit) {
    size_t n = fit->input->n, triangles = fit->mesh->triangle_count, vertices = fit->mesh->vertex_count;
    fit->first = alloc_array(triangles, sizeof *fit->first);
    fit->link = alloc_array(fit->samples.n, sizeof *fit->link);
    fit->cost = alloc_zeroed(triangles, sizeof *fit->cost);
    fit->taken = alloc_zeroed(n, 1);
    fit->stale = alloc_array(vertices, 1);
    fit->touched = alloc_array(triangles, 1);
    fit->postponed = alloc_zeroed(triangles, 1);
    if (!fit->first || !fit->link || !fit->cost || !fit->taken || !fit->stale || !fit->touched ||
        !fit->postponed)
        return STATUS_NO_MEMORY;
    memset(fit->first, 0xff, triangles * sizeof *fit->first);
    memset(fit->stale, 1, vertices);
    memset(fit->touched, 1, triangles);
    return STATUS_OK;
}

static bool wants_middles(const struct mesh *mesh, const struct refine_input *input) {
    return input->hood && (double)input->n < FIT_ENOUGH * (double)mesh->triangle_count;
}

enum status fit_init(struct fit *fit, struct mesh *mesh, const struct refine_input *input,
                     const struct refine_options *options) {
    struct fit new = {.mesh = mesh, .input = input, .placement = options->placement, .threads = options->threads};
    new.far = FIT_FAR;
    enum status status = samples_init(&new.samples, input, wants_middles(mesh, input), options->threads);
    if (status == STATUS_OK) status = allocate(&new);
    if (status == STATUS_OK) status = halfedge_init(&new.he, mesh);
    if (status == STATUS_OK) {
        for (size_t v = 0; mesh->source && v < mesh->vertex_count; v++)
            if (mesh->source[v] != NONE) new.taken[mesh->source[v]] = 1;
        status = assign_points(&new);
    }
    if (status != STATUS_OK) {
        fit_done(&new);
        return status;
    }
    *fit = new;
    return STATUS_OK;
}

void fit_done(struct fit *fit) {
    halfedge_done(&fit->he);
    samples_done(&fit->samples);
    free(fit->first), free(fit->link), free(fit->cost);
    free(fit->taken), free(fit->stale), free(fit->touched), free(fit->postponed);
    *fit = (struct fit){0};
}
