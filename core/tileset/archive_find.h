/* A member of an archive (3tz), found without reading more than its index.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_ARCHIVE_FIND_H
#define WHITTLE_CORE_TILESET_ARCHIVE_FIND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Reads n bytes from `at` of the archive; false where that can't be done. */
typedef bool archive_read(void *ctx, uint64_t at, void *to, size_t n);

enum archive_found { ARCHIVE_FOUND, ARCHIVE_NOT_THERE, ARCHIVE_UNREADABLE };

/* Where the member of this name lies in an archive of so many bytes, as core/tileset/archive.c writes them: bytes
 * *first to *first + *count - 1.  Four reads.  UNREADABLE: a read failed, it is none of these archives, or no memory.
 */
enum archive_found archive_find(archive_read *read, void *ctx, uint64_t bytes, const char *name, uint64_t *first,
                                uint64_t *count);

#endif
