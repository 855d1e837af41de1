/* Rays of a camera, or of a scanner that turns, are a lattice: from where they come a point's ray is midway between
 * one of those nearest to it and another one, on the other side:
 *
 *      o   o   o   o         a: of the nearest to p, by directions, of the points that are near p in space
 *        o   a   o   o       c: the nearest to where 2 p - a is; the a whose c is nearest there counts
 *      o       p   o
 *        o   o   c   o       from elsewhere noise and steps put other points beside p, and few there
 *
 * A few are tried for each, since where half of a scan's points are missing at random every second one has none
 * opposite.
 *
 * Places of grids are tried; the best ones move by steps to where points are less uneven; from the best of these the
 * exact place is sought by such triples (centre.c), which are chosen anew from each place that they lead to.  It is
 * taken where far more points are midway than from elsewhere, and none explains what it leaves.
 *
 * Where most of a lattice is missing, few points have one opposite, and their unevenness tells little; but those that
 * have one are midway exactly, as those from elsewhere seldom are.  So the best places move to where more are midway,
 * and what counts is how many are so all but exactly.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/lattice.h"

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/spatial/knn.h"
#include "core/surface/sheet/centre.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/rays.h"

enum { NEAR = RAYS_NEAR, SAMPLES = 2048, SOME = 1024, MANY = 256, FEW = 128, FEWEST = 32 };
enum { PLACES = EYE_PLACES_AROUND + EYE_PLACES_DENSE };
enum { LIKELY = PLACES / 8 /* of all places, by the fewest samples: the best are among these */, USUAL = PLACES / 8 };
enum { STARTS = 12, BEST = 6, CHUNK = 32, SHRINKS = 4, MOVES = 12, APPROACHES = 6, REFINEMENTS = 5, REST_LEAST = 64 };
enum { THIN_STARTS = 4, THIN_SHRINKS = 6, THIN_MOVES = 40, ELSEWHERE = 64 };
static const double SHRINK = 0.5;
static const double EXACT = 0.05;
static const double FINE = 0.012;
static const double EXPLAINS = 0.55; /* of what isn't midway from elsewhere */
/* Of a lattice most of which is missing, by FINE: from a place .31 to .45 where a quarter is left; of what is none, or
 * of several scans, up to .21. */
static const double EXPLAINS_THIN = 0.25;
static const double OUTSTANDING = 1.5;     /* times as many as from any place elsewhere */
static const double AS_MANY_OF_REST = 0.5; /* as the place explains, another one of the rest at most */
static const double HOPELESS = 0.75; /* unevenness from the best place by what is usual: no lattice is seen from near */
static const double IMAGE_LACKS = 0.3; /* of what the place explains, one opposite at most */
/* Of those that aren't midway from a place elsewhere, by FINE: .26 to 1 from the place of scans of which a quarter or
 * all is left; from elsewhere, of what is no lattice or a plane's own, up to 0. */
static const double EXPLAINS_BESIDE = 0.15;
static const double EVEN_ITSELF = 0.6;    /* usually midway: points of a body, as they were made or meshed */
static const double AS_EXACT = 0.88;      /* of those midway by FINE, from one opposite at least */
static const double EXPLAINS_REST = 0.35; /* of the points that the place doesn't explain, another one at most */

/* How many of the points are looked at; the last is all. */
static const size_t SOME_OF[] = {FEWEST, FEW, MANY, SOME, SAMPLES};
enum extent { BY_FEWEST, BY_FEW, BY_MANY, BY_SOME, BY_ALL, EXTENTS };
enum { BLOCKS_MOST = (FEWEST + FEW + MANY + SOME + SAMPLES) / RAYS_TOGETHER + EXTENTS };

/* Points, evenly chosen in their order, and those near each, the point itself first. */
struct near_points {
    const vec3 *point;
    const uint32_t *id; /* NEAR of each */
    size_t count;
    vec3 origin;              /* a point, so that what is `at` is small */
    const float *at[EXTENTS]; /* blocks of RAYS_BLOCK, relative to there */
};

/* How many of so many. */
static size_t count_of_extent(const struct near_points *near, enum extent extent) {
    return SOME_OF[extent] < near->count ? SOME_OF[extent] : near->count;
}

