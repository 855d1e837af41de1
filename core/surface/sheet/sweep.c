/* From where a scanner stood its rays are equally far apart, over whatever they meet:
 *
 *      wall   . . . .       . . . .      from e each point is as far from the next one, as an angle, even across the
 *                     . . .              step; from elsewhere the steps differ as the surfaces' distances and slants do
 *                      box
 *               \ | /
 *                 e
 *
 * One place is sought for all points, and where there is none, one for each half of the order, and so on.  That is
 * about right, since a camera's rays are nearer to each other at its rim; where three points after each other tell more
 * it is made exact by these (centre.c).  Each part then takes the place of the largest part that has one which explains
 * it as well.  A wall is seen from its two sides alike, so a place whose image in the points' plane is as good tells
 * nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/sweep.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/surface/sheet/centre.h"
#include "core/surface/sheet/eye.h"
#include "core/surface/sheet/rays.h"

enum { STEPS = 512, FEW_STEPS = 128, FEWEST_STEPS = 32, PART_LEAST = 1024 /* points */, STARTS = 6, MOVES = 40 };
enum { SHRINKS = 9, COARSE_SHRINKS = 5 /* of these, by few steps */ };
enum { ALL_PLACES = EYE_PLACES + EYE_PLACES_DENSE };
enum { MANY_TRIPLES = 2048, FEW_TRIPLES = 512, LEAF_TRIPLES = 256, QUARTERS = 4 };
enum { LARGE_PARTS = 4 /* of which one has an exact place at least where all points have the same */ };
enum { NODES = 2 * SWEEP_PARTS /* numbered from 1; those of node k are 2 k and 2 k + 1 */ };
static const double SHRINK = 0.6;
static const double TAIL = 0.15;    /* steps on either side that don't count: ends of lines, gaps */
static const double LIKELY = 0.125; /* of all places, by the fewest steps: the best are among these */
static const double HOPELESS = 0.5; /* spread from the best of all places by that of lengths: no place is near */
static const double STEADY = 0.5;   /* spread of the angles, a logarithm, that a scanner has at most */
static const double STEADIER = 0.5; /* and by the spread of the steps' lengths */
static const double EVEN = 0.1;     /* spread of lengths that need no place to explain them */
static const double ALIKE = 1.5, ALIKE_AT_LEAST = 0.1; /* spread by another one: as good an explanation */
static const double IMAGE = 3, IMAGE_AT_LEAST = 0.03;  /* likewise, of a place on the other side: not clearly worse */
static const double FLAT = 0.01;                       /* off the plane of the points, by how far the eye is */
/* What rays from an exact place are uneven by, of what the points are, and by what they are less so at least. */
static const double EXPLAINS_ALL = 0.65, EXPLAINS_PART = 0.5, EXPLAINS_SOME = 0.8;
static const double EXPLAINED = 0.004;
static const double IMAGE_LACKS = 0.1;                    /* of what the place explains, an image at most */
static const double BESIDE = 1.2, BESIDE_AT_LEAST = 0.02; /* by another place: as good */
/* What a quarter is uneven by from its own place, by that from all points', and less by. */
static const double OF_ONE = 0.9, FEW_UNEVEN = 0.002;
static const double ODD = 1.5;      /* what a quarter is uneven by, by what all are: from where it may not be seen */
static const double IN_ORDER = 0.2; /* length of a step by that of any two points */

/* A part of the order, and what is known of it. */
struct stretch {
    bool sought, known, exact; /* exact: by its triples */
    vec3 eye;
    double spread; /* at eye */
    size_t begin, end, n;
    struct step *step; /* n of them, in an order that any first ones are spread evenly over the part */
};

/* How much squares of lengths differ: the logarithm of what is left of the longest by the shortest. */
static double width_of(float *square, size_t n) {
    const double share[] = {TAIL, 1 - TAIL};
    float found[2];
    quantiles_of(square, n, share, 2, found);
    return 0.5 * log((double)found[1] / (double)found[0]);
}

/* How much the angles between rays from a place differ, by their sines, of the first n steps. */
static double spread_from(const struct stretch *part, size_t n, vec3 eye) {
    static const float LEAST = 1e-24F;
    float square[STEPS];
    rays_sines(part->step, n, eye, square);
    for (size_t i = 0; i < n; i++) square[i] = square[i] > LEAST ? square[i] : LEAST; /* of no length, too */
    return width_of(square, n);
}

