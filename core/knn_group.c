/* One walk through the tree for up to GROUP queries, then arithmetic.
 *
 *        .  .  . | .  .  .        The queries (q) are neighbours along the curve.  Around the middle of their box all
 *      .   .  q  .  q  . |  .     points within their reach and once more `usual`, what the last query's k-th
 *        .  q  . | q  .  .  .     neighbour was away, are gathered.  A query at distance e from the middle has found
 *      .  .  .  . |.  .  .        its neighbours for sure where the k-th is nearer than radius - e.
 *
 * Of each query's distances those below a bound become keys: their bits, the last eight replaced by the place of the
 * point.  As numbers keys are in the order of distances, none is equal to another, and how many are below one is its
 * rank: no branch depends on them.  Two keys that differ in those eight bits alone may be of equal distances; such
 * queries are left to the tree, whose order among equals it then is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/knn_group.h"

#include <assert.h>
#include <string.h>

#include "core/knn.h"
#include "core/lanes.h"

enum { GROUP = 16, PLACE_BITS = 8, PLACES = 1 << PLACE_BITS };
static const double ROOM = 1.2;          /* of the ball beyond the queries, in usual distances */
static const double NEAR = 1.5;          /* of the first bound, in squares of usual distances */
static const double ROUNDING = 1e-9;     /* far more than what the tree's bounds are off by */
static const double FARTHEST = 0x1p1000; /* squared; what is farther than that is left to the tree */
static const int64_t ONE = 1LL << 52;    /* added to bits: doubles a number, and 0 isn't subnormal, which is slow */

static_assert((int)KNN_GROUP_POINTS <= (int)PLACES, "a place for each point");

/* A query's points: distances and keys, by place; keys of those that are near, then those keys in order. */
struct ranking {
    double distance_sq[KNN_GROUP_POINTS], key[KNN_GROUP_POINTS];
    double near[KNN_GROUP_POINTS + LANES], ranked[KNN_GROUP_POINTS + LANES];
    unsigned count;
};

INLINE lanes keys_of(lanes distance_sq, lanes_mask place) {
    return (lanes)((((lanes_mask)distance_sq + ONE) & -(int64_t)PLACES) | place);
}

INLINE void measure(const struct knn_group *g, vec3 query, struct ranking *r) {
    lanes_mask place = {0, 1, 2, 3};
    for (unsigned i = 0; i < g->count; i += LANES, place += LANES) {
        lanes x = lanes_all(query.x) - lanes_load(&g->x[i]), y = lanes_all(query.y) - lanes_load(&g->y[i]),
              z = lanes_all(query.z) - lanes_load(&g->z[i]);
        lanes distance_sq = x * x + y * y + z * z;
        lanes_store(&r->distance_sq[i], distance_sq);
        lanes_store(&r->key[i], keys_of(distance_sq, place));
    }
}

/* Those of n keys that are of distances below a bound. */
INLINE void select_near(unsigned n, double bound_sq, struct ranking *r) {
    double bound = keys_of(lanes_all(bound_sq), (lanes_mask){0})[0];
    unsigned count = 0;
    for (unsigned i = 0; i < n; i++) {
        r->near[count] = r->key[i];
        count += r->key[i] < bound;
    }
    lanes_store(&r->near[count], lanes_all(INFINITY));
    r->count = count;
}

INLINE void rank_near(struct ranking *r) {
    for (unsigned i = 0; i < r->count; i += LANES) {
        lanes key = lanes_load(&r->near[i]);
        lanes_mask rank = {0};
        for (unsigned j = 0; j < r->count; j++) rank -= lanes_all(r->near[j]) < key;
        for (unsigned lane = 0; lane < LANES; lane++) r->ranked[rank[lane]] = key[lane];
    }
}

/* The same with two vectors of two. */
INLINE void rank_near_narrow(struct ranking *r) {
    for (unsigned i = 0; i < r->count; i += LANES) {
        lanes_half low = {r->near[i], r->near[i + 1]}, high = {r->near[i + 2], r->near[i + 3]};
        lanes_half_mask low_rank = {0}, high_rank = {0};
        for (unsigned j = 0; j < r->count; j++) {
            lanes_half other = {r->near[j], r->near[j]};
            low_rank -= other < low;
            high_rank -= other < high;
        }
        r->ranked[low_rank[0]] = low[0], r->ranked[low_rank[1]] = low[1];
        r->ranked[high_rank[0]] = high[0], r->ranked[high_rank[1]] = high[1];
    }
}

FOR_EACH_PROCESSOR
static void rank(const struct knn_group *g, vec3 query, unsigned k, double usual, struct ranking *r) {
    measure(g, query, r);
    select_near(g->count, NEAR * usual * usual, r);
    if (r->count < k) select_near(g->count, FARTHEST, r);
    if (processor_is_wide())
        rank_near(r);
    else
        rank_near_narrow(r);
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

bool knn_group_nearest(const struct knn_group *group, vec3 query, unsigned k, double usual, uint32_t *id,
                       double *distance_sq) {
    struct ranking r;
    if (group->count < k) return false;
    rank(group, query, k, usual, &r);
    if (r.count < k) return false;
    double farthest = sqrt(r.distance_sq[bits_of(r.ranked[k - 1]) & (PLACES - 1)]);
    if (farthest + vec3_distance(query, group->centre) >= group->radius * (1 - ROUNDING)) return false;
    if (has_equals(&r, k)) return false;
    for (unsigned i = 0; i < k; i++) {
        unsigned place = bits_of(r.ranked[i]) & (PLACES - 1);
        id[i] = group->id[place];
        distance_sq[i] = r.distance_sq[place];
    }
    return true;
}

unsigned knn_group_length(const vec3 *query, size_t n, double width) {
    unsigned length = 1;
    while (length < n && length < GROUP && vec3_distance_sq(query[0], query[length]) <= width * width) length++;
    return length;
}

/* The smallest ball around the middle of the box. */
static void surround(struct knn_group *group, const vec3 *query, unsigned n) {
    vec3 least = query[0], most = query[0];
    for (unsigned i = 1; i < n; i++) least = vec3_min(least, query[i]), most = vec3_max(most, query[i]);
    group->centre = vec3_lerp(least, most, 0.5);
    double reach_sq = 0;
    for (unsigned i = 0; i < n; i++) reach_sq = fmax(reach_sq, vec3_distance_sq(group->centre, query[i]));
    group->radius = sqrt(reach_sq);
}

enum status knn_group_gather(struct knn_group *group, const struct knn_pieces *pieces, const vec3 *point,
                             const vec3 *query, unsigned n, double usual, bool *gathered) {
    surround(group, query, n);
    group->radius += ROOM * usual;
    enum status status =
        knn_pieces_within(pieces, group->centre, group->radius, KNN_GROUP_POINTS, group->id, &group->count);
    *gathered = !status && group->count <= KNN_GROUP_POINTS;
    if (!*gathered) return status;
    for (unsigned i = 0; i < group->count; i++) {
        vec3 p = point[group->id[i]];
        group->x[i] = p.x, group->y[i] = p.y, group->z[i] = p.z;
    }
    for (unsigned i = group->count; i % LANES; i++) group->x[i] = group->y[i] = group->z[i] = 0;
    return STATUS_OK;
}