/* The k-th of so many that are spread over all. */
static size_t spread_sample(const struct near_points *near, size_t k, size_t samples) {
    return k * near->count / samples;
}

/* The last block is filled up with its last point. */
static void lay_out(struct near_points *near, float *room) {
    for (int e = 0; e < EXTENTS; e++) {
        size_t n = count_of_extent(near, (enum extent)e), blocks = (n + RAYS_TOGETHER - 1) / RAYS_TOGETHER;
        near->at[e] = room;
        for (size_t i = 0; i < blocks * RAYS_TOGETHER; i++) {
            const uint32_t *id = &near->id[NEAR * spread_sample(near, i < n ? i : n - 1, n)];
            float *x = &room[i / RAYS_TOGETHER * RAYS_BLOCK + i % RAYS_TOGETHER];
            for (size_t k = 0; k < NEAR; k++, x += RAYS_TOGETHER) {
                vec3 p = vec3_sub(near->point[id[k]], near->origin);
                x[0] = (float)p.x;
                x[(size_t)NEAR * RAYS_TOGETHER] = (float)p.y;
                x[(size_t)2 * NEAR * RAYS_TOGETHER] = (float)p.z;
            }
        }
        room += blocks * RAYS_BLOCK;
    }
}

/* Of points from the first on, a block of them: those that have others on both sides, as seen from a place: of the
 * nearest ones that which has another one the most exactly opposite, as some of a lattice may be missing.  which:
 * their numbers; how many. */
static size_t find_beside(const struct near_points *near, enum extent extent, size_t first, vec3 place,
                          uint32_t of[RAYS_TOGETHER][3], size_t which[RAYS_TOGETHER]) {
    int32_t one[RAYS_TOGETHER], opposite[RAYS_TOGETHER];
    size_t found = 0, n = count_of_extent(near, extent);
    rays_between(&near->at[extent][first / RAYS_TOGETHER * RAYS_BLOCK], vec3_sub(place, near->origin), one, opposite);
    for (size_t i = 0; i < RAYS_TOGETHER && first + i < n; i++) {
        const uint32_t *id = &near->id[NEAR * spread_sample(near, first + i, n)];
        if (!one[i]) continue;
        which[found] = first + i;
        of[found][0] = id[one[i]], of[found][1] = id[0], of[found++][2] = id[opposite[i]];
    }
    return found;
}

/* How unevenly each of so many points lies between others, from 0 to 1; how many. */
static size_t unevenness_of_each(const struct near_points *near, enum extent extent, vec3 place,
                                 double uneven[SAMPLES]) {
    size_t n = count_of_extent(near, extent);
    for (size_t i = 0; i < n; i++) uneven[i] = 1;
    for (size_t first = 0; first < n; first += RAYS_TOGETHER) {
        uint32_t of[RAYS_TOGETHER][3];
        size_t which[RAYS_TOGETHER], found = find_beside(near, extent, first, place, of, which);
        double each[RAYS_TOGETHER];
        if (found) centre_unevenness_each(near->point, of, found, place, each);
        for (size_t i = 0; i < found; i++) uneven[which[i]] = each[i];
    }
    return n;
}

/* The share of so many points that are midway but for a tolerance. */
static double share_midway(const struct near_points *near, vec3 place, enum extent extent, double tolerance) {
    double uneven[SAMPLES];
    size_t midway = 0, n = unevenness_of_each(near, extent, place, uneven);
    for (size_t i = 0; i < n; i++) midway += uneven[i] < tolerance;
    return (double)midway / (double)n;
}

/* By so many points; *exact (may be NULL): the share of those that are midway but for EXACT. */
static double unevenness_from(const struct near_points *near, vec3 place, enum extent extent, double *exact) {
    double uneven[SAMPLES], sum = 0;
    size_t midway = 0, n = unevenness_of_each(near, extent, place, uneven);
    for (size_t i = 0; i < n; i++) sum += uneven[i], midway += uneven[i] < EXACT;
    if (exact) *exact = (double)midway / (double)n;
    return sum / (double)n;
}

