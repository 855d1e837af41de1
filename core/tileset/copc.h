/* A cloud as COPC (Cloud Optimized Point Cloud 1.0): LAZ whose points are a tree of cubes, so that a reader over HTTP
 * fetches no more of it than it shows.  The tree is that of 3D Tiles (core/tileset/octree.h): each cube adds the most
 * important points that no cube above it has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_COPC_H
#define WHITTLE_CORE_TILESET_COPC_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* kept: n >= 1 ids of the cloud's points, the most important first; NULL stands for all of them, in an order that
 * spreads over space.  fd is a file that can be written anew (cloud_takes_copc), stays open and isn't synced.  What LAS
 * can't hold goes to left_out (may be NULL) under "cloud.copc.laz".  The same bytes for any number of threads (0 = all
 * processors).  O(n depth), with about 100 bytes a point.  STATUS_IO, STATUS_NO_SPACE, STATUS_NO_MEMORY,
 * STATUS_BAD_PARAMETER. */
enum status copc_write(int fd, const struct cloud *cloud, const uint32_t *kept, size_t n, unsigned threads,
                       struct left_out *left_out, struct error *error) MUST_CHECK;

#endif
