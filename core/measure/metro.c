/* Distances of samples, batch by batch: make the samples and measure them in parallel, then add up in order.  The
 * largest distance from a surface is searched for after that, since samples inside of triangles miss corners and edges.
 *
 * Adding up is serial on purpose.  It costs a thousandth of the measuring, and so sums don't depend on the number of
 * threads.  They are compensated (Kahan), since a mean over millions of tiny distances is what this file is for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/metro.h"

#include <assert.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/measure/largest.h"
#include "core/measure/sampler.h"

enum { BATCH = 1 << 16, GRAIN = 1024, TRIALS = 512 };
enum { PER_TRIANGLE = 10, PER_REFERENCE_TRIANGLE = 4 /* which has so many that means need no more */ };

/* Nodes that a sample visits, in the mean: between a scan and its mesh 9 to 45. */
enum { USUAL_VISITS = 12, MANY_VISITS = 48 };
static const double DISK_FAR = 64, DISK_SLACK = 0x1p-6; /* struct knn_slack, of tangent disks */

/* What samples are measured to: a surface, points with tangent disks, or points. */
struct target {
    struct bvh *bvh;
    const struct mesh *mesh; /* that bvh is of */
    const struct metro_reference *disks;
    const struct knn *points;
};

/* One task: samples of this to the target, into stats. */
struct direction {
    const struct sampler *sampler;
    const struct target *target;
    struct distance_stats *stats;
    const struct mesh *surface; /* whose largest distance is searched for beyond the samples; NULL = it isn't */
    uint32_t *nearest;          /* to be filled: of each sample the nearest triangle of the target; may be NULL */
};

struct sum {
    double value, lost;
};

struct meter {
    const struct metro_options *options;
    uint64_t done, total; /* samples, of all directions */
    vec3 *sample;         /* BATCH of each */
    double *distance;
    uint32_t *nearest;
    const struct direction *now;
    size_t begin; /* of the batch */
};

/* ------------------------------------------------------------------------------------------------- measuring */

static void sample_range(void *ctx, size_t begin, size_t end) {
    struct meter *m = ctx;
    sampler_fill(m->now->sampler, m->begin + begin, m->begin + end, &m->sample[begin]);
}

static void measure_range(void *ctx, size_t begin, size_t end) {
    struct meter *m = ctx;
    uint32_t hint = NONE;
    for (size_t i = begin; i < end; i++) {
        struct bvh_hit hit = bvh_closest(m->now->target->bvh, m->sample[i], hint);
        m->distance[i] = sqrt(hit.distance_sq);
        m->nearest[i] = hint = hit.triangle;
    }
}

static void root_range(void *ctx, size_t begin, size_t end) {
    struct meter *m = ctx;
    for (size_t i = begin; i < end; i++) m->distance[i] = sqrt(m->distance[i]);
}

/* From squared distances to the nearest points to distances to their tangent disks. */
static void disk_range(void *ctx, size_t begin, size_t end) {
    struct meter *m = ctx;
    const struct metro_reference *disks = m->now->target->disks;
    for (size_t i = begin; i < end; i++) {
        uint32_t q = m->nearest[i];
        double distance = sqrt(m->distance[i]);
        bool inside = distance <= 2 * (double)disks->spacing[q];
        double height = fabs(vec3_dot(vec3_sub(m->sample[i], disks->point[q]), disks->normal[q]));
        m->distance[i] = inside ? height : distance;
    }
}

static void sample_and_measure_range(void *ctx, size_t begin, size_t end) {
    sample_range(ctx, begin, end);
    measure_range(ctx, begin, end);
}

/* Distances of the n places in m->sample. */
static enum status measure_places(struct meter *m, size_t n) {
    unsigned threads = m->options->threads;
    const struct target *target = m->now->target;
    if (target->bvh) {
        par_for(threads, n, GRAIN, measure_range, m);
        return STATUS_OK;
    }
    enum status status;
    if (target->disks)
        status =
            knn_search_nearly(target->disks->knn, &(struct knn_slack){target->disks->spacing, DISK_FAR, DISK_SLACK},
                              m->sample, n, 1, threads, m->nearest, m->distance);
    else
        status = knn_search(target->points, m->sample, n, 1, threads, m->nearest, m->distance);
    if (!status) par_for(threads, n, GRAIN, target->disks ? disk_range : root_range, m);
    return status;
}

static enum status measure_metro_batch(struct meter *m, size_t n) {
    if (m->now->target->bvh) {
        par_for(m->options->threads, n, GRAIN, sample_and_measure_range, m);
        return STATUS_OK;
    }
    par_for(m->options->threads, n, GRAIN, sample_range, m);
    return measure_places(m, n);
}

