/* The service's log.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/log.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#include "core/base/clock.h"

enum { LINE_BYTES = 1024, ESCAPED_BYTES = 4, KINDS = 64, SELDOM_MS = 1000 };

/* Lines of a kind that has been told lately are counted only. */
static struct {
    pthread_mutex_t lock;
    size_t count;
    struct {
        const char *format;
        enum log_level level;
        int64_t told_ms;
        uint64_t left_out;
    } kind[KINDS];
} seldom = {.lock = PTHREAD_MUTEX_INITIALIZER};

static size_t stamp(char *line, const char *level) {
    struct timespec now;
    struct tm tm;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &tm);
    size_t used = strftime(line, LINE_BYTES, "%Y-%m-%dT%H:%M:%S", &tm);
    return used + (size_t)snprintf(line + used, LINE_BYTES - used, ".%03ldZ %s ", now.tv_nsec / 1000000, level);
}

/* Copies a text; what isn't printable ASCII becomes \xXX, and a backslash too, so that each says one thing.  Returns
 * the copy's length; what doesn't fit is cut. */
static size_t escape(char *to, size_t bytes, const char *text, size_t count) {
    size_t used = 0;
    for (size_t i = 0; i < count && used + ESCAPED_BYTES < bytes; i++) {
        unsigned char c = (unsigned char)text[i];
        if (c >= 0x20 && c < 0x7f && c != '\\')
            to[used++] = (char)c;
        else
            used += (size_t)snprintf(to + used, bytes - used, "\\x%02X", c);
    }
    return used;
}

void log_vline(enum log_level level, const char *format, va_list args) {
    static const char *const names[] = {"info ", "warn ", "error"};
    char text[LINE_BYTES], line[2 * LINE_BYTES];
    int n = vsnprintf(text, sizeof text, format, args);
    size_t count = n < 0 ? 0 : (size_t)n < sizeof text ? (size_t)n : sizeof text - 1;
    if (count && text[count - 1] == '\n') count--; /* of a library's message */
    size_t used = stamp(line, names[level]);
    used += escape(line + used, sizeof line - used - 1, text, count);
    line[used++] = '\n';
    ssize_t ignored = write(STDERR_FILENO, line, used);
    (void)ignored; /* there is nobody left to tell */
}

void log_line(enum log_level level, const char *format, ...) {
    va_list args;
    va_start(args, format);
    log_vline(level, format, args);
    va_end(args);
}

static void tell_left_out(size_t kind) {
    if (seldom.kind[kind].left_out)
        log_line(seldom.kind[kind].level, "%llu more of these lines were left out: %.200s",
                 (unsigned long long)seldom.kind[kind].left_out, seldom.kind[kind].format);
    seldom.kind[kind].left_out = 0;
}

/* The table is full after KINDS kinds: all further ones are one. */
static size_t find_kind(const char *format) {
    size_t i = 0;
    while (i < seldom.count && seldom.kind[i].format != format) i++;
    if (i < seldom.count) return i;
    if (i == KINDS) return KINDS - 1;
    seldom.kind[i].format = format;
    seldom.kind[i].told_ms = INT64_MIN / 2;
    seldom.count++;
    return i;
}

void log_vline_seldom(enum log_level level, const char *format, va_list args) {
    int64_t now = clock_ms();
    pthread_mutex_lock(&seldom.lock);
    size_t kind = find_kind(format);
    if (now - seldom.kind[kind].told_ms < SELDOM_MS) {
        seldom.kind[kind].level = level;
        seldom.kind[kind].left_out++;
    } else {
        tell_left_out(kind);
        seldom.kind[kind].told_ms = now;
        log_vline(level, format, args);
    }
    pthread_mutex_unlock(&seldom.lock);
}

void log_line_seldom(enum log_level level, const char *format, ...) {
    va_list args;
    va_start(args, format);
    log_vline_seldom(level, format, args);
    va_end(args);
}

void log_catch_up(void) {
    int64_t now = clock_ms();
    pthread_mutex_lock(&seldom.lock);
    for (size_t i = 0; i < seldom.count; i++)
        if (now - seldom.kind[i].told_ms >= SELDOM_MS) tell_left_out(i);
    pthread_mutex_unlock(&seldom.lock);
}

void log_plain(char *to, size_t bytes, const char *text) {
    size_t used = 0;
    for (; *text && used + 4 < bytes; text++) {
        bool plain = *text > ' ' && *text < 0x7f && *text != '%';
        used += (size_t)snprintf(to + used, bytes - used, plain ? "%c" : "%%%02X", (unsigned char)*text);
    }
    to[used] = 0;
}
