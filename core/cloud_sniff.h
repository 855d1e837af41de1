/* What a file's first bytes say that it is, whatever its name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_SNIFF_H
#define WHITTLE_CORE_CLOUD_SNIFF_H

#include <stddef.h>

enum cloud_kind {
    CLOUD_KIND_EMPTY, /* no byte */
    CLOUD_KIND_PLY,
    CLOUD_KIND_TEXT, /* plain text of no other known kind: may be XYZ */
    CLOUD_KIND_OTHER /* nothing that we read */
};

struct cloud_guess {
    enum cloud_kind kind;
    const char *looks_like; /* for people, e.g. "a PNG image"; static, never NULL */
};

/* Looks at up to the first 4096 of the n bytes at first; 64 are enough to tell the known kinds apart. */
struct cloud_guess cloud_sniff(const void *first, size_t n);

#endif
