/* Problems: the table is whole, and the JSON says what was put in, whatever the texts hold.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/problem.h"

#include <jansson.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static json_t *encoded(const struct problem *problem) {
    char *text = problem_encode(problem);
    assert_non_null(text);
    json_t *json = json_loads(text, 0, NULL);
    assert_non_null(json);
    free(text);
    return json;
}

static const char *text_of(const json_t *json, const char *name) {
    return json_string_value(json_object_get(json, name));
}

static void every_kind_has_a_row(void **state) {
    (void)state;
    for (int i = 0; i < PROBLEM_COUNT; i++) {
        const struct problem_type *type = problem_type((enum problem_kind)i);
        assert_non_null(type->slug);
        assert_true(type->http_status >= 400 && type->http_status <= 599);
        assert_true(type->title[0] && type->help[0]);
        assert_ptr_equal(problem_type_of_slug(type->slug), type); /* so no slug is there twice */
    }
    assert_null(problem_type_of_slug("none"));
}

static void members_are_encoded(void **state) {
    (void)state;
    struct problem problem;
    problem_set(&problem, PROBLEM_BODY_TOO_LARGE, "%d is too much", 7);
    problem_add_number(&problem, "limit", 5);
    problem_add_text(&problem, "hint", "less");
    problem_add_list(&problem, "supported", "a,b/c");
    problem_add_error(&problem, "ratio", "7", "at most 1", NULL);
    json_t *json = encoded(&problem), *list = json_object_get(json, "supported");
    assert_string_equal(text_of(json, "type"), "/problems/body-too-large");
    assert_int_equal(json_integer_value(json_object_get(json, "status")), 413);
    assert_string_equal(text_of(json, "detail"), "7 is too much");
    assert_int_equal(json_integer_value(json_object_get(json, "limit")), 5);
    assert_string_equal(text_of(json, "hint"), "less");
    assert_int_equal(json_array_size(list), 2);
    assert_string_equal(json_string_value(json_array_get(list, 1)), "b/c");
    const json_t *error = json_array_get(json_object_get(json, "errors"), 0);
    assert_string_equal(text_of(error, "parameter"), "ratio");
    assert_null(json_object_get(error, "did_you_mean"));
    json_decref(json);
}

static void bytes_that_are_no_text_do_not_spoil_it(void **state) {
    (void)state;
    struct problem problem;
    problem_set(&problem, PROBLEM_MALFORMED_CLOUD, "%s", "\xff\xfe \"quoted\"\n\x01");
    problem_add_text(&problem, "property", "\xc3");
    problem_add_error(&problem, "\xe2\x82", "\x80", NULL, NULL);
    json_t *json = encoded(&problem);
    assert_string_equal(text_of(json, "detail"), "?? \"quoted\"\n\x01");
    assert_string_equal(text_of(json, "property"), "?");
    json_decref(json);
}

static void what_does_not_fit_is_dropped(void **state) {
    (void)state;
    struct problem problem;
    char long_text[2 * PROBLEM_DETAIL_BYTES];
    memset(long_text, 'x', sizeof long_text);
    long_text[sizeof long_text - 1] = 0;
    problem_set(&problem, PROBLEM_ENGINE_ERROR, "%s", long_text);
    for (int i = 0; i < 100; i++) {
        problem_add_text(&problem, long_text, long_text);
        problem_add_error(&problem, long_text, long_text, long_text, long_text);
    }
    assert_int_equal(problem.member_count, PROBLEM_MAX_MEMBERS);
    assert_int_equal(problem.error_count, PROBLEM_MAX_ERRORS);
    json_decref(encoded(&problem));
}

static void errors_of_the_core_become_problems(void **state) {
    (void)state;
    struct error error = {0};
    struct problem problem;
    for (int i = 1; i < STATUS_COUNT; i++) {
        error_set(&error, (enum status)i, "", "text");
        problem_from_error(&problem, &error);
        assert_string_equal(problem.detail, "text");
    }
    error_set_at(&error, STATUS_MALFORMED, "x", 12, 345, "no number");
    problem_from_error(&problem, &error);
    json_t *json = encoded(&problem);
    assert_int_equal(json_integer_value(json_object_get(json, "status")), 422);
    assert_int_equal(json_integer_value(json_object_get(json, "line")), 12);
    assert_int_equal(json_integer_value(json_object_get(json, "byte_offset")), 345);
    assert_string_equal(text_of(json, "property"), "x");
    json_decref(json);
}

static void a_position_that_is_not_known_is_left_out(void **state) {
    (void)state;
    struct error error = {0};
    struct problem problem;
    error_set(&error, STATUS_MALFORMED, NULL, "broken");
    problem_from_error(&problem, &error);
    assert_int_equal(problem.member_count, 0);
}

static void status_is_read_back(void **state) {
    (void)state;
    assert_int_equal(problem_status_of("{\"status\":422}"), 422);
    assert_int_equal(problem_status_of("{\"status\":200}"), 500);
    assert_int_equal(problem_status_of("{}"), 500);
    assert_int_equal(problem_status_of("nonsense"), 500);
    assert_int_equal(problem_status_of(NULL), 500);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_kind_has_a_row),
        cmocka_unit_test(members_are_encoded),
        cmocka_unit_test(bytes_that_are_no_text_do_not_spoil_it),
        cmocka_unit_test(what_does_not_fit_is_dropped),
        cmocka_unit_test(errors_of_the_core_become_problems),
        cmocka_unit_test(a_position_that_is_not_known_is_left_out),
        cmocka_unit_test(status_is_read_back),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
