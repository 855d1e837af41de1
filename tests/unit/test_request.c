/* What headers say: ranges, preferences, entity tags.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/request.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static enum request_range range(const char *header, uint64_t bytes, uint64_t *first, uint64_t *last) {
    struct request request = {.header[HEADER_RANGE] = header};
    return request_range(&request, bytes, first, last);
}

static void assert_range(const char *header, uint64_t first, uint64_t last) {
    uint64_t f, l;
    assert_int_equal(range(header, 100, &f, &l), RANGE_ONE);
    assert_int_equal(f, first);
    assert_int_equal(l, last);
}

static void one_range(void **state) {
    (void)state;
    assert_range("bytes=0-0", 0, 0);
    assert_range("bytes=0-99", 0, 99);
    assert_range("bytes=99-", 99, 99);
    assert_range("bytes=50-1000", 50, 99);
    assert_range("bytes=-1", 99, 99);
    assert_range("bytes=-100", 0, 99);
    assert_range("bytes=-18446744073709551615", 0, 99);
    assert_range("Bytes=5-18446744073709551615", 5, 99);
}

static void ranges_outside(void **state) {
    (void)state;
    uint64_t f, l;
    assert_int_equal(range("bytes=100-", 100, &f, &l), RANGE_UNSATISFIABLE);
    assert_int_equal(range("bytes=-0", 100, &f, &l), RANGE_UNSATISFIABLE);
    assert_int_equal(range("bytes=0-", 0, &f, &l), RANGE_UNSATISFIABLE);
    assert_int_equal(range("bytes=-5", 0, &f, &l), RANGE_UNSATISFIABLE);
}

static void what_is_no_range_means_everything(void **state) {
    (void)state;
    static const char *const headers[] = {NULL,         "",
                                          "bytes",      "bytes=",
                                          "bytes=-",    "bytes=5",
                                          "bytes=5-4",  "bytes=1-2,3-",
                                          "bytes= 1-2", "bytes=+1-2",
                                          "bytes=1--2", "bytes=1-2x",
                                          "chars=1-2",  "bytes=0x1-0x2",
                                          "bytes=--5",  "bytes=99999999999999999999-"};
    uint64_t f, l;
    for (size_t i = 0; i < sizeof headers / sizeof *headers; i++)
        assert_int_equal(range(headers[i], 100, &f, &l), RANGE_NONE);
}

static int64_t wait_of(const char *prefer) {
    struct request request = {.header[HEADER_PREFER] = prefer};
    return request_prefer_wait_ms(&request, 60000);
}

static bool is_async(const char *prefer) {
    struct request request = {.header[HEADER_PREFER] = prefer};
    return request_prefers_async(&request);
}

static void preferences(void **state) {
    (void)state;
    assert_int_equal(wait_of(NULL), -1);
    assert_int_equal(wait_of("wait=5"), 5000);
    assert_int_equal(wait_of("wait=0"), 0);
    assert_int_equal(wait_of("respond-async, wait=10"), 10000);
    assert_int_equal(wait_of("Wait = \"7\""), 7000);
    assert_int_equal(wait_of("wait=600"), 60000);
    assert_int_equal(wait_of("wait=99999999999999999999"), 60000);
    assert_int_equal(wait_of("wait=-5"), -1);
    assert_int_equal(wait_of("wait=soon"), -1);
    assert_int_equal(wait_of("waiting=5"), -1);
    assert_int_equal(wait_of("await=5"), -1);
    assert_true(is_async("respond-async"));
    assert_true(is_async("wait=5;x=y, RESPOND-ASYNC"));
    assert_false(is_async("respond-asynchronously"));
    assert_false(is_async(""));
}

static bool none_match(const char *header) {
    struct request request = {.header[HEADER_IF_NONE_MATCH] = header};
    return request_none_match(&request, "\"abc\"");
}

static void entity_tags(void **state) {
    (void)state;
    assert_true(none_match("\"abc\""));
    assert_true(none_match("W/\"abc\""));
    assert_true(none_match("\"x\" , \"abc\",\"y\""));
    assert_true(none_match("*"));
    assert_false(none_match(NULL));
    assert_false(none_match(""));
    assert_false(none_match("abc"));
    assert_false(none_match("\"abcd\""));
    assert_false(none_match("\"ab\", ,"));
}

static void a_text_that_is_missing_is_a_failure(void **state) {
    (void)state;
    struct response response;
    response_init(&response);
    response_text(&response, 200, "text/plain", NULL);
    assert_int_equal(response.status, 500);
    response_text(&response, 201, "text/plain", strdup("x"));
    assert_int_equal(response.status, 201);
    assert_int_equal(response.text_bytes, 1);
    response_done(&response);
    response_done(&response);
}

static void headers_that_do_not_fit_are_cut_or_dropped(void **state) {
    (void)state;
    struct response response;
    response_init(&response);
    for (int i = 0; i < 100; i++) response_header(&response, "X", "%0*d", 2 * RESPONSE_HEADER_BYTES, i);
    assert_int_equal(response.header_count, RESPONSE_MAX_HEADERS);
    assert_int_equal(strlen(response.header[0].value), RESPONSE_HEADER_BYTES - 1);
    response_done(&response);
}

static bool accepts(const char *header) {
    struct request request = {.header[HEADER_ACCEPT] = header};
    return request_accepts(&request, "model/ply");
}

static void accepted_types(void **state) {
    static const char *const yes[] = {"",
                                      "*/*",
                                      "model/ply",
                                      "MODEL/Ply",
                                      "model/*",
                                      "text/html, */*;q=0.8",
                                      "image/png,model/ply",
                                      "model/ply;q=0.001",
                                      "model/ply ; a=b",
                                      ", model/*",
                                      "model/ply;q=0;x, model/ply"};
    static const char *const no[] = {"image/png",          "text/*",        "model/plyx",
                                     "model/pl",           "model/ply;q=0", "*/*; q=0.000",
                                     "model/obj, */*;q=0", "model",         "*"};
    (void)state;
    assert_true(accepts(NULL));
    for (size_t i = 0; i < sizeof yes / sizeof *yes; i++) assert_true(accepts(yes[i]));
    for (size_t i = 0; i < sizeof no / sizeof *no; i++) assert_false(accepts(no[i]));
}

