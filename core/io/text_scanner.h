/* A cursor over text: lines, words and numbers, for the readers of text formats.
 *
 * \n, \r and \r\n all end a line; spaces, tabs, \v and \f stand between words.  Nothing is copied or allocated.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_TEXT_SCANNER_H
#define WHITTLE_CORE_IO_TEXT_SCANNER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/text/number.h"

struct scan {
    const char *begin, *at, *end;
    uint64_t line; /* which one at is on, from 1 */
    char comment;  /* begins a comment up to the end of the line; 0 = there are none */
    bool joins;    /* a backslash at the end of a line joins the next one to it */
};

struct scan_word {
    const char *text; /* in the text that is scanned; no NUL follows */
    size_t n;
};

/* Classes of characters, for readers that split lines in their own way. */
static inline bool scan_is_blank(char c) { return c == ' ' || c == '\t'; }
static inline bool scan_is_quote(char c) { return c == '"' || c == '\''; }
static inline bool scan_is_newline(char c) { return c == '\n' || c == '\r'; }

/* Whether the text from .. stop stands in brackets, as units of columns do: [m], (m). */
static inline bool scan_is_bracketed(const char *from, const char *stop) {
    return stop - from >= 2 && ((*from == '[' && stop[-1] == ']') || (*from == '(' && stop[-1] == ')'));
}

/* At the beginning of n bytes, after a byte order mark; the text ends before a mark of its end (DOS has one). */
struct scan scan_start(const void *bytes, size_t n);

/* The next word on this line; false at its end. */
bool scan_word(struct scan *scan, struct scan_word *word);

/* The next word on this line or a later one; false at the end of the text. */
bool scan_token(struct scan *scan, struct scan_word *word);

/* Goes to the beginning of the next line. */
void scan_next_line(struct scan *scan);

/* How many words are left on this line. */
size_t scan_count_words(struct scan scan);

/* Whether the word is this text. */
bool scan_is(const struct scan_word *word, const char *text);

/* The same in capitals or not. */
bool scan_is_any_case(const struct scan_word *word, const char *text);

/* The whole word as a number, or as a whole number (decimal digits alone, with a sign for the latter).  False: it isn't
 * one, or it doesn't fit; *value is untouched. */
bool scan_f64(const struct scan_word *word, double *value);
bool scan_f32(const struct scan_word *word, float *value);
bool scan_u64(const struct scan_word *word, uint64_t *value);
bool scan_i64(const struct scan_word *word, int64_t *value);

/* The word for an error message. */
const char *scan_quote(const struct scan_word *word, char quote[NUMBER_QUOTE_BYTES]);

#endif
