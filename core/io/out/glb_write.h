/* Writing a mesh as binary glTF 2.0.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_GLB_WRITE_H
#define WHITTLE_CORE_IO_OUT_GLB_WRITE_H

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"

/* One scene of one node of one mesh.  Positions are float32: exact where all coordinates fit, else relative to the
 * centre of the bounding box, which the node's translation then holds.  NORMAL where all vertices have a normal,
 * COLOR_0 (linear, uint16) where all have a colour, which is taken for sRGB; other properties of 1- and 2-byte integers
 * and float32 become attributes _NAME in capitals.  Axes are as in the input.
 *
 * cloud (NULL = none) is what mesh->source refers to.  fd stays open and isn't synced.  What can't be held goes to
 * left_out (may be NULL) under "mesh.glb".  STATUS_IO (with the reason), STATUS_NO_MEMORY, STATUS_LIMIT for more than 4
 * GiB.  O(size). */
enum status mesh_write_glb(int fd, const struct mesh *mesh, const struct cloud *cloud, struct left_out *left_out,
                           struct error *error) MUST_CHECK;

#endif
