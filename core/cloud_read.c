/* Bytes from a descriptor, and the reader for their format.
 *
 * Both readers want all bytes at once.  A regular file is mapped, so that they come straight from the page cache; a
 * pipe is read into a buffer that grows by half.  What a pipe's first bytes say is believed as soon as they are there:
 * data of an unknown kind, or more than a PLY header promises, isn't read to its end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud_read.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/alloc.h"
#include "core/cloud_ply.h"
#include "core/cloud_sniff.h"
#include "core/cloud_xyz.h"

enum { FIRST_BYTES = PLY_HEADER_MAX_BYTES };

/* ------------------------------------------------------------------------------------------------ formats */

static enum status check_kind(const void *bytes, size_t n, struct error *error) {
    struct cloud_guess guess = cloud_sniff(bytes, n);
    switch (guess.kind) {
    case CLOUD_KIND_EMPTY: return error_set_at(error, STATUS_MALFORMED, "read", 0, 0, "the file is empty");
    case CLOUD_KIND_OTHER:
        return error_set_at(error, STATUS_UNSUPPORTED, "read", 0, 0, "this looks like %s; PLY and XYZ are read",
                            guess.looks_like);
    case CLOUD_KIND_PLY:
    case CLOUD_KIND_TEXT: return STATUS_OK;
    }
    return STATUS_ENGINE;
}

enum status cloud_read_memory(const void *bytes, size_t n, const struct cloud_limits *limits,
                              const struct progress *progress, struct cloud *cloud, struct error *error) {
    enum status status = check_kind(bytes, n, error);
    if (status) return status;
    return (cloud_sniff(bytes, n).kind == CLOUD_KIND_PLY ? cloud_ply_read : cloud_xyz_read)(bytes, n, limits, progress,
                                                                                            cloud, error);
}

/* ------------------------------------------------------------------------------------------------ pipes */

struct buffer {
    unsigned char *bytes; /* owned */
    size_t used, capacity;
    bool ended;
};

/* Reads until the buffer holds want bytes or the data ends. */
static enum status fill(int fd, struct buffer *b, size_t want, struct error *error) {
    while (!b->ended && b->used < want) {
        if (b->used == b->capacity) {
            size_t capacity = b->capacity + b->capacity / 2 + FIRST_BYTES;
            unsigned char *grown = alloc_resize(b->bytes, capacity, 1);
            if (!grown) return error_set(error, STATUS_NO_MEMORY, "read", "no memory after %zu bytes", b->used);
            b->bytes = grown;
            b->capacity = capacity;
        }
        size_t room = b->capacity - b->used, missing = want - b->used;
        ssize_t got = read(fd, b->bytes + b->used, room < missing ? room : missing);
        if (got < 0 && errno != EINTR) return error_set(error, STATUS_IO, "read", "can't read: %s", strerror(errno));
        if (got > 0) b->used += (size_t)got;
        b->ended = got == 0;
    }
    return STATUS_OK;
}

/* How many bytes are worth reading after the first: one more than a header of known length promises. */
static enum status worth_reading(const struct buffer *b, size_t *want, struct error *error) {
    *want = SIZE_MAX;
    enum status status = check_kind(b->bytes, b->used, error);
    if (status || cloud_sniff(b->bytes, b->used).kind != CLOUD_KIND_PLY) return status;
    struct ply_summary summary;
    status = ply_header_check(b->bytes, b->used, b->ended ? b->used : UINT64_MAX, &summary, error);
    if (!status && summary.complete && summary.bytes_exact && summary.bytes_expected < SIZE_MAX)
        *want = (size_t)summary.bytes_expected + 1;
    return status;
}

static enum status read_pipe(int fd, struct buffer *b, struct error *error) {
    size_t want;
    enum status status = fill(fd, b, FIRST_BYTES, error);
    if (!status) status = worth_reading(b, &want, error);
    return status ? status : fill(fd, b, want, error);
}

static enum status read_from_pipe(int fd, const struct cloud_limits *limits, const struct progress *progress,
                                  struct cloud *cloud, struct error *error) {
    struct buffer b = {0};
    enum status status = read_pipe(fd, &b, error);
    if (!status) status = cloud_read_memory(b.bytes, b.used, limits, progress, cloud, error);
    free(b.bytes);
    return status;
}

/* ------------------------------------------------------------------------------------------------ files */

enum status cloud_read(int fd, const struct cloud_limits *limits, const struct progress *progress, struct cloud *cloud,
                       struct error *error) {
    struct stat about;
    if (fstat(fd, &about) != 0) return error_set(error, STATUS_IO, "read", "can't read: %s", strerror(errno));
    if (S_ISDIR(about.st_mode)) return error_set(error, STATUS_IO, "read", "can't read: %s", strerror(EISDIR));
    off_t begin = S_ISREG(about.st_mode) ? lseek(fd, 0, SEEK_CUR) : -1;
    if (begin < 0) return read_from_pipe(fd, limits, progress, cloud, error);
    if (begin >= about.st_size) return cloud_read_memory("", 0, limits, progress, cloud, error);
    size_t length = (size_t)about.st_size;
    unsigned char *map = mmap(NULL, length, PROT_READ, MAP_PRIVATE, fd, 0);
    if (map == MAP_FAILED) return read_from_pipe(fd, limits, progress, cloud, error);
    (void)madvise(map, length, MADV_SEQUENTIAL);
    enum status status = cloud_read_memory(map + begin, length - (size_t)begin, limits, progress, cloud, error);
    munmap(map, length);
    return status;
}

enum status cloud_read_path(const char *path, const struct cloud_limits *limits, const struct progress *progress,
                            struct cloud *cloud, struct error *error) {
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return error_set(error, STATUS_IO, "read", "can't open %s: %s", path, strerror(errno));
    enum status status = cloud_read(fd, limits, progress, cloud, error);
    close(fd);
    return status;
}
