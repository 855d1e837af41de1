/* The lines between whittle and whittled: what goes in comes out, and nothing else does.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/shared/worker_protocol.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static void assert_same(const struct wire_message *a, const struct wire_message *b) {
    assert_int_equal(a->kind, b->kind);
    assert_string_equal(a->stage, b->stage);
    assert_string_equal(a->text, b->text);
    assert_true(a->fraction > b->fraction - 1e-4 && a->fraction < b->fraction + 1e-4);
    assert_int_equal(a->error.code, b->error.code);
    assert_int_equal(a->error.line, b->error.line);
    assert_int_equal(a->error.byte_offset, b->error.byte_offset);
    assert_string_equal(a->error.where, b->error.where);
    assert_string_equal(a->error.text, b->error.text);
}

static void assert_round_trip(const struct wire_message *message) {
    char line[WIRE_LINE_BYTES];
    struct wire_message back;
    size_t length = wire_encode(message, line);
    assert_int_equal(strlen(line), length);
    assert_ptr_equal(strchr(line, '\n'), line + length - 1); /* one line, whatever the texts hold */
    line[length - 1] = 0;
    assert_true(wire_decode(line, &back));
    assert_same(&back, message);
}

static void progress_round_trip(void **state) {
    (void)state;
    struct wire_message message = {
        .kind = WIRE_PROGRESS, .fraction = 0.4217, .stage = "contract", .error.byte_offset = UINT64_MAX};
    assert_round_trip(&message);
    snprintf(message.text, sizeof message.text, "contracting 12 043 of 43 637 (100 %%)");
    assert_round_trip(&message);
    message.stage[0] = 0;
    assert_round_trip(&message);
    snprintf(message.stage, sizeof message.stage, "-");
    assert_round_trip(&message);
}

static void failure_round_trip_with_hostile_texts(void **state) {
    (void)state;
    struct wire_message message = {.kind = WIRE_FAILED};
    error_set_at(&message.error, STATUS_MALFORMED, "two words\n%", 17, 0, "bad\nline\tand 50%% of %%0A");
    assert_round_trip(&message);
    message.error.byte_offset = UINT64_MAX;
    message.error.where[0] = 0;
    assert_round_trip(&message);
    memset(message.error.where, '\n', sizeof message.error.where - 1);
    memset(message.error.text, '%', sizeof message.error.text - 1);
    message.error.where[sizeof message.error.where - 1] = 0;
    message.error.text[sizeof message.error.text - 1] = 0;
    assert_round_trip(&message);
}

static void done_round_trip(void **state) {
    (void)state;
    struct wire_message message = {.kind = WIRE_DONE, .error.byte_offset = UINT64_MAX};
    assert_round_trip(&message);
}

static void what_is_no_message_is_refused(void **state) {
    (void)state;
    static const char *const lines[] = {"",
                                        "hello",
                                        "done ",
                                        "done!",
                                        "progress",
                                        "progress ",
                                        "progress a",
                                        "progress a b c",
                                        "progress a 1.5 c",
                                        "progress a -1 c",
                                        "progress a nan c",
                                        "failed",
                                        "failed engine",
                                        "failed ok 0 - - text",
                                        "failed engine -1 - - text",
                                        "failed engine 1 x - text",
                                        "failed engine 99999999999999999999 - - text",
                                        "failed engine 1 -"};
    struct wire_message message;
    for (size_t i = 0; i < sizeof lines / sizeof *lines; i++) {
        memset(&message, 0x5a, sizeof message);
        assert_false(wire_decode(lines[i], &message));
        assert_int_equal(((unsigned char *)&message)[0], 0x5a); /* untouched */
    }
}

static void broken_escapes_stay_text(void **state) {
    (void)state;
    struct wire_message message;
    assert_true(wire_decode("progress a 0.5 50% %zz %0", &message));
    assert_string_equal(message.text, "50% %zz %0");
    assert_true(wire_decode("progress a 0.5 nul %00 here", &message));
    assert_string_equal(message.text, "nul %00 here");
}

static void count_message(void *ctx, const struct wire_message *message) {
    (void)message;
    ++*(int *)ctx;
}

static void a_stream_is_cut_into_lines(void **state) {
    (void)state;
    struct wire_reader reader = {0};
    const char *stream = "progress a 0.1 x\nnoise\nprogress b 0.2\ndone\n";
    int count = 0;
    for (size_t i = 0; i < strlen(stream); i++) wire_read(&reader, stream + i, 1, count_message, &count);
    assert_int_equal(count, 3);
}

static void an_overlong_line_is_skipped_whole(void **state) {
    (void)state;
    struct wire_reader reader = {0};
    char noise[3 * WIRE_LINE_BYTES];
    memset(noise, 'x', sizeof noise);
    int count = 0;
    wire_read(&reader, noise, sizeof noise, count_message, &count);
    wire_read(&reader, "\ndone\n", 6, count_message, &count);
    assert_int_equal(count, 1);
}

static void every_status_has_an_exit(void **state) {
    (void)state;
    assert_int_equal(wire_exit_status(STATUS_OK), 0);
    for (int i = 1; i < STATUS_COUNT; i++) assert_int_not_equal(wire_exit_status((enum status)i), 0);
    assert_int_equal(wire_exit_status(STATUS_MALFORMED), 65);
    assert_int_equal(wire_exit_status(STATUS_CANCELLED), 75);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(progress_round_trip),
        cmocka_unit_test(failure_round_trip_with_hostile_texts),
        cmocka_unit_test(done_round_trip),
        cmocka_unit_test(what_is_no_message_is_refused),
        cmocka_unit_test(broken_escapes_stay_text),
        cmocka_unit_test(a_stream_is_cut_into_lines),
        cmocka_unit_test(an_overlong_line_is_skipped_whole),
        cmocka_unit_test(every_status_has_an_exit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
