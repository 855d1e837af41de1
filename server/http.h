/* The HTTP listener: connections, bodies, and calling handlers where they may block.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_H
#define WHITTLE_SERVER_HTTP_H

#include "server/service.h"

struct http;

enum { HTTP_ADDRESS_BYTES = 128 };

/* Listens on config->listen; address gets "HOST:PORT" with the true port.  STATUS_BAD_PARAMETER when the address is
 * malformed, or beyond loopback without insecure_open. */
enum status http_open(struct service *service, struct http **http, char address[HTTP_ADDRESS_BYTES],
                      struct error *error) MUST_CHECK;

/* Takes no more connections, answers those that wait (service->events must be closed before), and ends.  Accepts
 * NULL. */
void http_close(struct http *http);

#endif
