/* A triangle is divided by parallels to its sides into k^2 equal parts, k the larger the more of the area it has, so
 * that a few large ones tell as much of their surface as many small ones do; no more in all than MOST for each point.
 *
 * Weights are areas: a point stands for a part of its triangles', a middle for a part of its own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/face_samples.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { FACES_GRAIN = 1024, DIVIDED_MOST = 16 };

#define MOST 3.25 /* middles for each point, times the parts that are asked for: what local Delaunay triangles have */

struct facing_samples {
    const struct refine_input *input;
    struct samples *samples;
    uint32_t *start;  /* count + 1: which middles are of each face, behind the points */
    double *area;     /* of each face */
    double mean_area; /* of the surface for each point */
};

static void face_corners(const struct refine_input *input, size_t f, vec3 corner[3]) {
    for (int k = 0; k < 3; k++) corner[k] = input->points[input->faces->triangle[f][k]];
}

static unsigned divided(double area, double unit, unsigned least) {
    double k = unit > 0 ? floor(sqrt(area / unit) + 0.5) : least;
    return k < least ? least : k > DIVIDED_MOST * least ? DIVIDED_MOST * least : (unsigned)k;
}

static double count_parts(const struct facing_samples *s, double unit, unsigned least) {
    double count = 0;
    for (size_t f = 0; f < s->input->faces->count; f++) {
        unsigned k = divided(s->area[f], unit, least);
        count += (double)k * k;
    }
    return count;
}

/* Which area is one part's: that of a usual triangle's, or more where that makes too many.  Negative: too many in any
 * case. */
static double unit_of(const struct facing_samples *s, double total, unsigned least) {
    enum { TRIALS = 8 };
    double most = MOST * (double)s->input->n * least * least, faces = (double)s->input->faces->count;
    double unit = total / (faces * least * least);
    for (int i = 0; i < TRIALS; i++, unit *= 2)
        if (count_parts(s, unit, least) <= most) return unit;
    return faces * least * least <= most ? INFINITY : -1;
}

static void number_parts(const struct facing_samples *s, double unit, unsigned least) {
    size_t n = s->input->n, faces = s->input->faces->count, p = 0;
    uint32_t at = (uint32_t)n;
    for (size_t f = 0; f < faces; f++) {
        const uint32_t *id = s->input->faces->triangle[f];
        uint32_t lowest = id[0] < id[1] ? id[0] : id[1];
        if (id[2] < lowest) lowest = id[2];
        while (p <= lowest) s->samples->middle[p++] = at;
        s->start[f] = at;
        unsigned k = unit < 0 ? 0 : divided(s->area[f], unit, least);
        at += k * k;
    }
    s->start[faces] = at;
    while (p <= n) s->samples->middle[p++] = at;
    s->samples->n = at;
}

/* Part i of k^2: rows from corner a towards the side b c, in each of them upright and reversed ones in turns. */
static vec3 part_middle(const vec3 corner[3], unsigned k, unsigned i) {
    unsigned row = (unsigned)sqrt((double)i), place = i - row * row;
    bool reversed = place % 2;
    double along = place / 2, down = row;
    double b = (down - along + (reversed ? -1.0 / 3 : 1.0 / 3)) / k, c = (along + (reversed ? 2.0 / 3 : 1.0 / 3)) / k;
    vec3 ab = vec3_sub(corner[1], corner[0]), ac = vec3_sub(corner[2], corner[0]);
    return vec3_add(corner[0], vec3_add(vec3_scale(ab, b), vec3_scale(ac, c)));
}

static void part_range(void *ctx, size_t begin, size_t end) {
    const struct facing_samples *s = ctx;
    for (size_t f = begin; f < end; f++) {
        vec3 corner[3];
        face_corners(s->input, f, corner);
        unsigned parts = s->start[f + 1] - s->start[f], k = (unsigned)(sqrt((double)parts) + 0.5);
        vec3 normal = vec3_unit(vec3_triangle_normal(corner[0], corner[1], corner[2]));
        double share = 1 - samples_point_share(s->input, s->samples->parts);
        float weight = parts && s->mean_area > 0 ? (float)(share * s->area[f] / (parts * s->mean_area)) : 0;
        double longest = 0;
        for (int i = 0; i < 3; i++) longest = fmax(longest, vec3_distance(corner[i], corner[(i + 1) % 3]));
        for (unsigned i = 0; i < parts; i++) {
            vec3 middle = part_middle(corner, k, i);
            s->samples->sample[s->start[f] + i] = (struct sample){middle, weight, (float)(longest / k)};
            s->samples->normal[s->start[f] + i] = normal;
        }
    }
}

