/* Points are looked for in a hierarchy of the triangles, each from the answer of the one before, which lies nearby.
 *
 * A middle is near its point, so it goes downhill from there, over the mesh: where the nearest place of a triangle is
 * on an edge, the triangle behind it may be nearer still, and where it is a corner, any around that; amid a triangle
 * the way ends.  Few steps are needed, for a quarter of the time.  The surface may be nearer elsewhere, behind a fold;
 * but there it isn't what the middle's point stands on.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/fit_assign.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/bvh.h"
#include "core/cloud.h"
#include "core/par.h"

enum { SAMPLE_GRAIN = 2048, LIST_GRAIN = 512 };

#define TRUSTED 0.15 /* of the spacing: farther off than that, a middle is looked for in the hierarchy as well */

struct assignment {
    const struct fit *fit;
    const struct bvh *bvh;
    uint32_t *triangle;
    float *distance_sq;
};

struct stop {
    uint32_t triangle;
    struct triangle_hit hit;
};

/* Moves to the triangle if it is nearer. */
static bool try_triangle(const struct fit *fit, vec3 place, uint32_t triangle, struct stop *best) {
    struct triangle_frame frame = fit_frame(fit, triangle);
    struct triangle_hit hit = triangle_frame_hit(&frame, place);
    if (!(hit.distance_sq < best->hit.distance_sq)) return false;
    *best = (struct stop){triangle, hit};
    return true;
}

static bool try_around(const struct fit *fit, vec3 place, uint32_t h, struct stop *best) {
    bool nearer = false;
    uint32_t e = h;
    do {
        e = halfedge_around(&fit->he, e);
        if (e == NONE || e == h) return nearer;
        nearer |= try_triangle(fit, place, e / 3, best);
    } while (true);
}

static struct stop go_downhill(const struct fit *fit, vec3 place, uint32_t start) {
    struct stop best = {start, {.distance_sq = INFINITY}};
    bool nearer = try_triangle(fit, place, start, &best);
    while (nearer && best.hit.feature != TRIANGLE_INSIDE) {
        uint32_t h = 3 * best.triangle + best.hit.corner, twin = fit->he.twin[h];
        if (best.hit.feature == TRIANGLE_CORNER)
            nearer = try_around(fit, place, h, &best);
        else
            nearer = twin != NONE && try_triangle(fit, place, twin / 3, &best);
    }
    return best;
}

static struct stop search(const struct bvh *bvh, vec3 place, uint32_t hint) {
    struct bvh_hit hit = bvh_closest(bvh, place, hint);
    return (struct stop){hit.triangle, {.distance_sq = hit.distance_sq}};
}

static struct stop place_middle(const struct assignment *assignment, const struct sample *middle, uint32_t start) {
    struct stop stop = go_downhill(assignment->fit, middle->place, start);
    double trusted = TRUSTED * (double)middle->reach;
    return stop.hit.distance_sq < trusted * trusted ? stop : search(assignment->bvh, middle->place, stop.triangle);
}

static void assign_range(void *ctx, size_t begin, size_t end) {
    struct assignment *assignment = ctx;
    const struct samples *samples = &assignment->fit->samples;
    uint32_t hint = NONE;
    for (size_t i = begin; i < end; i++) {
        bool is_middle = samples->point[i] == NONE && hint != NONE;
        struct stop stop = is_middle ? place_middle(assignment, &samples->sample[i], hint)
                                     : search(assignment->bvh, samples->sample[i].place, hint);
        assignment->triangle[i] = stop.triangle;
        assignment->distance_sq[i] = (float)stop.hit.distance_sq;
        if (!is_middle) hint = stop.triangle;
    }
}

enum status fit_assign(const struct fit *fit, uint32_t *triangle, float *distance_sq) {
    struct bvh *bvh = NULL;
    enum status status = bvh_new(fit->mesh, fit->threads, &bvh);
    struct assignment assignment = {fit, bvh, triangle, distance_sq};
    if (status == STATUS_OK) par_for(fit->threads, fit->samples.n, SAMPLE_GRAIN, assign_range, &assignment);
    bvh_free(bvh);
    return status;
}

struct filling {
    struct fit *fit;
    const float *distance_sq;
    const uint32_t *sample; /* sorted by their triangles: those of t are sample[start[t] .. start[t + 1]) */
    const size_t *start;
};

static void fill_range(void *ctx, size_t begin, size_t end) {
    const struct filling *filling = ctx;
    struct fit *fit = filling->fit;
    const size_t *start = filling->start;
    size_t blocks = 0;
    for (size_t t = begin; t < end; t++) blocks += (start[t + 1] - start[t] + SAMPLE_BLOCK - 1) / SAMPLE_BLOCK;
    uint32_t spare = sample_lists_reserve(&fit->lists, blocks);
    for (size_t t = begin; t < end; t++)
        for (size_t i = start[t]; i < start[t + 1]; i++) {
            uint32_t id = filling->sample[i];
            const struct sample *sample = &fit->samples.sample[id];
            sample_lists_add(&fit->lists, (uint32_t)t, id, sample, &spare);
            fit->cost[t] += (double)sample->weight * fit_cost_of(fit, (double)filling->distance_sq[id]);
        }
}

/* start[t + 2] becomes the beginning of what follows t, and with each sample that is put there the end of t. */
static void sort_samples(const uint32_t *triangle, size_t n, size_t triangles, uint32_t *sample, size_t *start) {
    for (size_t i = 0; i < n; i++) start[triangle[i] + 2]++;
    for (size_t t = 2; t < triangles + 2; t++) start[t] += start[t - 1];
    for (size_t i = 0; i < n; i++) sample[start[triangle[i] + 1]++] = (uint32_t)i;
}

enum status fit_fill(struct fit *fit, const uint32_t *triangle, const float *distance_sq) {
    size_t n = fit->samples.n, triangles = fit->mesh->triangle_count;
    uint32_t *sample = alloc_array(n, sizeof *sample);
    size_t *start = alloc_zeroed(triangles + 2, sizeof *start);
    struct filling filling = {fit, distance_sq, sample, start};
    bool enough = sample && start;
    if (enough) {
        sort_samples(triangle, n, triangles, sample, start);
        par_for(fit->threads, triangles, LIST_GRAIN, fill_range, &filling);
    }
    free(sample), free(start);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}
