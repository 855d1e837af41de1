/* Writing a mesh as PLY.  (Reading one is cloud_read: it gives the vertices as points, and the triangles.)
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_PLY_WRITE_H
#define WHITTLE_CORE_IO_OUT_PLY_WRITE_H

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"
#include "core/params.h"

/* Writes element vertex and element face (list uchar int vertex_indices, and property uchar hole_fill when any triangle
 * is tagged MESH_HOLE_FILL) to fd, which stays open and isn't synced.
 *
 * With a cloud (NULL = none) that mesh->source refers to, x, y, z have the types that they have there, or double where
 * an integer type would have to hold a position that isn't the point's own; a vertex at its point's position gets that
 * point's bytes.  When every vertex has a source, all other scalar properties of the points follow them, in the cloud's
 * order.  Without a cloud or sources x, y, z are double.
 *
 * STATUS_IO (with the reason), STATUS_NO_MEMORY, STATUS_LIMIT for more than INT32_MAX vertices.  O(size). */
enum status mesh_write_ply(int fd, const struct mesh *mesh, const struct cloud *cloud, enum encoding encoding,
                           struct error *error) MUST_CHECK;

#endif
