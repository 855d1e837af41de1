/* Reading clouds part by part, so that no file has to fit into memory: PLY, LAS, LAZ, PCD, E57, PTX and lines of text,
 * from regular files.  What is compressed is decompressed onto a disk first, into a file without a name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_STREAM_H
#define WHITTLE_CORE_IO_STREAM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/cloud/select.h"

struct cloud_stream;

/* Begins with `count` >= 1 files, which are read one after the other as one cloud: all must have the first one's
 * properties.  limits may be NULL; columns, threads, select and scratch of it are followed.  Paths are copied.  Numbers
 * of scans (CLOUD_SCAN) go on from file to file; of several files of scanners every point has one.
 * STATUS_UNSUPPORTED for a format, or a file of one, that isn't read so, STATUS_MALFORMED, STATUS_IO, STATUS_NO_MEMORY.
 * *out is the caller's, to be given to cloud_stream_free. */
enum status cloud_stream_open(const char *const *path, size_t count, const struct cloud_limits *limits,
                              struct cloud_stream **out, struct error *error) MUST_CHECK;

/* What the first file says of all points: properties, comments, form, las ...  count is the present part's.  Borrowed
 * until the stream is freed. */
const struct cloud *cloud_stream_cloud(const struct cloud_stream *stream);

/* The next part, at most some four million points, all with a position and asked for: *part borrowed until the next
 * call; its count is 0 at the end alone.  A point's number is how many were given before it, the same each time that
 * the files are read.  Memory: what a part takes, 60 MiB or less of usual files. */
enum status cloud_stream_next(struct cloud_stream *stream, const struct cloud **part, struct error *error) MUST_CHECK;

/* Where all was scanned from, as a cloud's view and view_count say it (core/cloud/cloud.h): of the files that have been
 * read to the end, so of all of them after the last part.  Borrowed until the next one. */
const vec3 *cloud_stream_views(const struct cloud_stream *stream, uint64_t *count);

/* What the files that have been read to the end have and no cloud can hold, as a cloud's left_out says it.  Borrowed
 * until the next part. */
const char *cloud_stream_left_out(const struct cloud_stream *stream);

/* How much of the bytes is read, 0 to 1; and how many points had no position, by now. */
double cloud_stream_fraction(const struct cloud_stream *stream);
uint64_t cloud_stream_dropped(const struct cloud_stream *stream);

/* Bytes that what is decompressed has taken on the disk at most, by now. */
uint64_t cloud_stream_unpacked(const struct cloud_stream *stream);

/* How many points with a position weren't asked for, by now. */
struct selection cloud_stream_selection(const struct cloud_stream *stream);

/* Accepts NULL. */
void cloud_stream_free(struct cloud_stream *stream);

#endif
