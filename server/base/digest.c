/* SHA-256, SHA-1 and SHA-512, by nettle.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/digest.h"

#include <errno.h>
#include <nettle/base16.h>
#include <nettle/base64.h>
#include <nettle/hmac.h>
#include <nettle/memops.h>
#include <nettle/nettle-meta.h>
#include <nettle/sha1.h>
#include <nettle/sha2.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"

enum { BLOCK_BYTES = 64 * 1024 /* on the stack */ };

struct digest {
    const struct nettle_hash *hash;
    union {
        struct sha256_ctx sha256;
        struct sha1_ctx sha1;
        struct sha512_ctx sha512;
    } state;
};

static struct digest *digest_of(const struct nettle_hash *hash) {
    struct digest *digest = alloc_array(1, sizeof *digest);
    if (!digest) return NULL;
    digest->hash = hash;
    hash->init(&digest->state);
    return digest;
}

struct digest *digest_new(void) {
    return digest_of(&nettle_sha256);
}
struct digest *digest_new_sha1(void) {
    return digest_of(&nettle_sha1);
}
struct digest *digest_new_sha512(void) {
    return digest_of(&nettle_sha512);
}

void digest_free(struct digest *digest) { free(digest); }

void digest_update(struct digest *digest, const void *bytes, size_t count) {
    digest->hash->update(&digest->state, count, bytes);
}

void digest_finish(struct digest *digest, char hex[DIGEST_HEX_BYTES]) {
    uint8_t raw[SHA256_DIGEST_SIZE];
    digest->hash->digest(&digest->state, sizeof raw, raw);
    base16_encode_update(hex, sizeof raw, raw);
    hex[DIGEST_HEX_BYTES - 1] = 0;
}

void digest_finish_base64(struct digest *digest, char base64[DIGEST_LONGEST_BASE64_BYTES]) {
    uint8_t raw[SHA512_DIGEST_SIZE];
    size_t length = digest->hash->digest_size;
    digest->hash->digest(&digest->state, length, raw);
    base64_encode_raw(base64, length, raw);
    base64[BASE64_ENCODE_RAW_LENGTH(length)] = 0;
}

/* Hashes up to so many bytes; returns how many there were, or -1 with errno.  will NULL: it goes on. */
static int64_t read_some(int fd, struct digest *digest, uint64_t offset, uint64_t most,
                         const struct digest_will *will) {
    unsigned char block[BLOCK_BYTES];
    uint64_t done = 0;
    while (done < most) {
        if (will && !will->goes_on(will->ctx)) {
            errno = ECANCELED;
            return -1;
        }
        size_t wanted = most - done < BLOCK_BYTES ? (size_t)(most - done) : BLOCK_BYTES;
        ssize_t n = pread(fd, block, wanted, (off_t)(offset + done));
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return -1;
        if (n == 0) break;
        digest_update(digest, block, (size_t)n);
        done += (uint64_t)n;
    }
    return (int64_t)done;
}

int digest_range(struct digest *digest, int fd, uint64_t offset, uint64_t count) {
    int64_t found = read_some(fd, digest, offset, count, NULL);
    if (found >= 0 && (uint64_t)found < count) errno = EIO;
    return found >= 0 && (uint64_t)found == count ? 0 : -1;
}

int digest_file_while(int fd, const struct digest_will *will, char hex[DIGEST_HEX_BYTES], uint64_t *bytes) {
    struct digest *digest = digest_new();
    int64_t found = digest ? read_some(fd, digest, 0, INT64_MAX, will) : -1;
    if (found >= 0) {
        *bytes = (uint64_t)found;
        digest_finish(digest, hex);
    }
    digest_free(digest);
    return found >= 0 ? 0 : -1;
}

int digest_file(int fd, char hex[DIGEST_HEX_BYTES], uint64_t *bytes) { return digest_file_while(fd, NULL, hex, bytes); }

bool digest_text(const char *text, char hex[DIGEST_HEX_BYTES]) {
    struct digest *digest = digest_new();
    if (!digest) return false;
    digest_update(digest, text, strlen(text));
    digest_finish(digest, hex);
    digest_free(digest);
    return true;
}

void digest_hmac(const void *key, size_t key_bytes, const void *message, size_t bytes, char hex[DIGEST_HEX_BYTES]) {
    struct hmac_sha256_ctx ctx;
    uint8_t raw[SHA256_DIGEST_SIZE];
    hmac_sha256_set_key(&ctx, key_bytes, key);
    hmac_sha256_update(&ctx, bytes, message);
    hmac_sha256_digest(&ctx, sizeof raw, raw);
    base16_encode_update(hex, sizeof raw, raw);
    hex[DIGEST_HEX_BYTES - 1] = 0;
}

bool digest_same(const char a[DIGEST_HEX_BYTES], const char b[DIGEST_HEX_BYTES]) {
    return memeql_sec(a, b, DIGEST_HEX_BYTES - 1) != 0;
}

void digest_base64(const char hex[DIGEST_HEX_BYTES], char base64[DIGEST_BASE64_BYTES]) {
    uint8_t raw[SHA256_DIGEST_SIZE] = {0};
    size_t length = sizeof raw;
    struct base16_decode_ctx ctx;
    base16_decode_init(&ctx);
    base16_decode_update(&ctx, &length, raw, DIGEST_HEX_BYTES - 1, hex);
    base64_encode_raw(base64, sizeof raw, raw);
    base64[DIGEST_BASE64_BYTES - 1] = 0;
}

bool digest_base64_read(const char *base64, unsigned char *bytes, size_t *count) {
    struct base64_decode_ctx ctx;
    size_t length = strlen(base64), room = *count;
    if (BASE64_DECODE_LENGTH(length) > room) return false;
    base64_decode_init(&ctx);
    return base64_decode_update(&ctx, count, bytes, length, base64) && base64_decode_final(&ctx);
}
