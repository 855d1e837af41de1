/* Writing points of a cloud as LAS, LAZ or COPC.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_LAS_WRITE_H
#define WHITTLE_CORE_IO_OUT_LAS_WRITE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* A cloud that was LAS keeps its version (1.5 becomes 1.4), point format, scale, offset, coordinate system, extra bytes
 * with their descriptions, and every field of a kept point as it was.  Any other becomes LAS 1.2 or 1.4 of the least
 * point format that has its fields by name (intensity, classification, gps_time, red ...), with a scale that is a power
 * of ten and uses the 31 bits; nothing is said of a coordinate system.  Colours of 8 bits become 16, times 257.  Other
 * scalar properties become extra bytes with their name and type; lists are left out.
 *
 * ids are n ids < cloud->count, in the order in which they are to be written; NULL stands for 0 .. n-1.  fd is written
 * from where it stands and stays open; nothing is synced.  Of LAZ, chunks are compressed on `threads` threads (0 = all
 * processors); the place of their table is written where the file can be, else told at its end.  What can't be held
 * goes to left_out (may be NULL) under "cloud.las" or "cloud.laz".  STATUS_IO, STATUS_NO_MEMORY.  O(n). */
enum status cloud_write_las(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, bool compressed,
                            unsigned threads, struct left_out *left_out, struct error *error) MUST_CHECK;

/* A cube of an octree: the root is level 0 at 0, 0, 0; a level further there are two along each axis. */
struct las_cube {
    uint32_t level, at[3];
    uint32_t points; /* of its own; > 0 */
};

struct las_cubes {
    const struct las_cube *cube; /* count; borrowed */
    size_t count;
    vec3 centre;          /* of the root, in the units of the file */
    double half, spacing; /* half the root's edge; about how far its own points are apart */
};

/* The same as COPC 1.0: LAZ 1.4 of a point format from 6 to 8, with a chunk for each cube and, where the cubes are, in
 * a record at its end.  ids are in the order of the cubes, each one's points together.  LAS of other formats is taken
 * by the names of its fields, and keeps scale, offset and coordinate system.  fd is a file that can be written anew;
 * STATUS_BAD_PARAMETER for others. */
enum status cloud_write_copc(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n,
                             const struct las_cubes *cubes, unsigned threads, struct left_out *left_out,
                             struct error *error) MUST_CHECK;
bool cloud_takes_copc(int fd);

/* place[i] = where those writers put point i: coordinates of LAS are multiples of a step. */
void las_places(const struct cloud *cloud, const uint32_t *ids, size_t n, vec3 *place);

/* Keeps colours of 16 bits for that, before the cloud's records get them in 8.  6 bytes for each point.
 * STATUS_NO_MEMORY. */
enum status cloud_keep_colours(struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
