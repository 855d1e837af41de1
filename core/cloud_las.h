/* Reading LAS 1.0 to 1.4, point formats 0 to 10.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_LAS_H
#define WHITTLE_CORE_CLOUD_LAS_H

#include <stddef.h>

#include "core/cloud.h"
#include "core/progress.h"
#include "core/status.h"

/* Reads a whole file of n bytes.  limits (NULL = none) and whether the n bytes can hold what is promised are checked
 * before anything is allocated; progress may be NULL.  All fields of the point format are kept, extra bytes too;
 * coordinates are scaled in double.
 *
 * On success *cloud is the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the byte offset and
 * what is wrong there; STATUS_LIMIT, STATUS_UNSUPPORTED, STATUS_NO_MEMORY, STATUS_CANCELLED.  O(n). */
enum status cloud_las_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