static void take_lattice_triples(const struct near_points *near, vec3 place, enum extent extent,
                                 struct centre_triples *triples) {
    size_t n = count_of_extent(near, extent);
    triples->point = near->point, triples->count = 0;
    for (size_t first = 0; first < n; first += RAYS_TOGETHER) {
        uint32_t of[RAYS_TOGETHER][3];
        size_t which[RAYS_TOGETHER], found = find_beside(near, extent, first, place, of, which);
        for (size_t i = 0; i < found; i++) centre_add(triples, of[i][0], of[i][1], of[i][2]);
    }
}

/* Moves a place to where the points are a lattice, nearby; returns the share of them that is midway from there. */
static double approach_lattice(const struct near_points *near, vec3 *place) {
    struct centre_triples triples;
    for (int round = 0; round < APPROACHES; round++) {
        take_lattice_triples(near, *place, BY_SOME, &triples);
        centre_approach(&triples, place);
    }
    return share_midway(near, *place, BY_SOME, EXACT);
}

/* Moves a lattice's place to the exact one. */
static void refine_place(const struct near_points *near, struct lattice *lattice) {
    struct centre_triples triples;
    for (int round = 0; round < REFINEMENTS; round++) {
        take_lattice_triples(near, lattice->at, BY_ALL, &triples);
        centre_refine(&triples, &lattice->at);
    }
    lattice->exact = share_midway(near, lattice->at, BY_ALL, EXACT);
}

static const vec3 WAYS[] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
enum { WAY_COUNT = sizeof WAYS / sizeof *WAYS };

/* Moves a place along the axes to where the points are less uneven, by steps that shrink, as an approach doesn't come
 * from as far; returns how uneven. */
static double climb(const struct near_points *near, double step, vec3 *place) {
    double least = unevenness_from(near, *place, BY_MANY, NULL);
    for (int shrunk = 0, moves = 0; shrunk < SHRINKS && moves < MOVES; moves++) {
        vec3 from = *place;
        for (size_t w = 0; w < WAY_COUNT; w++) {
            vec3 at = vec3_add(from, vec3_scale(WAYS[w], step));
            double uneven = unevenness_from(near, at, BY_MANY, NULL);
            if (uneven < least) least = uneven, *place = at;
        }
        if (vec3_equal(from, *place)) step *= SHRINK, shrunk++;
    }
    return least;
}

/* The same to where more of them are midway: a move that paid is made again. */
static void climb_midway(const struct near_points *near, double step, vec3 *place) {
    double most = share_midway(near, *place, BY_SOME, EXACT);
    vec3 last = {0, 0, 0};
    for (int shrunk = 0, moves = 0; shrunk < THIN_SHRINKS && moves < THIN_MOVES; moves++) {
        vec3 from = *place, on = vec3_add(from, last);
        double share = vec3_equal(on, from) ? 0 : share_midway(near, on, BY_SOME, EXACT);
        bool paid = share > most;
        if (paid) most = share, *place = on;
        for (size_t w = 0; !paid && w < WAY_COUNT; w++) {
            vec3 at = vec3_add(from, vec3_scale(WAYS[w], step));
            share = share_midway(near, at, BY_SOME, EXACT);
            if (share > most) most = share, *place = at;
        }
        last = vec3_sub(*place, from);
        if (vec3_equal(from, *place)) step *= SHRINK, shrunk++;
    }
}

/* ------------------------------------------------------------------------------------------------ the search */

struct start {
    vec3 at;
    double uneven, exact;
};

struct lattice_search {
    struct near_points near;
    vec3 place[PLACES];
    double step;
    float rough[PLACES];              /* how uneven, by the fewest samples */
    uint32_t likely[LIKELY];          /* the best of all by these */
    float uneven[LIKELY];             /* by more of them */
    float usual[USUAL], exact[USUAL]; /* the same from places that are spread over all */
    struct start start[STARTS];       /* the best places, which move */
    double elsewhere[ELSEWHERE];      /* the share that is midway from places that are spread over all */
};

static void try_places(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) s->rough[i] = (float)unevenness_from(&s->near, s->place[i], BY_FEWEST, NULL);
}

static void try_likely(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++)
        s->uneven[i] = (float)unevenness_from(&s->near, s->place[s->likely[i]], BY_FEW, NULL);
}

