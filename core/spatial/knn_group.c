/* One walk through the tree for several queries, then arithmetic.
 *
 *        .  .  . | .  .  .        The queries (q) are neighbours along the curve.  Around the middle of their box all
 *      .   .  q  .  q  . |  .     points within their reach and some room, which depends on what the last query's k-th
 *        .  q  . | q  .  .  .     neighbour was away, are gathered.  A query at distance e from the middle has found
 *      .  .  .  . |.  .  .        its neighbours for sure where the k-th is nearer than radius - e.
 *
 * Of each query's distances those below a bound become keys: their bits, the last nine replaced by the place of the
 * point.  As numbers keys are in the order of distances, none is equal to another, and how many are below one is its
 * rank: no branch depends on them.  Keys that differ in those nine bits alone may be of equal distances, as most are
 * in a lattice: they are put in order once more, by distance and id.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/knn_group.h"

#include <assert.h>
#include <string.h>

#include "core/math/simd.h"
#include "core/spatial/knn.h"

enum { PLACE_BITS = 9, PLACES = 1 << PLACE_BITS, FOUR = 4, SIXTEEN = 16 };
static const double NEAR = 1.25;         /* of the first bound, in squares of usual distances */
static const double ROUNDING = 1e-9;     /* far more than what the tree's bounds are off by */
static const double FARTHEST = 0x1p1000; /* squared; what is farther than that is left to the tree */
static const int64_t ONE = 1LL << 52;    /* added to bits: doubles a number, and 0 isn't subnormal, which is slow */

static_assert((int)KNN_GROUP_POINTS <= (int)PLACES, "a place for each point");

/* A query's points: distances and keys, by place; keys of those that are near, then those keys in order. */
struct ranking {
    double distance_sq[KNN_GROUP_POINTS], key[KNN_GROUP_POINTS];
    double near[KNN_GROUP_POINTS + FOUR], ranked[KNN_GROUP_POINTS + FOUR];
    unsigned count;
};

INLINE f64v keys_of(f64v distance_sq, i64v place) {
    return f64_of_bits(((f64_bits(distance_sq) + ONE) & -(int64_t)PLACES) | place);
}

INLINE f64v distances_at(const struct knn_group *g, unsigned i, vec3 from) {
    f64v x = f64_all(from.x) - f64_load(&g->x[i]), y = f64_all(from.y) - f64_load(&g->y[i]),
         z = f64_all(from.z) - f64_load(&g->z[i]);
    return x * x + y * y + z * z;
}

INLINE void measure(const struct knn_group *g, vec3 query, struct ranking *r) {
    for (unsigned i = 0; i < g->count; i += F64_LANES) {
        f64v distance_sq = distances_at(g, i, query);
        f64_store(&r->distance_sq[i], distance_sq);
        f64_store(&r->key[i], keys_of(distance_sq, i64_count() + i));
    }
}

/* Those of n keys that are of distances below a bound. */
INLINE void select_near(unsigned n, double bound_sq, struct ranking *r) {
    double bound = SIMD_LANE(keys_of(f64_all(bound_sq), i64_all(0)), 0);
    unsigned count = 0;
    for (unsigned i = 0; i < n; i++) {
        r->near[count] = r->key[i];
        count += r->key[i] < bound;
    }
    for (unsigned k = 0; k < FOUR; k++) r->near[count + k] = INFINITY;
    r->count = count;
}

/* Ranks so many keys from one on, a constant, among all: the more at once, the less often all are fetched. */
INLINE void rank_some(struct ranking *r, unsigned first, unsigned some) {
    enum { MOST = SIXTEEN / F64_LANES };
    f64v key[MOST];
    i64v rank[MOST];
    unsigned parts = some / F64_LANES;
    for (unsigned k = 0; k < parts; k++) key[k] = f64_load(&r->near[first + k * F64_LANES]), rank[k] = i64_all(0);
    for (unsigned j = 0; j < r->count; j++) {
        f64v other = f64_all(r->near[j]);
        for (unsigned k = 0; k < parts; k++) rank[k] -= f64_less(other, key[k]);
    }
    for (unsigned k = 0; k < some; k++)
        r->ranked[SIMD_LANE(rank[k / F64_LANES], k % F64_LANES)] = SIMD_LANE(key[k / F64_LANES], k % F64_LANES);
}

