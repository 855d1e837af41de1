/* Triangles between few kept points are long where the surface is flat, so their length says nothing.  But the original
 * points do: wherever there is surface one of them is near, as near as they are to each other.
 *
 *     + . . . . +
 *      \ o o o /        o: places of the grid.  Each looks for the nearest original point; one that finds none within
 *       . o o .         a few times the distance of points there is over something that wasn't scanned.
 *        \ o /
 *         . .
 *          +            Corners are original points, and not looked at.  Nor is what lies about a corner or place that
 *                       has a point so near that all of this is near as well: that is most.
 *
 * The distance of points is that of the scan at the nearest one, but no less than usual in the scan: chance leaves gaps
 * in dense parts as large as those of others.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/support.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/surface/sheet/scan_lines.h"

enum {
    SIXTH = 7,
    GRAIN = 4096,
    CHUNK = 1024,
    TRIANGLES = 256,
    RANGE = 8 * TRIANGLES,
    TURN = 64 * RANGE,
    SIDES = 10,
    FEW_SIDES = 6,
    ROUGH_SIDES = 3,
    MIDDLE = 3,
    BALLS = 12,
    PLACES = (SIDES + 1) * (SIDES + 2) / 2 - 3
};
static const double STEP = 1.5;               /* of the grid, in reaches */
static const double AROUND = 0.7;             /* reaches: no place amid evenly spread points is as far off */
static const double SURELY = 2, NEARLY = 0.3; /* struct knn_slack: what is surely far may be nearer by a third */
static const float STRAY = 3;                 /* reaches of a neighbour */

/* Of all points, where they are looked for. */
struct reaches {
    const struct knn *knn;
    const vec3 *point;
    float *reach;
    enum status *status; /* of each chunk */
};

static void reach_of_chunk(void *ctx, size_t begin, size_t end) {
    const struct reaches *reaches = ctx;
    uint32_t id[CHUNK * SIXTH];
    double distance_sq[CHUNK * SIXTH];
    enum status status = knn_search(reaches->knn, &reaches->point[begin], end - begin, SIXTH, 1, id, distance_sq);
    for (size_t i = 0; !status && i < end - begin; i++) {
        size_t last = SIXTH * (i + 1) - 1;
        while (last > SIXTH * i && id[last] == NONE) last--;
        reaches->reach[begin + i] = (float)sqrt(distance_sq[last]);
    }
    reaches->status[begin / CHUNK] = status;
}

/* No reach is below the median. */
static enum status lift_to_median(float *reach, size_t n, float *median) {
    float *sorted = alloc_array(n, sizeof *sorted);
    if (!sorted) return STATUS_NO_MEMORY;
    memcpy(sorted, reach, n * sizeof *sorted);
    *median = quantile_of(sorted, n, 0.5);
    for (size_t i = 0; i < n; i++) reach[i] = fmaxf(reach[i], *median);
    free(sorted);
    return STATUS_OK;
}

enum status sheet_reach(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, float *reach,
                        float *median) {
    struct reaches reaches = {knn, point, reach, alloc_zeroed(n / CHUNK + 1, sizeof *reaches.status)};
    enum status status = reaches.status ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) par_for(threads, n, CHUNK, reach_of_chunk, &reaches);
    for (size_t i = 0; !status && i <= n / CHUNK; i++) status = reaches.status[i];
    free(reaches.status);
    return status ? status : lift_to_median(reach, n, median);
}

/* How far the farthest of the first six neighbours is; they are the nearest, but across scan lines not in their order.
 */
static float reach_of(const struct neighbourhood *neighbours, const vec3 *point, size_t p) {
    double farthest = 0;
    for (size_t i = 0; i < neighbours->count[p] && i < SIXTH - 1; i++)
        farthest = fmax(farthest, vec3_distance(point[p], point[neighbours->id[p * neighbours->stride + i]]));
    return (float)farthest;
}

/* What follows from neighbours, for each point. */
struct near_reaches {
    const struct neighbourhood *neighbours;
    const vec3 *point;
    const float *reach;
    float *made;
    uint8_t *stray;
};

static void reach_in_range(void *ctx, size_t begin, size_t end) {
    const struct near_reaches *near = ctx;
    for (size_t p = begin; p < end; p++) near->made[p] = reach_of(near->neighbours, near->point, p);
}