static double spread_of_lengths(const struct stretch *part) {
    float square[STEPS];
    for (size_t i = 0; i < part->n; i++) {
        vec3 way = vec3_sub(part->step[i].to, part->step[i].from);
        square[i] = fmaxf((float)vec3_dot(way, way), 1e-37F);
    }
    return width_of(square, part->n);
}

/* Moves a place along the axes while that is better by the first n steps, with ways that get shorter so many times. */
static double improve(const struct stretch *part, size_t n, double step, int shrinks, vec3 *eye) {
    static const vec3 way[] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    double best = spread_from(part, n, *eye);
    for (int shrunk = 0, moves = 0; shrunk < shrinks && moves < MOVES;) {
        vec3 from = *eye;
        bool moved = false;
        for (size_t w = 0; w < sizeof way / sizeof *way; w++) {
            vec3 at = vec3_add(from, vec3_scale(way[w], step));
            double spread = spread_from(part, n, at);
            if (spread < best) best = spread, *eye = at, moved = true;
        }
        moves += moved, shrunk += !moved;
        if (!moved) step *= SHRINK;
    }
    return best;
}

/* The plane that the points of a part are nearest to, and how far off it they are. */
struct part_plane {
    vec3 at, normal;
    double thickness;
};

static struct part_plane plane_of(const struct stretch *part) {
    sym3 moment = {0};
    vec3 mean = {0, 0, 0}, axis[3];
    double value[3];
    for (size_t i = 0; i < part->n; i++) mean = vec3_add(mean, part->step[i].from);
    mean = vec3_scale(mean, 1 / (double)part->n);
    for (size_t i = 0; i < part->n; i++) moment = sym3_add(moment, sym3_outer(vec3_sub(part->step[i].from, mean)));
    sym3_eigen(moment, value, axis);
    return (struct part_plane){mean, axis[0], sqrt(fmax(value[0], 0) / (double)part->n)};
}

static double height_over(const struct part_plane *plane, vec3 p) {
    return vec3_dot(vec3_sub(p, plane->at), plane->normal);
}

static bool is_steady(const struct stretch *part, double spread) {
    return spread < STEADY && spread < STEADIER * spread_of_lengths(part);
}

static bool is_as_good(double spread, double best) { return spread < ALIKE * best + ALIKE_AT_LEAST; }

/* Whether the points are seen as evenly from their other side: from the image of the eye in their plane, or, as
 * parallel rays are, from opposite.  Not where the eye is amid them. */
static bool has_image(const struct stretch *part, double step) {
    struct part_plane plane = plane_of(part);
    double height = height_over(&plane, part->eye);
    vec3 away = vec3_sub(part->eye, plane.at);
    if (fabs(height) < plane.thickness) return false;
    vec3 image[] = {vec3_sub(part->eye, vec3_scale(plane.normal, 2 * height)), vec3_sub(plane.at, away)};
    for (int i = 0; i < 2; i++) {
        double most = IMAGE * part->spread + IMAGE_AT_LEAST;
        if (spread_from(part, part->n, image[i]) < most) return true;
        if (improve(part, part->n, step, SHRINKS, &image[i]) < most && height_over(&plane, image[i]) * height < 0)
            return true;
    }
    return false;
}

/* ------------------------------------------------------------------------------------------------ the search */

struct sweep_search {
    const vec3 *point;
    struct stretch *part; /* by node */
    vec3 place[EYE_PLACES];
    double step;
    size_t first;  /* node of the level that is looked at */
    size_t stride; /* so many nodes on to the next one */
    bool skips;    /* what isn't known by larger parts */
};

struct tried {
    double spread;
    vec3 at;
};

/* Keeps the STARTS best ones, the best first. */
static void keep_best(struct tried best[STARTS], size_t *count, struct tried new) {
    if (*count == STARTS && new.spread >= best[STARTS - 1].spread) return;
    size_t i = *count < STARTS ? (*count)++ : STARTS - 1;
    for (; i > 0 && best[i - 1].spread > new.spread; i--) best[i] = best[i - 1];
    best[i] = new;
}

static bool explains(double uneven, double of_points, double most) {
    return uneven < most * of_points && uneven + EXPLAINED < of_points;
}

/* Whether the points follow each other as evenly seen from their other side, as those of a wall do; or in the plane
 * that they all lie in, where all of them are behind each other.  Not where the eye is amid them. */
