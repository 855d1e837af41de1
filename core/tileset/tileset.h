/* A simplified cloud as 3D Tiles 1.1 (OGC 22-025r4): tiles that a viewer loads as it comes nearer.
 *
 *     tileset.json    which tiles there are, where, and how much is missing without those below
 *     tiles/N.glb     the points of tile N: binary glTF
 *
 * A tile adds to those above it (refine ADD): of its cube it has the points of the highest rank that none above has.
 * geometricError is measured: the largest distance, in the input's units, of a point below the tile to the nearest one
 * of the tile and of those above it, which are shown wherever it is; 0 where there is none below.  That of the whole
 * tileset, of which nothing is shown then, is the diagonal of its box.
 *
 * Quantized points (core/io/out/glb_write.h) lie up to half a step off those that are measured.
 *
 * Coordinates are the input's, around the middle of its box, which the root's transform says; z is upwards.  They are
 * taken for what 3D Tiles calls local: nothing is projected.  The name of the input's coordinate system is among the
 * tileset's metadata.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_TILESET_H
#define WHITTLE_CORE_TILESET_TILESET_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/out/glb_write.h"
#include "core/io/out/kept_file.h"

struct tileset_points {
    const struct cloud *cloud;
    const uint32_t *kept; /* n >= 1 ids of the cloud's points, the most important first */
    size_t n;
    const struct kept_file *file; /* in place of those: the points are in it, and the cloud says what their records are;
                                     memory holds file->most_points of them at a time, and others lie beside it */
    unsigned threads;             /* 0 = all processors */
    struct glb_packing packing;
};

/* Writes the archive (3tz: a zip whose members aren't compressed, with an index at its end) to fd, which stays open and
 * isn't synced.  What tiles don't hold is noted in left_out (may be NULL).  The same bytes for any number of threads.
 * STATUS_IO, STATUS_NO_SPACE, STATUS_NO_MEMORY. */
enum status tileset_write_archive(int fd, const struct tileset_points *points, struct left_out *left_out,
                                  struct error *error) MUST_CHECK;

/* Writes the tiles into folder/tiles, which is made where it isn't there, each whole or not at all; then tileset.json
 * to fd.  Tiles of these names that are there are replaced. */
enum status tileset_write_folder(int fd, const char *folder, const struct tileset_points *points,
                                 struct left_out *left_out, struct error *error) MUST_CHECK;

#endif
