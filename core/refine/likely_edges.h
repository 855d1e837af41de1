/* Edges of a surface through all points, flipped to where they more probably are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_LIKELY_EDGES_H
#define WHITTLE_CORE_REFINE_LIKELY_EDGES_H

#include "core/mesh/mesh.h"

/* Flips edges as long as the other diagonal of their two triangles is the likelier one: across from wide angles, where
 * the surface bends little, and between vertices that have few edges.  Vertices, topology and the number of triangles
 * stay; a flipped one is supported where either was.  Edges at vertices where the surface isn't one, or ends, stay, and
 * all do where flips make the surface rougher and not far more regular, as they do one of a scan's points.
 * *flips (may be NULL) is how many were made.  One thread; O(triangles).  STATUS_NO_MEMORY: then the mesh is as it was.
 */
enum status take_likely_edges(struct mesh *mesh, size_t *flips) MUST_CHECK;

/* The same, whatever the points are of, for edges across gaps alone, where no point tells how the surface bends, as on
 * the bottom of a statue: both diagonals are over three times as long as the points at their ends are apart.
 * spacing: of all points, by source, in the mesh's units; share: how many of them, in (0, 1], are vertices of the mesh.
 * Edges at vertices without a source stay. */
enum status take_likely_edges_across_gaps(struct mesh *mesh, const float *spacing, double share,
                                          size_t *flips) MUST_CHECK;

/* Flips edges, single ones and two beside each other, as long as the surface bends so much less that this outweighs
 * wider angles across from them: teeth along a crease, where its edges are longer than those across, and spikes where
 * fine parts end at coarse ones.  None where it gets no smoother by all of them, as of points that lie evenly on a
 * smooth body.  Vertices, topology and the number of triangles stay, and edges at vertices where the surface isn't one,
 * or ends.  *flips (may be NULL) is how many were made, two that go together counting for one.  One thread;
 * O(triangles).  STATUS_NO_MEMORY: then the mesh is as it was. */
enum status take_smooth_edges(struct mesh *mesh, size_t *flips) MUST_CHECK;

#endif