static void try_usual(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) {
        double exact;
        s->usual[i] = (float)unevenness_from(&s->near, s->place[i * PLACES / USUAL], BY_FEW, &exact);
        s->exact[i] = (float)exact;
    }
}

static void climb_from_starts(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) s->start[i].uneven = climb(&s->near, s->step, &s->start[i].at);
}

static void approach_starts(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) s->start[i].exact = approach_lattice(&s->near, &s->start[i].at);
}

static int less_uneven(const void *a, const void *b) {
    const struct start *x = a, *y = b;
    return (x->uneven > y->uneven) - (x->uneven < y->uneven);
}

/* In their order; of places that are as good as the last of these the first ones. */
static void choose_likely(struct lattice_search *s) {
    float sorted[PLACES];
    size_t count = 0;
    memcpy(sorted, s->rough, sizeof sorted);
    float least = quantile_of(sorted, PLACES, (double)LIKELY / PLACES);
    for (int equal = 0; equal < 2; equal++)
        for (uint32_t i = 0; i < PLACES && count < LIKELY; i++)
            if (equal ? !(s->rough[i] < least) && !(s->rough[i] > least) : s->rough[i] < least) s->likely[count++] = i;
}

/* The best places, the best first. */
static void choose_starts(struct lattice_search *s) {
    size_t count = 0;
    for (size_t i = 0; i < LIKELY; i++) {
        double uneven = (double)s->uneven[i];
        if (count == STARTS && uneven >= s->start[STARTS - 1].uneven) continue;
        size_t at = count < STARTS ? count++ : STARTS - 1;
        for (; at > 0 && s->start[at - 1].uneven > uneven; at--) s->start[at] = s->start[at - 1];
        s->start[at] = (struct start){s->place[s->likely[i]], uneven, 0};
    }
}

static double explained(double exact, double usual) { return (exact - usual) / fmax(1 - usual, 1e-9); }

/* The place from where most points are midway; exact where that explains some of them.  Where it is hardly less uneven
 * from the best one than from others (by so much of it at most), no more are midway than usual, for all that is told.
 */
static void seek_place(struct lattice_search *s, double hopeless, unsigned threads, struct lattice *lattice) {
    par_for(threads, PLACES, CHUNK, try_places, s);
    choose_likely(s);
    par_for(threads, LIKELY, CHUNK, try_likely, s);
    par_for(threads, USUAL, CHUNK, try_usual, s);
    choose_starts(s);
    lattice->usual = lattice->exact = (double)quantile_of(s->exact, USUAL, 0.5);
    par_for(threads, STARTS, 1, climb_from_starts, s);
    qsort(s->start, STARTS, sizeof *s->start, less_uneven);
    if (s->start->uneven > hopeless * (double)quantile_of(s->usual, USUAL, 0.5)) return;
    par_for(threads, BEST, 1, approach_starts, s);
    const struct start *best = s->start;
    for (int i = 1; i < BEST; i++)
        if (s->start[i].exact > best->exact) best = &s->start[i];
    lattice->at = best->at;
    refine_place(&s->near, lattice);
}

static void climb_thin(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t i = begin; i < end; i++) {
        climb_midway(&s->near, s->step, &s->start[i].at);
        s->start[i].exact = approach_lattice(&s->near, &s->start[i].at);
    }
}

static void look_from_places(void *ctx, size_t begin, size_t end) {
    struct lattice_search *s = ctx;
    for (size_t k = begin; k < end; k++)
        s->elsewhere[k] = share_midway(&s->near, s->place[k * PLACES / ELSEWHERE], BY_SOME, FINE);
}

/* The place from which most points are midway, of a lattice most of which is missing, from where seek_place started;
 * whether they are one. */
static bool seek_thin_place(struct lattice_search *s, unsigned threads, struct lattice *lattice) {
    par_for(threads, THIN_STARTS, 1, climb_thin, s);
    const struct start *best = s->start;
    for (int i = 1; i < THIN_STARTS; i++)
        if (s->start[i].exact > best->exact) best = &s->start[i];
    lattice->at = best->at;
    refine_place(&s->near, lattice);
    double fine = share_midway(&s->near, lattice->at, BY_ALL, FINE), most = 0, sum = 0;
    par_for(threads, ELSEWHERE, 1, look_from_places, s);
    for (size_t k = 0; k < ELSEWHERE; k++) most = fmax(most, s->elsewhere[k]), sum += s->elsewhere[k];
    return explained(fine, sum / ELSEWHERE) > EXPLAINS_THIN && fine > OUTSTANDING * most;
}

