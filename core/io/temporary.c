/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/temporary.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

enum { TEMPORARY_PATH_BYTES = 4096, PUSHED_BYTES = 1 << 20 };

static enum status temporary_failed(const char *folder, int failure, struct error *error) {
    return error_set(error, status_from_errno(failure), "scratch", "can't write into %s: %s", folder,
                     strerror(failure));
}

/* File systems without O_TMPFILE have a name for a moment. */
static int open_unnamed(const char *folder) {
    char path[TEMPORARY_PATH_BYTES];
    int fd = open(folder, O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
    if (fd >= 0 || snprintf(path, sizeof path, "%s/.input.XXXXXX", folder) >= (int)sizeof path) return fd;
    fd = mkostemp(path, O_CLOEXEC);
    if (fd >= 0) unlink(path);
    return fd;
}

struct inflating {
    int fd;
    const char *folder;
    struct error *error;
};

static enum status write_piece(void *ctx, const void *bytes, size_t n) {
    const struct inflating *to = ctx;
    for (size_t done = 0; done < n;) {
        ssize_t wrote = write(to->fd, (const char *)bytes + done, n - done);
        if (wrote < 0 && errno == EINTR) continue;
        if (wrote <= 0) return temporary_failed(to->folder, wrote < 0 ? errno : ENOSPC, to->error);
        done += (size_t)wrote;
    }
    return STATUS_OK;
}

static enum status inflate_all(struct inflating *to, enum inflate_kind kind, const unsigned char *packed, size_t n) {
    struct inflate *inflate = NULL;
    enum status status = inflate_new(kind, NULL, (struct inflate_out){write_piece, to}, &inflate, to->error);
    for (size_t at = 0; !status && at < n; at += PUSHED_BYTES)
        status = inflate_push(inflate, packed + at, n - at < PUSHED_BYTES ? n - at : PUSHED_BYTES, to->error);
    if (!status) status = inflate_end(inflate, to->error);
    inflate_free(inflate);
    return status;
}

static enum status map_all(int fd, const char *folder, size_t n, unsigned char **map, struct error *error) {
    void *mapped = mmap(NULL, n, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (mapped == MAP_FAILED) return temporary_failed(folder, errno, error);
    *map = mapped;
    return STATUS_OK;
}

enum status temporary_inflate(const char *folder, enum inflate_kind kind, const void *packed, size_t n,
                              unsigned char **map, size_t *bytes, struct error *error) {
    struct inflating to = {open_unnamed(folder), folder, error};
    struct stat about;
    if (to.fd < 0) return temporary_failed(folder, errno, error);
    enum status status = inflate_all(&to, kind, packed, n);
    if (!status && fstat(to.fd, &about) != 0) status = temporary_failed(folder, errno, error);
    if (!status && about.st_size == 0)
        status = error_set_at(error, STATUS_MALFORMED, "read", 0, 0, "the file is empty");
    if (!status) status = map_all(to.fd, folder, (size_t)about.st_size, map, error);
    if (!status) *bytes = (size_t)about.st_size;
    close(to.fd);
    return status;
}

enum status temporary_map(const char *folder, size_t n, unsigned char **map, struct error *error) {
    int fd = open_unnamed(folder);
    if (fd < 0) return temporary_failed(folder, errno, error);
    int failure = posix_fallocate(fd, 0, (off_t)n); /* a hole that the disk has no room for would be a signal later */
    enum status status = failure ? temporary_failed(folder, failure, error) : map_all(fd, folder, n, map, error);
    close(fd);
    return status;
}
