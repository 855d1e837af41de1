/* Statuses and errors: how every stage says what went wrong.
 *
 * Kernels (vec3, sym3, quadric, heap) can't fail.  Stages return an enum status and leave their outputs untouched when
 * it isn't STATUS_OK.  Edges (files, shims, the pipeline) also fill a struct error on the caller's stack, so that a
 * message can say where and what.  Nothing here allocates.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_STATUS_H
#define WHITTLE_CORE_BASE_STATUS_H

#include <stdint.h>

/* A closed list.  The names (status_name) are part of the protocol between whittle and whittled and of exit statuses:
 * add at the end, never renumber. */
enum status {
    STATUS_OK = 0,
    STATUS_NO_MEMORY,     /* an allocation failed */
    STATUS_IO,            /* the operating system refused a read or a write */
    STATUS_UNSUPPORTED,   /* the content is of no format that we read */
    STATUS_MALFORMED,     /* the format is known, the content breaks it; line or byte_offset say where */
    STATUS_DEGENERATE,    /* too few distinct points, or all on one line or plane where a mesh is asked for */
    STATUS_BAD_PARAMETER, /* unknown, out of range, or in conflict with another one */
    STATUS_LIMIT,         /* over a named limit */
    STATUS_CANCELLED,     /* the tick callback asked to stop */
    STATUS_ENGINE,        /* a library threw or an invariant broke: our fault */
    STATUS_NO_SPACE       /* the disk, a quota or the length that a file may have is used up */
};
#define STATUS_COUNT 11

enum { ERROR_WHERE_BYTES = 64, ERROR_TEXT_BYTES = 320 };

/* Zero-initialise.  line counts from 1; 0 = not known.  byte_offset counts from 0; UINT64_MAX = not known. */
struct error {
    enum status code;
    uint64_t line;
    uint64_t byte_offset;
    char where[ERROR_WHERE_BYTES]; /* a stage, a parameter or a property */
    char text[ERROR_TEXT_BYTES];   /* a sentence for people, without a full stop */
};

/* Lower-case name, e.g. "malformed".  Never NULL; "unknown" outside the list. */
const char *status_name(enum status status);

/* The status whose name this is, or STATUS_ENGINE when there is none. */
enum status status_from_name(const char *name);

/* The status of a refused write or open by its errno: STATUS_NO_SPACE (ENOSPC, EDQUOT, EFBIG), else STATUS_IO. */
enum status status_from_errno(int number);

/* Fills error (may be NULL) with code, where and a printf-formatted text, position unknown, and returns code.  Text
 * that doesn't fit is cut. */
enum status error_set(struct error *error, enum status code, const char *where, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

/* The same with a position: line (0 = unknown) and byte_offset (UINT64_MAX = unknown). */
enum status error_set_at(struct error *error, enum status code, const char *where, uint64_t line, uint64_t byte_offset,
                         const char *format, ...) __attribute__((format(printf, 6, 7)));

#define MUST_CHECK __attribute__((warn_unused_result))

#endif
