/* What places that aren't points of a cloud have of its attributes: colours, normals and all else of vertices that the
 * refinement has moved, or averages.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_ATTRIBUTES_H
#define WHITTLE_CORE_PIPELINE_ATTRIBUTES_H

#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"

/* Fills *out (the caller's, for cloud_done) with a cloud of n places in the cloud's coordinates: the properties of
 * the cloud, lists without items, each as at the point source[i] (may be NULL) that the place stands for, where that is
 * NONE at the nearest one.  With `mean` numbers that have fractions, colours and intensities are means over all points
 * that this place is nearest to, where there are any; normals are unit vectors again; whole numbers of other kinds,
 * such as classes, stay those of the one point.  Coordinates are the place's, rounded to their types; whole ones become
 * double. The same for any number of threads.  O((points + n) log).  STATUS_NO_MEMORY. */
enum status attributes_at(const struct cloud *cloud, const vec3 *place, const uint32_t *source, size_t n, bool mean,
                          unsigned threads, struct cloud *out, struct error *error) MUST_CHECK;

/* Turns the normals (nx, ny, nz) of vertices, a cloud of the mesh's vertices in their order, to the side that the mesh
 * faces there: several of them may have their normal of one point, which lies on the other side of a sheet or a fold.
 * Nothing where there are no such properties with fractions.  O(vertices + triangles).  STATUS_NO_MEMORY. */
enum status attributes_turn_normals(struct cloud *vertices, const struct mesh *mesh) MUST_CHECK;

#endif
