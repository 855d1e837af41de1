/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/phantom.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/measure/sampler.h"
#include "core/spatial/bvh.h"

enum { SAMPLES = 20000 };

/* A place, and what is nearest to it. */
struct places {
    size_t count;
    vec3 *at;
    struct bvh_hit *hit; /* of the other mesh */
    uint32_t *point;
    double *distance_sq; /* of the point */
};

static void places_done(struct places *places) {
    free(places->at), free(places->hit), free(places->point), free(places->distance_sq);
}

/* Places evenly over a mesh, to be done with in any case. */
static enum status find_places(const struct mesh *mesh, const struct mesh *other,
                               const struct metro_reference *reference, const struct metro_options *options,
                               struct places *places) {
    static const struct knn_slack near_enough = {.far = 4, .share = 0x1p-4};
    struct knn_slack slack = near_enough;
    struct sampler sampler = {0};
    struct bvh *bvh = NULL;
    size_t n = options->samples && options->samples < SAMPLES ? options->samples : SAMPLES;
    *places = (struct places){n, alloc_array(n, sizeof *places->at), alloc_array(n, sizeof *places->hit),
                              alloc_array(n, sizeof *places->point), alloc_array(n, sizeof *places->distance_sq)};
    bool room = places->at && places->hit && places->point && places->distance_sq;
    enum status status = room ? bvh_new(other, options->threads, &bvh) : STATUS_NO_MEMORY;
    if (!status) status = sampler_uniform(mesh, n, options->seed, &sampler);
    if (!status) {
        slack.length = reference->spacing;
        sampler_fill(&sampler, 0, n, places->at);
        bvh_closest_all(bvh, places->at, n, options->threads, places->hit);
        status = knn_search_nearly(reference->knn, &slack, places->at, n, 1, options->threads, places->point,
                                   places->distance_sq);
    }
    sampler_done(&sampler);
    bvh_free(bvh);
    return status;
}

/* To what the point nearest to a place tells of the surface around it: its tangent disk. */
static double distance_to_disk(const struct metro_reference *reference, const struct places *places, size_t i) {
    uint32_t q = places->point[i];
    double distance = sqrt(places->distance_sq[i]);
    if (distance > 2 * (double)reference->spacing[q]) return distance;
    return fabs(vec3_dot(vec3_sub(places->at[i], reference->point[q]), reference->normal[q]));
}

static size_t count_far(const struct metro_reference *reference, const struct places *places) {
    size_t count = 0;
    for (size_t i = 0; i < places->count; i++) {
        double spacing = (double)reference->spacing[places->point[i]];
        count += places->hit[i].distance_sq > spacing * spacing && distance_to_disk(reference, places, i) > spacing;
    }
    return count;
}

static enum status count_phantom(const struct mesh *mesh, const struct mesh *other,
                                 const struct metro_reference *reference, const struct metro_options *options,
                                 size_t *count) {
    struct places places;
    enum status status = find_places(mesh, other, reference, options, &places);
    if (!status) *count = count_far(reference, &places);
    places_done(&places);
    return status;
}

enum status phantom_is_more(const struct mesh *mesh, const struct mesh *other, const struct metro_reference *reference,
                            const struct metro_options *options, bool *is_more) {
    size_t count = 0, of_other = 0;
    enum status status = count_phantom(mesh, other, reference, options, &count);
    if (!status && count) status = count_phantom(other, mesh, reference, options, &of_other);
    double more = (double)count - (double)of_other;
    if (!status) *is_more = more > 2 * sqrt((double)(count + of_other));
    return status;
}

enum status phantom_depth(const struct mesh *mesh, const struct mesh *other, const struct metro_reference *reference,
                          const struct metro_options *options, struct phantom_depth *depth) {
    struct places places;
    double sum = 0, squares = 0;
    enum status status = find_places(mesh, other, reference, options, &places);
    for (size_t i = 0; !status && i < places.count; i++) {
        double disk = distance_to_disk(reference, &places, i), square = fmin(places.hit[i].distance_sq, disk * disk);
        sum += sqrt(square), squares += square;
    }
    if (!status) *depth = (struct phantom_depth){sum / (double)places.count, sqrt(squares / (double)places.count)};
    places_done(&places);
    return status;
}
