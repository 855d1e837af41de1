/* Poles.  The Voronoi cell of a sample is long in the direction of the normal; its farthest vertex, the pole, gives it.
 * A cell of a hull vertex has no farthest vertex: the mean of the hull's normals around it stands in.
 *
 * Sources: N. Amenta, M. Bern, Surface reconstruction by Voronoi filtering (1999).  T. K. Dey, S. Goswami, Tight
 * Cocone: a water-tight surface reconstructor (2003), section 2.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cocone_frame.h"

#include <math.h>
#include <stdlib.h>

#include "core/alloc.h"
#include "core/par.h"

enum { GRAIN = 1024 };

struct job {
    const struct cocone_star *star;
    const vec3 *dense;
    struct cocone_frame *frame;
};

/* The direction of the positive pole: unit. */
static vec3 pole_direction(const struct cocone_star *star, uint32_t v, uint8_t *hull) {
    vec3 outward = {0, 0, 0}, pole = {0, 0, 0};
    double farthest_sq = -1;
    *hull = 0;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        vec3 dual = cocone_star_dual(star, cell, v);
        if (!cocone_star_is_finite(star, cell)) {
            outward = vec3_add(outward, dual);
            *hull = 1;
        } else if (vec3_length_sq(dual) > farthest_sq) {
            pole = dual;
            farthest_sq = vec3_length_sq(dual);
        }
    }
    vec3 direction = vec3_unit(*hull && vec3_length_sq(outward) > 0 ? outward : pole);
    return vec3_length_sq(direction) > 0 ? direction : (vec3){0, 0, 1};
}

static void measure_heights(const struct cocone_star *star, struct cocone_frame *frame, uint32_t v) {
    double above_sq = 0, below_sq = 0;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        if (!cocone_star_is_finite(star, cell)) continue;
        vec3 dual = cocone_star_dual(star, cell, v);
        double *side = vec3_dot(dual, frame->normal[v]) < 0 ? &below_sq : &above_sq;
        *side = fmax(*side, vec3_length_sq(dual));
    }
    frame->above[v] = frame->hull[v] ? INFINITY : sqrt(above_sq);
    frame->below[v] = sqrt(below_sq);
}

static void build_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    struct cocone_frame *frame = job->frame;
    for (uint32_t v = (uint32_t)begin; v < end; v++) {
        vec3 pole = pole_direction(job->star, v, &frame->hull[v]);
        bool dense = job->dense && vec3_length_sq(job->dense[v]) > 0;
        vec3 normal = dense ? job->dense[v] : pole;
        frame->normal[v] = vec3_dot(normal, pole) < 0 ? vec3_scale(normal, -1) : normal;
        measure_heights(job->star, frame, v);
    }
}

enum status cocone_frame_build(const struct cocone_star *star, const vec3 *dense, unsigned threads,
                               struct cocone_frame *out) {
    struct cocone_frame frame = {0};
    frame.normal = alloc_array(star->n, sizeof *frame.normal);
    frame.above = alloc_array(star->n, sizeof *frame.above);
    frame.below = alloc_array(star->n, sizeof *frame.below);
    frame.hull = alloc_array(star->n, sizeof *frame.hull);
    if (!frame.normal || !frame.above || !frame.below || !frame.hull) {
        cocone_frame_done(&frame);
        return STATUS_NO_MEMORY;
    }
    struct job job = {star, dense, &frame};
    par_for(threads, star->n, GRAIN, build_range, &job);
    *out = frame;
    return STATUS_OK;
}

void cocone_frame_done(struct cocone_frame *frame) {
    free(frame->normal);
    free(frame->above);
    free(frame->below);
    free(frame->hull);
    *frame = (struct cocone_frame){0};
}

double cocone_frame_cosine(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                           uint32_t vertex) {
    return vec3_dot(vec3_unit(cocone_star_dual(star, cell, vertex)), frame->normal[vertex]);
}

bool cocone_frame_accepts(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t half,
                          uint32_t vertex) {
    double a = cocone_frame_cosine(star, frame, cocone_star_cell(half), vertex);
    double b = cocone_frame_cosine(star, frame, cocone_star_cell(cocone_star_twin(star, half)), vertex);
    return fmin(a, b) <= COCONE_FRAME_SIN && fmax(a, b) >= -COCONE_FRAME_SIN;
}
