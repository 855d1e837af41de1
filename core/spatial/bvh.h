/* The point of a triangle mesh that is nearest to a point: exact, by a bounding volume hierarchy.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_BVH_H
#define WHITTLE_CORE_SPATIAL_BVH_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"

struct bvh;

/* What a query finds.  Lengths are in the mesh's units. */
struct bvh_hit {
    double distance_sq; /* INFINITY where nothing was found */
    vec3 point;         /* of the mesh, nearest to the query; not set where nothing was found */
    uint32_t
        triangle; /* that point lies in; the lowest id of those at the same distance; NONE where nothing was found */
};

/* Builds a hierarchy over all triangles of the mesh (any number below 2^32 - 1, none included; degenerate ones count as
 * the segments or points that they are; coordinates finite).  Nothing of the mesh is referred to afterwards.  *bvh is
 * the caller's, to be given to bvh_free.  Same result for any number of threads (0 = all processors).
 * O(triangles log triangles), about 0.4 us for each of 1e5; at most 123 bytes for each, and 48 more while it is being
 * built.  STATUS_NO_MEMORY. */
enum status bvh_new(const struct mesh *mesh, unsigned threads, struct bvh **bvh) MUST_CHECK;

/* The same for few queries, a fifth as many as there are triangles: it takes the triangles in their order, where
 * neighbours lie near each other as a rule, so it is built in a seventh of the time, while a query takes up to twice as
 * long.  Answers are the same. */
enum status bvh_new_rough(const struct mesh *mesh, unsigned threads, struct bvh **bvh) MUST_CHECK;

/* The nearest point of the mesh to p (finite).  hint = a triangle that is likely to be near, such as the one found for
 * a neighbouring point, or NONE: it changes the time, not the answer.  A mesh without triangles has no nearest point.
 * Cost: O(log triangles) where the mesh is much nearer than it is large, about 0.5 us among 1e4 triangles and 0.9 us
 * among 1e5; a point to which all triangles are equally near visits them all.  From over 4096 times as far off as most
 * of the mesh is long a point is found that may be farther than the nearest by 1e-5 of the distance.  Can't fail. */
struct bvh_hit bvh_closest(const struct bvh *bvh, vec3 p, uint32_t hint);

/* The same among points of the mesh at most sqrt(bound_sq) away: the smaller the bound, the faster. */
struct bvh_hit bvh_closest_within(const struct bvh *bvh, vec3 p, uint32_t hint, double bound_sq);

/* hit[i] = bvh_closest of p[i], i < n; each query is hinted with the one before, so points in an order that keeps
 * neighbours together are faster.  Same result for any number of threads (0 = all processors). */
void bvh_closest_all(const struct bvh *bvh, const vec3 *p, size_t n, unsigned threads, struct bvh_hit *hit);

/* How many nodes and leaves queries for these visit together, without hints; as soon as that is over `most`, what it is
 * so far.  About 20 for each query, unless much of the mesh is as near as the nearest. */
size_t bvh_visits(const struct bvh *bvh, const vec3 *p, size_t n, size_t most);

/* Accepts NULL. */
void bvh_free(struct bvh *bvh);

#endif
