/* SHA-256, by nettle: the name of a cloud and the tag of an output.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DIGEST_H
#define WHITTLE_SERVER_DIGEST_H

#include <stddef.h>
#include <stdint.h>

enum { DIGEST_HEX_BYTES = 65, DIGEST_BASE64_BYTES = 45 };

struct digest; /* a hash in the making */

/* Returns new, NULL when memory runs out; digest_free accepts NULL. */
struct digest *digest_new(void);
void digest_free(struct digest *digest);

void digest_update(struct digest *digest, const void *bytes, size_t count);

/* Writes the hash as lower-case hexadecimal, and starts anew. */
void digest_finish(struct digest *digest, char hex[DIGEST_HEX_BYTES]);

/* The hash and length of an open file, read from its start in blocks.  -1 with errno when it can't be read. */
int digest_file(int fd, char hex[DIGEST_HEX_BYTES], uint64_t *bytes);

/* Hexadecimal to base64, as Repr-Digest wants it. */
void digest_base64(const char hex[DIGEST_HEX_BYTES], char base64[DIGEST_BASE64_BYTES]);

#endif