enum status sheet_reach_in(const struct neighbourhood *neighbours, const vec3 *point, unsigned threads, float *reach,
                           float *median) {
    struct near_reaches near = {.neighbours = neighbours, .point = point, .made = reach};
    size_t on_lines;
    par_for(threads, neighbours->n, GRAIN, reach_in_range, &near);
    enum status status = scan_lines_reach(neighbours, point, threads, reach, &on_lines);
    return status ? status : lift_to_median(reach, neighbours->n, median);
}

static void stray_in_range(void *ctx, size_t begin, size_t end) {
    const struct near_reaches *near = ctx;
    const struct neighbourhood *neighbours = near->neighbours;
    for (size_t p = begin; p < end; p++) {
        float least = near->reach[p];
        for (size_t i = 0; i < neighbours->count[p] && i < SIXTH - 1; i++)
            least = fminf(least, near->reach[neighbours->id[p * neighbours->stride + i]]);
        near->stray[p] = near->reach[p] > STRAY * least;
    }
}

void sheet_find_strays(const struct neighbourhood *neighbours, const float *reach, unsigned threads, uint8_t *stray) {
    struct near_reaches near = {.neighbours = neighbours, .reach = reach, .stray = stray};
    par_for(threads, neighbours->n, GRAIN, stray_in_range, &near);
}

static void inner_range(void *ctx, size_t begin, size_t end) {
    const struct near_reaches *near = ctx;
    const struct neighbourhood *neighbours = near->neighbours;
    for (size_t p = begin; p < end; p++) {
        float sorted[SIXTH];
        size_t count = 0;
        sorted[count++] = near->reach[p];
        for (size_t i = 0; i < neighbours->count[p] && i < SIXTH - 1; i++) {
            float value = near->reach[neighbours->id[p * neighbours->stride + i]];
            size_t at = count++;
            for (; at > 0 && sorted[at - 1] > value; at--) sorted[at] = sorted[at - 1];
            sorted[at] = value;
        }
        near->made[p] = sorted[count / 2];
    }
}

void sheet_inner_reach(const struct neighbourhood *neighbours, const float *reach, unsigned threads, float *inner) {
    struct near_reaches near = {.neighbours = neighbours, .reach = reach, .made = inner};
    par_for(threads, neighbours->n, GRAIN, inner_range, &near);
}

/* ------------------------------------------------------------------------------------------------ triangles */

/* A place and how far around it nothing is far, since a point is near. */
struct ball {
    vec3 centre;
    double radius;
};

/* Some triangles, their places that are looked at now, and the balls that were found so far. */
struct places {
    int most_sides; /* of the grid; searches from far away are slow, and for a share fewer places will do */
    size_t count;
    vec3 *place;
    uint32_t *of; /* the triangle of each */
    uint32_t *nearest;
    double *distance_sq;
    uint32_t begin;    /* the first triangle */
    struct ball *ball; /* BALLS for each */
    uint8_t *balls;
};

static double longest_side(const struct mesh *mesh, uint32_t t) {
    const uint32_t *v = mesh->triangle[t];
    vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
    return fmax(vec3_distance(a, b), fmax(vec3_distance(b, c), vec3_distance(c, a)));
}

static bool is_in_ball(const struct places *places, uint32_t t, vec3 place) {
    const struct ball *ball = &places->ball[(size_t)(t - places->begin) * BALLS];
    for (int i = 0; i < places->balls[t - places->begin]; i++)
        if (vec3_distance_sq(place, ball[i].centre) < ball[i].radius * ball[i].radius) return true;
    return false;
}

static void add_ball(struct places *places, uint32_t t, vec3 centre, double radius) {
    uint8_t *count = &places->balls[t - places->begin];
    if (!(radius > 0) || *count == BALLS) return;
    places->ball[(size_t)(t - places->begin) * BALLS + (*count)++] = (struct ball){centre, radius};
}

/* The places of a triangle's grid, of which one in nine comes first: those are in the middle of others, for which a
 * point near them tells enough.  How many there are in all; those in balls are none to look at. */