static void add(struct sum *sum, double value) {
    double y = value - sum->lost, t = sum->value + y;
    sum->lost = (t - sum->value) - y;
    sum->value = t;
}

static int tick(const struct meter *m) {
    return progress_tick(m->options->progress, "measure", m->total ? (double)m->done / (double)m->total : 1);
}

/* Notes the largest distance of each triangle's samples; *element is the triangle of the last one. */
static void note_seen(const struct meter *m, size_t n, float *seen, size_t *element) {
    const size_t *first = m->now->sampler->first;
    for (size_t i = 0; i < n; i++) {
        while (first[*element + 1] <= m->begin + i) ++*element;
        seen[*element] = fmaxf(seen[*element], (float)m->distance[i]);
    }
}

static enum status measure_for_search(void *ctx, const vec3 *position, size_t n, double *distance, uint32_t *nearest) {
    struct meter *m = ctx;
    if (tick(m)) return STATUS_CANCELLED;
    memcpy(m->sample, position, n * sizeof *position);
    enum status status = measure_places(m, n);
    if (status) return status;
    memcpy(distance, m->distance, n * sizeof *distance);
    memcpy(nearest, m->nearest, n * sizeof *nearest);
    return STATUS_OK;
}

static enum status search_largest(struct meter *m, const float *seen, double *max) {
    struct largest_search search = {.from = m->now->surface,
                                    .seen = seen,
                                    .to = m->now->target->mesh,
                                    .measure = measure_for_search,
                                    .ctx = m,
                                    .threads = m->options->threads};
    return largest_distance(&search, max);
}

static enum status measure_direction(struct meter *m, const struct direction *direction, struct sum sums[2],
                                     double *max) {
    const struct mesh *surface = direction->sampler->count ? direction->surface : NULL;
    float *seen = surface ? alloc_zeroed(surface->triangle_count, sizeof *seen) : NULL;
    enum status status = surface && !seen ? STATUS_NO_MEMORY : STATUS_OK;
    size_t element = 0;
    m->now = direction;
    for (m->begin = 0; !status && m->begin < direction->sampler->count; m->begin += BATCH) {
        size_t left = direction->sampler->count - m->begin, n = left < BATCH ? left : BATCH;
        status = tick(m) ? STATUS_CANCELLED : measure_metro_batch(m, n);
        if (status) break;
        if (direction->nearest) memcpy(&direction->nearest[m->begin], m->nearest, n * sizeof *m->nearest);
        if (surface) note_seen(m, n, seen, &element);
        for (size_t i = 0; i < n; i++) {
            add(&sums[0], m->distance[i]);
            add(&sums[1], m->distance[i] * m->distance[i]);
            if (m->distance[i] > *max) *max = m->distance[i];
        }
        m->done += n;
    }
    if (!status && surface) status = search_largest(m, seen, max);
    free(seen);
    return status;
}

static bool meter_allocate(struct meter *m) {
    m->sample = alloc_array(BATCH, sizeof *m->sample);
    m->distance = alloc_array(BATCH, sizeof *m->distance);
    m->nearest = alloc_array(BATCH, sizeof *m->nearest);
    return m->sample && m->distance && m->nearest;
}

/* Measures consecutive directions that share their stats as one. */
static enum status measure_shared(struct meter *m, const struct direction *direction, size_t n) {
    struct sum sums[2] = {{0, 0}, {0, 0}};
    struct distance_stats stats = {0};
    for (size_t i = 0; i < n; i++) {
        enum status status = measure_direction(m, &direction[i], sums, &stats.max);
        if (status) return status;
        stats.count += direction[i].sampler->count;
    }
    if (stats.count > 0) {
        stats.mean = sums[0].value / (double)stats.count;
        stats.rms = sqrt(sums[1].value / (double)stats.count);
    }
    *direction->stats = stats;
    return STATUS_OK;
}

/* Directions of the same stats stand next to each other. */
static enum status measure_all(const struct direction *direction, size_t n, const struct metro_options *options) {
    struct meter m = {.options = options};
    for (size_t i = 0; i < n; i++) m.total += direction[i].sampler->count;
    enum status status = meter_allocate(&m) ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0, end; !status && i < n; i = end) {
        for (end = i + 1; end < n && direction[end].stats == direction[i].stats;) end++;
        status = measure_shared(&m, &direction[i], end - i);
    }
    if (!status && progress_tick(options->progress, "measure", 1)) status = STATUS_CANCELLED;
    free(m.sample);
    free(m.distance);
    free(m.nearest);
    return status;
}

