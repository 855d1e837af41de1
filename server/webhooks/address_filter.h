/* Which addresses are inside: loopback, private networks, and all else that isn't the public internet.  A service that
 * opens connections to where its clients say must not be led there.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WEBHOOKS_ADDRESS_FILTER_H
#define WHITTLE_SERVER_WEBHOOKS_ADDRESS_FILTER_H

#include <stdbool.h>
#include <sys/socket.h>

/* Whether an address is none of the public internet.  What is neither IPv4 nor IPv6 is inside.
 * Source: IANA IPv4 and IPv6 Special-Purpose Address Registries (RFC 6890). */
bool address_is_inside(const struct sockaddr *address);

/* Whether the address is in the list: numeric addresses, separated by commas. */
bool address_is_listed(const struct sockaddr *address, const char *list);

#endif
