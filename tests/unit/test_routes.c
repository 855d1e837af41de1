/* Routes: every row is found by its own path, and nothing else is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/routes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static const struct route *find(const char *method, const char *path) {
    struct route_match match;
    routes_match(method, path, &match);
    return match.route;
}

static void every_row_finds_itself(void **state) {
    (void)state;
    size_t count;
    const struct route *table = routes_table(&count);
    assert_int_equal(count, OPERATION_COUNT);
    for (size_t i = 0; i < count; i++) {
        assert_int_equal(table[i].operation, i);
        assert_ptr_equal(find(table[i].method, table[i].pattern), &table[i]); /* "{id}" is a fine id */
    }
}

static void operation_ids_are_unique(void **state) {
    (void)state;
    size_t count;
    const struct route *table = routes_table(&count);
    for (size_t i = 0; i < count; i++)
        for (size_t j = 0; j < i; j++) assert_string_not_equal(table[i].operation_id, table[j].operation_id);
}

static void captures_in_order(void **state) {
    (void)state;
    struct route_match match;
    routes_match("GET", "/v1/jobs/one/outputs/two.ply", &match);
    assert_int_equal(match.route->operation, OPERATION_GET_OUTPUT);
    assert_string_equal(match.capture[0], "one");
    assert_string_equal(match.capture[1], "two.ply");
    routes_match("GET", "/v1/jobs/one", &match);
    assert_string_equal(match.capture[1], "");
}

static void head_is_get(void **state) {
    (void)state;
    assert_ptr_equal(find("HEAD", "/v1/jobs"), find("GET", "/v1/jobs"));
    assert_null(find("HEAD", "/v1/simplify"));
}

static void another_method_is_told_what_is_allowed(void **state) {
    (void)state;
    struct route_match match;
    routes_match("PUT", "/v1/jobs/x", &match);
    assert_null(match.route);
    assert_string_equal(match.allow, "GET, HEAD, DELETE");
    routes_match("get", "/v1/info", &match); /* methods have their case */
    assert_null(match.route);
    assert_string_equal(match.allow, "GET, HEAD");
}

static void what_is_no_path_of_ours(void **state) {
    (void)state;
    static const char *const paths[] = {"",
                                        "v1/jobs",
                                        "/v1",
                                        "/v1/",
                                        "/v1/jobs/",
                                        "//v1/jobs",
                                        "/v1//jobs",
                                        "/v1/jobs/x/",
                                        "/v1/jobs/x/log/",
                                        "/v1/job",
                                        "/v1/jobsx",
                                        "/V1/jobs",
                                        "//",
                                        "/openapi.json/",
                                        "/v1/jobs//log",
                                        "/problems/",
                                        "*",
                                        "/v1/jobs/x/outputs/",
                                        "/v1/jobs/x/outputs/a/b"};
    for (size_t i = 0; i < sizeof paths / sizeof *paths; i++) {
        struct route_match match;
        routes_match("GET", paths[i], &match);
        assert_null(match.route);
        assert_string_equal(match.allow, "");
    }
}

static void a_capture_that_is_too_long_is_no_match(void **state) {
    (void)state;
    char path[512];
    int n = snprintf(path, sizeof path, "/v1/jobs/%0*d", ROUTES_CAPTURE_BYTES - 1, 7);
    assert_non_null(find("GET", path));
    snprintf(path + n, sizeof path - (size_t)n, "0");
    assert_null(find("GET", path));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_row_finds_itself),
        cmocka_unit_test(operation_ids_are_unique),
        cmocka_unit_test(captures_in_order),
        cmocka_unit_test(head_is_get),
        cmocka_unit_test(another_method_is_told_what_is_allowed),
        cmocka_unit_test(what_is_no_path_of_ours),
        cmocka_unit_test(a_capture_that_is_too_long_is_no_match),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
