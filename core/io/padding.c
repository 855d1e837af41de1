/* Padding after the data.
 *
 * Anything else that follows is refused: a header that promises too few points would lose the others without a word.
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

bool padding_is(const void *bytes, size_t n) {
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

void padding_note(char note[PADDING_NOTE_BYTES], size_t n) {
    snprintf(note, PADDING_NOTE_BYTES, "bytes of padding after the data: %zu", n);
}
