/* Rays of a camera, or of a scanner that turns, are a lattice: from where they come a point's ray is midway between
 * that nearest to it and another one, on the other side:
 *
 *      o   o   o   o         a: the nearest to p, of the points that are near p in space
 *        o   a   o   o       c: the nearest to where 2 p - a is
 *      o   o   p   o
 *        o   o   c   o       from elsewhere noise and steps put other points beside p, and none there
 *
 * Places of a grid are tried; from the best ones the exact place is sought by such triples (centre.c), which are chosen
 * anew from each place that they lead to.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/lattice.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/quantile.h"
#include "core/spatial/knn.h"
#include "core/surface/sheet/centre.h"
#include "core/surface/sheet/eye.h"

enum { NEAR = 25 /* the point itself and others */, SAMPLES = 2048, SOME = 1024, FEW = 256, STARTS = 12, CHUNK = 32 };
enum { APPROACHES = 6, REFINEMENTS = 5 };
static const double EXPLAINS = 0.5, TELLS = 0.2; /* of what is usual, which is more than that */
static const double EXACT = 0.05, MOST = 0.5;
static const double IMAGE_LACKS = 0.3; /* of what the place explains, one opposite at most */

/* Points, evenly chosen in their order, and those near each. */
struct near_points {
    const vec3 *point;
    uint32_t *id; /* NEAR of each */
};

/* Whether there are points on both sides of the s-th one, as seen from a place: a and c. */
static bool find_beside(const struct near_points *near, size_t s, vec3 place, uint32_t *a, uint32_t *c) {
    const uint32_t *id = &near->id[s * NEAR];
    vec3 direction[NEAR];
    double least = INFINITY;
    int first = 0, last = 0;
    for (int k = 0; k < NEAR; k++) direction[k] = vec3_unit(vec3_sub(near->point[id[k]], place));
    for (int k = 1; k < NEAR; k++) {
        double apart = vec3_distance_sq(direction[k], direction[0]);
        if (apart > 0 && apart < least) least = apart, first = k;
    }
    vec3 opposite = vec3_sub(vec3_scale(direction[0], 2), direction[first]);
    least = INFINITY;
    for (int k = 1; k < NEAR; k++) {
        double off = vec3_distance_sq(direction[k], opposite);
        if (k != first && off < least) least = off, last = k;
    }
    *a = id[first], *c = id[last];
    return first > 0 && last > 0;
}

/* By so many of the samples; *exact: the share of those that are midway but for EXACT. */
static double unevenness_from(const struct near_points *near, vec3 place, size_t samples, double *exact) {
    double sum = 0;
    size_t midway = 0;
    for (size_t i = 0; i < samples; i++) {
        uint32_t a, c;
        size_t s = i * (SAMPLES / samples);
        bool both = find_beside(near, s, place, &a, &c);
        vec3 p = near->point[near->id[s * NEAR]];
        double uneven = both ? centre_unevenness_of(near->point[a], p, near->point[c], place) : 1;
        sum += uneven, midway += uneven < EXACT;
    }
    if (exact) *exact = (double)midway / (double)samples;
    return sum / (double)samples;
}

static void take_lattice_triples(const struct near_points *near, vec3 place, size_t samples,
                                 struct centre_triples *triples) {
    triples->point = near->point, triples->count = 0;
    for (size_t i = 0; i < samples; i++) {
        uint32_t a, c;
        size_t s = i * (SAMPLES / samples);
        if (find_beside(near, s, place, &a, &c)) centre_add(triples, a, near->id[s * NEAR], c);
    }
}

/* Moves a place to where the points are a lattice, nearby; returns how uneven that is. */
static double approach_lattice(const struct near_points *near, vec3 *place) {
    struct centre_triples triples;
    for (int round = 0; round < APPROACHES; round++) {
        take_lattice_triples(near, *place, SOME, &triples);
        centre_approach(&triples, place);
    }
    return unevenness_from(near, *place, SOME, NULL);
}

/* ------------------------------------------------------------------------------------------------ the search */

