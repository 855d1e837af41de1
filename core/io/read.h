/* Reading a cloud of any format that we know, compressed by gzip or zstd or not, from anywhere.  The format is told by
 * the content, never by a name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_READ_H
#define WHITTLE_CORE_IO_READ_H

#include <stddef.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/cloud/cloud.h"

/* Common to the three: limits and progress (stage "read") may be NULL.  On success *cloud is the caller's, for
 * cloud_done; else it is untouched.  STATUS_MALFORMED (empty, or what the format's reader says, with the line or the
 * byte offset), STATUS_UNSUPPORTED (says what it looks like), STATUS_LIMIT, STATUS_IO, STATUS_NO_MEMORY,
 * STATUS_CANCELLED.  Time is linear in the bytes; memory is what the cloud needs, and the bytes too where they come
 * from a pipe or are decompressed.  Positions in errors count decompressed bytes, but for errors in the compressed data
 * itself (where "inflate"), whose limits are those of core/io/codec/inflate.h. */

/* Reads from where fd stands to its end: a regular file is mapped, anything else (a pipe, a terminal) is read.  fd
 * stays open.  A regular file that somebody cuts short meanwhile ends the process by SIGBUS. */
enum status cloud_read(int fd, const struct cloud_limits *limits, const struct progress *progress, struct cloud *cloud,
                       struct error *error) MUST_CHECK;

/* The same for a file by name. */
enum status cloud_read_path(const char *path, const struct cloud_limits *limits, const struct progress *progress,
                            struct cloud *cloud, struct error *error) MUST_CHECK;

/* The same for n bytes in memory, which are borrowed. */
enum status cloud_read_memory(const void *bytes, size_t n, const struct cloud_limits *limits,
                              const struct progress *progress, struct cloud *cloud, struct error *error) MUST_CHECK;

#endif
