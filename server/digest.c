/* SHA-256, by nettle.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/digest.h"

#include <errno.h>
#include <nettle/base16.h>
#include <nettle/base64.h>
#include <nettle/hmac.h>
#include <nettle/memops.h>
#include <nettle/sha1.h>
#include <nettle/sha2.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/alloc.h"

enum { BLOCK_BYTES = 64 * 1024 /* on the stack */ };

struct digest {
    bool is_sha1;
    struct sha256_ctx sha;
    struct sha1_ctx sha1;
};

struct digest *digest_new(void) {
    struct digest *digest = alloc_array(1, sizeof *digest);
    if (digest) sha256_init(&digest->sha);
    if (digest) digest->is_sha1 = false;
    return digest;
}

struct digest *digest_new_sha1(void) {
    struct digest *digest = malloc(sizeof *digest);
    if (digest) sha1_init(&digest->sha1);
    if (digest) digest->is_sha1 = true;
    return digest;
}

void digest_free(struct digest *digest) { free(digest); }

void digest_update(struct digest *digest, const void *bytes, size_t count) {
    if (digest->is_sha1)
        sha1_update(&digest->sha1, count, bytes);
    else
        sha256_update(&digest->sha, count, bytes);
}

void digest_finish(struct digest *digest, char hex[DIGEST_HEX_BYTES]) {
    uint8_t raw[SHA256_DIGEST_SIZE];
    sha256_digest(&digest->sha, sizeof raw, raw);
    base16_encode_update(hex, sizeof raw, raw);
    hex[DIGEST_HEX_BYTES - 1] = 0;
}

void digest_finish_base64(struct digest *digest, char base64[DIGEST_BASE64_BYTES]) {
    uint8_t raw[SHA256_DIGEST_SIZE];
    size_t length = digest->is_sha1 ? SHA1_DIGEST_SIZE : SHA256_DIGEST_SIZE;
    if (digest->is_sha1)
        sha1_digest(&digest->sha1, length, raw);
    else
        sha256_digest(&digest->sha, length, raw);
    base64_encode_raw(base64, length, raw);
    base64[BASE64_ENCODE_RAW_LENGTH(length)] = 0;
}

/* Hashes up to so many bytes; returns how many there were, or -1 with errno. */
static int64_t read_some(int fd, struct digest *digest, uint64_t offset, uint64_t most) {
    unsigned char block[BLOCK_BYTES];
    uint64_t done = 0;
    while (done < most) {
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
    int64_t found = read_some(fd, digest, offset, count);
    if (found >= 0 && (uint64_t)found < count) errno = EIO;
    return found >= 0 && (uint64_t)found == count ? 0 : -1;
}

int digest_file(int fd, char hex[DIGEST_HEX_BYTES], uint64_t *bytes) {
    struct digest *digest = digest_new();
    int64_t found = digest ? read_some(fd, digest, 0, INT64_MAX) : -1;
    if (found >= 0) {
        *bytes = (uint64_t)found;
        digest_finish(digest, hex);
    }
    digest_free(digest);
    return found >= 0 ? 0 : -1;
}

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