static unsigned add_places(const struct mesh *mesh, uint32_t t, double step, bool first, struct places *places) {
    const uint32_t *v = mesh->triangle[t];
    vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
    double longest = longest_side(mesh, t);
    int most = places->most_sides, sides = longest < most * step ? (int)ceil(longest / step) : most;
    unsigned all = 0;
    if (most % 2 == 0) sides += sides % 2; /* the middle of a side is farthest from its ends */
    for (int i = 0; i <= sides; i++)
        for (int j = 0; i + j <= sides; j++) {
            bool middle = i % MIDDLE == 1 && j % MIDDLE == 1;
            if (i == sides || j == sides || i + j == 0 || middle != first) continue;
            double u = (double)i / sides, w = (double)j / sides;
            vec3 along = vec3_add(vec3_scale(vec3_sub(b, a), u), vec3_scale(vec3_sub(c, a), w));
            vec3 place = vec3_add(a, along);
            all++;
            if (is_in_ball(places, t, place)) continue;
            places->place[places->count] = place;
            places->of[places->count++] = t;
        }
    return all;
}

/* Counts the places of each triangle, and those that are far; further: those by another limit's medians. */
struct tally {
    uint8_t far, further, all;
};

/* One look at triangles: the most sides of the grid, and how many the triangle has to be long. */
struct pass {
    int most_sides;
    double least;
};

/* What triangles are looked at in. */
struct look {
    struct sheet_limit limit;
    double medians;          /* of the other one */
    double least;            /* longest sides below this one need no look */
    double surely;           /* no place is far that has a point so near */
    const float *reach;      /* at each vertex that a triangle with such a side has */
    const float *away;       /* likewise: the nearest point */
    const uint8_t *of;       /* NULL = all triangles */
    bool any;                /* whether there is a place that is far is all that is asked */
    const struct pass *pass; /* those after the first look again at triangles that have nothing far so far */
    int passes;
    unsigned threads;
    const struct progress *progress;
};

/* Among points that lie at random in a sheet the sixth is at r where 6 are in a disc of r, so one of 2 r is empty in
 * one of exp(24) places: with limit->beside of 2 or more a gap is none of chance. */
static bool is_beside(const struct sheet_points *points, const struct sheet_limit *limit, vec3 place,
                      uint32_t nearest) {
    if (!points->normal || limit->beside == 0) return false;
    vec3 away = vec3_sub(place, points->point[nearest]);
    double off = vec3_dot(away, points->normal[nearest]), most = limit->beside * (double)points->inner[nearest];
    return vec3_length_sq(away) - off * off > most * most;
}

static bool is_far(double distance_sq, double reach, const struct sheet_limit *limit, double medians) {
    double apart = limit->apart > 0 ? limit->apart : AROUND;
    double most = fmax(fmin(limit->times * reach, medians), apart * reach);
    return distance_sq > most * most;
}

static enum status judge(const struct sheet_points *points, const struct look *look, struct places *places,
                         struct tally *tally) {
    const struct sheet_limit *limit = &look->limit;
    double median = (double)points->median;
    struct knn_slack slack = {points->reach, SURELY * limit->times, NEARLY};
    enum status status = knn_search_nearly(points->knn, &slack, places->place, places->count, 1, 1, places->nearest,
                                           places->distance_sq);
    for (size_t i = 0; !status && i < places->count; i++) {
        uint32_t nearest = places->nearest[i];
        double reach = (double)points->reach[nearest], distance_sq = places->distance_sq[i];
        bool beside = is_beside(points, limit, places->place[i], nearest);
        struct tally *t = &tally[places->of[i]];
        add_ball(places, places->of[i], places->place[i], look->surely - sqrt(distance_sq));
        if (beside || is_far(distance_sq, reach, limit, limit->medians * median)) t->far++;
        if (beside || is_far(distance_sq, reach, limit, look->medians * median)) t->further++;
    }
    return status;
}

static bool is_looked_at(const struct look *look, const struct mesh *mesh, uint32_t t) {
    return (!look->of || look->of[t]) && longest_side(mesh, t) >= look->least;
}

