/* A closed mesh, cut along closed paths of its edges: a handle less where a path goes around one or through it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_CUT_H
#define WHITTLE_CORE_MESH_CUT_H

#include "core/mesh/halfedge.h"

/* A closed path: from each of the vertices an edge runs to the next, and from the last to the first. */
struct mesh_path {
    const uint32_t *vertex; /* borrowed; each once */
    size_t count;           /* at least 3 */
};

/* Cuts the mesh (he: its half-edges, each with a twin, no vertex knotted), which has sources and tags, along paths that
 * have no vertex in common, and closes both sides of each cut with a disc: triangles, tagged as filling a hole, around
 * a new vertex near the middle of the path, which has no source.  The vertices of the path are there twice then, in the
 * same places and with the same sources; new vertices and triangles come last, of each path the copies and then both
 * middles.  *mesh is untouched on failure, and he no longer of it afterwards.  O(triangles).  STATUS_NO_MEMORY. */
enum status mesh_cut(struct mesh *mesh, const struct halfedge *he, const struct mesh_path *path,
                     size_t paths) MUST_CHECK;

#endif
