/* Connections of one client: addresses that are one client's, and those that aren't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/peers.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static struct sockaddr_storage address_of(const char *text) {
    struct sockaddr_storage address = {0};
    struct sockaddr_in ipv4 = {.sin_family = AF_INET};
    struct sockaddr_in6 ipv6 = {.sin6_family = AF_INET6};
    if (inet_pton(AF_INET, text, &ipv4.sin_addr) == 1)
        memcpy(&address, &ipv4, sizeof ipv4);
    else if (inet_pton(AF_INET6, text, &ipv6.sin6_addr) == 1)
        memcpy(&address, &ipv6, sizeof ipv6);
    else
        fail_msg("%s is no address", text);
    return address;
}

/* Whether the second address is refused when the first has all its connections. */
static int are_one(const char *first, const char *second) {
    struct sockaddr_storage a = address_of(first), b = address_of(second);
    struct peers *peers = peers_new(2);
    assert_non_null(peers);
    for (int i = 0; i < 2; i++) assert_true(peers_enter(peers, (struct sockaddr *)&a));
    assert_false(peers_enter(peers, (struct sockaddr *)&a));
    int one = !peers_enter(peers, (struct sockaddr *)&b);
    if (!one) peers_leave(peers, (struct sockaddr *)&b);
    peers_leave(peers, (struct sockaddr *)&a);
    assert_true(peers_enter(peers, (struct sockaddr *)&a));
    for (int i = 0; i < 2; i++) peers_leave(peers, (struct sockaddr *)&a);
    peers_free(peers);
    return one;
}

static void a_network_of_ipv6_is_one_client(void **state) {
    (void)state;
    assert_true(are_one("2001:db8:1:2::1", "2001:db8:1:2:ffff:ffff:ffff:ffff"));
    assert_true(are_one("::1", "::2"));
    assert_false(are_one("2001:db8:1:2::1", "2001:db8:1:3::1"));
    assert_false(are_one("2001:db8:1:2::1", "2001:db9:1:2::1"));
}

static void each_address_of_ipv4_is_a_client(void **state) {
    (void)state;
    assert_true(are_one("192.0.2.1", "192.0.2.1"));
    assert_false(are_one("192.0.2.1", "192.0.2.2"));
    assert_false(are_one("192.0.2.1", "193.0.2.1"));
}

static void an_address_of_ipv4_is_the_same_in_ipv6(void **state) {
    (void)state;
    assert_true(are_one("::ffff:192.0.2.1", "192.0.2.1"));
    assert_false(are_one("::ffff:192.0.2.1", "::ffff:192.0.2.2"));
    assert_false(are_one("0.0.0.0", "::1"));
}

enum { CLIENTS = 20000, THREADS = 4, ROUNDS = 20000 };

static void many_clients_come_and_go(void **state) {
    struct peers *peers = peers_new(1);
    struct sockaddr_in address = {.sin_family = AF_INET};
    (void)state;
    for (int round = 0; round < 2; round++) {
        for (uint32_t i = 0; i < CLIENTS; i++) {
            address.sin_addr.s_addr = htonl(i);
            assert_true(peers_enter(peers, (struct sockaddr *)&address));
            assert_false(peers_enter(peers, (struct sockaddr *)&address));
        }
        for (uint32_t i = 0; i < CLIENTS; i++) {
            address.sin_addr.s_addr = htonl((i * 7919) % CLIENTS);
            peers_leave(peers, (struct sockaddr *)&address);
        }
    }
    peers_free(peers);
}

static void *enter_and_leave(void *ctx) {
    struct sockaddr_storage address = address_of("192.0.2.1");
    for (int i = 0; i < ROUNDS; i++) {
        if (!peers_enter(ctx, (struct sockaddr *)&address)) return ctx;
        peers_leave(ctx, (struct sockaddr *)&address);
    }
    return NULL;
}

static void threads_count_together(void **state) {
    struct sockaddr_storage address = address_of("192.0.2.1");
    struct peers *peers = peers_new(THREADS);
    pthread_t thread[THREADS];
    (void)state;
    for (int i = 0; i < THREADS; i++) assert_int_equal(pthread_create(&thread[i], NULL, enter_and_leave, peers), 0);
    for (int i = 0; i < THREADS; i++) {
        void *failed = peers;
        assert_int_equal(pthread_join(thread[i], &failed), 0);
        assert_null(failed);
    }
    for (int i = 0; i < THREADS; i++) assert_true(peers_enter(peers, (struct sockaddr *)&address));
    assert_false(peers_enter(peers, (struct sockaddr *)&address));
    for (int i = 0; i < THREADS; i++) peers_leave(peers, (struct sockaddr *)&address);
    peers_free(peers);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_network_of_ipv6_is_one_client),
        cmocka_unit_test(each_address_of_ipv4_is_a_client),
        cmocka_unit_test(an_address_of_ipv4_is_the_same_in_ipv6),
        cmocka_unit_test(many_clients_come_and_go),
        cmocka_unit_test(threads_count_together),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
