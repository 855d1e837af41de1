/* One POST to an address that a client gave, by libcurl: the only file that knows it.
 *
 * The request goes to no inside address (webhooks/address_filter.h): that is decided on the address that a connection
 * is about to be opened to, after the name was resolved, so a name that resolves to something else a moment later
 * doesn't help. Redirects are not followed, no proxy is used, nothing but http and https is spoken, and of the
 * answer only the status counts: at most 64 KiB of headers and 64 KiB of text are read, the text for 2 s at most.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WEBHOOKS_HTTP_CLIENT_H
#define WHITTLE_SERVER_WEBHOOKS_HTTP_CLIENT_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"

enum { HTTP_CLIENT_MAX_HEADERS = 8 };

struct http_client_post {
    const char *url, *body;
    size_t body_bytes;
    const char *header[HTTP_CLIENT_MAX_HEADERS]; /* "Name: value"; NULL ends them */
    const char *allow; /* inside addresses that are allowed all the same (address_is_listed) */
    long timeout_ms;
    const _Atomic bool *stop; /* it is given up as soon as this is true */
};

/* To be called once, before any thread; and at the end. */
enum status http_client_open(struct error *error) MUST_CHECK;
void http_client_close(void);

/* Sends it; blocks.  STATUS_OK with the HTTP status that came back; STATUS_IO: nothing did, and why. */
enum status http_client_post(const struct http_client_post *post, int *http_status, struct error *error) MUST_CHECK;

/* "host:port" of a URL that is valid, in lower case, cut where it doesn't fit; false: none. */
bool http_client_url_host(const char *url, char *host, size_t bytes);

/* Whether the text is an http or https URL with a host and without user and password. */
bool http_client_url_valid(const char *url);

#endif
