/* The service's log: one line for each request and each transition, on standard error.
 *
 *     2026-01-31T12:00:00.123Z info  job=0198… accepted -> running attempt=1
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_LOG_H
#define WHITTLE_SERVER_BASE_LOG_H

#include <stdarg.h>
#include <stddef.h>

enum log_level { LOG_INFO, LOG_WARNING, LOG_ERROR };

/* Writes one line with one write(2), so that threads don't mix theirs.  What isn't printable ASCII becomes \xXX
 * (and so does a backslash): what a client sends can neither forge a line nor speak to a terminal. */
void log_line(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));
void log_vline(enum log_level level, const char *format, va_list args) __attribute__((format(printf, 2, 0)));

/* The same for what may come as often as it likes, such as a library's complaints: one line a second of each kind,
 * which is its format.  How many were left out is told before the next one, or by log_catch_up, to be called now and
 * then. */
void log_line_seldom(enum log_level level, const char *format, ...) __attribute__((format(printf, 2, 3)));
void log_vline_seldom(enum log_level level, const char *format, va_list args) __attribute__((format(printf, 2, 0)));
void log_catch_up(void);

/* Copies a text of a client's for use as a value in a line: blanks and what isn't ASCII, which would look like other
 * things there, become %XX; cut where it doesn't fit. */
void log_plain(char *to, size_t bytes, const char *text);

#endif
