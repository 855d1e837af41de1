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
    const vec3 *points = fit->input->points;
    double sum = 0;
    for (size_t k = 0; k < triangles; k++) {
        for (uint32_t i = fit->first[triangle[k]]; i != NONE; i = fit->link[i]) {
            double nearest_sq = INFINITY;
            for (size_t j = 0; j < frames; j++)
                nearest_sq = triangle_frame_nearer_sq(&frame[j], points[i], nearest_sq);
            sum += fit->weight[i] * fit_cost_of(fit, nearest_sq);
            if (sum > limit) return sum;
        }
    }
    return sum;
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

void fit_share(struct fit *fit, const uint32_t *triangle, size_t n) {
    assert(n <= FIT_MAX_RING);
    struct triangle_frame frame[FIT_MAX_RING];
    for (size_t k = 0; k < n; k++) frame[k] = fit_frame(fit, triangle[k]);
    for (uint32_t i = take_points(fit, triangle, n), next; i != NONE; i = next) {
        next = fit->link[i];
        double nearest_sq = INFINITY;
        size_t owner = 0;
        for (size_t k = 0; k < n; k++) {
            double d_sq = triangle_frame_nearer_sq(&frame[k], fit->input->points[i], nearest_sq);
            if (d_sq < nearest_sq) nearest_sq = d_sq, owner = k;
        }
        fit->link[i] = fit->first[triangle[owner]];
        fit->first[triangle[owner]] = i;
        fit->cost[triangle[owner]] += fit->weight[i] * fit_cost_of(fit, nearest_sq);
    }
}

double fit_total(const struct fit *fit) {
    double sum = 0;
    for (size_t t = 0; t < fit->mesh->triangle_count; t++) sum += fit->cost[t];
    return sum;
}

/* Weights with mean 1, in proportion to the area that a point stands for. */
static void set_weights(struct fit *fit) {
    const struct refine_input *input = fit->input;
    double sum = 0;
    for (size_t i = 0; i < input->n; i++) sum += fit->weight[i] = input->spacing[i] * input->spacing[i];
    double mean = input->n ? sum / (double)input->n : 0;
    for (size_t i = 0; i < input->n; i++) {
        double relative = mean > 0 ? fit->weight[i] / mean : 1;
        fit->weight[i] = relative > FIT_LARGEST_WEIGHT ? FIT_LARGEST_WEIGHT : relative;
    }
}

static enum status assign_points(struct fit *fit) {
    struct bvh *bvh = NULL;
    struct bvh_hit *hit = alloc_array(fit->input->n, sizeof *hit);
    enum status status = hit ? bvh_new(fit->mesh, &bvh) : STATUS_NO_MEMORY;
    if (status != STATUS_OK) goto out;
    bvh_closest_all(bvh, fit->input->points, fit->input->n, fit->threads, hit);
    for (uint32_t i = (uint32_t)fit->input->n; i-- > 0;) {
        uint32_t t = hit[i].triangle;
        fit->link[i] = fit->first[t];
        fit->first[t] = i;
        fit->cost[t] += fit->weight[i] * fit_cost_of(fit, hit[i].distance_sq);
    }
out:
    bvh_free(bvh);
    free(hit);
    return status;
}

static enum status allocate(struct fit *fit) {
    size_t n = fit->input->n, triangles = fit->mesh->triangle_count, vertices = fit->mesh->vertex_count;
    fit->weight = alloc_array(n, sizeof *fit->weight);
    fit->first = alloc_array(triangles, sizeof *fit->first);
    fit->link = alloc_array(n, sizeof *fit->link);
    fit->cost = alloc_zeroed(triangles, sizeof *fit->cost);
    fit->taken = alloc_zeroed(n, 1);
    fit->stale = alloc_array(vertices, 1);
    fit->touched = alloc_array(triangles, 1);
    fit->postponed = alloc_zeroed(triangles, 1);
    if (!fit->weight || !fit->first || !fit->link || !fit->cost || !fit->taken || !fit->stale || !fit->touched ||
        !fit->postponed)
        return STATUS_NO_MEMORY;
    memset(fit->first, 0xff, triangles * sizeof *fit->first);
    memset(fit->stale, 1, vertices);
    memset(fit->touched, 1, triangles);
    return STATUS_OK;
}

enum status fit_init(struct fit *fit, struct mesh *mesh, const struct refine_input *input,
                     const struct refine_options *options) {
    struct fit new = {.mesh = mesh, .input = input, .placement = options->placement, .threads = options->threads};
    new.far = FIT_FAR;
    enum status status = allocate(&new);
    if (status == STATUS_OK) status = halfedge_init(&new.he, mesh);
    if (status == STATUS_OK) {
        set_weights(&new);
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
    free(fit->weight), free(fit->first), free(fit->link), free(fit->cost);
    free(fit->taken), free(fit->stale), free(fit->touched), free(fit->postponed);
    *fit = (struct fit){0};
}
