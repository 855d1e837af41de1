/* The lines between whittle and whittled: encode, decode, and cutting a stream into lines.
 *
 * Both ends live in this file so that they can't drift apart.  Decoding trusts nothing: the worker handles hostile
 * files, and what it says may be the hostile file's words.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/shared/worker_protocol.h"

#include <assert.h>
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int wire_exit_status(enum status status) {
    static const int exits[STATUS_COUNT] = {
        [STATUS_OK] = 0,
        [STATUS_NO_MEMORY] = WIRE_EXIT_MEMORY,
        [STATUS_IO] = WIRE_EXIT_IO,
        [STATUS_UNSUPPORTED] = WIRE_EXIT_DATA,
        [STATUS_MALFORMED] = WIRE_EXIT_DATA,
        [STATUS_DEGENERATE] = WIRE_EXIT_DATA,
        [STATUS_BAD_PARAMETER] = WIRE_EXIT_PARAMETER,
        [STATUS_LIMIT] = WIRE_EXIT_DATA,
        [STATUS_CANCELLED] = WIRE_EXIT_CANCELLED,
        [STATUS_ENGINE] = WIRE_EXIT_ENGINE,
        [STATUS_NO_SPACE] = WIRE_EXIT_IO,
    };
    return (unsigned)status < STATUS_COUNT ? exits[status] : WIRE_EXIT_ENGINE;
}

/* ------------------------------------------------------------------------------------------------ encode */

/* A line being written; it always fits, by the assertions below. */
struct out {
    char *line;
    size_t used;
};

__attribute__((format(printf, 2, 3))) static void put(struct out *out, const char *format, ...) {
    va_list args;
    va_start(args, format);
    int n = vsnprintf(out->line + out->used, WIRE_LINE_BYTES - out->used, format, args);
    va_end(args);
    if (n > 0) out->used += (size_t)n;
    assert(out->used < WIRE_LINE_BYTES);
}

/* Text with '%', control characters and, where blanks is false, blanks as %XX. */
static void put_escaped(struct out *out, const char *text, bool blanks) {
    for (const char *p = text; *p; p++) {
        unsigned char c = (unsigned char)*p;
        bool plain = c >= 0x20 && c != 0x7f && c != '%' && (c != ' ' || blanks);
        put(out, plain ? "%c" : "%%%02X", c);
    }
}

/* One word: never empty, and never the mark of an empty one by accident. */
static void put_word(struct out *out, const char *word) {
    if (!word[0])
        put(out, "-");
    else if (strcmp(word, "-") == 0)
        put(out, "%%2D");
    else
        put_escaped(out, word, false);
}

static void put_progress(struct out *out, const struct wire_message *message) {
    double fraction = isfinite(message->fraction) ? fmin(fmax(message->fraction, 0), 1) : 0;
    put(out, "progress ");
    put_word(out, message->stage);
    put(out, " %.4f ", fraction);
    put_escaped(out, message->text, true);
}

static void put_failed(struct out *out, const struct error *error) {
    put(out, "failed %s %" PRIu64 " ", status_name(error->code), error->line);
    if (error->byte_offset == UINT64_MAX)
        put(out, "- ");
    else
        put(out, "%" PRIu64 " ", error->byte_offset);
    put_word(out, error->where);
    put(out, " ");
    put_escaped(out, error->text, true);
}

/* Escaping makes three bytes of one, and the longest message still fits. */
_Static_assert(3 * (ERROR_WHERE_BYTES + ERROR_TEXT_BYTES) + 128 < WIRE_LINE_BYTES, "a failed line fits");
_Static_assert(3 * (WIRE_STAGE_BYTES + WIRE_TEXT_BYTES) + 64 < WIRE_LINE_BYTES, "a progress line fits");

size_t wire_encode(const struct wire_message *message, char line[WIRE_LINE_BYTES]) {
    struct out out = {line, 0};
    switch (message->kind) {
    case WIRE_PROGRESS: put_progress(&out, message); break;
    case WIRE_FAILED: put_failed(&out, &message->error); break;
    case WIRE_DONE: put(&out, "done"); break;
    }
    put(&out, "\n");
    return out.used;
}

/* ------------------------------------------------------------------------------------------------ decode */

static int hex_digit(char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
                                  : -1;
}

