/* A cloud that shows a number for every point, as a property and as a colour.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_COLOUR_MAP_H
#define WHITTLE_CORE_CLOUD_COLOUR_MAP_H

#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* Fills *out (the caller's, for cloud_done) with all points of the cloud: x, y, z in their own type and bit for bit,
 * the property `name` as float, and uchar red, green, blue.  value (cloud->count of them, not negative) goes from green
 * (0) over yellow to red at the value that one point in twenty exceeds (Lee, Jong figure 4).  O(n) on average.
 * STATUS_NO_MEMORY. */
enum status paint_cloud(const struct cloud *cloud, const char *name, const float *value, struct cloud *out) MUST_CHECK;

#endif
