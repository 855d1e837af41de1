/* Tokens, signatures, and the heads of requests: what is taken, and what is refused.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "server/auth/tokens.h"
#include "server/base/digest.h"
#include "server/base/signature.h"
#include "server/http/request.h"

struct fixture {
    char folder[64], path[96];
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_access.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    snprintf(f->path, sizeof f->path, "%s/file", f->folder);
    *state = f;
    return 0;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    unlink(f->path);
    int rc = rmdir(f->folder);
    free(f);
    return rc;
}

static void write_file(const struct fixture *f, const void *bytes, size_t count, mode_t mode) {
    FILE *file = fopen(f->path, "w");
    assert_non_null(file);
    assert_int_equal(fwrite(bytes, 1, count, file), count);
    fclose(file);
    assert_int_equal(chmod(f->path, mode), 0);
}

/* ------------------------------------------------------------------------------------------------ tokens */

static void a_token_is_found_by_its_hash_alone(void **state) {
    const struct fixture *f = *state;
    struct tokens *tokens;
    struct error error;
    struct principal who;
    char hash[DIGEST_HEX_BYTES], text[256];
    assert_true(digest_text("secret", hash));
    int n = snprintf(text, sizeof text, " # none\n\nalice:read,submit:%s # hers\r\n", hash);
    write_file(f, text, (size_t)n, 0600);
    assert_int_equal(tokens_open(f->path, &tokens, &error), STATUS_OK);
    assert_int_equal(tokens_count(tokens), 1);
    assert_true(tokens_find(tokens, "secret", &who));
    assert_string_equal(who.name, "alice");
    assert_int_equal(who.scopes, ROUTES_READ | ROUTES_SUBMIT);
    const char *const others[] = {"", "secre", "secret ", "Secret", hash};
    for (size_t i = 0; i < sizeof others / sizeof *others; i++) assert_false(tokens_find(tokens, others[i], &who));
    write_file(f, "rubbish", 7, 0600);
    assert_int_equal(tokens_reload(tokens, &error), STATUS_BAD_PARAMETER);
    assert_true(tokens_find(tokens, "secret", &who)); /* the old ones stay */
    tokens_close(tokens);
}

static void a_principal_sees_its_own_unless_it_is_an_admin(void **state) {
    (void)state;
    struct principal alice = {.name = "alice", .scopes = ROUTES_READ}, root = {.name = "root", .scopes = ROUTES_ADMIN};
    assert_true(principal_sees(&alice, "alice"));
    assert_false(principal_sees(&alice, "alic"));
    assert_false(principal_sees(&alice, ""));
    assert_true(principal_sees(&root, "alice"));
}

/* ------------------------------------------------------------------------------------------------ signatures */

static void the_key_is_made_once_and_kept_private(void **state) {
    const struct fixture *f = *state;
    struct signature_key first, second;
    struct error error;
    struct stat facts;
    assert_int_equal(signature_open(f->path, &first, &error), STATUS_OK);
    assert_int_equal(signature_open(f->path, &second, &error), STATUS_OK);
    assert_memory_equal(&first, &second, sizeof first);
    assert_int_equal(stat(f->path, &facts), 0);
    assert_int_equal(facts.st_mode & 0777, 0600);
    write_file(f, "short", 5, 0600);
    assert_int_equal(signature_open(f->path, &second, &error), STATUS_MALFORMED);
    write_file(f, &first, sizeof first, 0640);
    assert_int_equal(signature_open(f->path, &second, &error), STATUS_MALFORMED);
}

static void a_key_is_read_as_it_was_told(void **state) {
    struct signature_key key = {.bytes = {0, 1, 0x7f, 0x80, 0xff, 0xa5}}, back;
    char hex[SIGNATURE_HEX_BYTES];
    (void)state;
    signature_key_text(&key, hex);
    assert_int_equal(strncmp(hex, "00017f80ffa500", 14), 0);
    assert_true(signature_key_read(hex, &back));
    assert_memory_equal(key.bytes, back.bytes, SIGNATURE_KEY_BYTES);
    assert_false(signature_key_read("", &back));
    assert_false(signature_key_read(hex + 1, &back));
    hex[3] = 'G';
    assert_false(signature_key_read(hex, &back));
}

static void a_signature_is_of_one_path_and_one_time(void **state) {
    (void)state;
    struct signature_key key = {.bytes = "0123456789abcdef0123456789abcde"}, other = {.bytes = "x"};
    char hex[SIGNATURE_HEX_BYTES];
    signature_make(&key, "/a", 1000, hex);
    assert_true(signature_holds(&key, "/a", 1000, hex));
    assert_false(signature_holds(&key, "/b", 1000, hex));
    assert_false(signature_holds(&key, "/a", 1001, hex));
    assert_false(signature_holds(&other, "/a", 1000, hex));
    assert_false(signature_holds(&key, "/a", 1000, ""));
    hex[0] = hex[0] == '0' ? '1' : '0';
    assert_false(signature_holds(&key, "/a", 1000, hex));
}

