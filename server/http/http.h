/* The HTTP listener: connections, bodies, and calling handlers where they may block.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_HTTP_H
#define WHITTLE_SERVER_HTTP_HTTP_H

#include "server/jobs/service.h"

struct handlers;
struct http;

enum { HTTP_ADDRESS_BYTES = 160 };

/* URLs without a path, with the true ports; admin "" = there is none. */
struct http_addresses {
    char main[HTTP_ADDRESS_BYTES], admin[HTTP_ADDRESS_BYTES];
};

/* Calls these handlers, which are borrowed.  Listens on config->listen, and for health and metrics on
 * config->admin_listen.  STATUS_BAD_PARAMETER when an address is malformed, or beyond loopback with neither tokens nor
 * insecure_open. */
enum status http_open(struct service *service, const struct handlers *handlers, struct http **http,
                      struct http_addresses *addresses, struct error *error) MUST_CHECK;

/* Looks at the addresses of these settings as http_open does, and listens nowhere. */
enum status http_check_addresses(const struct config *config, struct error *error) MUST_CHECK;

/* How many bodies of clouds are on their way in. */
unsigned http_uploads(struct http *http);

/* Takes no more connections, answers those that wait (service->feed must be closed before), and ends.  Accepts
 * NULL. */
void http_close(struct http *http);

#endif
