/* The socket that the service listens on.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_LISTEN_H
#define WHITTLE_SERVER_HTTP_LISTEN_H

#include <stdbool.h>

#include "core/base/status.h"

/* Opens a listening socket on "HOST:PORT" ("[::1]:8080" for IPv6; port 0 takes a free one).  STATUS_BAD_PARAMETER when
 * the address is malformed, or not loopback and open is false; STATUS_IO when it is taken.  *fd is the caller's. */
enum status listen_open(const char *address, bool open, int *fd, struct error *error) MUST_CHECK;

/* Takes over a listening socket that was inherited, instead of opening one.  STATUS_BAD_PARAMETER when it isn't a
 * listening TCP socket, or not on loopback and open is false.  *fd is the caller's, and is inherited itself. */
enum status listen_adopt(int inherited, bool open, int *fd, struct error *error) MUST_CHECK;

/* "HOST:PORT" of a listening socket. */
enum { LISTEN_NAME_BYTES = 128 };
void listen_name(int fd, char name[LISTEN_NAME_BYTES]);

/* The host of a client's address, without its port. */
struct sockaddr;
void listen_peer(const struct sockaddr *address, char host[LISTEN_NAME_BYTES]);

#endif
