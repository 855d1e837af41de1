/* Surfaces with borders: what the reconstructions of solids are not for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_SHEET_H
#define WHITTLE_CORE_SURFACE_SHEET_SHEET_H

#include "core/surface/reconstruct.h"

/* Sheets through points in space, of which tets (dimension 3) are the tetrahedra, by an advancing front; what no
 * original point supports is left out.  input->dense must be known.  An empty mesh where nothing is left.
 * STATUS_NO_MEMORY, STATUS_LIMIT, STATUS_CANCELLED (stages "front" and "support"). */
enum status sheet_open(const struct tets *tets, const struct reconstruct_input *input, unsigned threads,
                       const struct progress *progress, struct mesh *mesh) MUST_CHECK;

/* One sheet over the plane normal to the unit vector up: the Delaunay triangles of the points' feet in it, without
 * those that no original point supports; in a landscape wider gaps are spanned.  All triangles face up.  Otherwise like
 * sheet_open; STATUS_CANCELLED also in stage "delaunay", STATUS_ENGINE where CGAL fails; error (may be NULL) says why.
 */
enum status sheet_heightfield(const struct reconstruct_input *input, vec3 up, bool landscape, unsigned threads,
                              const struct progress *progress, struct mesh *mesh, struct error *error) MUST_CHECK;

/* One sheet as it is seen from a place: the Delaunay triangles of the points' directions on the sphere around it,
 * without those that no original point supports, as they lie between rays; where these leave points out, the sheets
 * through those (sheet_open). All triangles face the place.  Otherwise like sheet_heightfield. */
enum status sheet_viewed(const struct reconstruct_input *input, vec3 view, unsigned threads,
                         const struct progress *progress, struct mesh *mesh, struct error *error) MUST_CHECK;

/* Whether points lie in rings, or parts of such, as a turning scanner's do, which are far apart where it looked at the
 * ground from afar: of some of the points the neighbours are along a line.  O(points). */
bool sheet_is_in_rings(const struct neighbourhood *neighbours, const vec3 *point);

/* Takes out of an open mesh what a refinement has moved to where no original point supports it: triangles of which more
 * than .15 is far from all points.  viewed: it was made by sheet_viewed, which spans wider gaps.  Vertices are numbered
 * anew, and where only corners held parts together each part gets one of its own.  dense->neighbours must be known.
 * *mesh is untouched on failure, but may have got tags. STATUS_NO_MEMORY. */
enum status sheet_trim(struct mesh *mesh, const struct reconstruct_dense *dense, bool viewed,
                       unsigned threads) MUST_CHECK;

/* Takes out of a height field its walls, what is steeper than 72 degrees, where points are farther than five times as
 * they are from each other: nobody has seen those.  Otherwise like sheet_trim. */
enum status sheet_trim_walls(struct mesh *mesh, const struct reconstruct_dense *dense, vec3 up,
                             unsigned threads) MUST_CHECK;

#endif
