/* The lists of samples, and what a surface costs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/fit.h"

#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/refine/local_delaunay.h"
#include "core/refine/refine_internal.h"

enum { FACE_GRAIN = 1024 };

#define SMALLEST_MEAN 1e-9 /* so that a perfect mesh has lengths to go by, too */

struct surface fit_frames(const struct fit *fit, const uint32_t *triangle, size_t n, struct triangle_frames *frames) {
    struct triangle_corners corners[FRAMES_MOST];
    assert(n > 0 && n <= FRAMES_MOST);
    const vec3 *vertex = fit->mesh->vertex;
    for (size_t i = 0; i < n; i++) {
        const uint32_t *corner = fit->mesh->triangle[triangle[i]];
        corners[i] = (struct triangle_corners){&vertex[corner[0]], &vertex[corner[1]], &vertex[corner[2]]};
    }
    return triangle_frames_make(frames, corners, n);
}

vec3 fit_middle(const struct fit *fit, uint32_t triangle) {
    const uint32_t *corner = fit->mesh->triangle[triangle];
    const vec3 *vertex = fit->mesh->vertex;
    return vec3_scale(vec3_add(vec3_add(vertex[corner[0]], vertex[corner[1]]), vertex[corner[2]]), 1.0 / 3);
}

/* Fills the batch with what comes after region->reached and ->rest. */
static void gather_on(const struct fit *fit, struct fit_region *region) {
    for (size_t k = 0; k <= region->reached; k++) region->begin[k] = 0;
    while (region->reached < region->n) {
        region->rest = sample_batch_add(&region->batch, fit->lists.block, region->rest);
        if (region->rest != NONE) break;
        region->begin[++region->reached] = region->batch.n;
        if (region->reached < region->n) region->rest = fit->lists.first[region->triangle[region->reached]];
    }
    for (size_t k = region->reached; k < region->n; k++) region->begin[k + 1] = region->batch.n;
}

void fit_gather(const struct fit *fit, struct fit_region *region) {
    region->reached = 0;
    region->rest = fit->lists.first[region->triangle[0]];
    sample_batch_clear(&region->batch, fit->mesh->vertex[fit->mesh->triangle[region->triangle[0]][0]]);
    gather_on(fit, region);
}

const struct fit_region *fit_next_part(const struct fit *fit, const struct fit_region *part, struct fit_region *more) {
    if (part->reached == part->n) return NULL;
    if (part != more) {
        more->n = part->n, more->reached = part->reached, more->rest = part->rest;
        memcpy(more->triangle, part->triangle, sizeof more->triangle);
    }
    sample_batch_clear(&more->batch, part->batch.origin);
    gather_on(fit, more);
    return more;
}

struct sample_batch_model fit_model(const struct fit *fit, const struct fit_region *region,
                                    const struct star_frames *star, double near) {
    struct sample_batch_model model = {0};
    struct fit_region more;
    float further = (float)(1 / fit->far);
    for (const struct fit_region *part = region; part; part = fit_next_part(fit, part, &more))
        sample_batch_fit(&part->batch, part->begin, star, (float)near, further, &model);
    return model;
}

double fit_cost_with(const struct fit *fit, const struct fit_region *region, const struct surface *surface,
                     double limit) {
    struct fit_region more;
    double sum = 0;
    for (const struct fit_region *part = region; part && sum <= limit; part = fit_next_part(fit, part, &more))
        sum += sample_batch_cost(&part->batch, surface, (float)(1 / fit->far), limit - sum);
    return sum;
}

double fit_star_cost(const struct fit *fit, const struct fit_region *region, const struct star_frames *star,
                     double limit) {
    struct fit_region more;
    double sum = 0;
    for (const struct fit_region *part = region; part && sum <= limit; part = fit_next_part(fit, part, &more))
        sum += sample_batch_star_cost(&part->batch, star, (float)(1 / fit->far), limit - sum);
    return sum;
}

void fit_find_nearest(const struct fit *fit, const struct fit_region *region, struct fit_place *place, size_t n) {
    struct fit_region more;
    for (size_t j = 0; j < n; j++) place[j].nearest_sq = INFINITY, place[j].nearest = NONE;
    for (const struct fit_region *part = region; part; part = fit_next_part(fit, part, &more))
        for (size_t j = 0; j < n; j++)
            sample_batch_nearest(&part->batch, place[j].at, &place[j].nearest_sq, &place[j].nearest);
    for (size_t j = 0; j < n; j++) {
        if (place[j].nearest == NONE) continue;
        prefetch(&fit->samples.sample[place[j].nearest]);
        prefetch(&fit->samples.normal[place[j].nearest]);
    }
}

