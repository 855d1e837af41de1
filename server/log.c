/* The service's log.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/log.h"

#include <stdbool.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

enum { LINE_BYTES = 1024 };

static size_t stamp(char *line, const char *level) {
    struct timespec now;
    struct tm tm;
    clock_gettime(CLOCK_REALTIME, &now);
    gmtime_r(&now.tv_sec, &tm);
    size_t used = strftime(line, LINE_BYTES, "%Y-%m-%dT%H:%M:%S", &tm);
    return used + (size_t)snprintf(line + used, LINE_BYTES - used, ".%03ldZ %s ", now.tv_nsec / 1000000, level);
}

void log_vline(enum log_level level, const char *format, va_list args) {
    static const char *const names[] = {"info ", "warn ", "error"};
    char line[LINE_BYTES];
    size_t start = stamp(line, names[level]);
    int n = vsnprintf(line + start, sizeof line - start - 1, format, args);
    size_t used = start + (n < 0 ? 0 : (size_t)n);
    if (used > sizeof line - 2) used = sizeof line - 2;
    if (used > start && line[used - 1] == '\n') used--; /* of a library's message */
    for (size_t i = start; i < used; i++)
        if ((unsigned char)line[i] < 0x20 || line[i] == 0x7f) line[i] = '?';
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

void log_plain(char *to, size_t bytes, const char *text) {
    size_t used = 0;
    for (; *text && used + 4 < bytes; text++) {
        bool plain = *text > ' ' && *text < 0x7f && *text != '%';
        used += (size_t)snprintf(to + used, bytes - used, plain ? "%c" : "%%%02X", (unsigned char)*text);
    }
    to[used] = 0;
}
