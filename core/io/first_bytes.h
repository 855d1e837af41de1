/* The beginning of a file, for those who tell its format by it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FIRST_BYTES_H
#define WHITTLE_CORE_IO_FIRST_BYTES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/io/text_scanner.h"

enum {
    FIRST_BYTES_LOOK = 4096,
    FIRST_BYTES_LONG_LOOK = 65536 /* for comments before the first word */
};

struct first_bytes {
    const char *text;
    size_t n;      /* that are there: the whole file, or its beginning */
    size_t looked; /* at most FIRST_BYTES_LOOK of them */
    bool is_text;  /* no control character that no text has is among those */
};

/* The n bytes are borrowed. */
struct first_bytes first_bytes_of(const void *bytes, size_t n);

/* Whether they begin with these bytes. */
bool first_begins(const struct first_bytes *first, const char *beginning, size_t bytes);

/* Whether the word is anywhere among those looked at, in capitals or not. */
bool first_contains(const struct first_bytes *first, const char *word);

/* The first word that is in no # comment; *rest is what follows it.  false: there is none. */
bool first_word(const struct first_bytes *first, struct scan_word *word, struct scan *rest);

#endif