static double deviation_of_sq(const struct fit *fit, const struct fit_place *place) {
    if (place->nearest == NONE) return 0;
    const struct sample *sample = &fit->samples.sample[place->nearest];
    if (place->nearest_sq > (double)sample->reach * (double)sample->reach) return place->nearest_sq;
    double height = vec3_dot(vec3_sub(place->at, sample->place), fit->samples.normal[place->nearest]);
    return height * height;
}

double fit_deviation_sq(const struct fit *fit, const struct fit_place *place, size_t n) {
    double farthest_sq = 0;
    for (size_t j = 0; j < n; j++) {
        double deviation_sq = deviation_of_sq(fit, &place[j]);
        if (deviation_sq > farthest_sq) farthest_sq = deviation_sq;
    }
    return farthest_sq;
}

static double deviation_of_middles_sq(const struct fit *fit, const struct fit_region *region, const vec3 *middle,
                                      size_t n) {
    struct fit_place place[FIT_MAX_RING];
    for (size_t j = 0; j < n; j++) place[j].at = middle[j];
    fit_find_nearest(fit, region, place, n);
    return fit_deviation_sq(fit, place, n);
}

bool fit_middles_stay(const struct fit *fit, const struct fit_region *region, const vec3 *middle, size_t n) {
    double deviation_sq = deviation_of_middles_sq(fit, region, middle, n);
    if (deviation_sq <= fit->deviation_sq) return true;
    vec3 present[FIT_MAX_RING];
    for (size_t k = 0; k < region->n; k++) present[k] = fit_middle(fit, region->triangle[k]);
    return deviation_sq <= deviation_of_middles_sq(fit, region, present, region->n);
}

bool fit_star_stays(const struct fit *fit, const struct fit_region *region, const vec3 *middle, vec3 from, vec3 to) {
    struct fit_place now[FIT_MAX_RING + 1], before[FIT_MAX_RING + 1];
    size_t n = region->n;
    for (size_t k = 0; k < n; k++) now[k].at = middle[k];
    now[n].at = to;
    fit_find_nearest(fit, region, now, n + 1);
    if (fit_deviation_sq(fit, now, n + 1) <= fit->deviation_sq) return true;
    for (size_t k = 0; k < n; k++) before[k].at = fit_middle(fit, region->triangle[k]);
    before[n].at = from;
    fit_find_nearest(fit, region, before, n + 1);
    for (size_t k = 0; k <= n; k++)
        if (deviation_of_sq(fit, &now[k]) > fmax(fit->deviation_sq, deviation_of_sq(fit, &before[k]))) return false;
    return true;
}

bool fit_stays(const struct fit *fit, const struct fit_region *region, const struct surface *surface) {
    vec3 middle[FIT_MAX_RING];
    for (size_t j = 0; j < surface->n; j++) middle[j] = surface_middle(surface, j);
    return fit_middles_stay(fit, region, middle, surface->n);
}

/* Empties the lists into one chain of blocks, in the order of the triangles. */
static uint32_t take_samples(struct fit *fit, const uint32_t *triangle, size_t n) {
    uint32_t chain = NONE;
    for (size_t k = n; k-- > 0;) {
        uint32_t first = sample_buckets_take(&fit->lists, triangle[k]), last = first;
        fit->cost[triangle[k]] = 0;
        if (first == NONE) continue;
        while (fit->lists.block[last].next != NONE) last = fit->lists.block[last].next;
        fit->lists.block[last].next = chain;
        chain = first;
    }
    return chain;
}

/* Puts the blocks from `first` to before `end` in front of the chain. */
static uint32_t put_back(struct fit *fit, uint32_t first, uint32_t end, uint32_t chain) {
    while (first != end) {
        uint32_t next = fit->lists.block[first].next;
        fit->lists.block[first].next = chain;
        chain = first;
        first = next;
    }
    return chain;
}

