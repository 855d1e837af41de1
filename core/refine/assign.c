/* Every sample goes downhill over the mesh, from a triangle nearby: where the nearest place of a triangle is on an
 * edge, the triangle behind it may be nearer still, and where it is a corner, any around that; amid a triangle the way
 * ends.  Few steps are needed.  A point sets out from its vertex's first triangle, or where there is none from where
 * the point before it came to; a middle from its point's.
 *
 * Triangles are measured to in frames of their own, which are in the room of the lists until these are filled.
 *
 * The surface may be nearer elsewhere, behind a fold.  So what ends farther off than may be expected is looked for in a
 * hierarchy of all triangles as well.  The middles of a long triangle, one of given faces that lies across others, are
 * many, and each would be looked for among all that lie there.  They follow each other, so the next one sets out from
 * what the one before was found in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/triangle_sides.h"
#include "core/spatial/bvh.h"

enum { POINT_GRAIN = 1024, FRAME_GRAIN = 1024, LIST_GRAIN = 512 };

#define TRUSTED 0.15 /* of the spacing: farther off than that, a sample is looked for in the hierarchy as well */

static_assert(sizeof(struct triangle_sides) <= sizeof(struct sample_block), "or it has no room there");

struct assignment {
    const struct fit *fit;
    const struct bvh *bvh;
    struct triangle_sides *sides; /* of each triangle; in the room of the lists */
    uint32_t *star;               /* of each point: the first triangle at a vertex that stands there, or NONE */
    uint32_t *triangle;
    float *distance_sq;
};

/* The nearest place so far: where on which triangle. */
struct stop {
    uint32_t triangle;
    struct triangle_hit hit;
};

/* Moves to the triangle if it is nearer. */
INLINE bool try_triangle(const struct assignment *a, vec3 place, uint32_t triangle, struct stop *best) {
    struct triangle_hit hit = triangle_sides_hit(&a->sides[triangle], place);
    if (!(hit.distance_sq < best->hit.distance_sq)) return false;
    *best = (struct stop){triangle, hit};
    return true;
}

INLINE bool try_around(const struct assignment *a, vec3 place, uint32_t h, struct stop *best) {
    bool nearer = false;
    uint32_t e = h;
    do {
        e = halfedge_around(&a->fit->he, e);
        if (e == NONE || e == h) return nearer;
        nearer |= try_triangle(a, place, e / 3, best);
    } while (best->hit.distance_sq > 0);
    return nearer;
}

/* Where there is no distance left, nothing is nearer. */
INLINE struct stop go_downhill(const struct assignment *a, vec3 place, uint32_t start) {
    struct stop best = {.triangle = start, .hit.distance_sq = INFINITY};
    bool nearer = try_triangle(a, place, start, &best);
    while (nearer && best.hit.feature != TRIANGLE_INSIDE && best.hit.distance_sq > 0) {
        uint32_t h = 3 * best.triangle + best.hit.corner, twin = a->fit->he.twin[h];
        if (best.hit.feature == TRIANGLE_CORNER)
            nearer = try_around(a, place, h, &best);
        else
            nearer = twin != NONE && try_triangle(a, place, twin / 3, &best);
    }
    return best;
}

static uint32_t assign_nearest(const struct assignment *a, size_t i, uint32_t triangle, double distance_sq) {
    a->triangle[i] = triangle;
    a->distance_sq[i] = (float)distance_sq;
    return triangle;
}

/* The nearest triangle of all; hint is one nearby. */
static uint32_t look_up(const struct assignment *a, size_t i, uint32_t hint) {
    struct bvh_hit hit = bvh_closest(a->bvh, a->fit->samples.sample[i].place, hint);
    return assign_nearest(a, i, hit.triangle, hit.distance_sq);
}

/* Whether what is found from a triangle nearby, which becomes *stop, is as near as may be expected. */
INLINE bool is_found_from(const struct assignment *a, size_t i, uint32_t start, struct stop *stop) {
    const struct sample *sample = &a->fit->samples.sample[i];
    double trusted = TRUSTED * (double)sample->reach;
    *stop = go_downhill(a, sample->place, start);
    return stop->hit.distance_sq < trusted * trusted;
}

/* The nearest that is found from a triangle nearby. */
INLINE uint32_t place_from(const struct assignment *a, size_t i, uint32_t start) {
    struct stop stop;
    if (is_found_from(a, i, start, &stop)) return assign_nearest(a, i, stop.triangle, stop.hit.distance_sq);
    return look_up(a, i, stop.triangle);
}

/* The middles of a point, from the triangle where that is. */
INLINE void place_middles(const struct assignment *a, uint32_t begin, uint32_t end, uint32_t near) {
    uint32_t away = NONE; /* what the one before was looked up in */
    struct stop stop;
    for (uint32_t i = begin; i < end; i++) {
        bool found = away != NONE && is_found_from(a, i, away, &stop);
        if (!found) away = NONE, found = is_found_from(a, i, near, &stop);
        if (found)
            assign_nearest(a, i, stop.triangle, stop.hit.distance_sq);
        else
            away = look_up(a, i, stop.triangle);
    }
}

