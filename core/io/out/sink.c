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
    *sink = (struct sink){.fd = fd, .capacity = BUFFER_BYTES, .buffer = alloc_array(BUFFER_BYTES, 1)};
    return sink->buffer ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status sink_init_memory(struct sink *sink) { return sink_init(sink, -1); }

void sink_restart(struct sink *sink) {
    sink->used = 0;
    sink->failure = 0;
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

/* Memory for n bytes more, and as much again; where there is none, what was put is forgotten. */
static void grow(struct sink *sink, size_t n) {
    size_t capacity = 2 * (sink->used + n);
    unsigned char *buffer = alloc_resize(sink->buffer, capacity, 1);
    if (!buffer) {
        sink->failure = ENOMEM;
        sink->used = 0;
        return;
    }
    sink->buffer = buffer;
    sink->capacity = capacity;
}

/* Where there is no room for n bytes; for more than the buffer has there may be none after it. */
static void make_room(struct sink *sink, size_t n) {
    if (sink->capacity - sink->used >= n) return;
    if (sink->fd >= 0)
        flush(sink);
    else
        grow(sink, n);
}

unsigned char *sink_reserve(struct sink *sink, size_t n) {
    assert(n <= MOST_RESERVED);
    make_room(sink, n);
    return sink->buffer + sink->used;
}

void sink_advance(struct sink *sink, size_t n) { sink->used += n; }

void sink_bytes(struct sink *sink, const void *bytes, size_t n) {
    make_room(sink, n);
    if (n > sink->capacity) {
        if (sink->fd >= 0) write_all(sink, bytes, n);
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
    if (sink->capacity && !sink->buffer) error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    if (!status && sink->buffer && sink->fd >= 0) flush(sink);
    if (!status && sink->failure)
        status =
            error_set(error, status_from_errno(sink->failure), "write", "can't write: %s", strerror(sink->failure));
    free(sink->buffer);
    *sink = (struct sink){0};
    return status;
}