static void hand_out(struct fit *fit, const struct sample_batch *batch, const struct surface *surface,
                     const uint32_t *to, uint32_t *spare) {
    uint8_t owner[SAMPLE_BATCH_ROOM];
    float distance_sq[SAMPLE_BATCH_ROOM];
    for (size_t i = 0; i < batch->n; i++) prefetch(&fit->samples.sample[batch->sample[i]]);
    sample_batch_owners(batch, surface, owner, distance_sq);
    for (size_t i = 0; i < batch->n; i++) {
        uint32_t id = batch->sample[i], t = to[owner[i]];
        sample_buckets_add(&fit->lists, t, id, &fit->samples.sample[id], spare);
        fit->cost[t] += (double)batch->weight[i] * fit_cost_of(fit, (double)distance_sq[i]);
    }
}

void fit_share(struct fit *fit, const uint32_t *from, size_t n, const uint32_t *to, size_t m) {
    assert(m > 0 && m <= FIT_MAX_RING);
    struct triangle_frames frames;
    struct sample_batch batch;
    struct surface surface = fit_frames(fit, to, m, &frames);
    for (size_t k = 0; k < m; k++) fit->facing[to[k]] = fit_facing_of(&surface, k);
    uint32_t rest = take_samples(fit, from, n), spare = NONE;
    while (rest != NONE) {
        uint32_t first = rest;
        sample_batch_clear(&batch, fit->mesh->vertex[fit->mesh->triangle[to[0]][0]]);
        rest = sample_batch_add(&batch, fit->lists.block, first);
        spare = put_back(fit, first, rest, spare);
        hand_out(fit, &batch, &surface, to, &spare);
    }
    sample_buckets_give(&fit->lists, spare);
}

void fit_drop_triangle(struct fit *fit, uint32_t triangle) {
    uint32_t last = (uint32_t)--fit->mesh->triangle_count;
    fit->he.triangle_count--;
    if (triangle != last) {
        halfedge_renumber(&fit->he, last, triangle);
        fit->lists.first[triangle] = fit->lists.first[last];
        fit->cost[triangle] = fit->cost[last], fit->facing[triangle] = fit->facing[last];
        fit->touched[triangle] = fit->touched[last];
        if (fit->mesh->tag) fit->mesh->tag[triangle] = fit->mesh->tag[last];
    }
    fit->lists.first[last] = NONE, fit->cost[last] = 0;
}

void fit_take(struct fit *fit, uint32_t point) {
    if (point != NONE && fit->taken[point] < UINT8_MAX) fit->taken[point]++;
}

void fit_leave(struct fit *fit, uint32_t point) {
    if (point != NONE && fit->taken[point] < UINT8_MAX) fit->taken[point]--;
}

double fit_mean(const struct fit *fit) {
    double sum = 0, weight = 0;
    struct sample_batch batch;
    for (uint32_t t = 0; t < fit->mesh->triangle_count; t++) {
        struct triangle_frames frames;
        struct surface surface = fit_frames(fit, &t, 1, &frames);
        for (uint32_t rest = fit->lists.first[t]; rest != NONE;) {
            sample_batch_clear(&batch, fit->mesh->vertex[fit->mesh->triangle[t][0]]);
            rest = sample_batch_add(&batch, fit->lists.block, rest);
            sum += sample_batch_cost(&batch, &surface, 0, INFINITY);
            weight += sample_batch_weight(&batch);
        }
    }
    return weight > 0 ? sum / weight : 0;
}

/* Lengths that the fit goes by, from the mean distance before it, and what area a sample stands for. */
static void set_scale(struct fit *fit, const float *distance_sq) {
    double sum = 0, weight = 0;
    for (size_t i = 0; i < fit->samples.n; i++) {
        sum += (double)fit->samples.sample[i].weight * sqrt((double)distance_sq[i]);
        weight += (double)fit->samples.sample[i].weight;
    }
    double mean = fmax(weight > 0 ? sum / weight : 0, SMALLEST_MEAN);
    fit->unit_area = fit_unsampled_unit_area(fit, weight);
    fit->far = FIT_FAR * mean;
    fit->near = FIT_NEAR * mean;
    fit->deviation_sq = FIT_DEVIATION * mean * FIT_DEVIATION * mean;
}

struct assigned {
    struct fit *fit;
    uint32_t *triangle;
    float *distance_sq;
    enum status filled, parted;
};

