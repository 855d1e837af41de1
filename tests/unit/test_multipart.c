/* Forms as a stream: the same parts come out, however the bytes come in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/multipart.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

/* What came out: "name[type]*:content|" for each part, * where it is a file. */
static char seen[4096];
static struct problem problem;

static void put(const char *text, size_t count) {
    size_t used = strlen(seen);
    assert_true(used + count < sizeof seen);
    memcpy(seen + used, text, count);
    seen[used + count] = 0;
}

static bool begin(void *ctx, const struct multipart_part *part, struct problem *why) {
    char text[256];
    (void)ctx;
    (void)why;
    put(text, (size_t)snprintf(text, sizeof text, "%s[%s]%s:", part->name, part->type, part->is_file ? "*" : ""));
    return true;
}

static bool take(void *ctx, const void *bytes, size_t count, struct problem *why) {
    (void)ctx;
    (void)why;
    assert_true(count > 0);
    put(bytes, count);
    return true;
}

static bool end(void *ctx, struct problem *why) {
    (void)ctx;
    (void)why;
    put("|", 1);
    return true;
}

static bool parse(const char *type, const char *body, size_t piece) {
    struct multipart_sink sink = {begin, take, end, NULL};
    size_t size = strlen(body);
    seen[0] = 0;
    struct multipart *form = multipart_new(type, sink, &problem);
    if (!form) return false;
    bool ok = true;
    for (size_t i = 0, n; ok && i < size; i += n) {
        n = piece < size - i ? piece : size - i;
        ok = multipart_push(form, body + i, n, &problem);
    }
    ok = ok && multipart_end(form, &problem);
    multipart_free(form);
    return ok;
}

#define TYPE "multipart/form-data; boundary=xyz"
#define PART(head) "--xyz\r\nContent-Disposition: form-data; " head "\r\n\r\n"

static void pieces_of_any_size_are_the_same(void **state) {
    (void)state;
    const char *body = "preamble\r\n" PART(
        "name=\"a\"; filename=\"b;name=c\"\r\nContent-Type: text/plain") "1 2\r\n--xy\r\n\r\r\n--x"
                                                                         "\r\n" PART("filename=f; name=e") "\r\n" PART(
                                                                             "name=\"q\\\"q\"") "\r"
                                                                                                "\r\n--xyz--"
                                                                                                "\r\nepilogue --xyz";
    for (size_t piece = 1; piece < 60; piece++) {
        assert_true(parse(TYPE, body, piece));
        assert_string_equal(seen, "a[text/plain]*:1 2\r\n--xy\r\n\r\r\n--x|e[]*:|q\"q[]:\r|");
    }
}

static void boundaries_are_read_as_they_come(void **state) {
    (void)state;
    static const char *const types[] = {"multipart/form-data; boundary=xyz", "multipart/form-data;boundary=\"xyz\"",
                                        "multipart/form-data; charset=\"a;boundary=b\"; BOUNDARY=xyz; x=y"};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++) {
        assert_true(parse(types[i], PART("name=a") "1\r\n--xyz--", 5));
        assert_string_equal(seen, "a[]:1|");
    }
    assert_false(parse("multipart/form-data", "", 1));
    assert_false(parse("multipart/form-data; boundary=", "", 1));
    assert_false(parse("multipart/form-data; boundary=\"xyz", "", 1));
}

static void what_breaks_the_format_is_refused_with_its_place(void **state) {
    (void)state;
    static const char *const wrong[] = {"",
                                        "--xyz",
                                        "--xyz\r\n",
                                        "--xyzz\r\n",
                                        "--xyz\r\n\r\n",
                                        "--xyz\r\nContent-Type: text/plain\r\n\r\n",
                                        PART("name=a") "no end",
                                        PART("name=\"\"") "\r\n--xyz--",
                                        PART("nom=a") "\r\n--xyz--",
                                        PART("name=a\r\nContent-Transfer-Encoding: base64") "\r\n--xyz--",
                                        "--xyz\r\nContent-Disposition: attachment; name=a\r\n\r\n\r\n--xyz--"};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        assert_false(parse(TYPE, wrong[i], 3));
        assert_int_equal(problem.kind, PROBLEM_MALFORMED_REQUEST);
        assert_string_equal(problem.member[0].name, "byte_offset");
    }
}

static void headers_have_a_limit(void **state) {
    (void)state;
    char body[MULTIPART_HEADER_BYTES + 200];
    int n = snprintf(body, sizeof body, "--xyz\r\nX: ");
    memset(body + n, 'x', sizeof body - (size_t)n - 1);
    body[sizeof body - 1] = 0;
    assert_false(parse(TYPE, body, 1000));
    assert_non_null(strstr(problem.detail, "too long"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pieces_of_any_size_are_the_same),
        cmocka_unit_test(boundaries_are_read_as_they_come),
        cmocka_unit_test(what_breaks_the_format_is_refused_with_its_place),
        cmocka_unit_test(headers_have_a_limit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