struct lattice_search {
    struct near_points near;
    vec3 place[EYE_PLACES];
    float uneven[EYE_PLACES];
    size_t start[STARTS]; /* the best places, which move */
};

static void try_places(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) s->uneven[i] = (float)unevenness_from(&s->near, s->place[i], FEW, NULL);
}

static void approach_starts(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) {
        size_t k = s->start[i];
        s->uneven[k] = (float)approach_lattice(&s->near, &s->place[k]);
    }
}

/* The best places, the best first. */
static void choose_starts(struct lattice_search *s) {
    size_t count = 0;
    for (size_t i = 0; i < EYE_PLACES; i++) {
        if (count == STARTS && s->uneven[i] >= s->uneven[s->start[STARTS - 1]]) continue;
        size_t at = count < STARTS ? count++ : STARTS - 1;
        for (; at > 0 && s->uneven[s->start[at - 1]] > s->uneven[i]; at--) s->start[at] = s->start[at - 1];
        s->start[at] = i;
    }
}

/* Whether the points are about as even from the other side of their middle, as those of a wall are. */
static bool is_even_from_opposite(const struct lattice_search *s, const struct lattice *lattice) {
    vec3 middle = {0, 0, 0};
    for (size_t i = 0; i < SAMPLES; i++) middle = vec3_add(middle, s->near.point[s->near.id[i * NEAR]]);
    middle = vec3_scale(middle, 1.0 / SAMPLES);
    vec3 opposite = vec3_sub(vec3_scale(middle, 2), lattice->at), towards = vec3_sub(lattice->at, middle);
    double uneven = approach_lattice(&s->near, &opposite);
    return vec3_dot(vec3_sub(opposite, middle), towards) < 0 &&
           uneven < lattice->uneven + IMAGE_LACKS * (lattice->usually - lattice->uneven);
}

static void search_lattice(struct lattice_search *s, unsigned threads, struct lattice *lattice) {
    struct centre_triples triples;
    float sorted[EYE_PLACES];
    par_for(threads, EYE_PLACES, CHUNK, try_places, s);
    for (size_t i = 0; i < EYE_PLACES; i++) sorted[i] = s->uneven[i];
    lattice->usually = (double)quantile_of(sorted, EYE_PLACES, 0.5);
    if (lattice->usually < TELLS) return;
    choose_starts(s);
    par_for(threads, STARTS, 1, approach_starts, s);
    size_t best = s->start[0];
    for (int i = 1; i < STARTS; i++)
        if (s->uneven[s->start[i]] < s->uneven[best]) best = s->start[i];
    lattice->at = s->place[best];
    for (int round = 0; round < REFINEMENTS; round++) {
        take_lattice_triples(&s->near, lattice->at, SAMPLES, &triples);
        centre_refine(&triples, &lattice->at);
    }
    lattice->uneven = unevenness_from(&s->near, lattice->at, SAMPLES, &lattice->exact);
    lattice->found =
        lattice->uneven < EXPLAINS * lattice->usually && lattice->exact > MOST && !is_even_from_opposite(s, lattice);
}

enum status lattice_find(const vec3 *point, size_t n, const struct knn *knn, unsigned threads,
                         struct lattice *lattice) {
    *lattice = (struct lattice){0};
    if (n < SAMPLES) return STATUS_OK;
    struct lattice_search *s = alloc_zeroed(1, sizeof *s);
    vec3 *sample = alloc_array(SAMPLES, sizeof *sample);
    double *distance_sq = alloc_array(SAMPLES * NEAR, sizeof *distance_sq);
    uint32_t *id = alloc_array(SAMPLES * NEAR, sizeof *id);
    enum status status = s && sample && distance_sq && id ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < SAMPLES; i++) sample[i] = point[i * n / SAMPLES];
    if (!status) status = knn_search(knn, sample, SAMPLES, NEAR, threads, id, distance_sq);
    if (!status) {
        s->near = (struct near_points){point, id};
        eye_places(sample, SAMPLES, s->place);
        search_lattice(s, threads, lattice);
    }
    free(s), free(sample), free(distance_sq), free(id);
    return status;
}
