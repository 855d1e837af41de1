/* Writing points of a cloud as LAS or LAZ.
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

/* Keeps colours of 16 bits for that, before the cloud's records get them in 8.  6 bytes for each point.
 * STATUS_NO_MEMORY. */
enum status cloud_keep_colours(struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