static void fill_first(void *ctx) {
    struct assigned *all = ctx;
    set_scale(all->fit, all->distance_sq);
    all->filled = fit_fill(all->fit, all->triangle, all->distance_sq);
}

static void make_partition(void *ctx) {
    struct assigned *all = ctx;
    all->parted = fit_partition_init(&all->fit->partition, &all->fit->he);
}

/* At first the partition is made as well, beside what the filling begins with: each is one thread's work. */
static enum status assign_all(struct fit *fit, bool is_first) {
    size_t n = fit->samples.n;
    struct assigned all = {fit, alloc_array(n, sizeof *all.triangle), alloc_array(n, sizeof *all.distance_sq), 0, 0};
    enum status status = STATUS_NO_MEMORY;
    fit->is_new = is_first;
    if (all.triangle && all.distance_sq) status = fit_assign(fit, all.triangle, all.distance_sq);
    if (status == STATUS_OK && is_first) {
        par_beside(fit->threads, fill_first, make_partition, &all);
        status = all.filled ? all.filled : all.parted;
    } else if (status == STATUS_OK) {
        status = fit_fill(fit, all.triangle, all.distance_sq);
    }
    free(all.triangle), free(all.distance_sq);
    return status;
}

static void face_range(void *ctx, size_t begin, size_t end) {
    struct fit *fit = ctx;
    for (size_t t = begin; t < end; t += FRAMES_MOST) {
        uint32_t triangle[FRAMES_MOST];
        size_t n = end - t < FRAMES_MOST ? end - t : FRAMES_MOST;
        struct triangle_frames frames;
        for (size_t k = 0; k < n; k++) triangle[k] = (uint32_t)(t + k);
        struct surface surface = fit_frames(fit, triangle, n, &frames);
        for (size_t k = 0; k < n; k++) fit->facing[t + k] = fit_facing_of(&surface, k);
    }
}

static enum status make_lists(struct fit *fit) {
    size_t threads = fit->threads ? fit->threads : par_processors();
    return sample_buckets_init(&fit->lists, fit->room, fit->samples.n, threads * FIT_MAX_RING);
}

static void *enlarged(void *old, size_t used, size_t room, size_t size) {
    void *new = alloc_array(room, size);
    if (new) memcpy(new, old, used * size);
    free(new ? old : NULL);
    return new;
}

/* Edges where the surface ends: one where more than two triangles meet has no twin either, but its ends stay where they
 * are, as those of all edges do where nothing but such edges is without. */
static size_t count_borders(const struct fit *fit) {
    size_t count = 0;
    bool ends = false;
    for (size_t v = 0; v < fit->mesh->vertex_count; v++) ends |= fit->he.locked[v] == HALFEDGE_BORDER;
    for (size_t h = 0; ends && h < 3 * fit->mesh->triangle_count; h++) count += fit->he.twin[h] == NONE;
    return count;
}

