/* Inside addresses, as tables of prefixes.
 *
 * IPv4: everything but the blocks below is public.  IPv6: only 2000::/3 can be public, and of that not the blocks
 * below; among them are those that carry an IPv4 address, which could be an inside one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/webhooks/address_filter.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

static const struct {
    uint32_t prefix;
    int bits;
} inside_ipv4[] = {
    {0x00000000, 8},  /* this network */
    {0x0a000000, 8},  /* private */
    {0x64400000, 10}, /* shared by carriers */
    {0x7f000000, 8},  /* loopback */
    {0xa9fe0000, 16}, /* link-local, and the metadata of clouds */
    {0xac100000, 12}, /* private */
    {0xc0000000, 24}, /* protocol assignments */
    {0xc0000200, 24}, /* documentation */
    {0xc0586300, 24}, /* relays of 6to4 */
    {0xc0a80000, 16}, /* private */
    {0xc6120000, 15}, /* benchmarks */
    {0xc6336400, 24}, /* documentation */
    {0xcb007100, 24}, /* documentation */
    {0xe0000000, 4},  /* multicast */
    {0xf0000000, 4},  /* reserved, and broadcast */
};

static const struct {
    unsigned char prefix[4];
    int bits;
} inside_ipv6[] = {
    {{0x20, 0x01, 0x00, 0x00}, 23}, /* protocol assignments, Teredo among them */
    {{0x20, 0x01, 0x0d, 0xb8}, 32}, /* documentation */
    {{0x20, 0x02, 0x00, 0x00}, 16}, /* 6to4 */
    {{0x3f, 0xff, 0x00, 0x00}, 20}, /* documentation */
};

static uint32_t mask(int bits) { return ~(uint32_t)0 << (32 - bits); }

static bool is_inside_ipv4(uint32_t address) {
    for (size_t i = 0; i < sizeof inside_ipv4 / sizeof *inside_ipv4; i++)
        if ((address & mask(inside_ipv4[i].bits)) == inside_ipv4[i].prefix) return true;
    return false;
}

static uint32_t first_word(const unsigned char *bytes) {
    return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

static bool is_inside_ipv6(const struct in6_addr *address) {
    uint32_t first = first_word(address->s6_addr);
    if (first >> 29 != 1) return true; /* not 2000::/3 */
    for (size_t i = 0; i < sizeof inside_ipv6 / sizeof *inside_ipv6; i++)
        if (((first ^ first_word(inside_ipv6[i].prefix)) & mask(inside_ipv6[i].bits)) == 0) return true;
    return false;
}

bool address_is_inside(const struct sockaddr *address) {
    struct sockaddr_in ipv4;
    struct sockaddr_in6 ipv6;
    if (address->sa_family == AF_INET) {
        memcpy(&ipv4, address, sizeof ipv4);
        return is_inside_ipv4(ntohl(ipv4.sin_addr.s_addr));
    }
    if (address->sa_family != AF_INET6) return true;
    memcpy(&ipv6, address, sizeof ipv6);
    return is_inside_ipv6(&ipv6.sin6_addr);
}

bool address_is_listed(const struct sockaddr *address, const char *list) {
    char text[INET6_ADDRSTRLEN] = "";
    struct sockaddr_in ipv4;
    struct sockaddr_in6 ipv6;
    if (address->sa_family == AF_INET) {
        memcpy(&ipv4, address, sizeof ipv4);
        inet_ntop(AF_INET, &ipv4.sin_addr, text, sizeof text);
    } else if (address->sa_family == AF_INET6) {
        memcpy(&ipv6, address, sizeof ipv6);
        inet_ntop(AF_INET6, &ipv6.sin6_addr, text, sizeof text);
    }
    for (const char *item = list; text[0] && *item; item += strcspn(item, ","), item += *item == ',') {
        item += strspn(item, " ");
        size_t length = strcspn(item, ", ");
        if (length == strlen(text) && strncmp(item, text, length) == 0) return true;
    }
    return false;
}
