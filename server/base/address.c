/* Addresses to listen at.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/address.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { PORT_DIGITS = 5 };

bool address_read(const char *text, struct address *address) {
    const char *colon = strrchr(text, ':');
    size_t length = colon ? (size_t)(colon - text) : 0, digits = colon ? strlen(colon + 1) : 0;
    if (length >= 2 && text[0] == '[' && colon[-1] == ']') {
        text++;
        length -= 2;
    }
    if (length == 0 || length >= ADDRESS_HOST_BYTES || digits == 0 || digits > PORT_DIGITS ||
        strspn(colon + 1, "0123456789") != digits)
        return false;
    unsigned long port = strtoul(colon + 1, NULL, 10);
    if (port > ADDRESS_MAX_PORT) return false;
    memcpy(address->host, text, length);
    address->host[length] = 0;
    address->port = (unsigned)port;
    return true;
}