INLINE void rank_near(struct ranking *r) {
    unsigned i = 0;
    for (; i + SIXTEEN <= r->count + FOUR; i += SIXTEEN) rank_some(r, i, SIXTEEN);
    for (; i < r->count; i += FOUR) rank_some(r, i, FOUR);
}

/* Ranks what is nearer than the smaller of two bounds; where that isn't k points, what is nearer than the other one. */
static void rank(const struct knn_group *g, vec3 query, unsigned k, double near_sq, double sure_sq, struct ranking *r) {
    measure(g, query, r);
    select_near(g->count, fmin(near_sq, sure_sq), r);
    if (r->count < k && near_sq < sure_sq) select_near(g->count, sure_sq, r);
    if (r->count < k) return;
    rank_near(r);
}

static uint64_t bits_of(double key) {
    uint64_t bits;
    memcpy(&bits, &key, sizeof bits);
    return bits;
}

/* Whether any of the first k may be as far as the one after it. */
static bool has_equals(const struct ranking *r, unsigned k) {
    bool equal = false;
    for (unsigned i = 0; i < k && i + 1 < r->count; i++)
        equal |= bits_of(r->ranked[i]) >> PLACE_BITS == bits_of(r->ranked[i + 1]) >> PLACE_BITS;
    return equal;
}

/* Puts the n keys from the first on, which differ in their places alone, in the order of their distances, equal ones in
 * that of their ids. */
static void rank_run(const struct knn_group *g, struct ranking *r, unsigned first, unsigned n) {
    double key[KNN_GROUP_POINTS], distance_sq[KNN_GROUP_POINTS], id[KNN_GROUP_POINTS];
    for (unsigned i = 0; i < n; i++) {
        unsigned place = bits_of(r->ranked[first + i]) & (PLACES - 1);
        key[i] = r->ranked[first + i], distance_sq[i] = r->distance_sq[place], id[i] = g->id[place];
    }
    for (unsigned i = 0; i < n; i++) {
        int64_t rank = 0;
        for (unsigned j = 0; j < n; j++) /* no branch to guess wrong */
            rank += (distance_sq[j] < distance_sq[i]) | ((distance_sq[j] == distance_sq[i]) & (id[j] < id[i]));
        r->ranked[first + rank] = key[i];
    }
}

/* Puts what the first k may be among in order.  Nothing that is as far as the last one is missing: what is ranked is
 * all that is nearer than a bound. */
static void rank_equals(const struct knn_group *g, unsigned k, struct ranking *r) {
    for (unsigned i = 0, n; i < k; i += n) {
        uint64_t bits = bits_of(r->ranked[i]) >> PLACE_BITS;
        for (n = 1; i + n < r->count && bits_of(r->ranked[i + n]) >> PLACE_BITS == bits;) n++;
        if (n > 1) rank_run(g, r, i, n);
    }
}

FOR_EACH_PROCESSOR(bool, knn_group_nearest)
(const struct knn_group *group, vec3 query, unsigned k, double usual, uint32_t *id, double *distance_sq) {
    struct ranking r;
    double sure = group->radius * (1 - ROUNDING) - vec3_distance(query, group->centre); /* all that is nearer is here */
    if (group->count < k || !(sure > 0)) return false;
    rank(group, query, k, NEAR * usual * usual, fmin(sure * sure, FARTHEST), &r);
    if (r.count < k) return false;
    if (has_equals(&r, k)) rank_equals(group, k, &r);
    for (unsigned i = 0; i < k; i++) {
        unsigned place = bits_of(r.ranked[i]) & (PLACES - 1);
        id[i] = group->id[place];
        distance_sq[i] = r.distance_sq[place];
    }
    return true;
}

