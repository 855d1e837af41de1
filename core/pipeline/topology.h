/* Pieces and handles of a closed surface, and fewer of them where they are too small to be known of.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_TOPOLOGY_H
#define WHITTLE_CORE_PIPELINE_TOPOLOGY_H

#include <stdbool.h>

#include "core/mesh/mesh.h"
#include "core/spatial/neighbourhood.h"

struct topology {
    size_t components;
    long handles; /* of all of them */
    bool wide;    /* handles that could have been taken away were, and those left aren't small */
    long tubes;   /* so many of the handles are certain, as they have loops around tubes (core/surface/tubes.h); 0 = not
                     known */
};

/* Pieces that are left out have at most this share of the vertices together. */
#define TOPOLOGY_LEFT_OUT_MOST 0.01

/* No more pieces, nor handles, but for those that are certain. */
static inline bool topology_is_simpler(const struct topology *topology, const struct topology *than) {
    return topology->components <= than->components && topology->handles - topology->tubes <= than->handles;
}

/* Of what topology_simplify has made no more complex than the other: whether it is, but for what is too large to be
 * there by mistake alone. */
static inline bool topology_may_be_right(const struct topology *topology, const struct topology *than) {
    return topology->handles - topology->tubes <= than->handles || topology->wide;
}

/* How many pieces n points tell of, at least: islands of them, of the above share each, none of which has neighbours,
 * or is among the 24 nearest, of a point of another.  knn: of the points.  O(points), and as many searches where their
 * neighbours are of several islands.  STATUS_NO_MEMORY. */
enum status topology_count_islands(const struct neighbourhood *neighbours, const struct knn *knn, const vec3 *point,
                                   unsigned threads, size_t *islands) MUST_CHECK;

/* That of a closed mesh.  O(triangles log triangles).  STATUS_NO_MEMORY. */
enum status topology_find(const struct mesh *mesh, struct topology *topology) MUST_CHECK;

/* Counts the tubes of a closed mesh that has handles, as above; O(triangles) for each handle. */
enum status topology_count_tubes(const struct mesh *mesh, struct topology *topology) MUST_CHECK;

/* Takes handles and pieces away from a closed mesh, which has sources and tags and of which *topology is known, the
 * smallest first, until it has no more of them than another, or none is left that is small: handles that a loop of at
 * most twelve edges goes around or through, with bars but for tubes, pieces that have a hundredth of the vertices
 * together.  *topology follows. Where a handle was cut, vertices are there twice, and some have no source
 * (core/mesh/cut.h).  A mesh that has none too many stays as it is, without cost.  STATUS_NO_MEMORY: then the mesh is
 * closed, but not what it was. */
enum status topology_simplify(struct mesh *mesh, const struct topology *than, bool bars, unsigned threads,
                              struct topology *topology) MUST_CHECK;

#endif