/* A surface whose border shrinks has as many triangles more as its border has edges less. */
static enum status make_room(struct fit *fit) {
    struct mesh *mesh = fit->mesh;
    size_t n = mesh->triangle_count;
    fit->borders = count_borders(fit);
    fit->room = n + fit->borders;
    if (fit->borders == 0) return STATUS_OK;
    void *triangle = enlarged(mesh->triangle, n, fit->room, sizeof *mesh->triangle);
    if (triangle) mesh->triangle = fit->he.triangle = triangle;
    void *twin = enlarged(fit->he.twin, n, fit->room, 3 * sizeof *fit->he.twin);
    if (twin) fit->he.twin = twin;
    void *tag = mesh->tag ? enlarged(mesh->tag, n, fit->room, sizeof *mesh->tag) : NULL;
    if (tag) mesh->tag = tag;
    return triangle && twin && (tag || !mesh->tag) ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status allocate(struct fit *fit) {
    size_t n = fit->input->n, triangles = fit->room, vertices = fit->mesh->vertex_count;
    fit->cost = alloc_zeroed(triangles, sizeof *fit->cost);
    fit->facing = alloc_array(triangles, sizeof *fit->facing);
    fit->taken = alloc_zeroed(n, 1);
    fit->stale = alloc_array(vertices, 1);
    fit->touched = alloc_array(triangles, 1);
    fit->postponed = alloc_zeroed(triangles, 1);
    if (!fit->cost || !fit->facing || !fit->taken || !fit->stale || !fit->touched || !fit->postponed)
        return STATUS_NO_MEMORY;
    memset(fit->stale, 1, vertices);
    memset(fit->touched, 1, triangles);
    return make_lists(fit);
}

/* Those that are there already, if they are the ones wanted. */
static enum status find_samples(struct fit *fit, unsigned parts) {
    struct samples *ready = fit->input->samples;
    if (ready && ready->n > 0 && ready->parts == parts) {
        fit->samples = *ready;
        *ready = (struct samples){0};
        return STATUS_OK;
    }
    if (ready) samples_done(ready);
    return samples_init(&fit->samples, fit->input, parts, fit->threads);
}

static void forget_local_delaunay(const struct fit *fit) {
    if (fit->input && fit->input->local_delaunay) local_delaunay_done(fit->input->local_delaunay);
}

/* A knotted vertex neither moves nor merges, and to a point that is taken none comes. */
static void fix(struct fit *fit, const uint8_t *fixed) {
    for (size_t v = 0; v < fit->mesh->vertex_count; v++) {
        uint32_t point = fit->mesh->source[v];
        if (point != NONE && fixed[point]) fit->he.locked[v] = HALFEDGE_KNOTTED;
    }
    for (size_t p = 0; p < fit->input->n; p++)
        if (fixed[p]) fit_take(fit, (uint32_t)p);
}

enum status fit_init(struct fit *fit, struct mesh *mesh, const struct refine_input *input,
                     const struct refine_options *options) {
    struct fit new = {.mesh = mesh, .input = input, .placement = options->placement, .threads = options->threads};
    new.has_up = vec3_length_sq(input->up) > 0;
    new.has_front = new.has_up || input->viewed;
    new.fold = input->exact || input->sharp || creases_matter(input->creases, input->n) ? FIT_FOLD : 0;
    bool of_use = input->neighbours && refine_uses_local_delaunay(input->n, mesh->triangle_count);
    enum status status = find_samples(&new, input->faces || of_use);
    if (options->placement == PLACEMENT_SUBSET) forget_local_delaunay(&new);
    if (status == STATUS_OK) status = halfedge_init(&new.he, mesh, new.threads);
    if (status == STATUS_OK) status = make_room(&new);
    if (status == STATUS_OK) status = allocate(&new);
    if (status == STATUS_OK) {
        for (size_t v = 0; mesh->source && v < mesh->vertex_count; v++) fit_take(&new, mesh->source[v]);
        if (input->faces && input->faces->fixed) fix(&new, input->faces->fixed);
        par_for(new.threads, mesh->triangle_count, FACE_GRAIN, face_range, &new);
        status = assign_all(&new, true);
    }
    if (status != STATUS_OK) {
        fit_done(&new);
        return status;
    }
    *fit = new;
    return STATUS_OK;
}

enum status fit_reassign(struct fit *fit) {
    sample_buckets_done(&fit->lists);
    memset(fit->cost, 0, fit->room * sizeof *fit->cost);
    memset(fit->stale, 1, fit->mesh->vertex_count);
    memset(fit->touched, 1, fit->room);
    enum status status = make_lists(fit);
    return status == STATUS_OK ? assign_all(fit, false) : status;
}

bool fit_may_look_closer(const struct fit *fit) {
    bool between = fit->input->neighbours || fit->input->faces;
    return between && (double)fit->input->n < FIT_CLOSE * (double)fit->mesh->triangle_count;
}

enum status fit_look_closer(struct fit *fit) {
    samples_done(&fit->samples);
    enum status status = samples_init(&fit->samples, fit->input, SAMPLES_QUARTERS, fit->threads);
    forget_local_delaunay(fit);
    return status == STATUS_OK ? fit_reassign(fit) : status;
}

void fit_done(struct fit *fit) {
    forget_local_delaunay(fit);
    halfedge_done(&fit->he);
    samples_done(&fit->samples);
    sample_buckets_done(&fit->lists);
    fit_partition_done(&fit->partition);
    free(fit->cost), free(fit->facing);
    free(fit->taken), free(fit->stale), free(fit->touched), free(fit->postponed);
    *fit = (struct fit){0};
}
