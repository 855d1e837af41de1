/* The log: lines can't be forged, and none comes oftener than it may.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/log.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

enum { SEEN_BYTES = 65536, STAMP_BYTES = 31 /* 2026-01-31T12:00:00.123Z info  */ };

static int stderr_before;
static FILE *caught;
static char seen[SEEN_BYTES];

static int catch_lines(void **state) {
    (void)state;
    caught = tmpfile();
    stderr_before = dup(STDERR_FILENO);
    return caught && stderr_before >= 0 && dup2(fileno(caught), STDERR_FILENO) >= 0 ? 0 : -1;
}

static int let_lines(void **state) {
    (void)state;
    dup2(stderr_before, STDERR_FILENO);
    close(stderr_before);
    fclose(caught);
    return 0;
}

/* What was written so far. */
static const char *read_lines(void) {
    ssize_t n = pread(fileno(caught), seen, sizeof seen - 1, 0);
    seen[n > 0 ? n : 0] = 0;
    return seen;
}

static size_t count_lines(const char *text) {
    size_t count = 0;
    for (const char *at = read_lines(); (at = strstr(at, text)); at++) count++;
    return count;
}

static void bytes_that_are_not_printable_are_written_out(void **state) {
    (void)state;
    log_line(LOG_INFO, "%s", "a\nb\r\x1b[31m\x7f\x80\xc3\xbc\xff\\x41 end\n");
    assert_string_equal(read_lines() + STAMP_BYTES, "a\\x0Ab\\x0D\\x1B[31m\\x7F\\x80\\xC3\\xBC\\xFF\\x5Cx41 end\n");
}

static void a_line_of_any_length_is_one_line(void **state) {
    char text[5000];
    (void)state;
    memset(text, 0x9b, sizeof text - 1);
    text[sizeof text - 1] = 0;
    log_line(LOG_ERROR, "%s", text);
    memset(text, 'x', sizeof text - 1);
    log_line(LOG_ERROR, "%s", text);
    assert_int_equal(count_lines("\n"), 2);
    assert_int_equal(read_lines()[strlen(seen) - 1], '\n');
    assert_null(strchr(seen, 0x9b));
}

static double clock_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

/* However long it takes: at most one line each second, and each is told or counted. */
static void what_comes_often_is_told_once_a_second_and_counted(void **state) {
    enum { LINES = 20000 };
    (void)state;
    double begin = clock_s();
    for (unsigned i = 0; i < LINES; i++) log_line_seldom(LOG_WARNING, "the disk is full (%u)", i);
    log_line_seldom(LOG_WARNING, "something else");
    double took = clock_s() - begin;
    assert_in_range(count_lines("the disk is full ("), 1, (uintmax_t)took + 1 + count_lines("left out"));
    assert_int_equal(count_lines("something else"), 1);
    while (clock_s() - begin < took + 1.1) log_catch_up();
    unsigned long long left_out = 0;
    size_t told = 0;
    for (const char *at = read_lines(); *at; at = strchr(at, '\n') + 1) {
        const char *number = strstr(at, "warn  ") + strlen("warn  ");
        bool counts = strtoull(number, NULL, 10) > 0;
        left_out += strtoull(number, NULL, 10);
        told += !counts && strncmp(number, "the disk is full", 16) == 0;
    }
    assert_int_equal(told + left_out, LINES);
    size_t before = count_lines("\n");
    log_catch_up();
    assert_int_equal(count_lines("\n"), before);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(bytes_that_are_not_printable_are_written_out, catch_lines, let_lines),
        cmocka_unit_test_setup_teardown(a_line_of_any_length_is_one_line, catch_lines, let_lines),
        cmocka_unit_test_setup_teardown(what_comes_often_is_told_once_a_second_and_counted, catch_lines, let_lines),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