/* The reach at each corner of the triangles that are looked at, and how far it is from the nearest point. */
static enum status look_at_corners(const struct mesh *mesh, const struct sheet_points *points, const struct look *look,
                                   float *reach, float *away) {
    size_t count = 0, n = mesh->vertex_count;
    uint32_t *of = alloc_array(n, sizeof *of), *nearest = alloc_array(n, sizeof *nearest);
    vec3 *place = alloc_array(n, sizeof *place);
    double *distance_sq = alloc_array(n, sizeof *distance_sq);
    enum status status = of && nearest && place && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t v = 0; v < n; v++) reach[v] = 0;
    for (uint32_t t = 0; !status && t < mesh->triangle_count; t++)
        if (is_looked_at(look, mesh, t))
            for (int k = 0; k < 3; k++) reach[mesh->triangle[t][k]] = 1;
    for (uint32_t v = 0; !status && v < n; v++)
        if (reach[v] > 0) of[count] = v, place[count++] = mesh->vertex[v];
    if (!status) status = knn_search(points->knn, place, count, 1, look->threads, nearest, distance_sq);
    for (size_t i = 0; !status && i < count; i++)
        reach[of[i]] = points->reach[nearest[i]], away[of[i]] = (float)sqrt(distance_sq[i]);
    free(of), free(nearest), free(place), free(distance_sq);
    return status;
}

/* Looks at the triangles from places->begin up to `end`, or at those of them that have no place that is far yet. */
static enum status look_once(const struct mesh *mesh, const struct sheet_points *points, const struct look *look,
                             const struct pass *pass, size_t end, struct places *places, struct tally *tally) {
    enum status status = STATUS_OK;
    places->most_sides = pass->most_sides;
    for (int turn = 0; turn < 2 && !status; turn++) {
        places->count = 0;
        for (uint32_t t = places->begin; t < end; t++) {
            const uint32_t *v = mesh->triangle[t];
            if (!is_looked_at(look, mesh, t) || (look->any && tally[t].far)) continue;
            double step = STEP * (double)fminf(look->reach[v[0]], fminf(look->reach[v[1]], look->reach[v[2]]));
            if (longest_side(mesh, t) < pass->least * step) continue;
            if (turn == 0) tally[t].all = 0;
            tally[t].all = (uint8_t)(tally[t].all + add_places(mesh, t, step, turn == 0, places));
        }
        status = judge(points, look, places, tally);
    }
    return status;
}

/* Corners are near, as a rule, and with them what is around. */
static void start_balls(const struct mesh *mesh, const struct look *look, size_t end, struct places *places) {
    memset(places->balls, 0, end - places->begin);
    for (uint32_t t = places->begin; t < end; t++)
        for (int k = 0; k < 3 && is_looked_at(look, mesh, t); k++) {
            uint32_t v = mesh->triangle[t][k];
            add_ball(places, t, mesh->vertex[v], look->surely - (double)look->away[v]);
        }
}

