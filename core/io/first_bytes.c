/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/first_bytes.h"

#include <string.h>
#include <strings.h>

#include "core/io/padding.h"

static bool has_control_character(const char *text, size_t n) {
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)text[i] < 32 && !(text[i] >= '\t' && text[i] <= '\r')) return true;
    return false;
}

struct first_bytes first_bytes_of(const void *bytes, size_t n) {
    struct first_bytes first = {.text = bytes, .n = n, .looked = n < FIRST_BYTES_LOOK ? n : FIRST_BYTES_LOOK};
    first.is_text = !has_control_character(first.text, first.looked < n ? first.looked : padding_text_bytes(bytes, n));
    return first;
}

bool first_begins(const struct first_bytes *first, const char *beginning, size_t bytes) {
    return first->n >= bytes && memcmp(first->text, beginning, bytes) == 0;
}

bool first_contains(const struct first_bytes *first, const char *word) {
    size_t bytes = strlen(word);
    for (size_t i = 0; i + bytes <= first->looked; i++)
        if (strncasecmp(first->text + i, word, bytes) == 0) return true;
    return false;
}

bool first_word(const struct first_bytes *first, struct scan_word *word, struct scan *rest) {
    *rest = scan_start(first->text, first->n < FIRST_BYTES_LONG_LOOK ? first->n : FIRST_BYTES_LONG_LOOK);
    rest->comment = '#';
    return scan_token(rest, word);
}
