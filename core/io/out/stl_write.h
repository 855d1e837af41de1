/* Writing a mesh as binary STL.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_STL_WRITE_H
#define WHITTLE_CORE_IO_OUT_STL_WRITE_H

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"

/* Coordinates are float32: exact where all fit, else around an origin which the header tells (stl_origin.h) where they
 * lie far from 0 for the mesh's size; normals are those of the facets.
 *
 * cloud (NULL = none) is what mesh->source refers to.  fd stays open and isn't synced.  What can't be held goes to
 * left_out (may be NULL) under "mesh.stl".  STATUS_IO (with the reason), STATUS_NO_MEMORY, STATUS_LIMIT for more than
 * UINT32_MAX triangles.  O(size). */
enum status mesh_write_stl(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) MUST_CHECK;

#endif
