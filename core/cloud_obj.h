/* Reading Wavefront OBJ.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_OBJ_H
#define WHITTLE_CORE_CLOUD_OBJ_H

#include <stddef.h>

#include "core/cloud.h"
#include "core/progress.h"
#include "core/status.h"

/* Reads a whole file of n bytes.  limits (NULL = none) and whether the n bytes can hold what is promised are checked
 * before anything is allocated; progress may be NULL.  What is kept and what is left out is on top of cloud_obj.c.
 *
 * On success *cloud is the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the line and what is
 * wrong there; STATUS_LIMIT, STATUS_UNSUPPORTED, STATUS_NO_MEMORY, STATUS_CANCELLED.  O(n). */
enum status cloud_obj_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
