/* Flat faces that have points along their edges alone.
 *
 * Corners of a mesh of a machine's part lie on the edges of its faces: a flange is two circles of them, and the rims of
 * the holes for its bolts.  No point's neighbours lie on such a face, so nothing around one tells of it, but many
 * points that are exactly on one plane, in closed rings one inside the other, do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SPATIAL_FLAT_FACES_H
#define WHITTLE_CORE_SPATIAL_FLAT_FACES_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/neighbourhood.h"

/* Places spread over such faces. */
struct flat_faces {
    size_t count;
    vec3 *point, *normal; /* unit normals of either sign; owned */
    float *spacing;       /* about how far they are apart; owned */
    size_t holes;         /* through such faces, or what stands on them: so many handles a body may have by these */
};

/* Finds faces between a ring of points and those next inside it, which have no other points on them: of n distinct
 * points in the normalised frame.  Where points around the rings lie to both sides of the plane, it cuts through a
 * body, and there is no face.  At most half as many places as points.  One thread but for searches; O(n) and a few
 * tests of all points for each plane.  None where the points are lattice's.  STATUS_NO_MEMORY: then *faces is
 * untouched. */
enum status flat_faces_find(const struct knn *knn, const struct neighbourhood *neighbours, const vec3 *point, size_t n,
                            unsigned threads, struct flat_faces *faces) MUST_CHECK;

/* Accepts zeroed ones. */
void flat_faces_done(struct flat_faces *faces);

#endif
