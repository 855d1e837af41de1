/* What a file's first bytes say that it is, whatever its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_SNIFF_H
#define WHITTLE_CORE_IO_SNIFF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/io/formats.h"

/* A kind of file: CLOUD_KIND_PLY and so on for each format (core/io/formats.h), and others. */
#define ROW(constant, name, title, looks_like, forms) CLOUD_KIND_##constant,
enum cloud_kind {
    CLOUD_FORMAT_ROWS(ROW) CLOUD_KIND_EMPTY, /* no byte */
    CLOUD_KIND_GZIP,                         /* any of the others, compressed */
    CLOUD_KIND_ZSTD,
    CLOUD_KIND_OTHER /* nothing that we read */
};
#undef ROW

/* Whether files of this kind can be read part by part (core/io/stream.h), once they aren't compressed. */
static inline bool cloud_kind_has_parts(enum cloud_kind kind) {
    return kind == CLOUD_KIND_PLY || kind == CLOUD_KIND_LAS || kind == CLOUD_KIND_TEXT || kind == CLOUD_KIND_PCD ||
           kind == CLOUD_KIND_E57 || kind == CLOUD_KIND_PTX;
}

struct cloud_guess {
    enum cloud_kind kind;
    const char *looks_like; /* for people, e.g. "a PNG image"; static, never NULL */
    const char *form;       /* of its format, as reports name it; "gzip", "zstd"; "" for what isn't read; static */
};

/* Looks at up to the first 4096 of the n bytes at first (64 KiB where they begin with comments).  64 are enough for
 * most kinds; binary STL takes 134, OBJ the first line that is no comment.  Binary STL has no mark of its own: it is
 * told by its length, or where n bytes are only its beginning, by facets that make sense. */
struct cloud_guess cloud_sniff(const void *first, size_t n);

/* The forms of all formats that are read, with commas between. */
const char *cloud_sniff_formats(void);

/* The formats that are read, for people: "PLY, PCD ... and XYZ text". */
const char *cloud_sniff_titles(void);

#endif
