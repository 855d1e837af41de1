/* Points without a position: what scanners and programs write where nothing was measured.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FINITE_H
#define WHITTLE_CORE_IO_FINITE_H

#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* The end of every reader: drops the points that have a coordinate which is nan or infinite, and the triangles at them,
 * and notes how many in cloud->left_out.  The others keep their order.  STATUS_MALFORMED where no point is left,
 * STATUS_NO_MEMORY; the cloud is then for cloud_done alone.  O(points + triangles), in place. */
enum status cloud_drop_unplaced(struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
