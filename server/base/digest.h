/* SHA-256, by nettle: the name of a cloud and the tag of an output; SHA-1, for checksums of pieces; and SHA-512, for
 * digests of bodies.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_DIGEST_H
#define WHITTLE_SERVER_BASE_DIGEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { DIGEST_HEX_BYTES = 65, DIGEST_BASE64_BYTES = 45, DIGEST_LONGEST_BASE64_BYTES = 89 /* SHA-512's */ };

struct digest; /* a hash in the making */

/* Returns new, NULL when memory runs out; digest_free accepts NULL.  Those of SHA-1 and
 * SHA-512 have no use but in base64. */
struct digest *digest_new(void);
struct digest *digest_new_sha1(void);
struct digest *digest_new_sha512(void);
void digest_free(struct digest *digest);

void digest_update(struct digest *digest, const void *bytes, size_t count);

/* Writes the hash as lower-case hexadecimal, and starts anew. */
void digest_finish(struct digest *digest, char hex[DIGEST_HEX_BYTES]);

/* The same as base64, of any hash. */
void digest_finish_base64(struct digest *digest, char base64[DIGEST_LONGEST_BASE64_BYTES]);

/* Adds count bytes of an open file.  -1 with errno when they can't be read; EIO: the file ends before. */
int digest_range(struct digest *digest, int fd, uint64_t offset, uint64_t count);

/* The hash and length of an open file, read from its start in blocks.  -1 with errno when it can't be read. */
int digest_file(int fd, char hex[DIGEST_HEX_BYTES], uint64_t *bytes);

/* The same, for as long as goes_on, asked before each block, says so; then -1 with ECANCELED. */
struct digest_will {
    bool (*goes_on)(void *ctx);
    void *ctx;
};
int digest_file_while(int fd, const struct digest_will *will, char hex[DIGEST_HEX_BYTES], uint64_t *bytes);

/* The hash of a text; false when memory runs out. */
bool digest_text(const char *text, char hex[DIGEST_HEX_BYTES]);

/* HMAC-SHA256 of a message, as lower-case hexadecimal. */
void digest_hmac(const void *key, size_t key_bytes, const void *message, size_t bytes, char hex[DIGEST_HEX_BYTES]);

/* Whether two hashes in hexadecimal are the same, in a time that doesn't tell where they differ. */
bool digest_same(const char a[DIGEST_HEX_BYTES], const char b[DIGEST_HEX_BYTES]);

/* Base64 to bytes, at most *count of them; *count is how many there were.  false: it is no base64, or too much. */
bool digest_base64_read(const char *base64, unsigned char *bytes, size_t *count);

/* Hexadecimal to base64, as Repr-Digest wants it. */
void digest_base64(const char hex[DIGEST_HEX_BYTES], char base64[DIGEST_BASE64_BYTES]);

#endif