static enum request_flag flag_of(const char *text) {
    struct request request = {.header[HEADER_UPLOAD_COMPLETE] = text};
    return request_flag(&request, HEADER_UPLOAD_COMPLETE);
}

static void booleans_with_their_parameters(void **state) {
    static const char *const right[] = {
        "?1",      " ?1  ",           "?1;a",        "?1; a=1;b=-2.5",         "?1;a=?0",
        "?1;*a=x", "?1;a=\"?0\\\"\"", "?1;a=:AQ==:", "?1;a=@1700000000;b=a/b", "?1;a=%\"f%c3\""};
    static const char *const wrong[] = {"",          "1",       "?",      "?2",          "?10",      "?1 ;a",
                                        "?1,?0",     "?1;",     "?1;A=1", "?1;a=\"open", "?1;a=:AQ", "?1;a=1.",
                                        "?1;a=@1.5", "?1;a=?2", "?1 x",   "true"};
    (void)state;
    assert_int_equal(flag_of(NULL), FLAG_ABSENT);
    assert_int_equal(flag_of("?0"), FLAG_FALSE);
    assert_int_equal(flag_of("?0;a=?1"), FLAG_FALSE);
    for (size_t i = 0; i < sizeof right / sizeof *right; i++) assert_int_equal(flag_of(right[i]), FLAG_TRUE);
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) assert_int_equal(flag_of(wrong[i]), FLAG_MALFORMED);
}

static int64_t integer_of(const char *text) {
    struct request request = {.header[HEADER_UPLOAD_DRAFT] = text};
    int64_t number = -1;
    bool read = request_integer(&request, HEADER_UPLOAD_DRAFT, &number);
    assert_true(read || number == -1);
    return read ? number : INT64_MIN;
}

static void whole_numbers_with_their_parameters(void **state) {
    static const char *const wrong[] = {"", "-", "+1", "1.5", "0x8", "8,8", "8 8", "?1", "1234567890123456", "eight"};
    (void)state;
    assert_int_equal(integer_of("8"), 8);
    assert_int_equal(integer_of(" 8;a "), 8);
    assert_int_equal(integer_of("-3"), -3);
    assert_int_equal(integer_of("999999999999999"), 999999999999999);
    assert_int_equal(integer_of(NULL), INT64_MIN);
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) assert_int_equal(integer_of(wrong[i]), INT64_MIN);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(booleans_with_their_parameters),
        cmocka_unit_test(whole_numbers_with_their_parameters),
        cmocka_unit_test(one_range),
        cmocka_unit_test(ranges_outside),
        cmocka_unit_test(what_is_no_range_means_everything),
        cmocka_unit_test(preferences),
        cmocka_unit_test(entity_tags),
        cmocka_unit_test(a_text_that_is_missing_is_a_failure),
        cmocka_unit_test(headers_that_do_not_fit_are_cut_or_dropped),
        cmocka_unit_test(accepted_types),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
