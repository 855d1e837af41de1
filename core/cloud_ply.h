/* Reading PLY: ascii, binary little and big endian, any property types in any order, lists, faces.
 * The header alone, for one who doesn't read the cloud, is core/ply_header.h; writing is core/cloud_write.h.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_PLY_H
#define WHITTLE_CORE_CLOUD_PLY_H

#include <stddef.h>

#include "core/cloud.h"
#include "core/ply_header.h"
#include "core/progress.h"
#include "core/status.h"

/* Reads a whole PLY file of n bytes.  All properties of the vertex element are kept; element face with a list
 * vertex_indices or vertex_index becomes triangles (fans; faces of fewer than three vertices are left out); other
 * elements are checked and skipped.  limits (NULL = none) are checked before anything is allocated, and so is whether
 * the n bytes can hold what the header promises.  progress may be NULL.
 *
 * On success *cloud is the caller's, for cloud_done; else it is untouched.  STATUS_MALFORMED with the line (ascii) or
 * the byte offset (binary) and the property in error->where; STATUS_LIMIT, STATUS_UNSUPPORTED (version),
 * STATUS_NO_MEMORY, STATUS_CANCELLED.  O(n). */
enum status cloud_ply_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
