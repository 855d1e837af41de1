/* Padding after the data.
 *
 * Anything else that follows is refused: a header that promises too few points would lose the others without a word.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/padding.h"

#include <stdio.h>
#include <string.h>

bool padding_is(const void *bytes, size_t n) {
    static const char fill[] = {'\0', '\t', '\n', '\r', ' ', 0x1a};
    const char *at = bytes;
    for (size_t i = 0; i < n; i++)
        if (!memchr(fill, at[i], sizeof fill)) return false;
    return true;
}

void padding_note(char note[PADDING_NOTE_BYTES], size_t n) {
    snprintf(note, PADDING_NOTE_BYTES, "bytes of padding after the data: %zu", n);
}