static void set_hausdorff(struct metro_errors *errors) {
    errors->hausdorff = fmax(errors->forward.max, fmax(errors->backward.max, errors->surface.max));
}

/* ------------------------------------------------------------------------------------------------- directions */

static size_t sample_count(const struct metro_options *options, const struct mesh *mesh, size_t per_triangle) {
    if (options->samples) return (size_t)options->samples;
    size_t count = per_triangle * mesh->triangle_count;
    return count > METRO_MIN_SAMPLES ? count : METRO_MIN_SAMPLES;
}

static enum status target_surface(const struct mesh *mesh, unsigned threads, struct target *target) {
    target->mesh = mesh;
    return mesh->triangle_count ? bvh_new(mesh, threads, &target->bvh) : STATUS_DEGENERATE;
}

enum status metro_points(const vec3 *point, size_t n, const struct mesh *mesh, const struct metro_options *options,
                         struct distance_stats *stats) {
    struct target target = {0};
    struct sampler sampler = sampler_points(point, n);
    enum status status = target_surface(mesh, options->threads, &target);
    struct direction direction = {&sampler, &target, stats, NULL, options->nearest};
    if (!status) status = measure_all(&direction, 1, options);
    bvh_free(target.bvh);
    return status;
}

struct adding {
    const struct bvh *bvh;
    const vec3 *point;
    struct distance_sum *part; /* of each GRAIN points */
};

static void add_range(void *ctx, size_t begin, size_t end) {
    const struct adding *a = ctx;
    struct distance_sum *part = &a->part[begin / GRAIN];
    uint32_t hint = NONE;
    for (size_t i = begin; i < end; i++) {
        struct bvh_hit hit = bvh_closest(a->bvh, a->point[i], hint);
        distance_sum_add(part, sqrt(hit.distance_sq));
        hint = hit.triangle;
    }
}

enum status metro_add_points(const struct bvh *bvh, const vec3 *point, size_t n, unsigned threads,
                             struct distance_sum *sum) {
    size_t parts = (n + GRAIN - 1) / GRAIN;
    struct distance_sum *part = alloc_zeroed(parts, sizeof *part);
    if (!part) return STATUS_NO_MEMORY;
    struct adding adding = {bvh, point, part};
    par_for(threads, n, GRAIN, add_range, &adding);
    for (size_t i = 0; i < parts; i++) distance_sum_join(sum, &part[i]);
    free(part);
    return STATUS_OK;
}

/* How many nodes of what they are measured to a direction's samples visit, in the mean of some of them; over `most`, at
 * least that. */
static double visits_of(const struct direction *direction, size_t most) {
    vec3 trial[TRIALS];
    size_t count = direction->sampler->count, n = count < TRIALS ? count : TRIALS;
    if (!n || !direction->target->bvh) return 0;
    for (size_t i = 0; i < n; i++) {
        size_t at = i * (count / n);
        sampler_fill(direction->sampler, at, at + 1, &trial[i]);
    }
    return (double)bvh_visits(direction->target->bvh, trial, n, most * n) / (double)n;
}

/* Leaves as many samples as take no longer than usual ones: between faces that lie across each other each visits ten
 * times as many nodes.  STATUS_LIMIT: more than may be. */
static enum status take_fewer(const struct direction *direction, struct sampler *sampler,
                              const struct metro_options *options) {
    if (!options->most_visits) return STATUS_OK;
    double visits = visits_of(direction, options->most_visits);
    if (visits > (double)options->most_visits) return STATUS_LIMIT;
    if (!sampler || options->samples || visits <= MANY_VISITS) return STATUS_OK;
    size_t left = (size_t)((double)sampler->count * USUAL_VISITS / visits);
    sampler_done(sampler);
    *sampler = (struct sampler){0};
    return sampler_uniform(direction->surface, left ? left : 1, options->seed, sampler);
}

