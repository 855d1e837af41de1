/* A mesh with fewer vertices, of the same topology.
 *
 * Garland, Heckbert: Surface simplification using quadric error metrics (1997): edges are collapsed, the cheapest
 * first.  Here one end of an edge takes the place of both, so vertices stay a subset of those that there were; where
 * they may move, costs are those of Lindstrom, Turk: Fast and memory efficient polygonal simplification (1998).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_DECIMATE_H
#define WHITTLE_CORE_MESH_DECIMATE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/mesh/mesh.h"

/* What a mesh that wasn't made here may have. */
struct decimate_rules {
    bool borders; /* they are merged along themselves, for little change of their course; else they stay */
    bool slivers; /* triangles may be as thin as they were */
    bool viewed;  /* no triangle turns away from view that didn't face away before */
    vec3 view;
    bool moves;            /* what two vertices become may stand where that costs least, and has no source then */
    uint32_t (*record)[3]; /* of each corner the record of its vertex that it has, which follows; NULL = one for each
                              vertex.  Edges where corners of one vertex differ are seams: merged along themselves */
    unsigned threads;      /* 0 = all processors; the same mesh for any number */
};

/* Collapses edges until `count` vertices are left, or none can be collapsed any more: each collapse keeps the topology
 * and turns no triangle by more than about 75 degrees; vertices where several fans meet, where seams end or cross, or,
 * unless the rules (NULL = none) say else, of a border, stay.  Unused vertices go, whatever the count.  Sources and
 * tags follow.  Vertices near to each other in the mesh's order had better be so in space.  O(n log n).
 * STATUS_NO_MEMORY: then the mesh is as it was. */
enum status mesh_decimate(struct mesh *mesh, const struct decimate_rules *rules, size_t count) MUST_CHECK;

#endif