static vec3 middle_of_samples(const struct near_points *near) {
    vec3 sum = {0, 0, 0};
    for (size_t i = 0; i < near->count; i++) sum = vec3_add(sum, near->point[near->id[i * NEAR]]);
    return vec3_scale(sum, 1 / (double)near->count);
}

/* Whether about as many points are midway from the other side of their middle, as those of a wall are; unless those are
 * even themselves, all but exactly, too, which tells a scanner that was far off. */
static bool is_even_from_opposite(const struct near_points *near, const struct lattice *lattice) {
    vec3 middle = middle_of_samples(near), opposite = vec3_sub(vec3_scale(middle, 2), lattice->at);
    vec3 towards = vec3_sub(lattice->at, middle);
    double exact = approach_lattice(near, &opposite);
    if (vec3_dot(vec3_sub(opposite, middle), towards) >= 0) return false;
    if (exact <= lattice->exact - IMAGE_LACKS * (lattice->exact - lattice->usual)) return false;
    double fine = share_midway(near, lattice->at, BY_ALL, FINE);
    return lattice->usual > EVEN_ITSELF || share_midway(near, opposite, BY_ALL, FINE) > AS_EXACT * fine;
}

/* Room for the points near each sample, and for these in blocks. */
struct near_room {
    uint32_t *id;
    float *at;
};

/* Which of those that are midway from one place are so from another one, too: their share. */
static double share_of_both(const struct near_points *near, vec3 one, vec3 another) {
    double from_one[SAMPLES], from_another[SAMPLES];
    size_t of_one = 0, of_both = 0, n = unevenness_of_each(near, BY_ALL, one, from_one);
    (void)unevenness_of_each(near, BY_ALL, another, from_another);
    for (size_t i = 0; i < n; i++) {
        if (from_one[i] >= EXACT) continue;
        of_one++, of_both += from_another[i] < EXACT;
    }
    return (double)of_both / fmax((double)of_one, 1);
}

/* Whether there is another place that explains what this one doesn't: those are two scans.  A lattice's own points are
 * about one from places beside its own, too, so a place that explains what this one does isn't another scan's. */
static bool is_another_of_rest(struct lattice_search *s, const struct lattice *lattice, bool thin, unsigned threads,
                               const struct near_room *rest) {
    const struct near_points all = s->near;
    struct lattice other = {0};
    double most = EXPLAINS_REST, uneven[SAMPLES];
    size_t count = 0, n = unevenness_of_each(&all, BY_ALL, lattice->at, uneven);
    for (size_t i = 0; i < n; i++)
        if (!(uneven[i] < EXACT)) memcpy(&rest->id[NEAR * count++], &all.id[NEAR * i], NEAR * sizeof *rest->id);
    if (count < REST_LEAST) return false;
    s->near.id = rest->id, s->near.count = count;
    lay_out(&s->near, rest->at);
    seek_place(s, INFINITY, threads, &other);
    if (thin) seek_thin_place(s, threads, &other);
    s->near = all;
    if (thin) most = fmin(most, AS_MANY_OF_REST * explained(lattice->exact, lattice->usual));
    bool is_other = !thin || share_of_both(&all, lattice->at, other.at) < other.exact;
    return is_other && explained(other.exact, other.usual) > most;
}

static void search_lattice(struct lattice_search *s, unsigned threads, const struct near_room *rest,
                           struct lattice *lattice) {
    seek_place(s, HOPELESS, threads, lattice);
    bool thin = explained(lattice->exact, lattice->usual) <= EXPLAINS;
    lattice->found = (!thin || seek_thin_place(s, threads, lattice)) && !is_even_from_opposite(&s->near, lattice) &&
                     !is_another_of_rest(s, lattice, thin, threads, rest);
}

