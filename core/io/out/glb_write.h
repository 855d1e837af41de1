/* Writing a mesh, or points, as binary glTF 2.0.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_GLB_WRITE_H
#define WHITTLE_CORE_IO_OUT_GLB_WRITE_H

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/out/mesh_attributes.h"
#include "core/io/out/sink.h"
#include "core/mesh/mesh.h"
#include "core/params.h"

/* How numbers are written.  Quantized (KHR_mesh_quantization): positions as whole numbers of 16 bits from the lowest
 * corner on, off by up to half a 65 535th of the box's longest side along each axis; normals of 8 bits.  Compressed
 * (EXT_meshopt_compression): all views, without loss; most of what is read so is half as long, or a third where it is
 * quantized.  Who reads the file must know the extension. */
struct glb_packing {
    bool quantized, compressed;
};

/* One scene of one node of one mesh.  Positions are float32: exact where all coordinates fit, else relative to the
 * centre of the bounding box, which the node's translation then holds.  NORMAL where all vertices have a normal,
 * COLOR_0 (linear, uint16) where all have a colour, which is taken for sRGB; other properties of 1- and 2-byte integers
 * and float32 become attributes _NAME in capitals.  Axes are as in the input; where up, which isn't UP_AUTO, isn't
 * UP_Y, the node's matrix turns it to y, and a mark says so (core/io/formats/glb_up.h), by which the reader finds the
 * axes again.
 *
 * cloud (NULL = none) is what mesh->source refers to.  fd stays open and isn't synced.  What can't be held goes to
 * left_out (may be NULL) under "mesh.glb".  STATUS_IO (with the reason), STATUS_NO_MEMORY, STATUS_LIMIT for more than 4
 * GiB.  O(size). */
enum status mesh_write_glb(int fd, const struct mesh *mesh, const struct cloud *cloud,
                           const struct glb_packing *packing, enum up up, struct left_out *left_out,
                           struct error *error) MUST_CHECK;

/* Points of a tileset's tile.  Coordinates are those of the tileset, whose z points upwards; in the file y does, as
 * glTF says and viewers undo. */
struct glb_points {
    const struct mesh_attributes *attributes; /* of the whole cloud, so that tiles agree on what white is */
    const uint32_t *ids;                      /* n of the cloud's points */
    const vec3 *position;                     /* of each */
    size_t n;                                 /* at least 1 */
    struct glb_packing packing;
    vec3 centre; /* what coordinates are float32 around; the node's translation */
};

/* Puts one scene of one node of one primitive of mode POINTS: POSITION, NORMAL and COLOR_0 as above, intensity and
 * classification; material unlit where there are no normals.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status cloud_put_glb(struct sink *sink, const struct glb_points *points) MUST_CHECK;

/* Notes under `where` which properties these files don't hold. */
void cloud_glb_note(const struct glb_points *points, const char *where, struct left_out *left_out);

#endif
