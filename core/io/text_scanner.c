/* A cursor over text.
 *
 * Invariant: begin <= at <= end, and line is one more than the line ends before at.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/text_scanner.h"

#include <string.h>
#include <strings.h>

#include "core/io/padding.h"

static bool is_newline(char c) { return c == '\n' || c == '\r'; }
static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }

struct scan scan_start(const void *bytes, size_t n) {
    const char *text = bytes;
    struct scan scan = {.begin = text, .at = text, .end = text + padding_text_bytes(text, n), .line = 1};
    if (n >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0) scan.at += 3;
    return scan;
}

static void pass_newline(struct scan *scan) {
    if (*scan->at == '\r' && scan->at + 1 < scan->end && scan->at[1] == '\n') scan->at++;
    scan->at++;
    scan->line++;
}

static bool at_join(const struct scan *scan) {
    return scan->joins && scan->end - scan->at >= 2 && *scan->at == '\\' && is_newline(scan->at[1]);
}

static void skip_blanks(struct scan *scan) {
    for (; scan->at < scan->end; scan->at++) {
        if (at_join(scan)) {
            scan->at++;
            pass_newline(scan);
            scan->at--;
        } else if (!is_blank(*scan->at)) {
            break;
        }
    }
    if (scan->comment && scan->at < scan->end && *scan->at == scan->comment)
        while (scan->at < scan->end && !is_newline(*scan->at)) scan->at++;
}

static bool ends_word(const struct scan *scan) {
    char c = *scan->at;
    return is_blank(c) || is_newline(c) || at_join(scan) || (scan->comment && c == scan->comment);
}

bool scan_word(struct scan *scan, struct scan_word *word) {
    skip_blanks(scan);
    const char *from = scan->at;
    while (scan->at < scan->end && !ends_word(scan)) scan->at++;
    *word = (struct scan_word){from, (size_t)(scan->at - from)};
    return word->n > 0;
}

bool scan_token(struct scan *scan, struct scan_word *word) {
    while (!scan_word(scan, word)) {
        if (scan->at == scan->end) return false;
        pass_newline(scan);
    }
    return true;
}

void scan_next_line(struct scan *scan) {
    while (scan->at < scan->end && !is_newline(*scan->at)) scan->at++;
    if (scan->at < scan->end) pass_newline(scan);
}

size_t scan_count_words(struct scan scan) {
    struct scan_word word;
    size_t n = 0;
    while (scan_word(&scan, &word)) n++;
    return n;
}

bool scan_is(const struct scan_word *word, const char *text) {
    return strlen(text) == word->n && memcmp(word->text, text, word->n) == 0;
}

bool scan_is_any_case(const struct scan_word *word, const char *text) {
    return word->n == strlen(text) && strncasecmp(word->text, text, word->n) == 0;
}

bool scan_f64(const struct scan_word *word, double *value) {
    double read;
    if (!word->n || number_parse_f64(word->text, word->text + word->n, &read) != word->text + word->n) return false;
    *value = read;
    return true;
}

bool scan_f32(const struct scan_word *word, float *value) {
    float read;
    if (!word->n || number_parse_f32(word->text, word->text + word->n, &read) != word->text + word->n) return false;
    *value = read;
    return true;
}

bool scan_u64(const struct scan_word *word, uint64_t *value) {
    uint64_t n = 0;
    for (size_t i = 0; i < word->n; i++) {
        unsigned digit = (unsigned)(word->text[i] - '0');
        if (digit > 9 || __builtin_mul_overflow(n, 10u, &n) || __builtin_add_overflow(n, digit, &n)) return false;
    }
    if (!word->n) return false;
    *value = n;
    return true;
}

bool scan_i64(const struct scan_word *word, int64_t *value) {
    bool negative = word->n && word->text[0] == '-', sign = negative || (word->n && word->text[0] == '+');
    struct scan_word digits = {word->text + sign, word->n - sign};
    uint64_t n;
    if (!scan_u64(&digits, &n) || n > INT64_MAX) return false;
    *value = negative ? -(int64_t)n : (int64_t)n;
    return true;
}

const char *scan_quote(const struct scan_word *word, char quote[NUMBER_QUOTE_BYTES]) {
    return number_quote(word->text, word->text + word->n, quote);
}