/* Undoes escape() for length bytes; cuts what doesn't fit.  A broken escape or an escaped NUL is kept as it stands. */
static void unescape(const char *from, size_t length, char *to, size_t to_bytes) {
    size_t used = 0;
    for (size_t i = 0; i < length && used + 1 < to_bytes; i++) {
        int high = from[i] == '%' && i + 2 < length ? hex_digit(from[i + 1]) : -1;
        int low = high >= 0 ? hex_digit(from[i + 2]) : -1;
        int value = low >= 0 ? high * 16 + low : 0;
        to[used++] = value ? (char)value : from[i];
        if (value) i += 2;
    }
    to[used] = 0;
}

/* Takes the next word off *rest; false when there is none. */
static bool next_word(const char **rest, const char **word, size_t *length) {
    *word = *rest;
    *length = strcspn(*rest, " ");
    if (!*length) return false;
    *rest += *length;
    if (**rest == ' ') (*rest)++;
    return true;
}

static void unescape_word(const char *word, size_t length, char *to, size_t to_bytes) {
    if (length == 1 && word[0] == '-')
        to[0] = 0;
    else
        unescape(word, length, to, to_bytes);
}

static bool decode_unsigned(const char *word, size_t length, uint64_t *value) {
    char text[24], *end;
    if (length == 0 || length >= sizeof text || word[0] < '0' || word[0] > '9') return false;
    memcpy(text, word, length);
    text[length] = 0;
    errno = 0;
    *value = strtoull(text, &end, 10);
    return !errno && !*end;
}

static bool decode_progress(const char *rest, struct wire_message *message) {
    const char *word;
    size_t length;
    if (!next_word(&rest, &word, &length)) return false;
    unescape_word(word, length, message->stage, sizeof message->stage);
    if (!next_word(&rest, &word, &length)) return false;
    char *end;
    message->fraction = strtod(word, &end);
    if (end != word + length || !(message->fraction >= 0 && message->fraction <= 1)) return false;
    unescape(rest, strlen(rest), message->text, sizeof message->text);
    return true;
}

static bool decode_failed(const char *rest, struct error *error) {
    const char *word;
    size_t length;
    char name[32];
    if (!next_word(&rest, &word, &length)) return false;
    unescape(word, length, name, sizeof name);
    error->code = status_from_name(name);
    if (error->code == STATUS_OK) return false;
    if (!next_word(&rest, &word, &length) || !decode_unsigned(word, length, &error->line)) return false;
    if (!next_word(&rest, &word, &length)) return false;
    if (length == 1 && word[0] == '-')
        error->byte_offset = UINT64_MAX;
    else if (!decode_unsigned(word, length, &error->byte_offset))
        return false;
    if (!next_word(&rest, &word, &length)) return false;
    unescape_word(word, length, error->where, sizeof error->where);
    unescape(rest, strlen(rest), error->text, sizeof error->text);
    return true;
}

bool wire_decode(const char *line, struct wire_message *message) {
    struct wire_message found = {.error.byte_offset = UINT64_MAX};
    bool ok = false;
    if (strncmp(line, "progress ", 9) == 0)
        found.kind = WIRE_PROGRESS, ok = decode_progress(line + 9, &found);
    else if (strncmp(line, "failed ", 7) == 0)
        found.kind = WIRE_FAILED, ok = decode_failed(line + 7, &found.error);
    else if (strcmp(line, "done") == 0)
        found.kind = WIRE_DONE, ok = true;
    if (ok) *message = found;
    return ok;
}

/* ------------------------------------------------------------------------------------------------ stream */

static void end_line(struct wire_reader *reader, void (*found)(void *ctx, const struct wire_message *message),
                     void *ctx) {
    struct wire_message message;
    reader->line[reader->used] = 0;
    if (!reader->overlong && wire_decode(reader->line, &message)) found(ctx, &message);
    reader->used = 0;
    reader->overlong = false;
}

void wire_read(struct wire_reader *reader, const char *bytes, size_t count,
               void (*found)(void *ctx, const struct wire_message *message), void *ctx) {
    for (size_t i = 0; i < count; i++) {
        if (bytes[i] == '\n')
            end_line(reader, found, ctx);
        else if (reader->used + 1 < sizeof reader->line)
            reader->line[reader->used++] = bytes[i];
        else
            reader->overlong = true;
    }
}