static void assign_range(void *ctx, size_t begin, size_t end) {
    const struct assignment *a = ctx;
    const uint32_t *middle = a->fit->samples.middle;
    uint32_t near = NONE;
    for (uint32_t p = (uint32_t)begin; p < end; p++) {
        uint32_t start = a->star[p] == NONE ? near : a->star[p];
        near = start == NONE ? look_up(a, p, NONE) : place_from(a, p, start);
        place_middles(a, middle[p], middle[p + 1], near);
    }
}

static struct triangle_sides sides_of(const struct frames_four *f, size_t k) {
    struct triangle_frame frame = {.a = {f->ax[k], f->ay[k], f->az[k]},
                                   .u = {f->ux[k], f->uy[k], f->uz[k]},
                                   .v = {f->vx[k], f->vy[k], f->vz[k]},
                                   .n = {f->nx[k], f->ny[k], f->nz[k]},
                                   .bx = f->bx[k],
                                   .cx = f->cx[k],
                                   .cy = f->cy[k],
                                   .bc = {f->bc_x[k], f->bc_y[k], f->bc_length[k]},
                                   .ac = {f->ac_x[k], f->ac_y[k], f->ac_length[k]}};
    return triangle_sides_of(&frame);
}

static void frame_range(void *ctx, size_t begin, size_t end) {
    const struct assignment *a = ctx;
    for (size_t t = begin; t < end; t += FRAMES_MOST) {
        uint32_t triangle[FRAMES_MOST];
        size_t n = end - t < FRAMES_MOST ? end - t : FRAMES_MOST;
        struct triangle_frames frames;
        for (size_t k = 0; k < n; k++) triangle[k] = (uint32_t)(t + k);
        fit_frames(a->fit, triangle, n, &frames);
        for (size_t k = 0; k < n; k++) a->sides[t + k] = sides_of(&frames.four[k / FRAMES_WIDTH], k % FRAMES_WIDTH);
    }
}

static void find_stars(const struct fit *fit, uint32_t *star) {
    const struct mesh *mesh = fit->mesh;
    memset(star, 0xff, fit->samples.points * sizeof *star);
    for (size_t t = mesh->source ? mesh->triangle_count : 0; t-- > 0;)
        for (int k = 0; k < 3; k++) {
            uint32_t point = mesh->source[mesh->triangle[t][k]];
            if (point != NONE) star[point] = (uint32_t)t;
        }
}

FOR_EACH_PROCESSOR(enum status, fit_assign)
(const struct fit *fit, uint32_t *triangle, float *distance_sq) {
    struct bvh *bvh = NULL;
    size_t triangles = fit->mesh->triangle_count, points = fit->samples.points;
    struct assignment a = {.fit = fit, .triangle = triangle, .distance_sq = distance_sq};
    a.sides = sample_buckets_room(&fit->lists);
    a.star = alloc_array(points, sizeof *a.star);
    enum status status = STATUS_NO_MEMORY;
    /* A rough hierarchy goes by the order of triangles, of which refinement and a mesher along fronts leave none. */
    bool in_order = fit->is_new && fit->borders == 0;
    if (a.star) status = (in_order ? bvh_new_rough : bvh_new)(fit->mesh, fit->threads, &bvh);
    if (status == STATUS_OK) {
        a.bvh = bvh;
        find_stars(fit, a.star);
        par_for(fit->threads, triangles, FRAME_GRAIN, frame_range, &a);
        par_for(fit->threads, points, POINT_GRAIN, assign_range, &a);
    }
    free(a.star);
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
    uint32_t spare = sample_buckets_reserve(&fit->lists, blocks);
    for (size_t t = begin; t < end; t++)
        for (size_t i = start[t]; i < start[t + 1]; i++) {
            uint32_t id = filling->sample[i];
            const struct sample *sample = &fit->samples.sample[id];
            sample_buckets_add(&fit->lists, (uint32_t)t, id, sample, &spare);
            fit->cost[t] += (double)sample->weight * fit_cost_of(fit, (double)filling->distance_sq[id]);
        }
}

/* start[t + 2] becomes the beginning of what follows t, and with each sample that is put there the end of t. */
static void sort_samples(const uint32_t *triangle, size_t n, size_t triangles, uint32_t *sample, size_t *start) {
    for (size_t i = 0; i < n; i++) start[triangle[i] + 2]++;
    for (size_t t = 2; t < triangles + 2; t++) start[t] += start[t - 1];
    for (size_t i = 0; i < n; i++) sample[start[triangle[i] + 1]++] = (uint32_t)i;
}

FOR_EACH_PROCESSOR(enum status, fit_fill)
(struct fit *fit, const uint32_t *triangle, const float *distance_sq) {
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
