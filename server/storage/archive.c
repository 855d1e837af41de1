/* Headers are those of POSIX ustar, without times, users or groups.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/archive.h"

#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum {
    BLOCK_BYTES = 512,
    PIECE_BYTES = 1 << 20,
    MARK_AT = 257,
    KIND_AT = 156,
    SUM_AT = 148,
    SIZE_AT = 124,
    MODE_AT = 100
};

static uint64_t padding(uint64_t bytes) { return (BLOCK_BYTES - bytes % BLOCK_BYTES) % BLOCK_BYTES; }

uint64_t archive_bytes(const struct archive_member *member, size_t count) {
    uint64_t bytes = 2 * BLOCK_BYTES;
    for (size_t i = 0; i < count; i++) {
        uint64_t more = BLOCK_BYTES + padding(member[i].bytes);
        if (member[i].bytes > UINT64_MAX / 2 || bytes > UINT64_MAX / 2 - more) return UINT64_MAX;
        bytes += more + member[i].bytes;
    }
    return bytes;
}

/* Eleven octal digits, or where those don't do a number of 11 bytes behind 0x80. */
static void put_size(unsigned char *header, uint64_t bytes) {
    enum { DIGITS = 11 };
    if (bytes >> 3 * DIGITS == 0) {
        snprintf((char *)header + SIZE_AT, DIGITS + 1, "%011" PRIo64, bytes);
        return;
    }
    header[SIZE_AT] = 0x80;
    for (size_t i = 0; i < sizeof bytes; i++) header[SIZE_AT + DIGITS - i] = (unsigned char)(bytes >> 8 * i);
}

static void make_header(unsigned char header[BLOCK_BYTES], size_t number, uint64_t bytes) {
    unsigned sum = 0;
    memset(header, 0, BLOCK_BYTES);
    snprintf((char *)header, 32, "cloud-%zu", number);
    memcpy(header + MODE_AT,
           "0000644\0"
           "0000000\0"
           "0000000",
           24);
    put_size(header, bytes);
    memcpy(header + SIZE_AT + 12, "00000000000", 12);
    memset(header + SUM_AT, ' ', 8);
    header[KIND_AT] = '0';
    memcpy(header + MARK_AT,
           "ustar\0"
           "00",
           8);
    for (size_t i = 0; i < BLOCK_BYTES; i++) sum += header[i];
    snprintf((char *)header + SUM_AT, 8, "%06o", sum);
}

static bool lose(const struct archive_member *member, const char *why, struct problem *problem) {
    problem_set(problem, PROBLEM_NO_SUCH_CLOUD, "the cloud %.64s %s", member->sha256, why);
    return false;
}

static bool copy(struct store *store, const struct archive_member *member, unsigned char *piece, struct upload *upload,
                 struct problem *problem) {
    int fd = store_cloud_open(store, member->sha256);
    uint64_t left = member->bytes;
    bool ok = fd >= 0;
    if (!ok && errno == ENOENT)
        lose(member, "is not here any more", problem);
    else if (!ok)
        problem_set(problem, PROBLEM_NOT_READY, "the cloud %.64s can't be read: %s", member->sha256, strerror(errno));
    while (ok && left > 0) {
        ssize_t n = read(fd, piece, left < PIECE_BYTES ? (size_t)left : PIECE_BYTES);
        if (n < 0 && errno == EINTR) continue;
        ok = n > 0 ? upload_write(upload, piece, (size_t)n, problem) : lose(member, "can't be read", problem);
        if (n > 0) left -= (uint64_t)n;
    }
    if (fd >= 0) close(fd);
    return ok;
}

struct upload *archive_make(struct store *store, struct thread_pool *threads, const struct archive_member *member,
                            size_t count, uint64_t max_bytes, const struct admission *admission,
                            struct problem *problem) {
    static const unsigned char zeros[2 * BLOCK_BYTES];
    unsigned char header[BLOCK_BYTES], *piece = malloc(PIECE_BYTES);
    struct upload *upload =
        piece ? upload_new(store, threads, archive_bytes(member, count), max_bytes, admission, problem) : NULL;
    if (!piece) problem_set(problem, PROBLEM_INTERNAL_ERROR, "no memory");
    bool ok = upload != NULL;
    for (size_t i = 0; i < count && ok; i++) {
        make_header(header, i + 1, member[i].bytes);
        ok = upload_write(upload, header, sizeof header, problem) && copy(store, &member[i], piece, upload, problem) &&
             upload_write(upload, zeros, (size_t)padding(member[i].bytes), problem);
    }
    ok = ok && upload_write(upload, zeros, sizeof zeros, problem);
    free(piece);
    if (ok) return upload;
    upload_free(upload);
    return NULL;
}