static enum status places_new(struct places *places) {
    size_t room = (size_t)TRIANGLES * PLACES;
    *places = (struct places){.place = alloc_array(room, sizeof *places->place),
                              .of = alloc_array(room, sizeof *places->of),
                              .nearest = alloc_array(room, sizeof *places->nearest),
                              .distance_sq = alloc_array(room, sizeof *places->distance_sq),
                              .ball = alloc_array((size_t)TRIANGLES * BALLS, sizeof *places->ball),
                              .balls = alloc_array(TRIANGLES, 1)};
    bool ok = places->place && places->of && places->nearest && places->distance_sq && places->ball && places->balls;
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

static void places_done(struct places *places) {
    free(places->place), free(places->of), free(places->nearest), free(places->distance_sq);
    free(places->ball), free(places->balls);
}

/* Triangles that are looked at side by side, from `begin` on. */
struct turn {
    const struct mesh *mesh;
    const struct sheet_points *points;
    const struct look *look;
    struct tally *tally;
    size_t begin;
    enum status status[TURN / RANGE];
};

static void count_far_range(void *ctx, size_t first, size_t last) {
    struct turn *turn = ctx;
    struct places places;
    size_t begin = turn->begin + first, end = turn->begin + last;
    enum status status = places_new(&places);
    for (; begin < end && !status; begin += TRIANGLES) {
        size_t stop = end - begin < TRIANGLES ? end : begin + TRIANGLES;
        places.begin = (uint32_t)begin;
        start_balls(turn->mesh, turn->look, stop, &places);
        for (int i = 0; i < turn->look->passes && !status; i++)
            status = look_once(turn->mesh, turn->points, turn->look, &turn->look->pass[i], stop, &places, turn->tally);
    }
    places_done(&places);
    turn->status[first / RANGE] = status;
}

static enum status count_far(const struct mesh *mesh, const struct sheet_points *points, const struct look *look,
                             struct tally *tally) {
    size_t n = mesh->triangle_count;
    struct turn turn = {.mesh = mesh, .points = points, .look = look, .tally = tally};
    enum status status = STATUS_OK;
    for (; turn.begin < n && !status; turn.begin += TURN) {
        size_t count = n - turn.begin < TURN ? n - turn.begin : TURN;
        if (progress_tick(look->progress, "support", (double)turn.begin / (double)n)) return STATUS_CANCELLED;
        par_for(look->threads, count, RANGE, count_far_range, &turn);
        for (size_t i = 0; i * RANGE < count && !status; i++) status = turn.status[i];
    }
    return status;
}

/* In medians: what is nearer isn't far in any way. */
static double nearest_far(const struct sheet_points *points, const struct sheet_limit *limit) {
    return points->normal && limit->beside > 0 ? fmin(limit->times, limit->beside) : limit->times;
}

/* Tallies of triangles, for the caller to free.  No place of a triangle is farther from its corners, which are points,
 * than its longest side by the root of 3, so that small ones are near all over. */
static enum status tally_all(const struct mesh *mesh, const struct sheet_points *points, struct look look,
                             struct tally **out) {
    size_t n = mesh->vertex_count;
    float *reach = alloc_array(n, sizeof *reach), *away = alloc_array(n, sizeof *away);
    struct tally *tally = *out = alloc_zeroed(mesh->triangle_count, sizeof *tally);
    double near = nearest_far(points, &look.limit);
    look.least = sqrt(3) * near * (double)points->median;
    near = fmin(near, look.limit.medians);
    look.surely = (look.any ? near : fmin(near, look.medians)) * (double)points->median;
    look.reach = reach, look.away = away;
    enum status status = tally && reach && away ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = look_at_corners(mesh, points, &look, reach, away);
    if (!status) status = count_far(mesh, points, &look, tally);
    free(reach), free(away);
    return status;
}

static float share_of(unsigned far, unsigned all) { return all ? (float)far / (float)all : 0; }

/* Leaves those of out that are far in no more than the limit's share of the places of the finest grid. */
static enum status spare_mostly_near(const struct mesh *mesh, const struct sheet_points *points,
                                     const struct look *once, uint8_t *out) {
    static const struct pass finest = {SIDES, 0};
    struct look look = *once;
    struct tally *tally;
    look.any = false, look.medians = look.limit.medians, look.of = out;
    look.pass = &finest, look.passes = 1;
    enum status status = tally_all(mesh, points, look, &tally);
    for (size_t t = 0; !status && t < mesh->triangle_count; t++)
        out[t] = out[t] && (double)share_of(tally[t].far, tally[t].all) > look.limit.share;
    free(tally);
    return status;
}

/* Large triangles are looked at in a few places first: one that is far is enough, and searches from far away are slow.
 */
enum status sheet_unsupported(const struct mesh *mesh, const struct sheet_points *points, struct sheet_limit limit,
                              const uint8_t *of, unsigned threads, const struct progress *progress, uint8_t *out) {
    static const struct pass passes[] = {{ROUGH_SIDES, SIDES}, {FEW_SIDES, SIDES}, {SIDES, 0}};
    const struct look look = {.limit = limit,
                              .of = of,
                              .any = true,
                              .pass = passes,
                              .passes = sizeof passes / sizeof *passes,
                              .threads = threads,
                              .progress = progress};
    struct tally *tally;
    enum status status = tally_all(mesh, points, look, &tally);
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) out[t] = tally[t].far > 0;
    free(tally);
    if (!status && limit.share > 0) status = spare_mostly_near(mesh, points, &look, out);
    return status;
}

enum status sheet_far_share(const struct mesh *mesh, const struct sheet_points *points, struct sheet_limit limit,
                            double medians, unsigned threads, float *share, float *by_medians) {
    static const struct pass rough = {ROUGH_SIDES, 0};
    const struct look look = {.limit = limit, .medians = medians, .pass = &rough, .passes = 1, .threads = threads};
    struct tally *tally;
    enum status status = tally_all(mesh, points, look, &tally);
    for (size_t t = 0; !status && t < mesh->triangle_count; t++) {
        share[t] = share_of(tally[t].far, tally[t].all);
        by_medians[t] = share_of(tally[t].further, tally[t].all);
    }
    free(tally);
    return status;
}
