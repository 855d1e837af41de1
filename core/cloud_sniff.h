/* What a file's first bytes say that it is, whatever its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_SNIFF_H
#define WHITTLE_CORE_CLOUD_SNIFF_H

#include <stddef.h>
#include <stdint.h>

enum cloud_kind {
    CLOUD_KIND_EMPTY, /* no byte */
    CLOUD_KIND_PLY,
    CLOUD_KIND_PCD,
    CLOUD_KIND_OBJ,
    CLOUD_KIND_OFF,
    CLOUD_KIND_STL,
    CLOUD_KIND_LAS,
    CLOUD_KIND_TEXT, /* plain text of no other known kind: may be XYZ */
    CLOUD_KIND_GZIP, /* any of the others, compressed */
    CLOUD_KIND_ZSTD,
    CLOUD_KIND_OTHER /* nothing that we read */
};

struct cloud_guess {
    enum cloud_kind kind;
    const char *looks_like; /* for people, e.g. "a PNG image"; static, never NULL */
    const char *format;     /* as cloud_format_name has it, but "ply" for all of PLY; "gzip", "zstd"; "" for what isn't
                               read; static */
};

/* Looks at up to the first 4096 of the n bytes at first (64 KiB where they begin with comments).  64 are enough for
 * most kinds; binary STL takes 134, OBJ the first line that is no comment.  Binary STL has no mark of its own: it is
 * told by its length, or where n bytes are only its beginning, by facets that make sense. */
struct cloud_guess cloud_sniff(const void *first, size_t n);

/* The formats that are read, as cloud_format_name has them, with commas between. */
const char *cloud_sniff_formats(void);

#endif
