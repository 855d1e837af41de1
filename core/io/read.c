/* Bytes from a descriptor, and the reader for their format.
 *
 *     regular file -> mapped --+-----------------------------> reader of its kind
 *     pipe --------> buffer ---+--> inflate --> buffer ----->
 *
 * All readers want all bytes at once.  A regular file is mapped, so that they come straight from the page cache; what
 * comes from a pipe or is decompressed goes into a buffer that grows by half.  What the first bytes say is believed as
 * soon as they are there: data of an unknown kind, or more than a PLY header promises, isn't read to its end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/read.h"

#include <errno.h>
#include <fcntl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/io/codec/inflate.h"
#include "core/io/formats/ply_header.h"
#include "core/io/padding.h"
#include "core/io/reader.h"
#include "core/io/sniff.h"

enum { FIRST_BYTES = PLY_HEADER_MAX_BYTES, PIECE_BYTES = 64 * 1024 };

/* ------------------------------------------------------------------------------------------------ formats */

typedef enum status reader(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error);

static reader *const readers[] = {
#define ROW(constant, name, title, looks_like, forms) [CLOUD_KIND_##constant] = cloud_##name##_read,
    CLOUD_FORMAT_ROWS(ROW)
#undef ROW
        [CLOUD_KIND_OTHER] = NULL,
};

/* Whether there is a reader for what these bytes begin, which aren't compressed any more. */
static enum status check_kind(const void *bytes, size_t n, struct error *error) {
    struct cloud_guess guess = cloud_sniff(bytes, n);
    if (guess.kind == CLOUD_KIND_EMPTY) return error_set_at(error, STATUS_MALFORMED, "read", 0, 0, "the file is empty");
    if (readers[guess.kind]) return STATUS_OK;
    bool compressed = guess.kind == CLOUD_KIND_GZIP || guess.kind == CLOUD_KIND_ZSTD;
    if (compressed)
        return error_set_at(error, STATUS_UNSUPPORTED, "read", 0, 0, "this is %s twice over; once is read",
                            guess.looks_like);
    return error_set_at(error, STATUS_UNSUPPORTED, "read", 0, 0, "this looks like %s; what is read: %s",
                        guess.looks_like, cloud_sniff_titles());
}

static enum status read_plain(const void *bytes, size_t n, const struct cloud_limits *limits,
                              const struct progress *progress, struct cloud *cloud, struct error *error) {
    enum status status = check_kind(bytes, n, error);
    if (status) return status;
    enum cloud_kind kind = cloud_sniff(bytes, n).kind;
    if (kind != CLOUD_KIND_TEXT && limits && limits->columns && limits->columns[0] && !limits->columns_if_text)
        return error_set_at(error, STATUS_MALFORMED, "columns", 0, UINT64_MAX,
                            "the parameter columns names those of text; this is %s, which names its own",
                            cloud_sniff(bytes, n).looks_like);
    return readers[kind](bytes, n, limits, progress, cloud, error);
}

/* ------------------------------------------------------------------------------------------------ buffers */

struct buffer {
    unsigned char *bytes; /* owned */
    size_t used, capacity;
    bool ended;
};

static enum status buffer_reserve(struct buffer *b, size_t n, struct error *error) {
    if (b->capacity - b->used >= n) return STATUS_OK;
    size_t capacity = b->capacity + b->capacity / 2 + FIRST_BYTES + n;
    unsigned char *grown = alloc_resize(b->bytes, capacity, 1);
    if (!grown) return error_set(error, STATUS_NO_MEMORY, "read", "no memory after %zu bytes", b->used);
    b->bytes = grown;
    b->capacity = capacity;
    return STATUS_OK;
}

/* Reads until the buffer holds want bytes or the data ends. */
static enum status fill(int fd, struct buffer *b, size_t want, struct error *error) {
    while (!b->ended && b->used < want) {
        enum status status = buffer_reserve(b, 1, error);
        if (status) return status;
        size_t room = b->capacity - b->used, missing = want - b->used;
        ssize_t got = read(fd, b->bytes + b->used, room < missing ? room : missing);
        if (got < 0 && errno != EINTR) return error_set(error, STATUS_IO, "read", "can't read: %s", strerror(errno));
        if (got > 0) b->used += (size_t)got;
        b->ended = got == 0;
    }
    return STATUS_OK;
}

