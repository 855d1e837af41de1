/* Which way a mesh faces at its vertices.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_VERTEX_NORMALS_H
#define WHITTLE_CORE_MESH_VERTEX_NORMALS_H

#include "core/mesh/mesh.h"

/* normal[v], for each vertex: the sum of the normals of the triangles around v, each as long as twice its area, not of
 * unit length; 0 where there is none.  O(vertices + triangles). */
void mesh_vertex_normals(const struct mesh *mesh, vec3 *normal);

#endif
