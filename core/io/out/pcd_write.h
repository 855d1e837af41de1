/* Writing points of a cloud as PCD.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_PCD_WRITE_H
#define WHITTLE_CORE_IO_OUT_PCD_WRITE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/left_out.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/params.h"

/* PCD 0.7 in binary, unorganised.  Scalar properties keep their order, with the names that the Point Cloud Library has
 * for some: normal_x for nx ..., and red, green, blue as uint8 (and alpha) packed to a field rgb (rgba) in the place of
 * the first of them.  Lists are left out.  The cloud's comments become comments, a viewpoint among them the viewpoint.
 *
 * With PCD_DOUBLE all keep their types.  With PCD_FLOAT, which is what that library, Open3D and loaders.gl read, x, y,
 * z, the normal, curvature and intensity are float32, and labels uint32 where it holds all of them.  Coordinates that
 * would lose by it because they lie far from 0 are around an origin then, which a comment tells ("# origin X Y Z is to
 * be added to x y z") and cloud_pcd_read adds; so is the viewpoint.  The origin and the largest rounding error go to
 * left_out.
 *
 * ids are n ids < cloud->count; NULL stands for 0 .. n-1.  fd stays open and isn't synced.  What can't be held goes to
 * left_out (may be NULL) under "cloud.pcd".  STATUS_IO, STATUS_NO_MEMORY.  O(n). */
enum status cloud_write_pcd(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n,
                            enum pcd_precision precision, struct left_out *left_out, struct error *error) MUST_CHECK;

#endif
