/* Writing points of a cloud as PCD.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_PCD_WRITE_H
#define WHITTLE_CORE_CLOUD_PCD_WRITE_H

#include <stddef.h>
#include <stdint.h>

#include "core/cloud.h"
#include "core/losses.h"
#include "core/status.h"

/* PCD 0.7 in binary, unorganised.  Scalar properties keep their type and order, with the names that the Point Cloud
 * Library has for some: normal_x for nx ..., and red, green, blue as uint8 (and alpha) packed to a field rgb (rgba) in
 * the place of the first of them.  Lists are left out.  The cloud's comments become comments, a viewpoint among them
 * the viewpoint.
 *
 * ids are n ids < cloud->count; NULL stands for 0 .. n-1.  fd stays open and isn't synced.  What can't be held goes to
 * losses (may be NULL) under "cloud.pcd".  STATUS_IO, STATUS_NO_MEMORY.  O(n). */
enum status cloud_write_pcd(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, struct losses *losses,
                            struct error *error) MUST_CHECK;

#endif
