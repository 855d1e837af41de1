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

#include "core/base/status.h"
#include "core/io/codec/crc32.h"
#include "core/io/codec/md5.h"
#include "core/io/out/sink.h"

enum { ARCHIVE_NAME_BYTES = 40, ARCHIVE_ENTRY_MARK = 0x02014b50, ARCHIVE_ITEM_BYTES = MD5_BYTES + 8 };
#define ARCHIVE_INDEX "@3dtilesIndex1@"

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

/* Of two items of an index, which begin with digests: these are compared as two numbers of 64 bits each, the first one
 * first.  For qsort and bsearch. */
int archive_compare_items(const void *one, const void *other);

/* Accepts a zeroed one. */
void archive_done(struct archive *archive);

#endif