/* ------------------------------------------------------------------------------------------------ the samples */

/* Points, evenly chosen in their order, and what is near them. */
struct samples {
    vec3 *at;
    double *distance_sq;
    struct near_room near;
};

static bool near_room_init(struct near_room *room) {
    room->id = alloc_array((size_t)SAMPLES * NEAR, sizeof *room->id);
    room->at = alloc_array(BLOCKS_MOST, RAYS_BLOCK * sizeof *room->at);
    return room->id && room->at;
}

static void near_room_done(struct near_room *room) { free(room->id), free(room->at); }

/* Of at least SAMPLES points; *near borrows. */
static enum status samples_take(const vec3 *point, size_t n, const struct knn *knn, unsigned threads,
                                struct samples *samples, struct near_points *near) {
    samples->at = alloc_array(SAMPLES, sizeof *samples->at);
    samples->distance_sq = alloc_array((size_t)SAMPLES * NEAR, sizeof *samples->distance_sq);
    if (!near_room_init(&samples->near) || !samples->at || !samples->distance_sq) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < SAMPLES; i++) samples->at[i] = point[i * n / SAMPLES];
    enum status status = knn_search(knn, samples->at, SAMPLES, NEAR, threads, samples->near.id, samples->distance_sq);
    if (status) return status;
    *near = (struct near_points){point, samples->near.id, SAMPLES, samples->at[0], {NULL}};
    lay_out(near, samples->near.at);
    return STATUS_OK;
}

static void samples_done(struct samples *samples) {
    free(samples->at), free(samples->distance_sq);
    near_room_done(&samples->near);
}

enum status lattice_find(const vec3 *point, size_t n, const struct knn *knn, unsigned threads,
                         struct lattice *lattice) {
    struct samples samples = {0};
    struct near_room rest = {0};
    *lattice = (struct lattice){0};
    if (n < SAMPLES) return STATUS_OK;
    struct lattice_search *s = alloc_zeroed(1, sizeof *s);
    enum status status = s && near_room_init(&rest) ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = samples_take(point, n, knn, threads, &samples, &s->near);
    if (!status) {
        s->step = eye_places_around(samples.at, SAMPLES, s->place);
        eye_places_dense(samples.at, SAMPLES, &s->place[EYE_PLACES_AROUND]);
        search_lattice(s, threads, &rest, lattice);
    }
    samples_done(&samples);
    near_room_done(&rest);
    free(s);
    return status;
}

/* The places around the points that a place is compared with. */
struct elsewhere {
    struct near_points near;
    vec3 place[EYE_PLACES_AROUND];
    double share[ELSEWHERE];
};

static void look_from_elsewhere(void *ctx, size_t begin, size_t end) {
    struct elsewhere *e = ctx;
    for (size_t k = begin; k < end; k++)
        e->share[k] = share_midway(&e->near, e->place[k * EYE_PLACES_AROUND / ELSEWHERE], BY_SOME, FINE);
}

static bool is_from(struct elsewhere *e, vec3 place, unsigned threads) {
    vec3 opposite = vec3_sub(vec3_scale(middle_of_samples(&e->near), 2), place);
    double fine = share_midway(&e->near, place, BY_ALL, FINE), most = 0;
    par_for(threads, ELSEWHERE, 1, look_from_elsewhere, e);
    for (size_t k = 0; k < ELSEWHERE; k++) most = fmax(most, e->share[k]);
    return explained(fine, most) > EXPLAINS_BESIDE && share_midway(&e->near, opposite, BY_ALL, FINE) <= AS_EXACT * fine;
}

enum status lattice_is_from(const vec3 *point, size_t n, const struct knn *knn, unsigned threads, vec3 place,
                            bool *is) {
    struct samples samples = {0};
    *is = false;
    if (n < SAMPLES) return STATUS_OK;
    struct elsewhere *e = alloc_zeroed(1, sizeof *e);
    enum status status = e ? samples_take(point, n, knn, threads, &samples, &e->near) : STATUS_NO_MEMORY;
    if (!status) {
        eye_places_around(samples.at, SAMPLES, e->place);
        *is = is_from(e, place, threads);
    }
    samples_done(&samples);
    free(e);
    return status;
}