static bool has_exact_image(const struct stretch *part, const struct centre_triples *triples, double uneven) {
    struct part_plane plane = plane_of(part);
    double height = height_over(&plane, part->eye), edge_on = FLAT * vec3_distance(part->eye, plane.at);
    vec3 image[] = {vec3_sub(part->eye, vec3_scale(plane.normal, 2 * height)),
                    vec3_sub(plane.at, vec3_sub(part->eye, plane.at))};
    if (fabs(height) < fmax(plane.thickness, edge_on)) return plane.thickness < edge_on;
    double most = uneven + IMAGE_LACKS * (centre_unevenness_of_points(triples) - uneven);
    for (int i = 0; i < 2; i++)
        if (centre_approach(triples, &image[i]) < most && height_over(&plane, image[i]) * height < 0) return true;
    return false;
}

/* Whether each quarter of the triples has the same place as all, which are this uneven from it: not those of several
 * scans, or of one that moved. */
static bool is_of_all(const struct centre_triples *triples, vec3 eye, double uneven) {
    struct centre_triples quarter = {.point = triples->point};
    for (size_t q = 0; q < QUARTERS; q++) {
        quarter.count = 0;
        for (size_t i = q * triples->count / QUARTERS; i < (q + 1) * triples->count / QUARTERS; i++)
            centre_add(&quarter, triples->of[i][0], triples->of[i][1], triples->of[i][2]);
        vec3 own = eye;
        double by_all = centre_unevenness(&quarter, eye);
        bool odd = by_all > ODD * uneven + FEW_UNEVEN;
        if (odd && by_all > EXPLAINS_SOME * centre_unevenness_of_points(&quarter)) return false;
        if (fmin(centre_approach(&quarter, &own), centre_refine(&quarter, &own)) < OF_ONE * by_all - FEW_UNEVEN)
            return false;
    }
    return true;
}

/* Where rays follow each other most evenly, by some triples: from where the spread is least, or for all points from the
 * best of all places, too. */
static double approach(const struct sweep_search *s, const struct stretch *part, vec3 *eye) {
    struct centre_triples triples = {.point = s->point};
    struct tried start[STARTS];
    size_t count = 0;
    bool all = s->first == 1;
    centre_take(&triples, part->begin, part->end, FEW_TRIPLES);
    for (size_t i = 0; all && i < EYE_PLACES; i++)
        keep_best(start, &count, (struct tried){centre_unevenness(&triples, s->place[i]), s->place[i]});
    if (all) centre_take(&triples, part->begin, part->end, MANY_TRIPLES);
    double least = centre_approach(&triples, eye);
    for (size_t i = 0; i < count; i++) {
        double uneven = centre_approach(&triples, &start[i].at);
        if (uneven < least) least = uneven, *eye = start[i].at;
    }
    return least / centre_unevenness_of_points(&triples);
}

/* Whether a place is on the same side of the part's plane as its eye. */
static bool is_before(const struct stretch *part, vec3 place) {
    struct part_plane plane = plane_of(part);
    return height_over(&plane, part->eye) * height_over(&plane, place) > 0;
}

/* Makes the eye exact by the triples of the part. */
static void make_exact(const struct sweep_search *s, struct stretch *part) {
    struct centre_triples triples = {.point = s->point};
    struct stretch exact = *part;
    double most = s->first == 1 ? EXPLAINS_ALL : EXPLAINS_PART;
    if (!(approach(s, part, &exact.eye) < most)) return;
    centre_take(&triples, part->begin, part->end, CENTRE_TRIPLES);
    double uneven = centre_refine(&triples, &exact.eye);
    if (!explains(uneven, centre_unevenness_of_points(&triples), most)) return;
    bool sure = !has_exact_image(&exact, &triples, uneven) || (part->known && is_before(part, exact.eye));
    if (!sure || !is_of_all(&triples, exact.eye, uneven)) return;
    exact.known = exact.exact = true;
    *part = exact;
}

