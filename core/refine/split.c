/* A vertex that is put on an edge has four triangles.  That it goes there is the same as if it had stood in the middle
 * of the edge, where nothing would change, and moved from there: so what is known of stars will do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/refine_internal.h"

#include <string.h>

#include "core/cloud/cloud.h"
#include "core/refine/kernels/star_frames.h"

enum { PLACES = 6 };

/* In how many places an edge is tried: at most PLACES.  A vertex that may stand anywhere finds more that are worth it.
 */
static const size_t places_of[] = {[PLACEMENT_SUBSET] = 4, [PLACEMENT_OPTIMAL] = PLACES};

/* The two triangles of an edge, or the one of a border's. */
struct diamond {
    size_t n;           /* of the new vertex' triangles: 4, or 2 */
    uint32_t border[4]; /* half-edges across from the new vertex */
    struct fit_region region;
    struct star_rim rim;
    struct star_vectors outside; /* normals across the border */
    struct star_frames old, new;
    double cost;
};

static const struct star_limits limits_of_splits = {.turn = (float)FIT_CANDIDATE_LEAST_TURN, .thin = (float)FIT_THIN};

#define LEAP 0.5          /* of what the triangles cost: where it is less, the surface may fold for it */
#define SHARPEST (-0.75f) /* cosine of such a fold */

static void set_diamond_frames(const struct diamond *diamond, vec3 place, struct star_frames *frames) {
    star_frames_make(frames, &diamond->rim, vec3_sub(place, diamond->region.batch.origin));
}

static void set_diamond_rim(const struct fit *fit, struct diamond *diamond) {
    const vec3 *place[4];
    for (size_t i = 0; i < diamond->n; i++) place[i] = &fit->mesh->vertex[halfedge_from(&fit->he, diamond->border[i])];
    diamond->rim.n = diamond->n;
    diamond->rim.open = diamond->n == 2;
    if (diamond->rim.open) place[2] = &fit->mesh->vertex[halfedge_to(&fit->he, diamond->border[1])];
    star_vectors_set(&diamond->rim.place, place, diamond->n + diamond->rim.open, diamond->region.batch.origin);
    set_diamond_frames(diamond, vec3_scale(vec3_add(*place[0], *place[2]), 0.5), &diamond->old);
}

static void set_outside(const struct fit *fit, struct diamond *diamond) {
    static const vec3 none = {0};
    const vec3 *normal[4];
    for (size_t i = 0; i < diamond->n; i++) {
        uint32_t across = fit->he.twin[diamond->border[i]];
        normal[i] = across == NONE ? &none : &fit->facing[across / 3].normal;
    }
    star_vectors_set(&diamond->outside, normal, diamond->n, none);
}

static void diamond_of(const struct fit *fit, uint32_t h, struct diamond *diamond) {
    uint32_t g = fit->he.twin[h];
    diamond->n = g == NONE ? 2 : 4;
    diamond->region.n = diamond->n / 2;
    diamond->border[0] = halfedge_next(h), diamond->border[1] = halfedge_prev(h);
    diamond->region.triangle[0] = h / 3;
    diamond->cost = fit->cost[h / 3];
    if (g != NONE) {
        diamond->border[2] = halfedge_next(g), diamond->border[3] = halfedge_prev(g);
        diamond->region.triangle[1] = g / 3;
        diamond->cost += fit->cost[g / 3];
    }
    fit_gather(fit, &diamond->region);
}

/* Where a face that was bridged comes back, the triangle beside it stays where it was for the time being, so the fold
 * to it may be sharp where the split gains most of what the triangles cost. */
static bool split_may_leap(const struct fit *fit, const struct diamond *diamond) {
    struct star_limits limits = fit_limits(fit, limits_of_splits);
    limits.fold = SHARPEST;
    return fit->leaps && star_may_become(&diamond->old, &diamond->new, &diamond->outside, limits);
}