/* Points have the mean normal of their faces, by area, which is summed into samples->normal, and where their spacing
 * isn't known reach as far as their longest edge.  One of no face weighs nothing, and may be without a normal; but
 * where sharp faces were made of a part of the points, the others weigh what they stand for. */
static void set_points(const struct facing_samples *s) {
    const struct refine_input *input = s->input;
    struct sample *sample = s->samples->sample;
    vec3 *normal = s->samples->normal;
    double share = samples_point_share(s->input, s->samples->parts);
    for (size_t p = 0; p < input->n; p++) {
        sample[p] = (struct sample){input->points[p], 0, input->spacing ? input->spacing[p] : 0};
        normal[p] = (vec3){0, 0, 0};
    }
    for (size_t f = 0; f < input->faces->count; f++) {
        vec3 corner[3];
        face_corners(input, f, corner);
        vec3 across = vec3_triangle_normal(corner[0], corner[1], corner[2]);
        for (int k = 0; k < 3; k++) {
            uint32_t p = input->faces->triangle[f][k];
            normal[p] = vec3_add(normal[p], across);
            if (!input->spacing)
                sample[p].reach = fmaxf(sample[p].reach, (float)vec3_distance(corner[k], corner[(k + 1) % 3]));
            if (s->mean_area > 0) sample[p].weight += (float)(share * s->area[f] / (3 * s->mean_area));
        }
    }
    for (size_t p = 0; p < input->n; p++) {
        if (vec3_length_sq(normal[p]) > 0)
            normal[p] = vec3_unit(normal[p]);
        else if (input->normals)
            normal[p] = input->normals[p];
        if (input->sharp && sample[p].weight == 0 && s->mean_area > 0)
            sample[p].weight = (float)(share * (double)input->spacing[p] * (double)input->spacing[p] / s->mean_area);
    }
}

static enum status place(struct facing_samples *s, unsigned parts, unsigned threads) {
    const struct refine_faces *faces = s->input->faces;
    double total = 0;
    for (size_t f = 0; f < faces->count; f++) {
        vec3 corner[3];
        face_corners(s->input, f, corner);
        s->area[f] = vec3_length(vec3_triangle_normal(corner[0], corner[1], corner[2])) / 2;
        total += s->area[f];
    }
    unsigned least = parts == SAMPLES_QUARTERS ? 2 : 1;
    double unit = parts ? unit_of(s, total, least) : -1;
    s->mean_area = total / (double)s->input->n;
    s->samples->points = s->input->n;
    s->samples->parts = unit < 0 ? 0 : parts;
    number_parts(s, unit, least);
    s->samples->sample = alloc_array(s->samples->n, sizeof *s->samples->sample);
    s->samples->normal = alloc_array(s->samples->n, sizeof *s->samples->normal);
    if (!s->samples->sample || !s->samples->normal) return STATUS_NO_MEMORY;
    set_points(s);
    par_for(threads, faces->count, FACES_GRAIN, part_range, s);
    return STATUS_OK;
}

enum status face_samples_init(struct samples *samples, const struct refine_input *input, unsigned parts,
                              unsigned threads) {
    struct samples new = {0};
    size_t faces = input->faces->count;
    struct facing_samples s = {.input = input, .samples = &new};
    s.start = alloc_array(faces + 1, sizeof *s.start);
    s.area = alloc_array(faces, sizeof *s.area);
    new.middle = alloc_array(input->n + 1, sizeof *new.middle);
    enum status status = s.start && s.area && new.middle ? place(&s, parts, threads) : STATUS_NO_MEMORY;
    free(s.start), free(s.area);
    if (status)
        samples_done(&new);
    else
        *samples = new;
    return status;
}
