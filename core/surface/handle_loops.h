/* Short loops on a closed surface that no piece of it ends at: around its handles and through its tunnels.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_HANDLE_LOOPS_H
#define WHITTLE_CORE_SURFACE_HANDLE_LOOPS_H

#include "core/mesh/mesh.h"

enum { LOOPS_MOST_EDGES = 12 };

/* A closed path along edges of the mesh. */
struct loop {
    uint32_t vertex[LOOPS_MOST_EDGES];
    uint32_t count;
    double length;
    uint64_t homology; /* its class: that of a sum of loops is the exclusive or of theirs, 0 for what bounds a piece */
};

struct loops {
    struct loop *loop; /* owned */
    size_t count;
};

/* Finds, of each homology class (over Z2) that has loops of at most edges_most (<= LOOPS_MOST_EDGES) edges, the
 * shortest one: fewest edges, then shortest length.  None of them cuts its component in two.  The shortest come first.
 * The mesh has to be closed and oriented, each vertex with one fan.  A mesh without handles costs O(triangles log
 * triangles), each handle O(triangles) and a search around every vertex of a strip that crosses it; the searches take
 * their steps from *steps and end when none are left, then the loops found by then are returned.  *loops is untouched
 * on failure. STATUS_NO_MEMORY. */
enum status loops_find(const struct mesh *mesh, uint32_t edges_most, size_t *steps, struct loops *loops) MUST_CHECK;

/* Accepts zeroed loops. */
void loops_done(struct loops *loops);

#endif