enum status metro_measure(const struct mesh *mesh, const struct metro_reference *reference,
                          const struct metro_options *options, struct metro_errors *errors) {
    assert(!reference->normal || (reference->spacing && reference->knn));
    const struct mesh *surface = reference->surface;
    struct sampler points = sampler_points(reference->point, reference->point_count), on_mesh = {0}, on_surface = {0};
    struct target to_mesh = {0}, to_reference = {.disks = reference};
    struct metro_errors new = {0};
    enum status status = target_surface(mesh, options->threads, &to_mesh);
    if (!status && surface) status = target_surface(surface, options->threads, &to_reference);
    if (!status && (surface || (reference->normal && reference->point_count)))
        status = sampler_uniform(mesh, sample_count(options, mesh, PER_TRIANGLE), options->seed, &on_mesh);
    if (!status && surface)
        status = sampler_uniform(surface, sample_count(options, surface, PER_REFERENCE_TRIANGLE), options->seed,
                                 &on_surface);
    const struct direction directions[] = {{&points, &to_mesh, &new.forward, NULL, options->nearest},
                                           {&on_mesh, &to_reference, &new.backward, mesh, NULL},
                                           {&on_surface, &to_mesh, &new.surface, surface, NULL}};
    struct sampler *const thinned[] = {NULL, &on_mesh, &on_surface};
    for (int i = 0; i < 3 && !status; i++) status = take_fewer(&directions[i], thinned[i], options);
    if (!status) status = measure_all(directions, 3, options);
    set_hausdorff(&new);
    if (!status) *errors = new;
    sampler_done(&on_mesh);
    sampler_done(&on_surface);
    bvh_free(to_mesh.bvh);
    bvh_free(to_reference.bvh);
    return status;
}

enum status metro_clouds(const vec3 *const point[2], const size_t n[2], const struct metro_options *options,
                         struct metro_errors *errors) {
    struct knn *knn[2] = {NULL, NULL};
    struct metro_errors new = {0};
    enum status status = STATUS_OK;
    for (int i = 0; i < 2 && !status; i++) status = knn_new(point[i], n[i], options->threads, &knn[i], NULL);
    struct sampler all[2] = {sampler_points(point[0], n[0]), sampler_points(point[1], n[1])};
    const struct target target[2] = {{.points = knn[0]}, {.points = knn[1]}};
    const struct direction directions[] = {{.sampler = &all[1], .target = &target[0], .stats = &new.forward},
                                           {.sampler = &all[0], .target = &target[1], .stats = &new.backward}};
    if (!status) status = measure_all(directions, 2, options);
    set_hausdorff(&new);
    if (!status) *errors = new;
    for (int i = 0; i < 2; i++) knn_free(knn[i]);
    return status;
}

/* ------------------------------------------------------------------------------------------------- Metro itself */

struct box {
    vec3 lo, hi;
};

static struct box box_of(const vec3 *point, size_t n) {
    struct box box = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (size_t i = 0; i < n; i++) {
        box.lo = vec3_min(box.lo, point[i]);
        box.hi = vec3_max(box.hi, point[i]);
    }
    return box;
}

double metro_diagonal(const vec3 *point, size_t n) {
    struct box box = box_of(point, n);
    return n ? vec3_distance(box.lo, box.hi) : 0;
}

static double inflated_diagonal(const struct mesh *a, const struct mesh *b) {
    struct box x = box_of(a->vertex, a->vertex_count), y = box_of(b->vertex, b->vertex_count);
    vec3 size = vec3_sub(vec3_max(x.hi, y.hi), vec3_min(x.lo, y.lo));
    double growth = 2 * 0.02 * vec3_length(size);
    return vec3_length(vec3_add(size, (vec3){growth, growth, growth}));
}

enum status metro_compatible(const struct mesh *mesh, const struct mesh *original, const struct metro_options *options,
                             struct metro_errors *errors, double *diagonal) {
    size_t larger = mesh->triangle_count > original->triangle_count ? mesh->triangle_count : original->triangle_count;
    size_t count = options->samples ? (size_t)options->samples : PER_TRIANGLE * larger;
    struct sampler on_original[3] = {0}, on_mesh[3] = {0};
    struct target to_mesh = {0}, to_original = {0};
    struct metro_errors new = {0};
    struct direction directions[6];
    enum status status = target_surface(mesh, options->threads, &to_mesh);
    if (!status) status = target_surface(original, options->threads, &to_original);
    if (!status) status = sampler_metro(original, count, on_original);
    if (!status) status = sampler_metro(mesh, count, on_mesh);
    for (int i = 0; i < 3; i++) {
        directions[i] = (struct direction){&on_original[i], &to_mesh, &new.forward, NULL, NULL};
        directions[i + 3] = (struct direction){&on_mesh[i], &to_original, &new.backward, NULL, NULL};
    }
    if (!status) status = measure_all(directions, 6, options);
    set_hausdorff(&new);
    if (!status) *errors = new, *diagonal = inflated_diagonal(mesh, original);
    for (int i = 0; i < 3; i++) sampler_done(&on_original[i]), sampler_done(&on_mesh[i]);
    bvh_free(to_mesh.bvh);
    bvh_free(to_original.bvh);
    return status;
}
