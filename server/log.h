/* The service's log: one line for each request and each transition, on standard error.
 *
 *     2026-01-31T12:00:00.123Z info  job=0198… accepted -> running attempt=1
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_LOG_H
#define WHITTLE_SERVER_LOG_H

#include <stdarg.h>
#include <stddef.h>

enum log_level { LOG_INFO, LOG_WARNING, LOG_ERROR };

/* Writes one line with one write(2), so that threads don't mix theirs.  Control characters become '?': what a client
 * sends can't forge a line. */
void log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));
void log_vline(enum log_level level, const char *format, va_list args) __attribute__((format(printf, 2, 0)));

/* Copies a text of a client's for use as a value in a line: blanks and what isn't ASCII, which would look like other
 * things there, become %XX; cut where it doesn't fit. */
void log_plain(char *to, size_t bytes, const char *text);

#endif
