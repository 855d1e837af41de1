/* Signed paths: a link that opens one resource to whoever has it, until it expires.
 *
 * The signature is HMAC-SHA256 over path and expiry, by a key that is made at the first start and kept in a file that
 * only the service can read.  Removing the file ends all links at the next start.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_SIGNATURE_H
#define WHITTLE_SERVER_BASE_SIGNATURE_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/status.h"

enum { SIGNATURE_KEY_BYTES = 32, SIGNATURE_HEX_BYTES = 65 };

struct signature_key {
    unsigned char bytes[SIGNATURE_KEY_BYTES];
};

/* Reads the key of the file, or makes both (mode 0600, durable).  STATUS_MALFORMED when the file is no key, or others
 * may read it. */
enum status signature_open(const char *path, struct signature_key *key, struct error *error) MUST_CHECK;

/* Writes the key into a file that isn't there (mode 0600, durable). */
enum status signature_write(const char *path, const struct signature_key *key, struct error *error) MUST_CHECK;

/* The key as hexadecimal, and back; false: the text is no key. */
void signature_key_text(const struct signature_key *key, char hex[SIGNATURE_HEX_BYTES]);
bool signature_key_read(const char *hex, struct signature_key *key);

/* Signs a path until a time in seconds since 1970. */
void signature_make(const struct signature_key *key, const char *path, int64_t expires_s,
                    char hex[SIGNATURE_HEX_BYTES]);

/* Whether hex is the signature of path and expires_s; compared in constant time.  Whether it has expired is the
 * caller's to see. */
bool signature_holds(const struct signature_key *key, const char *path, int64_t expires_s, const char *hex);

#endif