/* How many bytes are worth reading: what a header of known length counts, and what is told of the rest. */
static enum status worth_reading(const struct buffer *b, size_t *want, struct error *error) {
    *want = SIZE_MAX;
    enum status status = check_kind(b->bytes, b->used, error);
    if (status || cloud_sniff(b->bytes, b->used).kind != CLOUD_KIND_PLY) return status;
    struct ply_summary summary;
    status = ply_header_check(b->bytes, b->used, b->ended ? b->used : UINT64_MAX, &summary, error);
    if (!status && summary.complete && summary.bytes_exact && summary.bytes_expected < SIZE_MAX - PADDING_MOST_BYTES)
        *want = (size_t)summary.bytes_expected + PADDING_MOST_BYTES + 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ compressed */

struct unpack {
    struct buffer out;
    size_t want; /* 0: the first bytes aren't all there yet */
    bool enough; /* as many as are wanted are there */
    const struct progress *progress;
    struct error *error;
};

static enum status take(void *ctx, const void *bytes, size_t n) {
    struct unpack *u = ctx;
    if (progress_tick(u->progress, "read", 0)) return error_set(u->error, STATUS_CANCELLED, "read", "cancelled");
    enum status status = buffer_reserve(&u->out, n, u->error);
    if (status) return status;
    memcpy(u->out.bytes + u->out.used, bytes, n);
    u->out.used += n;
    if (!u->want && u->out.used >= FIRST_BYTES) status = worth_reading(&u->out, &u->want, u->error);
    u->enough = !status && u->want && u->out.used >= u->want;
    return u->enough ? STATUS_CANCELLED : status;
}

/* Pushes n bytes, and what fd (-1 = none) has after them. */
static enum status push_all(struct inflate *inflate, const void *bytes, size_t n, int fd, struct error *error) {
    struct buffer piece = {0};
    enum status status = inflate_push(inflate, bytes, n, error);
    while (!status && fd >= 0 && !piece.ended) {
        piece.used = 0;
        status = fill(fd, &piece, PIECE_BYTES, error);
        if (!status) status = inflate_push(inflate, piece.bytes, piece.used, error);
    }
    free(piece.bytes);
    return status ? status : inflate_end(inflate, error);
}

static bool is_compressed(const void *bytes, size_t n) {
    enum inflate_kind kind;
    return inflate_sniff(bytes, n, &kind);
}

static enum status read_packed(const void *bytes, size_t n, int fd, const struct cloud_limits *limits,
                               const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct unpack u = {.progress = progress, .error = error};
    struct inflate *inflate = NULL;
    enum inflate_kind kind = INFLATE_GZIP;
    (void)inflate_sniff(bytes, n, &kind);
    enum status status = inflate_new(kind, NULL, (struct inflate_out){take, &u}, &inflate, error);
    if (!status) status = push_all(inflate, bytes, n, fd, error);
    inflate_free(inflate);
    if (u.enough) status = STATUS_OK;
    if (!status) status = read_plain(u.out.bytes, u.out.used, limits, progress, cloud, error);
    free(u.out.bytes);
    return status;
}

enum status cloud_read_memory(const void *bytes, size_t n, const struct cloud_limits *limits,
                              const struct progress *progress, struct cloud *cloud, struct error *error) {
    if (is_compressed(bytes, n)) return read_packed(bytes, n, -1, limits, progress, cloud, error);
    return read_plain(bytes, n, limits, progress, cloud, error);
}

/* ------------------------------------------------------------------------------------------------ pipes */

static enum status read_from_pipe(int fd, const struct cloud_limits *limits, const struct progress *progress,
                                  struct cloud *cloud, struct error *error) {
    struct buffer b = {0};
    size_t want;
    enum status status = fill(fd, &b, FIRST_BYTES, error);
    if (!status && is_compressed(b.bytes, b.used)) {
        status = read_packed(b.bytes, b.used, fd, limits, progress, cloud, error);
    } else {
        if (!status) status = worth_reading(&b, &want, error);
        if (!status) status = fill(fd, &b, want, error);
        if (!status) status = read_plain(b.bytes, b.used, limits, progress, cloud, error);
    }
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
