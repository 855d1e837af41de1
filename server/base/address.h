/* Addresses to listen at, as settings have them: "HOST:PORT", "[HOST]:PORT" where the host has colons.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_ADDRESS_H
#define WHITTLE_SERVER_BASE_ADDRESS_H

#include <stdbool.h>

enum { ADDRESS_HOST_BYTES = 96, ADDRESS_MAX_PORT = 65535 };

struct address {
    char host[ADDRESS_HOST_BYTES]; /* without brackets */
    unsigned port;                 /* ADDRESS_MAX_PORT at most */
};

/* Cuts it in two; false, and *address untouched, where it isn't such an address. */
bool address_read(const char *text, struct address *address);

#endif
