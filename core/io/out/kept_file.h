/* Points that are kept and don't fit into memory: a file of them, and those parts of it that its readers make.
 *
 *     head | key, position, record | ...
 *
 * A lower key is more important, and no two are alike.  Numbers are as the machine has them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_KEPT_FILE_H
#define WHITTLE_CORE_IO_OUT_KEPT_FILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/io/out/sink.h"

/* Which file it is, and what its readers may take. */
struct kept_file {
    char *path; /* owned */
    uint64_t count;
    size_t record_bytes;
    uint64_t most_points; /* that may be in memory at a time */
};

struct kept_head {
    char mark[16];
    uint64_t count, record_bytes;
    uint64_t of; /* what it was made of: a number of the writer's */
};
#define KEPT_MARK "whittle kept 1\0"

/* Accepts a zeroed one; the file stays. */
void kept_file_done(struct kept_file *file);

void kept_put(struct sink *sink, uint64_t key, vec3 position, const unsigned char *record, size_t record_bytes);

/* Whether the file is there, whole, and made of this. */
bool kept_file_is(const struct kept_file *file, uint64_t of);

/* Some points, one after the other. */
struct kept_points {
    size_t count;
    uint64_t *key; /* owned, as all that follows */
    vec3 *position;
    unsigned char *record;
};

/* Room for n.  STATUS_NO_MEMORY. */
enum status kept_points_make(struct kept_points *points, size_t n, size_t record_bytes) MUST_CHECK;

/* Accepts zeroed ones. */
void kept_points_done(struct kept_points *points);

/* Copies one, which there is room for. */
void kept_points_add(struct kept_points *points, const struct kept_points *from, size_t i, size_t record_bytes);

/* Reading, from the first point on.  STATUS_IO, STATUS_NO_MEMORY. */
struct kept_reader {
    int fd;
    size_t record_bytes;
    uint64_t count, done;
    unsigned char *bytes;      /* owned */
    struct kept_points points; /* that were read last */
};
enum status kept_reader_open(struct kept_reader *reader, const char *path, uint64_t count, size_t record_bytes,
                             struct error *error) MUST_CHECK;

/* The next ones, of which there are none at the end alone. */
enum status kept_reader_next(struct kept_reader *reader, const char *path, struct error *error) MUST_CHECK;

/* Accepts a zeroed one. */
void kept_reader_close(struct kept_reader *reader);

#endif
