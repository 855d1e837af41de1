/* Half-edges of a triangle mesh, as one flat array, and the changes of connectivity that refinement makes.
 *
 * Half-edge h = 3 t + k is the edge of triangle t from its corner k to the next.  Only the opposite half-edges (twin)
 * and one half-edge out of each vertex are stored; the rest is arithmetic.
 *
 *                c                         c                        c
 *              / t \                     / | \                    / | \
 *        a  --- h --->  b    flip:     a t | s b     split:     a --v-- b
 *              \ s /                     \ | /                    \ | /
 *                d                         d                        d
 *
 * Invariant: twin[twin[h]] == h where twin[h] isn't NONE, and both run between the same vertices the other way round.
 * An edge that isn't regular (boundary, more than two triangles, misoriented) has no twin, and its ends are locked;
 * a vertex whose triangles form more than one fan is locked too (and knotted).  A border's edges are merged and split
 * along it; no operation changes a knotted vertex's fans beyond what a flip does, so the surface stays as manifold as
 * it was.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_HALFEDGE_H
#define WHITTLE_CORE_MESH_HALFEDGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/mesh/mesh.h"

enum halfedge_lock {
    HALFEDGE_FREE = 0, /* its triangles go all the way around it */
    HALFEDGE_BORDER,   /* one fan of triangles, from a boundary to a boundary */
    HALFEDGE_KNOTTED   /* several fans */
};

struct halfedge {
    size_t vertex_count, triangle_count;
    uint32_t (*triangle)[3]; /* borrowed from the mesh, and changed */
    uint32_t *twin;          /* 3 * triangle_count */
    uint32_t *out;           /* vertex_count: a half-edge that starts there; NONE for an unused vertex */
    uint8_t *locked;         /* vertex_count: enum halfedge_lock */
};

/* Builds the half-edges of the mesh's triangles (fewer than 2^30).  O(triangles log triangles), where no vertex has
 * many O(triangles).  Same result for any number of threads (0 = all processors).  STATUS_NO_MEMORY only. */
enum status halfedge_init(struct halfedge *he, const struct mesh *mesh, unsigned threads) MUST_CHECK;
void halfedge_done(struct halfedge *he);

static inline uint32_t halfedge_next(uint32_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
static inline uint32_t halfedge_prev(uint32_t h) { return h % 3 == 0 ? h + 2 : h - 1; }
static inline uint32_t halfedge_from(const struct halfedge *he, uint32_t h) { return he->triangle[h / 3][h % 3]; }
static inline uint32_t halfedge_to(const struct halfedge *he, uint32_t h) {
    return halfedge_from(he, halfedge_next(h));
}
/* The vertex across from the edge in its triangle. */
static inline uint32_t halfedge_apex(const struct halfedge *he, uint32_t h) {
    return halfedge_from(he, halfedge_prev(h));
}
/* The next half-edge out of the same vertex, counter-clockwise; NONE past a boundary. */
static inline uint32_t halfedge_around(const struct halfedge *he, uint32_t h) { return he->twin[halfedge_prev(h)]; }

/* Fills ring with the half-edges out of a vertex that isn't knotted, counter-clockwise and at most max of them; their
 * number, or 0 when there are more.  On a border the first has no twin, and the last triangle's apex is a neighbour,
 * too.
 */
size_t halfedge_ring(const struct halfedge *he, uint32_t vertex, uint32_t *ring, size_t max);

/* Whether an edge joins a and b, looked for around a, which must not be knotted. */
bool halfedge_joined(const struct halfedge *he, uint32_t a, uint32_t b);

/* Turns the edge of h (which has a twin) into the other diagonal.  The two triangles keep their ids: h / 3 becomes
 * (a, d, c), whose second half-edge is the new diagonal, and twin[h] / 3 becomes (d, b, c).  The caller has seen to it
 * that c and d aren't joined. */
void halfedge_flip(struct halfedge *he, uint32_t h);

/* Whether `gone`, an end of h, may be merged into the other end without changing the surface's topology. */
bool halfedge_may_collapse(const struct halfedge *he, uint32_t h, uint32_t gone);

/* What a collapse frees and a split uses up; the second triangle is NONE at a border. */
struct halfedge_spare {
    uint32_t vertex, triangle[2];
};

/* Merges `gone` into the other end of h.  halfedge_may_collapse must hold. */
struct halfedge_spare halfedge_collapse(struct halfedge *he, uint32_t h, uint32_t gone);

/* Puts spare.vertex on the edge of h: triangles h / 3 and twin / 3 keep the halves at the start of h, the spare ones
 * (in this order; one at a border) become those at its end. */
void halfedge_split(struct halfedge *he, uint32_t h, struct halfedge_spare spare);

/* Triangle `to`, which nothing refers to any more, takes the place of triangle `from`, which nothing refers to then. */
void halfedge_renumber(struct halfedge *he, uint32_t from, uint32_t to);

#endif
