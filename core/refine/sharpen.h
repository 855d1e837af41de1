/* Creases that no point is on, put where the faces beside them meet.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_SHARPEN_H
#define WHITTLE_CORE_REFINE_SHARPEN_H

#include <stdbool.h>

#include "core/mesh/mesh.h"

/* Splits the edges of a surface through points that run across a crease, from the one face to the other, where the
 * planes of both faces meet; three that meet in a triangle become a corner.  New vertices come last and have no source;
 * those that there were stay, as does the topology.  noise: of the points, its standard deviation, as far as it is
 * known.  *added (may be NULL) is how many vertices there are more: none where the surface has too few such creases to
 * speak of, its points are on them, or most are round edges rather.  One thread; O(triangles).
 * STATUS_NO_MEMORY: then the mesh is as it was. */
enum status sharpen_creases(struct mesh *mesh, double noise, size_t *added) MUST_CHECK;

/* Whether the points of a closed surface tell that it is to have sharp creases: they were put evenly on a body, with no
 * regard to its creases.  Of points at random it isn't told.  One thread; O(triangles).  STATUS_NO_MEMORY. */
enum status sharpen_is_due(const struct mesh *mesh, bool *due) MUST_CHECK;

#endif
