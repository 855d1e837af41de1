/* Chunks of points are measured side by side and added up in their order, so the sums don't depend on the number of
 * threads.  The sign of a normal doesn't matter to a distance, so nothing is oriented here.  Kept points come by their
 * importance; their index is built along the curve.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/tangent.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/spatial/knn.h"

enum { CHUNK = 4096 };

struct part {
    enum status status;
    struct distance_sum sum;
};

struct tangent {
    struct tangent_planes planes;
    const uint32_t *kept; /* which of the planes belongs to each of the index's points; NULL: its own */
    const vec3 *point;
    struct part *part; /* one for each chunk, added up in order */
    float *distance;   /* of each point; may be NULL */
};

static void measure_chunk(void *ctx, size_t begin, size_t end) {
    const struct tangent *t = ctx;
    struct part *part = &t->part[begin / CHUNK];
    uint32_t nearest[CHUNK];
    double distance_sq[CHUNK];
    part->status = knn_search(t->planes.knn, &t->point[begin], end - begin, 1, 1, nearest, distance_sq);
    for (size_t i = begin; !part->status && i < end; i++) {
        uint32_t q = t->kept ? t->kept[nearest[i - begin]] : nearest[i - begin];
        double d = fabs(vec3_dot(vec3_sub(t->point[i], t->planes.point[q]), t->planes.normal[q]));
        distance_sum_add(&part->sum, d);
        if (t->distance) t->distance[i] = (float)d;
    }
}

static enum status add_up(const struct part *part, size_t parts, struct distance_sum *sum) {
    struct distance_sum total = *sum;
    for (size_t i = 0; i < parts; i++) {
        if (part[i].status) return part[i].status;
        distance_sum_join(&total, &part[i].sum);
    }
    *sum = total;
    return STATUS_OK;
}

enum status tangent_add(const struct tangent_planes *planes, const vec3 *point, size_t n, unsigned threads,
                        struct distance_sum *sum) {
    size_t parts = (n + CHUNK - 1) / CHUNK;
    struct part *part = alloc_zeroed(parts, sizeof *part);
    if (!part) return STATUS_NO_MEMORY;
    struct tangent tangent = {*planes, NULL, point, part, NULL};
    par_for(threads, n, CHUNK, measure_chunk, &tangent);
    enum status status = add_up(part, parts, sum);
    free(part);
    return status;
}

/* The kept points along the curve; item and spare are scratch for k each. */
static void sort_kept(const uint32_t *kept, size_t k, unsigned threads, uint64_t *item, uint64_t *spare,
                      uint32_t *sorted) {
    for (size_t i = 0; i < k; i++) item[i] = radix_item(kept[i], 0);
    item = radix_sort(item, spare, k, threads);
    for (size_t i = 0; i < k; i++) sorted[i] = radix_key(item[i]);
}

enum status tangent_error(const vec3 *point, const vec3 *normal, size_t n, const uint32_t *kept, size_t k,
                          unsigned threads, struct distance_stats *stats, float *distance) {
    struct knn *knn = NULL;
    size_t parts = (n + CHUNK - 1) / CHUNK;
    vec3 *kept_point = alloc_array(k, sizeof *kept_point);
    uint32_t *sorted = alloc_array(k, sizeof *sorted);
    uint64_t *item = alloc_array(k, 2 * sizeof *item);
    struct part *part = alloc_zeroed(parts, sizeof *part);
    enum status status = kept_point && sorted && item && part ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) sort_kept(kept, k, threads, item, item + k, sorted);
    free(item);
    for (size_t i = 0; !status && i < k; i++) kept_point[i] = point[sorted[i]];
    if (!status) status = knn_new(kept_point, k, threads, &knn, NULL);
    if (!status) {
        struct distance_sum sum = {0};
        struct tangent tangent = {{knn, point, normal}, sorted, point, part, distance};
        par_for(threads, n, CHUNK, measure_chunk, &tangent);
        status = add_up(part, parts, &sum);
        if (!status) *stats = distance_sum_stats(&sum, 1);
    }
    knn_free(knn);
    free(kept_point), free(sorted), free(part);
    return status;
}
