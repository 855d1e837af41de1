/* Names of statuses, and filling of errors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/status.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static const char *const names[STATUS_COUNT] = {"ok",         "no-memory",     "io",    "unsupported", "malformed",
                                                "degenerate", "bad-parameter", "limit", "cancelled",   "engine",
                                                "no-space"};

const char *status_name(enum status status) { return (unsigned)status < STATUS_COUNT ? names[status] : "unknown"; }

enum status status_from_name(const char *name) {
    for (int i = 0; i < STATUS_COUNT; i++)
        if (strcmp(names[i], name) == 0) return (enum status)i;
    return STATUS_ENGINE;
}

enum status status_from_errno(int number) {
    return number == ENOSPC || number == EDQUOT || number == EFBIG ? STATUS_NO_SPACE : STATUS_IO;
}

static void fill(struct error *error, enum status code, const char *where, uint64_t line, uint64_t byte_offset) {
    error->code = code;
    error->line = line;
    error->byte_offset = byte_offset;
    snprintf(error->where, sizeof error->where, "%s", where ? where : "");
}

enum status error_set(struct error *error, enum status code, const char *where, const char *format, ...) {
    if (!error) return code;
    fill(error, code, where, 0, UINT64_MAX);
    va_list args;
    va_start(args, format);
    vsnprintf(error->text, sizeof error->text, format, args);
    va_end(args);
    return code;
}

enum status error_set_at(struct error *error, enum status code, const char *where, uint64_t line, uint64_t byte_offset,
                         const char *format, ...) {
    if (!error) return code;
    fill(error, code, where, line, byte_offset);
    va_list args;
    va_start(args, format);
    vsnprintf(error->text, sizeof error->text, format, args);
    va_end(args);
    return code;
}
