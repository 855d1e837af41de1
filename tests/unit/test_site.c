/* Hosts and origins: what a list may hold, and what is in it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/site.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static void lists_of_hosts(void **state) {
    static const char *const good[] = {"", " , ", "a", "a.b-c_d", "*", "*.a", "1.2.3.4", "::1", "[::1]", " a , *.b"};
    static const char *const bad[] = {"a:1", "*a", "a.*", "a b", "*.", "**", "http://a", "[a]b", "[]", "a,b:1"};
    (void)state;
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) assert_true(site_hosts_valid(good[i]));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) assert_false(site_hosts_valid(bad[i]));
}

static void hosts_in_lists(void **state) {
    (void)state;
    assert_true(site_host_listed("b, A.example", "a.EXAMPLE.:80"));
    assert_true(site_host_listed("*.example", "a.b.example"));
    assert_false(site_host_listed("*.example", "example"));
    assert_false(site_host_listed("*.example", ".example"));
    assert_false(site_host_listed("a.example", "a.example.org"));
    assert_false(site_host_listed("a.example", "xa.example"));
    assert_false(site_host_listed("a", ""));
    assert_true(site_host_listed("[::2]", "[::2]:8080"));
    assert_true(site_host_listed("::2", "[::2]"));
    assert_false(site_host_listed("", "a"));
}

static void local_and_short_hosts(void **state) {
    static const char *const local[] = {"localhost", "LOCALHOST:1", "x.localhost", "127.0.0.1:8", "[::1]:8", "9.9.9.9"};
    static const char *const foreign[] = {"",      "localhost.x", "xlocalhost", "127.0.0.1.x",
                                          "127.1", "0x7f",        "::1",        ":80"};
    (void)state;
    for (size_t i = 0; i < sizeof local / sizeof *local; i++) assert_true(site_host_is_local(local[i]));
    for (size_t i = 0; i < sizeof foreign / sizeof *foreign; i++) assert_false(site_host_is_local(foreign[i]));
    assert_true(site_host_is_short("whittled:80"));
    assert_false(site_host_is_short("whittled.x"));
    assert_false(site_host_is_short(""));
}

static void origins(void **state) {
    static const char *const good[] = {"", "*", "https://a", "http://a:1, app+x://b"};
    static const char *const bad[] = {"a", "https://", "https://a/", "https://*.a", "://a", "https://a b", "null"};
    (void)state;
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) assert_true(site_origins_valid(good[i]));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) assert_false(site_origins_valid(bad[i]));
    assert_true(site_origin_listed("http://b,https://a:1", "https://A:1"));
    assert_false(site_origin_listed("https://a", "https://a:1"));
    assert_false(site_origin_listed("https://a", "http://a"));
    assert_true(site_origin_listed("*", "null"));
    assert_true(site_origin_is_of("https://a:1", "A:1"));
    assert_false(site_origin_is_of("https://a", "a:1"));
    assert_false(site_origin_is_of("null", "null"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lists_of_hosts),
        cmocka_unit_test(hosts_in_lists),
        cmocka_unit_test(local_and_short_hosts),
        cmocka_unit_test(origins),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
