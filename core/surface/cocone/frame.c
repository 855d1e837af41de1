/* Poles.  The Voronoi cell of a sample is long in the direction of the normal; its farthest vertex, the pole, gives it.
 * A cell of a hull vertex has no farthest vertex: the mean of the hull's normals around it stands in.
 *
 * Sources: N. Amenta, M. Bern, Surface reconstruction by Voronoi filtering (1999).  T. K. Dey, S. Goswami, Tight
 * Cocone: a water-tight surface reconstructor (2003), section 2.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"

enum { GRAIN = 1024 };

struct job {
    const struct cocone_star *star;
    const vec3 *dense;
    struct cocone_frame *frame;
    int count;
};

/* The direction of the positive pole: unit. */
static vec3 pole_direction(const struct cocone_star *star, uint32_t v) {
    vec3 outward = {0, 0, 0}, pole = {0, 0, 0};
    double farthest_sq = -1;
    bool hull = false;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        vec3 dual = cocone_star_dual(star, cell, v);
        double length_sq = vec3_length_sq(dual);
        if (!cocone_star_is_finite(star, cell)) {
            outward = vec3_add(outward, dual);
            hull = true;
        } else if (length_sq > farthest_sq) {
            pole = dual;
            farthest_sq = length_sq;
        }
    }
    vec3 direction = vec3_unit(hull && vec3_length_sq(outward) > 0 ? outward : pole);
    return vec3_length_sq(direction) > 0 ? direction : (vec3){0, 0, 1};
}

static void find_poles(const struct cocone_star *star, struct cocone_frame *frame, uint32_t v) {
    double highest[2] = {0, 0};
    vec3 normal = frame->normal[v];
    uint32_t *pole = frame->pole[v];
    pole[0] = pole[1] = NONE;
    frame->hull[v] = 0;
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++) {
        uint32_t cell = cocone_star_cell(star->corner[i]);
        double height = vec3_dot(cocone_star_dual(star, cell, v), normal);
        int side = height < 0;
        if (!cocone_star_is_finite(star, cell))
            frame->hull[v] |= (uint8_t)((height != 0) << side);
        else if (fabs(height) > highest[side])
            highest[side] = fabs(height), pole[side] = cell;
    }
}

static void build_range(void *ctx, size_t begin, size_t end) {
    const struct job *job = ctx;
    for (uint32_t v = (uint32_t)begin; v < end; v++) {
        vec3 pole = pole_direction(job->star, v);
        for (int k = 0; k < job->count; k++) {
            bool dense = k == 0 && job->dense && vec3_length_sq(job->dense[v]) > 0;
            vec3 normal = dense ? job->dense[v] : pole;
            job->frame[k].normal[v] = vec3_dot(normal, pole) < 0 ? vec3_scale(normal, -1) : normal;
            find_poles(job->star, &job->frame[k], v);
        }
    }
}

enum status cocone_frame_build(const struct cocone_star *star, const vec3 *dense, unsigned threads,
                               struct cocone_frame frame[], int count) {
    for (int k = 0; k < count; k++) {
        frame[k].normal = alloc_array(star->n, sizeof *frame->normal);
        frame[k].pole = alloc_array(star->n, sizeof *frame->pole);
        frame[k].hull = alloc_array(star->n, sizeof *frame->hull);
        if (!frame[k].normal || !frame[k].pole || !frame[k].hull) return STATUS_NO_MEMORY;
    }
    struct job job = {star, dense, frame, count};
    par_for(threads, star->n, GRAIN, build_range, &job);
    return STATUS_OK;
}

void cocone_frame_done(struct cocone_frame *frame) {
    free(frame->normal), free(frame->pole), free(frame->hull);
    *frame = (struct cocone_frame){0};
}

void cocone_frame_turn(struct cocone_frame *frame, uint32_t vertex) {
    uint32_t *pole = frame->pole[vertex], outer = pole[0];
    frame->normal[vertex] = vec3_scale(frame->normal[vertex], -1);
    pole[0] = pole[1], pole[1] = outer;
    frame->hull[vertex] = (uint8_t)(frame->hull[vertex] >> 1 | (frame->hull[vertex] & 1) << 1);
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
