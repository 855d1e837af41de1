/* Prefixes of cloud files.
 *
 * A file is read once, in blocks, and never parsed beyond its header: of text, ends of lines are counted; of binary
 * records without lists, bytes; of records with lists, the lengths are read and the rest skipped over.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/prefix.h"

#include <errno.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/io/formats/pcd_header.h"
#include "core/io/formats/ply_header.h"
#include "core/io/out/sink.h"

enum { BLOCK_BYTES = PLY_HEADER_MAX_BYTES };

struct source {
    int fd;
    int failure; /* errno of a read that failed */
    size_t at, end;
    unsigned char *block; /* owned */
};

/* Makes at least one byte available; false at the end. */
static bool refill(struct source *source) {
    if (source->at < source->end) return true;
    ssize_t n;
    do n = read(source->fd, source->block, BLOCK_BYTES);
    while (n < 0 && errno == EINTR);
    if (n < 0) source->failure = errno;
    source->at = 0;
    source->end = n > 0 ? (size_t)n : 0;
    return source->end > 0;
}

/* Fills the block from the start of the file. */
static void fill_first(struct source *source) {
    while (source->end < BLOCK_BYTES) {
        ssize_t n = read(source->fd, source->block + source->end, BLOCK_BYTES - source->end);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) source->failure = errno;
        if (n <= 0) return;
        source->end += (size_t)n;
    }
}

/* Copies a number of bytes; false where there are fewer. */
static bool copy_bytes(struct source *source, struct sink *sink, uint64_t count) {
    while (count) {
        if (!refill(source)) return false;
        size_t there = source->end - source->at, taken = count < there ? (size_t)count : there;
        sink_bytes(sink, source->block + source->at, taken);
        source->at += taken;
        count -= taken;
    }
    return true;
}

/* Copies up to and with the next end of line; false where there is none. */
static bool copy_line(struct source *source, struct sink *sink) {
    for (;;) {
        if (!refill(source)) return false;
        const unsigned char *from = source->block + source->at;
        const unsigned char *newline = memchr(from, '\n', source->end - source->at);
        size_t taken = newline ? (size_t)(newline - from) + 1 : source->end - source->at;
        sink_bytes(sink, from, taken);
        source->at += taken;
        if (newline) return true;
    }
}

static uint64_t copy_lines(struct source *source, struct sink *sink, uint64_t n) {
    uint64_t copied = 0;
    while (copied < n && copy_line(source, sink)) copied++;
    return copied;
}

/* ------------------------------------------------------------------------------------------------ PLY */

static bool copy_list(struct source *source, struct sink *sink, const struct property *property) {
    unsigned char length[8] = {0};
    size_t bytes = scalar_bytes(property->count_type);
    for (size_t i = 0; i < bytes; i++) {
        if (!refill(source)) return false;
        length[i] = source->block[source->at];
        if (!copy_bytes(source, sink, 1)) return false;
    }
    double items = scalar_load(length, property->count_type);
    return items >= 0 && items <= UINT32_MAX &&
           copy_bytes(source, sink, (uint64_t)items * scalar_bytes(property->type));
}

static bool copy_record(struct source *source, struct sink *sink, const struct ply_header *header) {
    const struct ply_element *vertex = &header->element[header->vertex];
    for (size_t i = 0; i < vertex->property_count; i++) {
        const struct property *property = &header->property[vertex->first + i];
        bool copied = property->is_list ? copy_list(source, sink, property)
                                        : copy_bytes(source, sink, scalar_bytes(property->type));
        if (!copied) return false;
    }
    return true;
}

/* Bytes of a record, the same for each; 0 where there are lists. */
static uint64_t record_bytes(const struct ply_header *header) {
    const struct ply_element *vertex = &header->element[header->vertex];
    uint64_t bytes = 0;
    for (size_t i = 0; i < vertex->property_count; i++) {
        const struct property *property = &header->property[vertex->first + i];
        if (property->is_list) return 0;
        bytes += scalar_bytes(property->type);
    }
    return bytes;
}

static bool copy_records(struct source *source, struct sink *sink, const struct ply_header *header, uint64_t n) {
    uint64_t each = record_bytes(header);
    if (header->form == PLY_ASCII) return copy_lines(source, sink, n) == n;
    if (each) return copy_bytes(source, sink, n * each);
    for (uint64_t i = 0; i < n; i++)
        if (!copy_record(source, sink, header)) return false;
    return true;
}

/* The header as it was, but for the number of vertices. */
static void copy_header(struct source *source, struct sink *sink, size_t bytes, uint64_t n) {
    static const char element[] = "element vertex ";
    const char *at = (const char *)source->block, *end = at + bytes;
    while (at < end) {
        const char *newline = memchr(at, '\n', (size_t)(end - at)), *next = newline ? newline + 1 : end;
        if ((size_t)(next - at) > sizeof element && memcmp(at, element, sizeof element - 1) == 0)
            sink_format(sink, "%s%" PRIu64 "\n", element, n);
        else
            sink_bytes(sink, at, (size_t)(next - at));
        at = next;
    }
    source->at = bytes;
}

