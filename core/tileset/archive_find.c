/* From the end: where the directory ends, its last entry, which is the index's, the index, the member's header.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/archive_find.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/io/codec/md5.h"
#include "core/tileset/archive.h"

/* Bytes of the parts, and where in them what is looked for lies. */
enum {
    END = 22,
    END64 = 56 + 20, /* with its locator */
    ENTRY = 46,
    EXTRA = 12,
    LOCAL = 30,
    TAIL = END + END64 + ENTRY + ARCHIVE_NAME_BYTES + EXTRA,
    ENTRY_SIZE_AT = 24,
    ENTRY_EXTRA_AT = 30,
    ENTRY_PLACE_AT = 42,
    LOCAL_SIZE_AT = 22,
    LOCAL_NAME_AT = 26,
    MOST_INDEX = 1 << 28
};

/* The entry of the index, which ends at `end` of the tail; NULL: there is none. */
static const unsigned char *index_entry(const unsigned char *tail, size_t end) {
    size_t name = strlen(ARCHIVE_INDEX);
    for (size_t extra = 0; extra <= EXTRA; extra += EXTRA) {
        if (end < ENTRY + name + extra) continue;
        const unsigned char *entry = tail + end - ENTRY - name - extra;
        if (load_little_endian(entry, 4) == ARCHIVE_ENTRY_MARK && memcmp(entry + ENTRY, ARCHIVE_INDEX, name) == 0 &&
            load_little_endian(entry + ENTRY_EXTRA_AT, 2) == extra)
            return entry;
    }
    return NULL;
}

/* Where the index lies; false: nowhere. */
static bool find_index(archive_read *read, void *ctx, uint64_t bytes, uint64_t *first, uint64_t *count) {
    unsigned char tail[TAIL];
    size_t n = bytes < TAIL ? (size_t)bytes : TAIL;
    if (n < END || !read(ctx, bytes - n, tail, n)) return false;
    const unsigned char *entry = index_entry(tail, n - END);
    if (!entry && n >= END + END64) entry = index_entry(tail, n - END - END64);
    if (!entry) return false;
    bool is_far = load_little_endian(entry + ENTRY_EXTRA_AT, 2) > 0;
    uint64_t place = is_far ? load_little_endian(entry + ENTRY + strlen(ARCHIVE_INDEX) + 4, 8)
                            : load_little_endian(entry + ENTRY_PLACE_AT, 4);
    *first = place + LOCAL + strlen(ARCHIVE_INDEX);
    *count = load_little_endian(entry + ENTRY_SIZE_AT, 4);
    return *count <= MOST_INDEX && *count % ARCHIVE_ITEM_BYTES == 0 && *first <= bytes && *count <= bytes - *first;
}

enum archive_found archive_find(archive_read *read, void *ctx, uint64_t bytes, const char *name, uint64_t *first,
                                uint64_t *count) {
    unsigned char wanted[ARCHIVE_ITEM_BYTES] = {0}, local[LOCAL];
    uint64_t at, n;
    if (strlen(name) >= ARCHIVE_NAME_BYTES) return ARCHIVE_NOT_THERE;
    if (!find_index(read, ctx, bytes, &at, &n)) return ARCHIVE_UNREADABLE;
    unsigned char *index = alloc_array(n, 1);
    if (!index || !read(ctx, at, index, n)) {
        free(index);
        return ARCHIVE_UNREADABLE;
    }
    md5_short(name, strlen(name), wanted);
    const unsigned char *item =
        bsearch(wanted, index, n / ARCHIVE_ITEM_BYTES, ARCHIVE_ITEM_BYTES, archive_compare_items);
    uint64_t place = item ? load_little_endian(item + MD5_BYTES, 8) : 0;
    free(index);
    if (!item) return ARCHIVE_NOT_THERE;
    if (place > bytes || !read(ctx, place, local, LOCAL)) return ARCHIVE_UNREADABLE;
    *first = place + LOCAL + load_little_endian(local + LOCAL_NAME_AT, 2);
    *count = load_little_endian(local + LOCAL_SIZE_AT, 4);
    return *first <= bytes && *count <= bytes - *first ? ARCHIVE_FOUND : ARCHIVE_UNREADABLE;
}
