/* A cloud of some of its points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_KEEP_H
#define WHITTLE_CORE_CLOUD_KEEP_H

#include "core/cloud/cloud.h"

/* Leaves the points with kept[i] != 0 (cloud->count of them, at least one), in their order and in place, with all that
 * belongs to them, and the triangles between them.  *triangles = how many were dropped.  O(points + triangles).
 * STATUS_NO_MEMORY leaves the cloud as it was. */
enum status cloud_keep(struct cloud *cloud, const uint8_t *kept, size_t *triangles) MUST_CHECK;

#endif
