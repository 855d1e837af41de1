/* 3D Tiles archives (3tz, version 1.3): zip, whose members are stored as they are, and an index of them at its end.
 *
 *     local header, name, content | ... | @3dtilesIndex1@ | central directory
 *
 * Of members beyond 4 GiB, or more than 65 535 of them, the zip is a zip64.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_ARCHIVE_H
#define WHITTLE_CORE_TILESET_ARCHIVE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/crc32.h"
#include "core/base/status.h"
#include "core/io/out/sink.h"

enum { ARCHIVE_NAME_BYTES = 40 };

struct archive_member {
    char name[ARCHIVE_NAME_BYTES];
    uint64_t at;
    uint32_t bytes, crc;
};

struct archive {
    struct sink *sink; /* borrowed */
    struct crc32 crc;
    uint64_t at;
    size_t count, capacity;
    struct archive_member *member; /* owned */
};

void archive_init(struct archive *archive, struct sink *sink);

/* name: of at most ARCHIVE_NAME_BYTES - 1 letters, none twice; bytes are copied to the sink.  STATUS_NO_MEMORY. */
enum status archive_add(struct archive *archive, const char *name, const void *bytes, uint32_t n) MUST_CHECK;

/* Puts the index and the directory.  STATUS_NO_MEMORY. */
enum status archive_finish(struct archive *archive) MUST_CHECK;

/* Accepts a zeroed one. */
void archive_done(struct archive *archive);

#endif
