/* The base path: what it may be, what is below it, and links that were written when it was another one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/links.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "api/openapi/openapi.h"
#include "api/problem.h"

static void base_paths(void **state) {
    static const char *const good[] = {"", "/a", "/a/b", "/a.b_c-d~9", "/.well-known"};
    static const char *const bad[] = {"/",   "a",       "/a/",  "/a//b",  "//a",      "/.",
                                      "/..", "/a/../b", "/a?b", "/a%20b", "/\xc3\xa4"};
    char longest[LINKS_BASE_BYTES + 1];
    (void)state;
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) assert_true(links_base_valid(good[i]));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) assert_false(links_base_valid(bad[i]));
    memset(longest, 'x', sizeof longest);
    longest[0] = '/';
    longest[LINKS_BASE_BYTES - 1] = 0;
    assert_true(links_base_valid(longest));
    longest[LINKS_BASE_BYTES - 1] = 'x';
    longest[LINKS_BASE_BYTES] = 0;
    assert_false(links_base_valid(longest));
}

static void below(void **state) {
    (void)state;
    assert_string_equal(links_below_base("/a/v1"), "/a/v1");
    links_set_base("/a/b");
    assert_string_equal(links_below_base("/a/b/v1/jobs"), "/v1/jobs");
    assert_string_equal(links_below_base("/a/b/"), "/");
    assert_string_equal(links_below_base("/a/b"), "/a/b");
    assert_string_equal(links_below_base("/a/bc/v1"), "/a/bc/v1");
    assert_string_equal(links_below_base("/v1/jobs"), "/v1/jobs");
    links_set_base("");
}

/* Puts the problem through two changes of the base path. */
static void kept_problems_follow(void **state) {
    struct problem problem;
    (void)state;
    links_set_base("/old");
    problem_set(&problem, PROBLEM_ENGINE_ERROR, "no more, see /problems/ and /v1/jobs/");
    problem_add_text(&problem, "log", "/v1/jobs/1/log");
    char *kept = problem_encode(&problem);
    links_set_base("/new/er");
    char *now = problem_relocate(kept);
    assert_non_null(strstr(now, "\"type\":\"/new/er/problems/engine-error\""));
    assert_non_null(strstr(now, "\"log\":\"/new/er/v1/jobs/1/log\""));
    assert_non_null(strstr(now, "see /problems/ and /v1/jobs/"));
    links_set_base("");
    char *bare = problem_relocate(now);
    assert_non_null(strstr(bare, "\"type\":\"/problems/engine-error\""));
    assert_null(problem_relocate("no JSON"));
    free(kept);
    free(now);
    free(bare);
}

static void the_contract_names_its_server(void **state) {
    size_t bytes;
    (void)state;
    const char *document = openapi_document(&bytes);
    char *text = openapi_here();
    assert_int_equal(strlen(text), bytes);
    assert_memory_equal(text, document, bytes);
    free(text);
    links_set_base("/a/b");
    text = openapi_here();
    assert_int_equal(strlen(text), bytes + 3);
    assert_non_null(strstr(text, "\"url\": \"/a/b\""));
    assert_null(strstr(text, "\"url\": \"/\""));
    free(text);
    links_set_base("");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(base_paths),
        cmocka_unit_test(below),
        cmocka_unit_test(kept_problems_follow),
        cmocka_unit_test(the_contract_names_its_server),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
