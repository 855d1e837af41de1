/* Reading XYZ: text with one point on each line.  Writing is core/cloud_write.h.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_XYZ_H
#define WHITTLE_CORE_CLOUD_XYZ_H

#include <stddef.h>

#include "core/cloud.h"
#include "core/progress.h"
#include "core/status.h"

/* Reads a whole XYZ file of n bytes.  Every column becomes a float64 property.  The grammar is in cloud_xyz.c.
 * limits (NULL = none) bound the points and columns; progress may be NULL.
 *
 * On success *cloud is the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the line and, in
 * error->where, the column's name; STATUS_LIMIT, STATUS_NO_MEMORY, STATUS_CANCELLED.  O(n). */
enum status cloud_xyz_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
