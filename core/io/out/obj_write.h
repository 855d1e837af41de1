/* Writing a mesh as Wavefront OBJ.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_OBJ_WRITE_H
#define WHITTLE_CORE_IO_OUT_OBJ_WRITE_H

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"

/* Lines v (with red green blue of 0 .. 1 behind the coordinates where all vertices have a colour), vn (where all have a
 * normal) and f.  Numbers read back to the same bits, as float32 where all of the cloud's coordinates are.  Triangles
 * that fill holes are in a group hole_fill, the others in a group surface, where there are both.
 *
 * cloud (NULL = none) is what mesh->source refers to.  fd stays open and isn't synced.  What can't be held goes to
 * left_out (may be NULL) under "mesh.obj".  STATUS_IO (with the reason), STATUS_NO_MEMORY.  O(size). */
enum status mesh_write_obj(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) MUST_CHECK;

#endif
