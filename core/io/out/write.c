/* Writing of clouds.
 *
 * A record is in native byte order and packed, so on a little-endian machine a point without lists is written in binary
 * as one copy of its record.  Everything else goes scalar by scalar.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/write.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "core/text/number.h"

static const bool little_endian = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__;

const char *cloud_write_type_name(enum scalar_type type) {
    static const char *const names[SCALAR_TYPE_COUNT] = {"char", "uchar", "short", "ushort",
                                                         "int",  "uint",  "float", "double"};
    return names[type];
}

static void put_binary_scalar(struct sink *sink, const unsigned char *p, enum scalar_type type) {
    size_t bytes = scalar_bytes(type);
    unsigned char *to = sink_reserve(sink, bytes);
    for (size_t i = 0; i < bytes; i++) to[i] = p[little_endian ? i : bytes - 1 - i];
    sink_advance(sink, bytes);
}

static void put_text(struct sink *sink, const void *p, enum scalar_type type) {
    char *to = (char *)sink_reserve(sink, NUMBER_TEXT_BYTES + 1);
    size_t n;
    float f32;
    if (type == SCALAR_FLOAT32)
        n = number_format_f32(to, (memcpy(&f32, p, sizeof f32), f32));
    else if (type == SCALAR_FLOAT64)
        n = number_format_f64(to, scalar_load(p, type));
    else
        n = number_format_int(to, (long long)scalar_load(p, type));
    to[n] = ' ';
    sink_advance(sink, n + 1);
}

void cloud_write_scalar(struct sink *sink, const void *p, enum scalar_type type, enum encoding encoding) {
    if (encoding == ENCODING_BINARY)
        put_binary_scalar(sink, p, type);
    else
        put_text(sink, p, type);
}

void cloud_write_end_record(struct sink *sink, enum encoding encoding) {
    if (encoding == ENCODING_BINARY) return;
    assert(sink->used > 0); /* the last space is still there: the buffer is emptied before a scalar, never after */
    sink->buffer[sink->used - 1] = '\n';
}

void cloud_write_ply_start(struct sink *sink, const char *comments, enum encoding encoding) {
    sink_format(sink, "ply\nformat %s 1.0\n", encoding == ENCODING_BINARY ? "binary_little_endian" : "ascii");
    if (comments) sink_text(sink, comments);
}

/* ------------------------------------------------------------------------------------------------ PLY */

static void put_header(struct sink *sink, const struct cloud *cloud, size_t n, enum encoding encoding) {
    cloud_write_ply_start(sink, cloud->comments, encoding);
    sink_format(sink, "element vertex %zu\n", n);
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *property = &cloud->property[j];
        if (property->is_list)
            sink_format(sink, "property list %s %s %s\n", cloud_write_type_name(property->count_type),
                        cloud_write_type_name(property->type), property->name);
        else
            sink_format(sink, "property %s %s\n", cloud_write_type_name(property->type), property->name);
    }
    sink_text(sink, "end_header\n");
}

static void put_list(struct sink *sink, const struct property *property, size_t id, enum encoding encoding) {
    unsigned char length[8];
    size_t at = property->list_offset[id], end = property->list_offset[id + 1], each = scalar_bytes(property->type);
    scalar_store(length, property->count_type, (double)((end - at) / each));
    cloud_write_scalar(sink, length, property->count_type, encoding);
    for (; at < end; at += each) cloud_write_scalar(sink, property->list_data + at, property->type, encoding);
}

static void put_point(struct sink *sink, const struct cloud *cloud, size_t id, enum encoding encoding) {
    const unsigned char *record = cloud->record + id * cloud->record_bytes;
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *property = &cloud->property[j];
        if (property->is_list)
            put_list(sink, property, id, encoding);
        else
            cloud_write_scalar(sink, record + property->offset_bytes, property->type, encoding);
    }
    cloud_write_end_record(sink, encoding);
}

static bool is_one_copy(const struct cloud *cloud, enum encoding encoding) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (cloud->property[j].is_list) return false;
    return encoding == ENCODING_BINARY && little_endian;
}

static size_t nth(const struct cloud *cloud, const uint32_t *ids, size_t i) {
    size_t id = ids ? ids[i] : i;
    assert(id < cloud->count);
    return id;
}

enum status cloud_write_ply(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, enum encoding encoding,
                            struct error *error) {
    struct sink sink;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    put_header(&sink, cloud, n, encoding);
    bool one_copy = is_one_copy(cloud, encoding);
    for (size_t i = 0; i < n && !sink.failure; i++) {
        size_t id = nth(cloud, ids, i);
        if (one_copy)
            sink_bytes(&sink, cloud->record + id * cloud->record_bytes, cloud->record_bytes);
        else
            put_point(&sink, cloud, id, encoding);
    }
    return sink_done(&sink, STATUS_OK, error);
}

/* ------------------------------------------------------------------------------------------------ XYZ */

/* Scalar properties in the order of the columns; returns how many. */
static size_t order_columns(const struct cloud *cloud, const struct property *column[CLOUD_MAX_PROPERTIES]) {
    size_t n = 0;
    for (int axis = 0; axis < 3; axis++) column[n++] = &cloud->property[cloud->xyz[axis]];
    for (uint32_t j = 0; j < cloud->property_count; j++)
        if (!cloud->property[j].is_list && j != cloud->xyz[0] && j != cloud->xyz[1] && j != cloud->xyz[2])
            column[n++] = &cloud->property[j];
    return n;
}

static void put_names(struct sink *sink, const struct property *const *column, size_t columns, enum xyz_header header) {
    if (header == HEADER_HASH) sink_text(sink, "# ");
    for (size_t j = 0; j < columns; j++) sink_format(sink, j ? " %s" : "%s", column[j]->name);
    sink_text(sink, "\n");
}

enum status cloud_write_xyz(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, enum xyz_header header,
                            struct error *error) {
    struct sink sink;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    const struct property *column[CLOUD_MAX_PROPERTIES];
    size_t columns = order_columns(cloud, column);
    if (header != HEADER_NONE) put_names(&sink, column, columns, header);
    for (size_t i = 0; i < n && !sink.failure; i++) {
        const unsigned char *record = cloud->record + nth(cloud, ids, i) * cloud->record_bytes;
        for (size_t j = 0; j < columns; j++)
            cloud_write_scalar(&sink, record + column[j]->offset_bytes, column[j]->type, ENCODING_ASCII);
        cloud_write_end_record(&sink, ENCODING_ASCII);
    }
    return sink_done(&sink, STATUS_OK, error);
}
