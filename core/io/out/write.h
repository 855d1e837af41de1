/* Writing points of a cloud, with all that the file said of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_WRITE_H
#define WHITTLE_CORE_IO_OUT_WRITE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/out/sink.h"
#include "core/params.h"

/* Common to both: ids are n ids < cloud->count, in the order in which the points are to be written, repetition allowed;
 * NULL stands for 0 .. n-1.  fd is written from where it stands and stays open; nothing is synced.  STATUS_IO (with the
 * reason), STATUS_NO_MEMORY.  O(n). */

/* A PLY file with one element vertex: all properties, lists too, each in its own type, in the order of the cloud, and
 * the cloud's comments.  Binary (little endian) keeps every bit; ascii keeps the value of every bit pattern but NaN's
 * payload. */
enum status cloud_write_ply(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, enum encoding encoding,
                            struct error *error) MUST_CHECK;

/* Lines "x y z ..." with all scalar properties, separated by one space; lists are left out.  A first line names the
 * columns, with HEADER_PLAIN as "x y z name ...", with HEADER_HASH as "# x y z name ...". */
enum status cloud_write_xyz(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, enum xyz_header header,
                            struct error *error) MUST_CHECK;

/* For writers of PLY.  "float", "uchar", ...: the name that most readers know. */
const char *cloud_write_type_name(enum scalar_type type);

/* Puts the scalar at p (native byte order): in binary as little endian, in ascii as its shortest text and a space. */
void cloud_write_scalar(struct sink *sink, const void *p, enum scalar_type type, enum encoding encoding);

/* Ends a record: in ascii the last space becomes a newline. */
void cloud_write_end_record(struct sink *sink, enum encoding encoding);

/* Puts "ply", the format line and the comments (NULL = none). */
void cloud_write_ply_start(struct sink *sink, const char *comments, enum encoding encoding);

#endif