FOR_EACH_PROCESSOR(size_t, knn_group_length)
(const vec3 *query, size_t n, double width) {
    size_t length = 1;
    while (length < n && vec3_distance_sq(query[0], query[length]) <= width * width) length++;
    return length;
}

/* The smallest ball around the middle of the box that holds the queries, and so much more. */
static void surround(struct knn_group *group, const vec3 *query, size_t n, double room) {
    vec3 least = query[0], most = query[0];
    for (size_t i = 1; i < n; i++) least = vec3_min(least, query[i]), most = vec3_max(most, query[i]);
    group->centre = vec3_lerp(least, most, 0.5);
    double reach_sq = 0;
    for (size_t i = 0; i < n; i++) reach_sq = fmax(reach_sq, vec3_distance_sq(group->centre, query[i]));
    group->radius = sqrt(reach_sq) + room;
}

/* Fills the last vector up. */
static void fill_up(struct knn_group *group) {
    for (unsigned i = group->count; i % F64_LANES; i++) group->x[i] = group->y[i] = group->z[i] = 0;
}

static bool gather_boxes(struct knn_group *group, struct knn_group_from *from, unsigned most) {
    enum { LOOSE = 31 };
    struct knn_gathered gathered = {group->x, group->y, group->z, group->id, 0};
    if (from->loose) {
        from->loose--;
        return false;
    }
    bool told = knn_boxes_within(from->boxes, group->centre, group->radius, most, &gathered);
    if (!told) from->loose = LOOSE;
    group->count = gathered.count;
    return told;
}

static enum status gather_pieces(struct knn_group *group, const struct knn_group_from *from, unsigned most) {
    enum status status = knn_pieces_within(from->pieces, group->centre, group->radius, most, group->id, &group->count);
    for (unsigned i = 0; !status && group->count <= most && i < group->count; i++) {
        vec3 p = from->point[group->id[i]];
        group->x[i] = p.x, group->y[i] = p.y, group->z[i] = p.z;
    }
    return status;
}

FOR_EACH_PROCESSOR(enum status, knn_group_gather)
(struct knn_group *group, struct knn_group_from *from, const vec3 *query, size_t n, double room, unsigned most,
 bool *gathered) {
    surround(group, query, n, room);
    enum status status = gather_boxes(group, from, most) ? STATUS_OK : gather_pieces(group, from, most);
    *gathered = !status && group->count <= most;
    if (*gathered) fill_up(group);
    return status;
}

/* The places of the points of `wide` that are within the ball of `group`, and how many. */
static unsigned places_within(const struct knn_group *wide, const struct knn_group *group,
                              uint16_t place[KNN_GROUP_POINTS + 1]) {
    double distance_sq[KNN_GROUP_POINTS], radius_sq = group->radius * group->radius;
    unsigned count = 0;
    for (unsigned i = 0; i < wide->count; i += F64_LANES)
        f64_store(&distance_sq[i], distances_at(wide, i, group->centre));
    for (unsigned i = 0; i < wide->count; i++) { /* no branch to guess wrong */
        place[count] = (uint16_t)i;
        count += distance_sq[i] < radius_sq;
    }
    return count;
}

FOR_EACH_PROCESSOR(bool, knn_group_narrow)
(const struct knn_group *wide, const vec3 *query, size_t n, double room, struct knn_group *group) {
    uint16_t place[KNN_GROUP_POINTS + 1];
    surround(group, query, n, room);
    if (vec3_distance(group->centre, wide->centre) + group->radius >= wide->radius * (1 - ROUNDING)) return false;
    group->count = places_within(wide, group, place);
    for (unsigned i = 0; i < group->count; i++) {
        unsigned from = place[i];
        group->x[i] = wide->x[from], group->y[i] = wide->y[from], group->z[i] = wide->z[from];
        group->id[i] = wide->id[from];
    }
    fill_up(group);
    return true;
}
