/* Reading STL, ascii and binary.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_STL_H
#define WHITTLE_CORE_CLOUD_STL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/cloud.h"
#include "core/progress.h"
#include "core/status.h"

/* Reads a whole file of n bytes.  limits (NULL = none) and whether the n bytes can hold what is promised are checked
 * before anything is allocated; progress may be NULL.  Corners at the same place become one point.
 *
 * On success *cloud is the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the line (ascii) or
 * the byte offset (binary) and what is wrong there; STATUS_LIMIT, STATUS_UNSUPPORTED, STATUS_NO_MEMORY,
 * STATUS_CANCELLED.  O(n). */
enum status cloud_stl_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

/* Whether the first bytes (134 are enough) begin the ascii form; some binary files begin with "solid" too. */
bool cloud_stl_is_text(const void *first, size_t n);

#endif
