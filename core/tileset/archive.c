/* Writing of archives.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/archive.h"

#include <assert.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"

enum {
    LOCAL_MARK = 0x04034b50,
    END_MARK = 0x06054b50,
    END64_MARK = 0x06064b50,
    END64_LOCATOR_MARK = 0x07064b50,
    VERSION = 20,
    VERSION64 = 45,
    UNIX = 3 << 8,          /* who has made it, so that attributes are a mode */
    MODE = 0100644,         /* of a regular file */
    FIRST_DAY = 1 << 5 | 1, /* of 1980: the result is the same at any time */
    EXTRA64 = 1,
    EXTRA64_BYTES = 8,
    END64_BYTES = 44,
};

static void archive_put(struct archive *archive, uint64_t value, size_t bytes) {
    unsigned char text[8];
    store_little_endian(text, value, bytes);
    sink_bytes(archive->sink, text, bytes);
    archive->at += bytes;
}

static void put_bytes(struct archive *archive, const void *bytes, size_t n) {
    sink_bytes(archive->sink, bytes, n);
    archive->at += n;
}

void archive_init(struct archive *archive, struct sink *sink) {
    *archive = (struct archive){.sink = sink};
    crc32_init(&archive->crc, CRC32_IEEE);
}

/* What local headers and the directory have of a member alike, from its version on. */
static void put_common(struct archive *archive, const struct archive_member *member, unsigned extra) {
    archive_put(archive, extra ? VERSION64 : VERSION, 2);
    archive_put(archive, 0, 2); /* flags */
    archive_put(archive, 0, 2); /* stored */
    archive_put(archive, 0, 2); /* midnight */
    archive_put(archive, FIRST_DAY, 2);
    archive_put(archive, member->crc, 4);
    archive_put(archive, member->bytes, 4);
    archive_put(archive, member->bytes, 4);
    archive_put(archive, strlen(member->name), 2);
    archive_put(archive, extra, 2);
}

enum status archive_add(struct archive *archive, const char *name, const void *bytes, uint32_t n) {
    if (archive->count == archive->capacity) {
        size_t capacity = 2 * archive->capacity + 64;
        struct archive_member *grown = alloc_resize(archive->member, capacity, sizeof *grown);
        if (!grown) return STATUS_NO_MEMORY;
        archive->member = grown;
        archive->capacity = capacity;
    }
    struct archive_member *member = &archive->member[archive->count++];
    *member = (struct archive_member){.at = archive->at, .bytes = n, .crc = crc32_of(&archive->crc, bytes, n)};
    snprintf(member->name, sizeof member->name, "%s", name);
    archive_put(archive, LOCAL_MARK, 4);
    put_common(archive, member, 0);
    put_bytes(archive, member->name, strlen(member->name));
    put_bytes(archive, bytes, n);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the index */

int archive_compare_items(const void *one, const void *other) {
    for (size_t at = 0; at < MD5_BYTES; at += 8) {
        uint64_t a = load_little_endian((const unsigned char *)one + at, 8);
        uint64_t b = load_little_endian((const unsigned char *)other + at, 8);
        if (a != b) return a < b ? -1 : 1;
    }
    return 0;
}

static enum status add_index(struct archive *archive) {
    size_t n = archive->count;
    unsigned char *item = alloc_array(n, ARCHIVE_ITEM_BYTES);
    if (!item) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        const struct archive_member *member = &archive->member[i];
        md5_short(member->name, strlen(member->name), item + i * ARCHIVE_ITEM_BYTES);
        store_little_endian(item + i * ARCHIVE_ITEM_BYTES + MD5_BYTES, member->at, 8);
    }
    qsort(item, n, ARCHIVE_ITEM_BYTES, archive_compare_items);
    enum status status = archive_add(archive, ARCHIVE_INDEX, item, (uint32_t)(n * ARCHIVE_ITEM_BYTES));
    free(item);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the directory */

static void put_entry(struct archive *archive, const struct archive_member *member) {
    bool far = member->at >= UINT32_MAX;
    archive_put(archive, ARCHIVE_ENTRY_MARK, 4);
    archive_put(archive, UNIX | (far ? VERSION64 : VERSION), 2);
    put_common(archive, member, far ? 4 + EXTRA64_BYTES : 0);
    archive_put(archive, 0, 2); /* comment */
    archive_put(archive, 0, 2); /* disk */
    archive_put(archive, 0, 2); /* not text */
    archive_put(archive, (uint64_t)MODE << 16, 4);
    archive_put(archive, far ? UINT32_MAX : member->at, 4);
    put_bytes(archive, member->name, strlen(member->name));
    if (!far) return;
    archive_put(archive, EXTRA64, 2);
    archive_put(archive, EXTRA64_BYTES, 2);
    archive_put(archive, member->at, 8);
}

static void put_end64(struct archive *archive, uint64_t first, uint64_t bytes) {
    uint64_t at = archive->at;
    archive_put(archive, END64_MARK, 4);
    archive_put(archive, END64_BYTES, 8);
    archive_put(archive, UNIX | VERSION64, 2);
    archive_put(archive, VERSION64, 2);
    archive_put(archive, 0, 4); /* this disk */
    archive_put(archive, 0, 4); /* the directory's */
    archive_put(archive, archive->count, 8);
    archive_put(archive, archive->count, 8);
    archive_put(archive, bytes, 8);
    archive_put(archive, first, 8);
    archive_put(archive, END64_LOCATOR_MARK, 4);
    archive_put(archive, 0, 4);
    archive_put(archive, at, 8);
    archive_put(archive, 1, 4); /* disks */
}

enum status archive_finish(struct archive *archive) {
    enum status status = add_index(archive);
    if (status) return status;
    uint64_t first = archive->at;
    for (size_t i = 0; i < archive->count; i++) put_entry(archive, &archive->member[i]);
    uint64_t bytes = archive->at - first;
    bool far = archive->at >= UINT32_MAX, many = archive->count >= UINT16_MAX;
    if (far || many) put_end64(archive, first, bytes);
    archive_put(archive, END_MARK, 4);
    archive_put(archive, 0, 2); /* this disk */
    archive_put(archive, 0, 2); /* the directory's */
    archive_put(archive, many ? UINT16_MAX : archive->count, 2);
    archive_put(archive, many ? UINT16_MAX : archive->count, 2);
    archive_put(archive, bytes, 4);
    archive_put(archive, far ? UINT32_MAX : first, 4);
    archive_put(archive, 0, 2); /* comment */
    return STATUS_OK;
}

void archive_done(struct archive *archive) {
    free(archive->member);
    *archive = (struct archive){0};
}