/* The STARTS best of all places, by few steps, of those that the fewest make likely. */
static size_t find_likeliest(const struct sweep_search *s, const struct stretch *part, size_t few,
                             struct tried best[STARTS]) {
    vec3 place[ALL_PLACES];
    float spread[ALL_PLACES], sorted[ALL_PLACES];
    vec3 from[STEPS];
    size_t count = 0, fewest = few < FEWEST_STEPS ? few : FEWEST_STEPS;
    for (size_t i = 0; i < part->n; i++) from[i] = part->step[i].from;
    memcpy(place, s->place, sizeof s->place);
    eye_places_dense(from, part->n, &place[EYE_PLACES]);
    for (size_t i = 0; i < ALL_PLACES; i++) spread[i] = (float)spread_from(part, fewest, place[i]);
    memcpy(sorted, spread, sizeof sorted);
    float likely = quantile_of(sorted, ALL_PLACES, LIKELY);
    for (size_t i = 0; i < ALL_PLACES; i++)
        if (spread[i] <= likely) keep_best(best, &count, (struct tried){spread_from(part, few, place[i]), place[i]});
    return count;
}

static void seek(const struct sweep_search *s, struct stretch *part) {
    struct tried best[STARTS];
    size_t few = part->n < FEW_STEPS ? part->n : FEW_STEPS;
    if (spread_of_lengths(part) < EVEN) return;
    size_t count = find_likeliest(s, part, few, best);
    part->spread = INFINITY;
    if (s->first > 1 && count > 0 && best[0].spread > HOPELESS * spread_of_lengths(part)) return;
    for (size_t i = 0; i < count; i++) {
        improve(part, few, s->step, COARSE_SHRINKS, &best[i].at);
        best[i].spread = spread_from(part, part->n, best[i].at);
        if (best[i].spread < part->spread) part->spread = best[i].spread, part->eye = best[i].at;
    }
    double step = s->step * pow(SHRINK, COARSE_SHRINKS - 1);
    part->spread = improve(part, part->n, step, SHRINKS - COARSE_SHRINKS + 1, &part->eye);
    part->known = is_steady(part, part->spread) && !has_image(part, s->step / 4);
    make_exact(s, part);
}

static void seek_range(void *ctx, size_t begin, size_t end) {
    struct sweep_search *s = ctx;
    for (size_t i = begin; i < end; i++) {
        size_t k = s->first + i * s->stride;
        if (s->part[k / 2].known)
            s->part[k].known = true, s->part[k].exact = s->part[k / 2].exact, s->part[k].eye = s->part[k / 2].eye;
        else if (!s->part[k].sought && !s->skips)
            seek(s, &s->part[k]), s->part[k].sought = true;
    }
}

/* All parts of a level; where it has many and of a few of them none is known, most others aren't either, and what less
 * than half of the order tells isn't asked for. */
static void seek_level(struct sweep_search *s, size_t level, unsigned threads) {
    enum { FEW_PARTS = 8 };
    bool any = level <= FEW_PARTS;
    s->first = level;
    s->stride = any ? 1 : level / FEW_PARTS, s->skips = false;
    if (!any) par_for(threads, FEW_PARTS, 1, seek_range, s);
    for (size_t k = level; k < 2 * level && !any; k += s->stride) any = s->part[k].known && !s->part[k / 2].known;
    s->stride = 1, s->skips = !any;
    par_for(threads, level, 1, seek_range, s);
}

/* ------------------------------------------------------------------------------------------------ parts */

/* Steps of points begin .. end - 1 of the order, evenly chosen; their own order is by an odd stride. */
static enum status take_steps(const vec3 *point, size_t begin, size_t end, struct stretch *part) {
    size_t all = end - begin - 1;
    part->begin = begin, part->end = end;
    part->n = all < STEPS ? all : STEPS;
    part->step = alloc_array(part->n, sizeof *part->step);
    if (!part->step) return STATUS_NO_MEMORY;
    size_t stride = part->n * 5 / 13 | 1;
    while (part->n % stride == 0 && stride > 1) stride -= 2;
    for (size_t i = 0, k = 0; i < part->n; i++, k = (k + stride) % part->n) {
        size_t at = begin + k * all / part->n;
        part->step[i] = (struct step){point[at], point[at + 1]};
    }
    return STATUS_OK;
}

static bool is_in_order(const struct stretch *all) {
    float next[STEPS], any[STEPS];
    for (size_t i = 0; i < all->n; i++) {
        next[i] = (float)vec3_distance(all->step[i].from, all->step[i].to);
        any[i] = (float)vec3_distance(all->step[i].from, all->step[(i + 1) % all->n].from);
    }
    return (double)quantile_of(next, all->n, 0.5) < IN_ORDER * (double)quantile_of(any, all->n, 0.5);
}

