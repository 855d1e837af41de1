/* What whittle says to whittled over the inherited descriptor: lines of text, one message each.
 *
 *     progress STAGE FRACTION MESSAGE...                         how far the whole job is, 0 to 1
 *     failed STATUS_NAME LINE BYTE_OFFSET WHERE TEXT...          the struct error that ended it
 *     done                                                       every output is written
 *
 * STAGE and WHERE are one word: '%', blanks and control characters are written %XX, and an empty word as '-'.  MESSAGE
 * and TEXT reach to the end of the line, with '%' and control characters written %XX.  LINE 0 and BYTE_OFFSET - mean
 * that the position isn't known.  A line is WIRE_LINE_BYTES at most; a reader ignores what it can't decode, so either
 * program may be the newer one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_SHARED_WORKER_PROTOCOL_H
#define WHITTLE_SERVER_SHARED_WORKER_PROTOCOL_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"

enum wire_kind { WIRE_PROGRESS, WIRE_FAILED, WIRE_DONE };

enum { WIRE_STAGE_BYTES = 32, WIRE_TEXT_BYTES = 256, WIRE_LINE_BYTES = 2048 };

struct wire_message {
    enum wire_kind kind;
    double fraction;              /* progress */
    char stage[WIRE_STAGE_BYTES]; /* progress */
    char text[WIRE_TEXT_BYTES];   /* progress: for people; may be empty */
    struct error error;           /* failed */
};

/* Exit statuses of whittle, those of <sysexits.h>; 0 is success. */
enum {
    WIRE_EXIT_PARAMETER = 64,
    WIRE_EXIT_DATA = 65,
    WIRE_EXIT_NO_INPUT = 66,
    WIRE_EXIT_ENGINE = 70,
    WIRE_EXIT_MEMORY = 71,
    WIRE_EXIT_NO_OUTPUT = 73,
    WIRE_EXIT_IO = 74,
    WIRE_EXIT_CANCELLED = 75
};

/* The exit status that goes with a status. */
int wire_exit_status(enum status status);

/* Writes the message as one line, newline and NUL included.  Returns its length without the NUL. */
size_t wire_encode(const struct wire_message *message, char line[WIRE_LINE_BYTES]);

/* Reads one line (without its newline, NUL-terminated).  false, and *message as it was, when it is no message. */
bool wire_decode(const char *line, struct wire_message *message);

/* Cuts a stream of bytes into lines.  Zero-initialise. */
struct wire_reader {
    char line[WIRE_LINE_BYTES];
    size_t used;
    bool overlong; /* what remains of a line that was too long is being skipped */
};

/* Gives bytes to the reader; found(ctx, message) is called for each message completed by them. */
void wire_read(struct wire_reader *reader, const char *bytes, size_t count,
               void (*found)(void *ctx, const struct wire_message *message), void *ctx);

#endif