static double split_cost(const struct fit *fit, struct diamond *diamond, vec3 place, double limit) {
    set_diamond_frames(diamond, place, &diamond->new);
    if (!fit_star_faces_front(fit, &diamond->new, place)) return INFINITY;
    if (star_may_become(&diamond->old, &diamond->new, &diamond->outside, fit_limits(fit, limits_of_splits)))
        return fit_star_cost(fit, &diamond->region, &diamond->new, limit);
    if (!split_may_leap(fit, diamond)) return INFINITY;
    double least = fmin(limit, LEAP * diamond->cost);
    double cost = fit_star_cost(fit, &diamond->region, &diamond->new, least);
    return cost < least ? cost : INFINITY;
}

static bool split_stays(const struct fit *fit, const struct diamond *diamond, vec3 place) {
    vec3 middle[4];
    for (size_t i = 0; i < diamond->n; i++) {
        vec3 rim = vec3_add(fit_corner(fit, diamond->border[i]), fit_corner(fit, halfedge_next(diamond->border[i])));
        middle[i] = vec3_scale(vec3_add(place, rim), 1.0 / 3);
    }
    return fit_middles_stay(fit, &diamond->region, middle, diamond->n);
}

struct place {
    float distance_sq;
    uint32_t sample;
    vec3 at;
};

/* Puts the samples of a batch among the places as far as they are farther off; the number of places. */
static size_t farthest_among(const struct fit *fit, const struct sample_batch *batch, const float *distance_sq,
                             struct place place[PLACES], size_t count) {
    size_t most = places_of[fit->placement];
    for (size_t i = 0; i < batch->n; i++) {
        if (count == most && distance_sq[i] <= place[count - 1].distance_sq) continue;
        uint32_t point = samples_point(&fit->samples, batch->sample[i]);
        if (fit->placement == PLACEMENT_SUBSET && (point == NONE || fit->taken[point])) continue;
        size_t at = count < most ? count++ : count - 1;
        for (; at > 0 && place[at - 1].distance_sq < distance_sq[i]; at--) place[at] = place[at - 1];
        place[at].distance_sq = distance_sq[i], place[at].sample = batch->sample[i];
    }
    return count;
}

/* The samples of the two triangles that are farthest off, the farthest first; of the free points alone for a subset. */
static size_t farthest(const struct fit *fit, const struct diamond *diamond, struct place place[PLACES]) {
    float distance_sq[SAMPLE_BATCH_ROOM];
    struct fit_region more;
    size_t count = 0;
    for (const struct fit_region *part = &diamond->region; part; part = fit_next_part(fit, part, &more)) {
        sample_batch_star_distances(&part->batch, &diamond->old, distance_sq);
        count = farthest_among(fit, &part->batch, distance_sq, place, count);
    }
    for (size_t i = 0; i < count; i++) place[i].at = fit->samples.sample[place[i].sample].place;
    return count;
}

/* Which place gains most; the gain. */
static double best_place(const struct fit *fit, struct diamond *diamond, const struct place *place, size_t places,
                         size_t *which) {
    double gain = 0;
    for (size_t i = 0; i < places; i++) {
        double limit = diamond->cost - gain, cost = split_cost(fit, diamond, place[i].at, limit);
        if (cost < limit) gain = diamond->cost - cost, *which = i;
    }
    return gain;
}

struct fit_candidate fit_split_best(const struct fit *fit, uint32_t h) {
    struct fit_candidate none = {.value = 0, .halfedge = NONE, .vertex = NONE, .source = NONE};
    struct diamond diamond;
    diamond_of(fit, h, &diamond);
    if (fit_is_exact(sample_batch_weight(&diamond.region.batch), diamond.cost)) return none;
    set_diamond_rim(fit, &diamond);
    struct place place[PLACES];
    size_t places = farthest(fit, &diamond, place), i = 0;
    set_outside(fit, &diamond);
    for (double gain; (gain = best_place(fit, &diamond, place, places, &i)) > 0;) {
        bool is_point = fit->placement == PLACEMENT_SUBSET;
        if (split_stays(fit, &diamond, place[i].at))
            return (struct fit_candidate){.value = gain,
                                          .halfedge = h,
                                          .vertex = NONE,
                                          .source = is_point ? samples_point(&fit->samples, place[i].sample) : NONE,
                                          .place = place[i].at};
        memmove(&place[i], &place[i + 1], (--places - i) * sizeof *place);
    }
    return none;
}