/* ------------------------------------------------------------------------------------------------ heads */

static const char *fault_of(const char *length, const char *coding) {
    static struct request request;
    memset(&request, 0, sizeof request);
    if (length) request_take_header(&request, "content-length", length, strlen(length));
    if (coding) request_take_header(&request, "TRANSFER-ENCODING", coding, strlen(coding));
    request_read_framing(&request);
    return request.fault;
}

static void ambiguous_framing_is_a_fault(void **state) {
    (void)state;
    assert_null(fault_of(NULL, NULL));
    assert_null(fault_of("17", NULL));
    assert_null(fault_of(NULL, "Chunked"));
    const char *const lengths[] = {"", "-1", "+1", "1 ", " 1", "1,1", "0x1", "9999999999999999999", "1.0"};
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) assert_non_null(fault_of(lengths[i], NULL));
    const char *const codings[] = {"", "gzip", "chunked, gzip", "gzip, chunked", "identity"};
    for (size_t i = 0; i < sizeof codings / sizeof *codings; i++) assert_non_null(fault_of(NULL, codings[i]));
    assert_non_null(fault_of("5", "chunked"));
}

static const char *fault_of_header(const char *name, const char *value) {
    struct request request = {0};
    request_take_header(&request, name, value, strlen(value));
    request_read_framing(&request);
    return request.fault;
}

static void names_and_hosts_that_others_read_otherwise_are_a_fault(void **state) {
    (void)state;
    static const char *const names[] = {"",
                                        "a b",
                                        "a:",
                                        "Content-Length ",
                                        "Content-Length5",
                                        "a\tb",
                                        "content-length0",
                                        "caf\xc3\xa9",
                                        "Transfer-Encodingchunked"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) assert_non_null(fault_of_header(names[i], "5"));
    assert_non_null(fault_of_header("X", "a\rContent-Length: 5"));
    assert_non_null(fault_of_header("X", "a\n b"));
    assert_null(fault_of_header("X-Content-Length", "5"));
    static const char *const hosts[] = {"a b", "a/b", "u@a", "a?b", "a#b", "a\\b", "caf\xc3\xa9"};
    for (size_t i = 0; i < sizeof hosts / sizeof *hosts; i++) assert_non_null(fault_of_header("Host", hosts[i]));
    static const char *const good[] = {"", "a", "a.example:80", "[::1]:80", "127.0.0.1", "xn--caf-dma.example"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) assert_null(fault_of_header("Host", good[i]));
}

static void what_comes_twice_or_holds_nul_is_a_fault(void **state) {
    (void)state;
    struct request request = {0};
    request_take_header(&request, "Host", "a", 1);
    assert_null(request.fault);
    request_take_header(&request, "host", "a", 1);
    assert_non_null(request.fault);
    request = (struct request){0};
    request_take_header(&request, "Prefer", "wait=1", 6);
    request_take_header(&request, "Prefer", "respond-async", 13);
    assert_null(request.fault);
    request_take_header(&request, "Range", "a\0b", 3);
    assert_non_null(request.fault);
    request = (struct request){0};
    for (int i = 0; i < REQUEST_MAX_QUERY; i++) request_take_argument(&request, "a", 1, "b", 1);
    assert_null(request.fault);
    request_take_argument(&request, "a", 1, NULL, 0);
    assert_non_null(request.fault);
}

static void ids_are_taken_where_they_are_well_formed(void **state) {
    (void)state;
    static const char trace[] = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
    struct request request = {0};
    request.header[HEADER_TRACEPARENT] = trace;
    request_identify(&request);
    assert_string_equal(request.id, "4bf92f3577b34da6a3ce929d0e0e4736");
    request.header[HEADER_REQUEST_ID] = "mine.1";
    request_identify(&request);
    assert_string_equal(request.id, "mine.1");
    const char *const bad[] = {"",     "a b", "a\"b",
                               "a\nb", "x=y", "01234567890123456789012345678901234567890123456789012345678901234"};
    request.header[HEADER_TRACEPARENT] = NULL;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        request.header[HEADER_REQUEST_ID] = bad[i];
        request_identify(&request);
        assert_int_equal(strlen(request.id), 16);
        assert_string_not_equal(request.id, bad[i]);
    }
}

int main(void) {
#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        TEST(a_token_is_found_by_its_hash_alone),
        TEST(a_principal_sees_its_own_unless_it_is_an_admin),
        TEST(the_key_is_made_once_and_kept_private),
        TEST(a_key_is_read_as_it_was_told),
        TEST(a_signature_is_of_one_path_and_one_time),
        TEST(ambiguous_framing_is_a_fault),
        TEST(names_and_hosts_that_others_read_otherwise_are_a_fault),
        TEST(what_comes_twice_or_holds_nul_is_a_fault),
        TEST(ids_are_taken_where_they_are_well_formed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
