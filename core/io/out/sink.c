/* Buffered writing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/sink.h"

#include <assert.h>
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"

enum { BUFFER_BYTES = 256 * 1024, MOST_RESERVED = 4096 };

enum status sink_init(struct sink *sink, int fd) {
    *sink = (struct sink){.fd = fd, .buffer = alloc_array(BUFFER_BYTES, 1)};
    return sink->buffer ? STATUS_OK : STATUS_NO_MEMORY;
}

static void write_all(struct sink *sink, const unsigned char *bytes, size_t n) {
    while (n > 0 && !sink->failure) {
        ssize_t wrote = fault_at("file-write") ? -1 : write(sink->fd, bytes, n);
        if (wrote < 0 && errno != EINTR) sink->failure = errno;
        if (wrote > 0) bytes += wrote, n -= (size_t)wrote;
    }
}

static void flush(struct sink *sink) {
    write_all(sink, sink->buffer, sink->used);
    sink->used = 0;
}

unsigned char *sink_reserve(struct sink *sink, size_t n) {
    assert(n <= MOST_RESERVED);
    if (BUFFER_BYTES - sink->used < n) flush(sink);
    return sink->buffer + sink->used;
}

void sink_advance(struct sink *sink, size_t n) { sink->used += n; }

void sink_bytes(struct sink *sink, const void *bytes, size_t n) {
    if (BUFFER_BYTES - sink->used < n) flush(sink);
    if (n > BUFFER_BYTES) {
        write_all(sink, bytes, n);
    } else {
        memcpy(sink->buffer + sink->used, bytes, n);
        sink->used += n;
    }
}

void sink_text(struct sink *sink, const char *text) { sink_bytes(sink, text, strlen(text)); }

void sink_format(struct sink *sink, const char *format, ...) {
    va_list args;
    va_start(args, format);
    int n = vsnprintf((char *)sink_reserve(sink, MOST_RESERVED), MOST_RESERVED, format, args);
    va_end(args);
    assert(n >= 0 && n < MOST_RESERVED);
    sink_advance(sink, (size_t)n);
}

void sink_rewrite(struct sink *sink, const void *bytes, size_t n, off_t at) {
    flush(sink);
    while (n > 0 && !sink->failure) {
        ssize_t wrote = fault_at("file-write") ? -1 : pwrite(sink->fd, bytes, n, at);
        if (wrote < 0 && errno != EINTR) sink->failure = errno;
        if (wrote > 0) bytes = (const unsigned char *)bytes + wrote, n -= (size_t)wrote, at += wrote;
    }
}

enum status sink_done(struct sink *sink, enum status status, struct error *error) {
    if (!status && sink->buffer) flush(sink);
    if (!status && sink->failure)
        status =
            error_set(error, status_from_errno(sink->failure), "write", "can't write: %s", strerror(sink->failure));
    free(sink->buffer);
    *sink = (struct sink){0};
    return status;
}
