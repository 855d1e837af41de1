/* A disc is sampled rather than intersected: cells too thin to hold a sample are the business of the repair, which
 * mends what the others leave behind.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <math.h>

#include "core/cloud/cloud.h"

enum { SAMPLES = 6 /* along each side of a triangle */, WALK_MOST = 200 /* cells from one sample to the next */ };

/* The cells of either label, and how many samples they have. */
struct found {
    const struct cocone_star *star;
    const uint8_t *inside;
    uint32_t *cell; /* of both labels */
    size_t count, most;
    size_t samples[2];
    uint32_t at; /* where the last sample was */
    bool full;
};

/* The corners of triangle i of the fan around a corner of the polygon. */
static void fan_triangle(const struct cocone_star *star, const struct cocone_disc *disc, size_t apex, size_t i,
                         vec3 corner[3]) {
    size_t at[3] = {apex, apex + 1 + i, apex + 2 + i};
    for (int k = 0; k < 3; k++) corner[k] = star->point[disc->point[at[k] % disc->count]];
}

static size_t best_apex(const struct cocone_star *star, const struct cocone_disc *disc) {
    size_t best = 0;
    double least = INFINITY;
    for (size_t apex = 0; apex < disc->count; apex++) {
        double area = 0;
        for (size_t i = 0; i + 2 < disc->count; i++) {
            vec3 c[3];
            fan_triangle(star, disc, apex, i, c);
            area += vec3_length(vec3_triangle_normal(c[0], c[1], c[2]));
        }
        if (area < least) least = area, best = apex;
    }
    return best;
}

/* Whether p is on the other side of a facet of the cell, as seen from inside. */
static bool is_beyond(const struct cocone_star *star, uint32_t half, vec3 p) {
    uint32_t v[3];
    cocone_star_vertices(star, half, v);
    const vec3 *q = star->point;
    return vec3_dot(vec3_triangle_normal(q[v[0]], q[v[1]], q[v[2]]), vec3_sub(p, q[v[0]])) < 0;
}

/* Walks to the cell that p is in; it may end at an infinite one. */
static uint32_t walk_to(const struct cocone_star *star, uint32_t cell, vec3 p) {
    for (int step = 0; step < WALK_MOST && cocone_star_is_finite(star, cell); step++) {
        unsigned i = 0;
        while (i < 4 && !is_beyond(star, cocone_star_pack(cell, i), p)) i++;
        if (i == 4) break;
        cell = star->tets->neighbour[cell][i];
    }
    return cell;
}

static void add_sample(struct found *f, vec3 p) {
    uint32_t cell = walk_to(f->star, f->at, p);
    if (!cocone_star_is_finite(f->star, cell)) return;
    f->at = cell;
    f->samples[f->inside[cell]]++;
    for (size_t k = 0; k < f->count; k++)
        if (f->cell[k] == cell) return;
    f->full |= f->count == f->most;
    if (!f->full) f->cell[f->count++] = cell;
}

static void sample_triangle(struct found *f, const vec3 corner[3], double shift) {
    vec3 normal = vec3_triangle_normal(corner[0], corner[1], corner[2]), origin = corner[0];
    double size = vec3_length(normal);
    if (size > 0) origin = vec3_add(origin, vec3_scale(normal, shift / sqrt(size)));
    for (int i = 0; i < SAMPLES; i++) {
        for (int j = 0; i + j < SAMPLES; j++) {
            vec3 p = vec3_add(origin, vec3_scale(vec3_sub(corner[1], corner[0]), (i + 1 / 3.0) / SAMPLES));
            add_sample(f, vec3_add(p, vec3_scale(vec3_sub(corner[2], corner[0]), (j + 1 / 3.0) / SAMPLES)));
        }
    }
}

static uint32_t first_cell(const struct cocone_star *star, uint32_t v) {
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++)
        if (cocone_star_is_finite(star, cocone_star_cell(star->corner[i]))) return cocone_star_cell(star->corner[i]);
    return 0;
}

size_t cocone_disc_cells(const struct cocone_star *star, const uint8_t *inside, const struct cocone_disc *disc,
                         uint32_t *cell, size_t most) {
    struct found f = {.star = star, .inside = inside, .cell = cell, .most = most};
    size_t apex = best_apex(star, disc), kept = 0;
    f.at = first_cell(star, disc->point[0]);
    for (size_t i = 0; i + 2 < disc->count; i++) {
        vec3 corner[3];
        fan_triangle(star, disc, apex, i, corner);
        sample_triangle(&f, corner, disc->shift);
    }
    if (f.full) return 0;
    int label = f.samples[1] > f.samples[0];
    for (size_t k = 0; k < f.count; k++)
        if (inside[cell[k]] == label) cell[kept++] = cell[k];
    return kept;
}
