/* Inside addresses: every special block, both ends of it, and what is next to it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/webhooks/address_filter.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

static struct sockaddr_storage address_of(const char *text) {
    struct sockaddr_storage storage = {0};
    struct sockaddr_in ipv4 = {.sin_family = AF_INET};
    struct sockaddr_in6 ipv6 = {.sin6_family = AF_INET6};
    if (inet_pton(AF_INET, text, &ipv4.sin_addr) == 1)
        memcpy(&storage, &ipv4, sizeof ipv4);
    else if (inet_pton(AF_INET6, text, &ipv6.sin6_addr) == 1)
        memcpy(&storage, &ipv6, sizeof ipv6);
    else
        fail_msg("%s is no address", text);
    return storage;
}

static void expect(const char *const *texts, bool inside) {
    for (; *texts; texts++) {
        struct sockaddr_storage address = address_of(*texts);
        if (address_is_inside((const struct sockaddr *)&address) != inside) fail_msg("%s", *texts);
    }
}

static void special_blocks_are_inside(void **state) {
    static const char *const texts[] = {
        "0.0.0.0",     "0.255.255.255",  "10.0.0.0",        "10.255.255.255",  "100.64.0.1",      "100.127.255.255",
        "127.0.0.1",   "127.255.0.1",    "169.254.169.254", "172.16.0.1",      "172.31.255.255",  "192.0.0.8",
        "192.0.2.1",   "192.88.99.1",    "192.168.1.1",     "198.18.0.1",      "198.19.255.255",  "198.51.100.7",
        "203.0.113.9", "224.0.0.1",      "239.1.1.1",       "240.0.0.1",       "255.255.255.255", "::",
        "::1",         "::ffff:8.8.8.8", "::7f00:1",        "64:ff9b::a00:1",  "100::1",          "fc00::1",
        "fd12::1",     "fe80::1",        "fec0::1",         "ff02::1",         "2001::1",         "2001:1ff:ffff::1",
        "2001:db8::1", "2002:7f00:1::",  "3fff::1",         "3fff:fff:ffff::", "4000::1",         NULL};
    (void)state;
    expect(texts, true);
    assert_true(address_is_inside(&(struct sockaddr){.sa_family = AF_UNIX}));
}

static void the_internet_is_not(void **state) {
    static const char *const texts[] = {
        "1.1.1.1",         "8.8.8.8",         "9.255.255.255", "11.0.0.0",     "100.63.255.255",
        "100.128.0.0",     "126.255.255.255", "128.0.0.1",     "169.253.0.1",  "172.15.255.255",
        "172.32.0.0",      "192.0.1.0",       "192.167.0.1",   "198.17.0.1",   "198.20.0.1",
        "203.0.114.1",     "223.255.255.255", "2000::1",       "2001:200::1",  "2001:db9::1",
        "2606:4700::1111", "2a00:1450::1",    "3ffe::1",       "3fff:1000::1", NULL};
    (void)state;
    expect(texts, false);
}

static void a_list_names_addresses_and_not_their_beginnings(void **state) {
    struct sockaddr_storage one = address_of("127.0.0.1"), other = address_of("127.0.0.10"), six = address_of("::1");
    (void)state;
    assert_true(address_is_listed((const struct sockaddr *)&one, "10.0.0.1, 127.0.0.1"));
    assert_true(address_is_listed((const struct sockaddr *)&six, "127.0.0.1,::1"));
    assert_false(address_is_listed((const struct sockaddr *)&other, "127.0.0.1"));
    assert_false(address_is_listed((const struct sockaddr *)&one, "127.0.0.10"));
    assert_false(address_is_listed((const struct sockaddr *)&one, ""));
    assert_false(address_is_listed(&(struct sockaddr){.sa_family = AF_UNIX}, ",,"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(special_blocks_are_inside),
        cmocka_unit_test(the_internet_is_not),
        cmocka_unit_test(a_list_names_addresses_and_not_their_beginnings),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