/* The first of all nodes above which none is known. */
static bool is_first(const struct stretch *part, size_t node) {
    return part[node].known && (node == 1 || !part[node / 2].known);
}

/* The exact place that makes a part's points as even as any does: that of the largest part of those as good. */
static bool find_exact(const struct stretch *part, size_t nodes, const vec3 *point, const struct stretch *own,
                       vec3 *eye) {
    struct centre_triples triples = {.point = point};
    double uneven[NODES], least = INFINITY;
    centre_take(&triples, own->begin, own->end, LEAF_TRIPLES);
    for (size_t k = 1; k < nodes; k++) {
        uneven[k] = is_first(part, k) && part[k].exact ? centre_unevenness(&triples, part[k].eye) : INFINITY;
        least = fmin(least, uneven[k]);
    }
    if (!(least < EXPLAINS_SOME * centre_unevenness_of_points(&triples))) return false;
    for (size_t k = 1; k < nodes; k++) {
        if (uneven[k] > BESIDE * least + BESIDE_AT_LEAST) continue;
        *eye = part[k].eye;
        return true;
    }
    return false;
}

/* Otherwise what explains a part as well as its own place, or where it has none: the place of the largest part that
 * does. */
static bool find_as_steady(const struct stretch *part, const struct stretch *own, size_t above, vec3 *eye) {
    for (size_t k = 1; k < above; k++) {
        if (!part[k].known) continue;
        double spread = spread_from(own, own->n, part[k].eye);
        if (!is_steady(own, spread) || (own->known && !is_as_good(spread, own->spread))) continue;
        *eye = part[k].eye;
        return true;
    }
    *eye = own->eye;
    return own->known;
}

static void adopt(const struct stretch *part, size_t parts, const vec3 *point, struct sweep *sweep) {
    sweep->one = true;
    for (size_t i = 0; i < parts; i++) {
        const struct stretch *own = &part[parts + i];
        size_t above = parts + i;
        while (above > 1 && part[above / 2].known) above /= 2;
        bool exact = find_exact(part, 2 * parts, point, own, &sweep->eye[i]);
        sweep->known[i] = exact || find_as_steady(part, own, above, &sweep->eye[i]);
        sweep->one = sweep->one && exact;
        sweep->share += sweep->known[i] ? 1.0 / (double)parts : 0;
    }
    for (size_t i = 0; i < parts; i++) {
        size_t first = 0;
        while (first < i && !(sweep->known[first] && vec3_equal(sweep->eye[first], sweep->eye[i]))) first++;
        sweep->places += sweep->known[i] && first == i;
    }
    sweep->one = sweep->one && sweep->places == 1;
}

/* Whether no part of the first levels has an exact place, so that none is that of all. */
static bool has_none_exact(const struct stretch *part, size_t level) {
    bool any = false;
    for (size_t k = 1; k < 2 * level; k++) any = any || part[k].exact;
    return !any;
}

enum status sweep_find(const vec3 *point, size_t n, bool one_alone, unsigned threads, struct sweep *sweep) {
    size_t parts = 1;
    vec3 from[STEPS];
    bool ends = false;
    *sweep = (struct sweep){.complete = true};
    if (n < PART_LEAST) return STATUS_OK;
    while (parts < SWEEP_PARTS && n / (2 * parts) >= PART_LEAST) parts *= 2;
    struct sweep_search *s = alloc_zeroed(1, sizeof *s);
    struct stretch *part = alloc_zeroed(NODES, sizeof *part);
    enum status status = s && part ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t level = 1; !status && level <= parts; level *= 2)
        for (size_t k = 0; k < level && !status; k++)
            status = take_steps(point, k * n / level, (k + 1) * n / level, &part[level + k]);
    if (!status && is_in_order(&part[1])) {
        s->part = part, s->point = point;
        for (size_t i = 0; i < part[1].n; i++) from[i] = part[1].step[i].from;
        s->step = eye_places(from, part[1].n, s->place);
        for (size_t level = 1; level <= parts && !ends; level *= 2) {
            seek_level(s, level, threads);
            ends = one_alone && level == LARGE_PARTS && level < parts && has_none_exact(part, level);
        }
        sweep->complete = !ends;
        if (!ends) sweep->parts = parts, adopt(part, parts, point, sweep);
    }
    for (size_t k = 0; part && k < NODES; k++) free(part[k].step);
    free(part), free(s);
    return status;
}
