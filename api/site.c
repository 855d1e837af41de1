/* Hosts and origins.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/site.h"

#include <arpa/inet.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

/* A stretch of text. */
struct span {
    const char *text;
    size_t bytes;
};

static bool span_is(struct span span, const char *text) {
    return span.bytes == strlen(text) && strncasecmp(span.text, text, span.bytes) == 0;
}

static bool span_ends(struct span span, struct span end) {
    return span.bytes > end.bytes && strncasecmp(span.text + span.bytes - end.bytes, end.text, end.bytes) == 0;
}

/* The next item of a list, without blanks around it; false past the last. */
static bool next_item(const char **list, struct span *item) {
    *list += strspn(*list, ", \t");
    if (!**list) return false;
    size_t bytes = strcspn(*list, ",");
    *item = (struct span){*list, bytes};
    *list += bytes;
    while (item->bytes && strchr(" \t", item->text[item->bytes - 1])) item->bytes--;
    return true;
}

/* The host of "HOST[:PORT]" or "[ADDRESS][:PORT]", without brackets and the dot that may end a name. */
static struct span host_of(const char *authority) {
    if (authority[0] == '[') return (struct span){authority + 1, strcspn(authority + 1, "]")};
    struct span host = {authority, strcspn(authority, ":")};
    if (host.bytes > 1 && host.text[host.bytes - 1] == '.') host.bytes--;
    return host;
}

/* ------------------------------------------------------------------------------------------------ hosts */

static bool is_address(struct span host) {
    char text[INET6_ADDRSTRLEN];
    unsigned char address[sizeof(struct in6_addr)];
    if (host.bytes >= sizeof text) return false;
    memcpy(text, host.text, host.bytes);
    text[host.bytes] = 0;
    return inet_pton(AF_INET, text, address) == 1 || inet_pton(AF_INET6, text, address) == 1;
}

static bool is_name(struct span host) {
    static const char allowed[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.";
    return host.bytes > 0 && strspn(host.text, allowed) >= host.bytes;
}

static struct span without_brackets(struct span item) {
    bool bracketed = item.bytes >= 2 && item.text[0] == '[' && item.text[item.bytes - 1] == ']';
    return bracketed ? (struct span){item.text + 1, item.bytes - 2} : item;
}

bool site_hosts_valid(const char *list) {
    struct span item;
    while (next_item(&list, &item)) {
        bool below = item.bytes > 2 && strncmp(item.text, "*.", 2) == 0;
        struct span name = below ? (struct span){item.text + 2, item.bytes - 2} : without_brackets(item);
        if (!span_is(item, "*") && !is_name(name) && !is_address(name)) return false;
    }
    return true;
}

bool site_host_listed(const char *list, const char *authority) {
    struct span item, host = host_of(authority);
    while (next_item(&list, &item)) {
        struct span name = without_brackets(item);
        if (span_is(item, "*")) return true;
        if (item.text[0] == '*' && span_ends(host, (struct span){item.text + 1, item.bytes - 1})) return true;
        if (name.bytes == host.bytes && strncasecmp(name.text, host.text, host.bytes) == 0) return true;
    }
    return false;
}

bool site_host_is_local(const char *authority) {
    struct span host = host_of(authority);
    return span_is(host, "localhost") || span_ends(host, (struct span){".localhost", 10}) || is_address(host);
}

bool site_host_is_short(const char *authority) {
    struct span host = host_of(authority);
    return is_name(host) && !memchr(host.text, '.', host.bytes);
}

bool site_host_is_plain(const char *authority) {
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.:[]";
    return authority[0] && !authority[strspn(authority, plain)];
}

/* ------------------------------------------------------------------------------------------------ origins */

/* What follows "scheme://"; NULL where there is no such thing. */
static const char *authority_of(const char *origin) {
    static const char letters[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789+-.";
    size_t scheme = strspn(origin, letters);
    return scheme && strncmp(origin + scheme, "://", 3) == 0 ? origin + scheme + 3 : NULL;
}

bool site_origins_valid(const char *list) {
    struct span item;
    while (next_item(&list, &item)) {
        const char *authority = authority_of(item.text), *end = item.text + item.bytes;
        if (span_is(item, "*")) continue;
        if (!authority || authority >= end || memchr(authority, '/', (size_t)(end - authority)) ||
            memchr(item.text, ' ', item.bytes) || memchr(item.text, '*', item.bytes))
            return false;
    }
    return true;
}

bool site_origin_listed(const char *list, const char *origin) {
    struct span item;
    while (next_item(&list, &item))
        if (span_is(item, "*") || span_is(item, origin)) return true;
    return false;
}

bool site_origin_is_of(const char *origin, const char *authority) {
    const char *own = authority_of(origin);
    return own && strcasecmp(own, authority) == 0;
}
