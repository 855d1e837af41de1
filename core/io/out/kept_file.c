/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/kept_file.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"

enum { AT_A_TIME = 1 << 14, KEY_BYTES = sizeof(uint64_t) + sizeof(vec3) };

void kept_file_done(struct kept_file *file) {
    free(file->path);
    *file = (struct kept_file){0};
}

void kept_put(struct sink *sink, uint64_t key, vec3 position, const unsigned char *record, size_t record_bytes) {
    sink_bytes(sink, &key, sizeof key);
    sink_bytes(sink, &position, sizeof position);
    sink_bytes(sink, record, record_bytes);
}

bool kept_file_is(const struct kept_file *file, uint64_t of) {
    struct kept_head head;
    struct stat about;
    int fd = open(file->path, O_RDONLY | O_CLOEXEC);
    bool whole = fd >= 0 && fstat(fd, &about) == 0 && pread(fd, &head, sizeof head, 0) == (ssize_t)sizeof head &&
                 memcmp(head.mark, KEPT_MARK, sizeof head.mark) == 0 && head.of == of && head.count == file->count &&
                 head.record_bytes == file->record_bytes &&
                 (uint64_t)about.st_size == sizeof head + head.count * (KEY_BYTES + head.record_bytes);
    if (fd >= 0) close(fd);
    return whole;
}

/* ------------------------------------------------------------------------------------------------ points */

enum status kept_points_make(struct kept_points *points, size_t n, size_t record_bytes) {
    *points = (struct kept_points){.key = alloc_array(n, sizeof *points->key),
                                   .position = alloc_array(n, sizeof *points->position),
                                   .record = alloc_array(n, record_bytes)};
    if (points->key && points->position && points->record) return STATUS_OK;
    kept_points_done(points);
    return STATUS_NO_MEMORY;
}

void kept_points_done(struct kept_points *points) {
    free(points->key), free(points->position), free(points->record);
    *points = (struct kept_points){0};
}

void kept_points_add(struct kept_points *points, const struct kept_points *from, size_t i, size_t record_bytes) {
    size_t to = points->count++;
    points->key[to] = from->key[i];
    points->position[to] = from->position[i];
    memcpy(points->record + to * record_bytes, from->record + i * record_bytes, record_bytes);
}

/* ------------------------------------------------------------------------------------------------ reading */

enum status kept_reader_open(struct kept_reader *reader, const char *path, uint64_t count, size_t record_bytes,
                             struct error *error) {
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    *reader = (struct kept_reader){.fd = fd, .record_bytes = record_bytes, .count = count};
    if (reader->fd < 0) {
        int failure = errno;
        *reader = (struct kept_reader){0};
        return error_set(error, STATUS_IO, "tiles", "can't open %s: %s", path, strerror(failure));
    }
    reader->bytes = alloc_array(AT_A_TIME, KEY_BYTES + record_bytes);
    enum status status = kept_points_make(&reader->points, AT_A_TIME, record_bytes);
    if (!status && !reader->bytes) status = STATUS_NO_MEMORY;
    if (!status && lseek(reader->fd, sizeof(struct kept_head), SEEK_SET) < 0) status = STATUS_IO;
    if (!status) return STATUS_OK;
    kept_reader_close(reader);
    return error_set(error, status, "tiles", "can't read %s: %s", path,
                     status == STATUS_IO ? strerror(errno) : "no memory");
}

enum status kept_reader_next(struct kept_reader *reader, const char *path, struct error *error) {
    uint64_t left = reader->count - reader->done;
    size_t n = left < AT_A_TIME ? (size_t)left : AT_A_TIME, each = KEY_BYTES + reader->record_bytes;
    for (size_t got = 0; got < n * each;) {
        ssize_t more = read(reader->fd, reader->bytes + got, n * each - got);
        if (more < 0 && errno == EINTR) continue;
        if (more <= 0)
            return error_set(error, STATUS_IO, "tiles", "can't read %s: %s", path,
                             more < 0 ? strerror(errno) : "it is too short");
        got += (size_t)more;
    }
    for (size_t i = 0; i < n; i++) {
        const unsigned char *at = reader->bytes + i * each;
        memcpy(&reader->points.key[i], at, sizeof *reader->points.key);
        memcpy(&reader->points.position[i], at + sizeof *reader->points.key, sizeof *reader->points.position);
        memcpy(reader->points.record + i * reader->record_bytes, at + KEY_BYTES, reader->record_bytes);
    }
    reader->points.count = n;
    reader->done += n;
    return STATUS_OK;
}

void kept_reader_close(struct kept_reader *reader) {
    if (reader->points.key || reader->bytes || reader->fd > 0) close(reader->fd);
    free(reader->bytes);
    kept_points_done(&reader->points);
    *reader = (struct kept_reader){0};
}
