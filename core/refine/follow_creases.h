/* Edges of a surface through all points, flipped to where the points say that creases run.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_FOLLOW_CREASES_H
#define WHITTLE_CORE_REFINE_FOLLOW_CREASES_H

#include "core/mesh/mesh.h"
#include "core/spatial/sheets.h"

/* Flips edges near creases as long as triangles lie better along the sheets at their corners: a triangle that cuts an
 * edge of the body off, or fills its step, lies along none of them.  Vertices stand at points (mesh->source); normals
 * of these (unit, of either sign) count where the creases tell nothing.  Vertices, topology and the number of triangles
 * stay; a flipped one is supported where either was.  Where over one edge for twenty points on creases would be
 * flipped, none is: the points are beside the creases then.  *flips (may be NULL) is how many were made.  One thread;
 * O(triangles).  STATUS_NO_MEMORY: then the mesh is as it was. */
enum status follow_creases(struct mesh *mesh, const struct creases *creases, const vec3 *normal,
                           size_t *flips) MUST_CHECK;

#endif