static enum status cut_short(const struct source *source, struct error *error) {
    if (source->failure) return error_set(error, STATUS_IO, "prefix", "can't read: %s", strerror(source->failure));
    return error_set(error, STATUS_MALFORMED, "prefix", "the file ends early");
}

/* Bytes of a big-endian file could be copied as well, but the lengths of its lists could not be read. */
static bool is_ours(const struct ply_header *header) {
    return header->element_count == 1 && header->form != PLY_BIG_ENDIAN;
}

static enum status copy_ply(struct source *source, struct sink *sink, uint64_t n, uint64_t *held, struct error *error) {
    struct ply_header header;
    enum status status = ply_header_parse(source->block, source->end, &header, error);
    if (status) return status;
    if (!is_ours(&header)) {
        status = error_set(error, STATUS_MALFORMED, "prefix", "this is no cloud that whittle wrote");
    } else if (n > header.element[0].count) {
        *held = header.element[0].count;
        status = error_set(error, STATUS_LIMIT, "prefix", "the cloud has %" PRIu64 " points", *held);
    } else {
        copy_header(source, sink, header.bytes, n);
        if (!copy_records(source, sink, &header, n)) status = cut_short(source, error);
    }
    ply_header_done(&header);
    return status;
}

/* ------------------------------------------------------------------------------------------------ XYZ */

static enum status copy_xyz(struct source *source, struct sink *sink, uint64_t n, uint64_t *held, struct error *error) {
    bool has_names = refill(source) && (source->block[0] == '#' || source->block[0] == 'x');
    if (has_names && !copy_line(source, sink)) return cut_short(source, error);
    uint64_t copied = copy_lines(source, sink, n);
    if (source->failure) return cut_short(source, error);
    if (copied == n) return STATUS_OK;
    *held = copied;
    return error_set(error, STATUS_LIMIT, "prefix", "the cloud has %" PRIu64 " points", copied);
}

/* ------------------------------------------------------------------------------------------------ PCD */

/* The header as it was, but for WIDTH and POINTS. */
static void copy_pcd_header(struct source *source, struct sink *sink, size_t bytes, uint64_t n) {
    static const char *const counts[] = {"WIDTH ", "POINTS "};
    const char *at = (const char *)source->block, *end = at + bytes;
    while (at < end) {
        const char *newline = memchr(at, '\n', (size_t)(end - at)), *next = newline ? newline + 1 : end;
        size_t i = 0;
        while (i < 2 && strncmp(at, counts[i], strlen(counts[i])) != 0) i++;
        if (i < 2)
            sink_format(sink, "%s%" PRIu64 "\n", counts[i], n);
        else
            sink_bytes(sink, at, (size_t)(next - at));
        at = next;
    }
    source->at = bytes;
}

static enum status copy_pcd(struct source *source, struct sink *sink, uint64_t n, uint64_t *held, struct error *error) {
    struct pcd_header header;
    enum status status = pcd_header_parse(source->block, source->end, &header, error);
    if (status) return status;
    if (header.data != PCD_BINARY)
        return error_set(error, STATUS_MALFORMED, "prefix", "this is no cloud that whittle wrote");
    if (n > header.points) {
        *held = header.points;
        return error_set(error, STATUS_LIMIT, "prefix", "the cloud has %" PRIu64 " points", *held);
    }
    copy_pcd_header(source, sink, header.bytes, n);
    return copy_bytes(source, sink, n * header.record_bytes) ? STATUS_OK : cut_short(source, error);
}

typedef enum status copier(struct source *source, struct sink *sink, uint64_t n, uint64_t *held, struct error *error);

static copier *copier_of(const struct source *source) {
    if (source->end >= 4 && memcmp(source->block, "ply\n", 4) == 0) return copy_ply;
    return source->end >= 6 && memcmp(source->block, "# .PCD", 6) == 0 ? copy_pcd : copy_xyz;
}

enum status cloud_prefix_copy(int from, int to, uint64_t n, uint64_t *held, struct error *error) {
    struct source source = {.fd = from, .block = alloc_array(BLOCK_BYTES, 1)};
    struct sink sink = {0};
    enum status status = source.block ? sink_init(&sink, to) : STATUS_NO_MEMORY;
    if (status) {
        error_set(error, status, "prefix", "no memory for a buffer");
    } else {
        fill_first(&source);
        status = copier_of(&source)(&source, &sink, n, held, error);
        status = sink_done(&sink, status, error);
    }
    free(source.block);
    return status;
}
