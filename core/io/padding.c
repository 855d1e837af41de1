/* What follows the data.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/padding.h"

#include <stdio.h>
#include <string.h>

#define END_OF_FILE 0x1a

static bool is_fill(char c) {
    static const char fill[] = {'\0', '\t', '\n', '\r', ' ', END_OF_FILE};
    return memchr(fill, c, sizeof fill);
}

static bool is_padding(const void *bytes, size_t n) {
    const char *at = bytes;
    for (size_t i = 0; i < n; i++)
        if (!is_fill(at[i])) return false;
    return true;
}

size_t padding_text_bytes(const char *text, size_t n) {
    size_t end = n;
    for (size_t i = n; i > 0 && is_fill(text[i - 1]); i--)
        if (text[i - 1] == END_OF_FILE) end = i - 1;
    return end;
}

void padding_note(char note[PADDING_NOTE_BYTES], const void *bytes, size_t n) {
    if (n > PADDING_MOST_BYTES)
        snprintf(note, PADDING_NOTE_BYTES, "bytes behind all that the header counts: more than %d", PADDING_MOST_BYTES);
    else if (is_padding(bytes, n))
        snprintf(note, PADDING_NOTE_BYTES, "bytes of padding after the data: %zu", n);
    else
        snprintf(note, PADDING_NOTE_BYTES, "bytes behind all that the header counts: %zu", n);
}
