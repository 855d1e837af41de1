/* The body of a PLY file.
 *
 * One reader walks over the bytes, element by element in the order of the header.  Everything is read through take(),
 * which gives the next scalar in native byte order, from text or from binary: so lists, faces and unknown elements are
 * written once.  The one case that matters for speed in binary, vertices without lists, is copied in blocks instead.
 *
 * In text each record stands on a line of its own; blank lines are skipped, \r, \n and \r\n all end a line.  After the
 * last element padding may follow, and nothing else.
 *
 * Invariant: begin <= at <= end, and nothing is allocated that is larger than a small multiple of the bytes that are
 * there: ply_header_fits has been asked before, and each list's length is compared with the bytes left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/io/build.h"
#include "core/io/finite.h"
#include "core/io/first_bytes.h"
#include "core/io/formats/ply_header.h"
#include "core/io/padding.h"
#include "core/io/parts.h"
#include "core/text/number.h"

enum { BLOCK_RECORDS = 16384, TICK_RECORDS = 16384, PART_RECORDS = 1 << 18 };

struct reader {
    const struct ply_header *header;
    const unsigned char *begin, *at, *end;
    bool text, swap;
    uint64_t line;                     /* text: which one at is on */
    const struct ply_element *element; /* being read, for errors */
    const struct property *property;
    uint64_t record, slot; /* slot: the vertex that stands first in the cloud: 0, but where it is read part by part */
    const struct property *index_list; /* of a face: its vertices; NULL = none */
    bool plain_faces;                  /* take_plain_triangle may take them */
    int8_t axis[CLOUD_MAX_PROPERTIES]; /* of each vertex property: 0, 1, 2, or -1 */
    size_t list_capacity[CLOUD_MAX_PROPERTIES];
    struct triangle_room triangles;
    const struct progress *progress;
    struct cloud *cloud;
    struct error *error;
};

/* ------------------------------------------------------------------------------------------------ errors */

static uint64_t line_of(const struct reader *r) { return r->text ? r->line : 0; }

static uint64_t offset_of(const struct reader *r, const unsigned char *at) {
    return r->text ? UINT64_MAX : (uint64_t)(at - r->begin);
}

static enum status ply_no_memory(struct reader *r) {
    return error_set(r->error, STATUS_NO_MEMORY, "read", "no memory for %zu points", r->cloud->count);
}

/* STATUS_MALFORMED at the current property: "vertex 3: what". */
static enum status ply_bad(struct reader *r, const unsigned char *at, const char *what) {
    return error_set_at(r->error, STATUS_MALFORMED, r->property ? r->property->name : r->element->name, line_of(r),
                        offset_of(r, at), "%s %" PRIu64 ": %s", r->element->name, r->record, what);
}

static enum status truncated(struct reader *r) {
    return error_set_at(r->error, STATUS_MALFORMED, r->element->name, line_of(r), offset_of(r, r->end),
                        "the data ends in %s %" PRIu64 " of %" PRIu64 " promised, after %zu bytes", r->element->name,
                        r->record, r->element->count, (size_t)(r->end - r->begin));
}

static enum status ply_bad_word(struct reader *r, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    number_quote((const char *)r->at, (const char *)r->end, quote);
    return error_set_at(r->error, STATUS_MALFORMED, r->property->name, line_of(r), UINT64_MAX,
                        "%s %" PRIu64 ": %s of type %s is '%s', %s", r->element->name, r->record, r->property->name,
                        r->property->type < SCALAR_FLOAT32 ? "integer" : "float", quote, what);
}

/* ------------------------------------------------------------------------------------------------ scalars */

static void copy_swapped(unsigned char *to, const unsigned char *from, size_t bytes) {
    for (size_t i = 0; i < bytes; i++) to[i] = from[bytes - 1 - i];
}

static enum status ply_take_binary(struct reader *r, enum scalar_type type, unsigned char out[8]) {
    size_t bytes = scalar_bytes(type);
    if ((size_t)(r->end - r->at) < bytes) return truncated(r);
    if (r->swap)
        copy_swapped(out, r->at, bytes);
    else
        memcpy(out, r->at, bytes);
    r->at += bytes;
    return STATUS_OK;
}

static bool at_blank(const struct reader *r) { return r->at < r->end && (*r->at == ' ' || *r->at == '\t'); }
static bool at_newline(const struct reader *r) { return r->at < r->end && (*r->at == '\n' || *r->at == '\r'); }

static void take_newline(struct reader *r) {
    if (*r->at == '\r' && r->at + 1 < r->end && r->at[1] == '\n') r->at++;
    r->at++;
    r->line++;
}

/* Stores a whole number in the range of its type; false otherwise. */
static bool store_integer(double value, enum scalar_type type, unsigned char out[8]) {
    static const double low[] = {INT8_MIN, 0, INT16_MIN, 0, INT32_MIN, 0};
    static const double high[] = {INT8_MAX, UINT8_MAX, INT16_MAX, UINT16_MAX, INT32_MAX, UINT32_MAX};
    if (!(value >= low[type] && value <= high[type] && value == (double)(int64_t)value)) return false;
    int64_t whole = (int64_t)value;
    if (scalar_bytes(type) == 1) memcpy(out, &(uint8_t){(uint8_t)whole}, 1);
    if (scalar_bytes(type) == 2) memcpy(out, &(uint16_t){(uint16_t)whole}, 2);
    if (scalar_bytes(type) == 4) memcpy(out, &(uint32_t){(uint32_t)whole}, 4);
    return true;
}

static bool ends_word(const char *at, const char *end) {
    return at == end || *at == ' ' || *at == '\t' || *at == '\n' || *at == '\r';
}

static enum status take_text(struct reader *r, enum scalar_type type, unsigned char out[8]) {
    while (at_blank(r)) r->at++;
    if (r->at == r->end) return truncated(r);
    if (at_newline(r)) return ply_bad(r, r->at, "the line ends before all values are there");
    const char *after, *text = (const char *)r->at, *end = (const char *)r->end;
    float f32 = 0;
    double f64 = 0;
    if (type == SCALAR_FLOAT32)
        after = number_parse_f32(text, end, &f32);
    else
        after = number_parse_f64(text, end, &f64);
    if (!after || !ends_word(after, end)) return ply_bad_word(r, "not a number");
    if (type == SCALAR_FLOAT32)
        memcpy(out, &f32, sizeof f32);
    else if (type == SCALAR_FLOAT64)
        memcpy(out, &f64, sizeof f64);
    else if (!store_integer(f64, type, out))
        return ply_bad_word(r, "not a whole number in the range of its type");
    r->at = (const unsigned char *)after;
    return STATUS_OK;
}

static enum status take(struct reader *r, enum scalar_type type, unsigned char out[8]) {
    return r->text ? take_text(r, type, out) : ply_take_binary(r, type, out);
}

/* The length of a list, which the bytes left can hold. */
static enum status take_length(struct reader *r, size_t *length) {
    unsigned char scalar[8];
    const unsigned char *at = r->at;
    enum status status = take(r, r->property->count_type, scalar);
    if (status) return status;
    double n = scalar_load(scalar, r->property->count_type);
    size_t left = (size_t)(r->end - r->at), each = r->text ? 2 : scalar_bytes(r->property->type);
    if (n < 0) return ply_bad(r, at, "negative length of a list");
    if (n > (double)(left / each)) return ply_bad(r, at, "a list is longer than the data that is left");
    *length = (size_t)n;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ records */

static enum status begin_record(struct reader *r) {
    r->property = NULL;
    if (r->record % TICK_RECORDS == 0 &&
        progress_tick(r->progress, "read", (double)(r->at - r->begin) / (double)(r->end - r->begin)))
        return error_set(r->error, STATUS_CANCELLED, "read", "cancelled");
    while (r->text && (at_blank(r) || at_newline(r))) {
        if (at_newline(r))
            take_newline(r);
        else
            r->at++;
    }
    return r->text && r->at == r->end ? truncated(r) : STATUS_OK;
}

static enum status end_record(struct reader *r) {
    if (!r->text) return STATUS_OK;
    while (at_blank(r)) r->at++;
    if (r->at == r->end) return STATUS_OK;
    if (!at_newline(r)) return ply_bad(r, r->at, "more values on the line than the element has properties");
    take_newline(r);
    return STATUS_OK;
}

/* Reads and forgets one property. */
static enum status skip_property(struct reader *r) {
    unsigned char scalar[8];
    size_t n = 1;
    enum status status = r->property->is_list ? take_length(r, &n) : STATUS_OK;
    if (!status && r->property->is_list && !r->text) { /* which are there */
        r->at += n * scalar_bytes(r->property->type);
        return STATUS_OK;
    }
    while (!status && n-- > 0) status = take(r, r->property->type, scalar);
    return status;
}

/* Calls record_of for each record of the current element up to `end`, between its beginning and its end. */
static enum status records_until(struct reader *r, uint64_t end, enum status (*record_of)(struct reader *r)) {
    for (; r->record < end; r->record++) {
        enum status status = begin_record(r);
        if (!status) status = record_of(r);
        if (!status) status = end_record(r);
        if (status) return status;
    }
    return STATUS_OK;
}

static enum status each_record(struct reader *r, enum status (*record_of)(struct reader *r)) {
    r->record = 0;
    return records_until(r, r->element->count, record_of);
}

static enum status skip_record(struct reader *r) {
    const struct property *property = r->header->property + r->element->first;
    for (size_t i = 0; i < r->element->property_count; i++) {
        r->property = &property[i];
        enum status status = skip_property(r);
        if (status) return status;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ vertices */

/* Makes room for bytes more of list j's items. */
static enum status grow_list(struct reader *r, size_t j, size_t used, size_t bytes) {
    struct property *property = &r->cloud->property[j];
    if (bytes <= r->list_capacity[j] - used) return STATUS_OK;
    size_t capacity = 2 * r->list_capacity[j] + bytes + 256;
    unsigned char *grown = alloc_resize(property->list_data, capacity, 1);
    if (!grown) return ply_no_memory(r);
    property->list_data = grown;
    r->list_capacity[j] = capacity;
    return STATUS_OK;
}

static enum status take_list(struct reader *r, size_t j) {
    struct property *property = &r->cloud->property[j];
    size_t length, each = scalar_bytes(property->type), used = property->list_offset[r->record];
    enum status status = take_length(r, &length);
    if (!status) status = grow_list(r, j, used, length * each + 8);
    for (size_t i = 0; !status && i < length; i++, used += each)
        status = take(r, property->type, property->list_data + used);
    property->list_offset[r->record + 1] = used;
    return status;
}

static enum status ply_take_vertex(struct reader *r) {
    struct cloud *cloud = r->cloud;
    size_t at = (size_t)(r->record - r->slot);
    unsigned char *record = cloud->record + at * cloud->record_bytes, scalar[8];
    enum status status = STATUS_OK;
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *property = r->property = &cloud->property[j];
        status = property->is_list ? take_list(r, j) : take(r, property->type, scalar);
        if (status) return status;
        if (property->is_list) continue;
        memcpy(record + property->offset_bytes, scalar, scalar_bytes(property->type));
        if (r->axis[j] >= 0) (&cloud->position[at].x)[r->axis[j]] = scalar_load(scalar, property->type);
    }
    return status;
}

/* Fills one axis of the positions of a block from its records. */
static void gather(struct cloud *cloud, int axis, size_t begin, size_t end) {
    const struct property *property = &cloud->property[cloud->xyz[axis]];
    const unsigned char *from = cloud->record + begin * cloud->record_bytes + property->offset_bytes;
    double *to = &cloud->position[begin].x + axis;
    if (property->type == SCALAR_FLOAT32) {
        for (size_t i = begin; i < end; i++, from += cloud->record_bytes, to += 3) {
            float value;
            memcpy(&value, from, sizeof value);
            *to = (double)value;
        }
    } else if (property->type == SCALAR_FLOAT64) {
        for (size_t i = begin; i < end; i++, from += cloud->record_bytes, to += 3) memcpy(to, from, sizeof *to);
    } else {
        for (size_t i = begin; i < end; i++, from += cloud->record_bytes, to += 3)
            *to = scalar_load(from, property->type);
    }
}

static void swap_block(struct cloud *cloud, size_t begin, size_t end) {
    for (size_t j = 0; j < cloud->property_count; j++) {
        size_t bytes = scalar_bytes(cloud->property[j].type);
        unsigned char *at = cloud->record + begin * cloud->record_bytes + cloud->property[j].offset_bytes;
        for (size_t i = begin; bytes > 1 && i < end; i++, at += cloud->record_bytes) {
            unsigned char native[8];
            copy_swapped(native, at, bytes);
            memcpy(at, native, bytes);
        }
    }
}

/* Fills the cloud's records begin .. end - 1, the first of which is at `from`, and their positions. */
static void copy_block(const struct reader *r, const unsigned char *from, size_t begin, size_t end) {
    struct cloud *cloud = r->cloud;
    memcpy(cloud->record + begin * cloud->record_bytes, from, (end - begin) * cloud->record_bytes);
    if (r->swap) swap_block(cloud, begin, end);
    for (int axis = 0; axis < 3; axis++) gather(cloud, axis, begin, end);
}

static void take_block(struct reader *r, size_t begin, size_t end) {
    copy_block(r, r->at, begin, end);
    r->at += (end - begin) * r->cloud->record_bytes;
}

static enum status take_fixed_vertices(struct reader *r) {
    size_t count = r->cloud->count;
    if ((size_t)(r->end - r->at) / r->cloud->record_bytes < count) return truncated(r);
    for (size_t begin = 0; begin < count; begin += BLOCK_RECORDS) {
        r->record = begin;
        enum status status = begin_record(r);
        if (status) return status;
        take_block(r, begin, count - begin < BLOCK_RECORDS ? count : begin + BLOCK_RECORDS);
    }
    return STATUS_OK;
}

static enum status allocate(struct reader *r) {
    struct cloud *cloud = r->cloud;
    cloud->position = alloc_array(cloud->count, sizeof *cloud->position);
    cloud->record = alloc_array(cloud->count, cloud->record_bytes);
    if (!cloud->position || !cloud->record) return ply_no_memory(r);
    for (size_t j = 0; j < cloud->property_count; j++) {
        struct property *property = &cloud->property[j];
        if (!property->is_list) continue;
        property->list_offset = alloc_zeroed(cloud->count + 1, sizeof *property->list_offset);
        property->list_data = alloc_array(r->list_capacity[j] = 256, 1);
        if (!property->list_offset || !property->list_data) return ply_no_memory(r);
    }
    return STATUS_OK;
}

static enum status read_vertices(struct reader *r) {
    bool exact = !r->text;
    enum status status = allocate(r);
    for (size_t j = 0; j < r->cloud->property_count; j++)
        if (r->cloud->property[j].is_list) exact = false;
    if (status) return status;
    return exact ? take_fixed_vertices(r) : each_record(r, ply_take_vertex);
}

/* ------------------------------------------------------------------------------------------------ faces */

static bool is_index_list(const struct property *property) {
    return property->is_list &&
           (strcmp(property->name, "vertex_indices") == 0 || strcmp(property->name, "vertex_index") == 0);
}

static enum status ply_take_index(struct reader *r, uint32_t *index) {
    unsigned char scalar[8];
    const unsigned char *at = r->at;
    enum status status = take(r, r->property->type, scalar);
    if (status) return status;
    double value = scalar_load(scalar, r->property->type);
    if (!(value >= 0 && value < (double)r->header->element[r->header->vertex].count))
        return ply_bad(r, at, "an index is of no vertex");
    *index = (uint32_t)value;
    return STATUS_OK;
}

static enum status append_triangle(struct reader *r, uint32_t a, uint32_t b, uint32_t c) {
    return cloud_build_append(r->cloud, &r->triangles, a, b, c, r->error);
}

/* The face that nearly all binary files have: "list uchar int", three vertices, native byte order.  False, with nothing
 * taken, for any other one, and for one that breaks a rule. */
static bool take_plain_triangle(struct reader *r, enum status *status) {
    enum { FACE_BYTES = 13 };
    uint32_t v[3];
    if (!r->plain_faces || r->end - r->at < FACE_BYTES || *r->at != 3) return false;
    memcpy(v, r->at + 1, sizeof v);
    uint64_t vertices = r->header->element[r->header->vertex].count;
    if (v[0] >= vertices || v[1] >= vertices || v[2] >= vertices) return false;
    r->at += FACE_BYTES;
    *status = append_triangle(r, v[0], v[1], v[2]);
    return true;
}

/* A polygon v0 v1 v2 v3 ... as the fan v0 v1 v2, v0 v2 v3, ... */
static enum status take_polygon(struct reader *r) {
    size_t length;
    enum status status = STATUS_OK;
    if (take_plain_triangle(r, &status)) return status;
    status = take_length(r, &length);
    uint32_t first = 0, last = 0, next = 0;
    for (size_t i = 0; !status && i < length; i++, last = next) {
        status = ply_take_index(r, &next);
        if (i == 0) first = next;
        if (!status && i >= 2) status = append_triangle(r, first, last, next);
    }
    return status;
}

static enum status ply_take_face(struct reader *r) {
    const struct property *property = r->header->property + r->element->first;
    for (size_t i = 0; i < r->element->property_count; i++) {
        r->property = &property[i];
        enum status status = r->property == r->index_list ? take_polygon(r) : skip_property(r);
        if (status) return status;
    }
    return STATUS_OK;
}

/* The first of the element's properties that lists its vertices, or NULL. */
static const struct property *find_index_list(const struct reader *r) {
    const struct property *property = r->header->property + r->element->first;
    for (size_t i = 0; i < r->element->property_count; i++)
        if (is_index_list(&property[i])) return &property[i];
    return NULL;
}

static enum status read_faces(struct reader *r) {
    const struct property *list = r->index_list = find_index_list(r);
    if (list && list->type >= SCALAR_FLOAT32)
        return error_set(r->error, STATUS_MALFORMED, list->name, "indices of vertices must be integers");
    r->plain_faces = list && !r->text && !r->swap && list->count_type == SCALAR_UINT8 &&
                     (list->type == SCALAR_INT32 || list->type == SCALAR_UINT32);
    enum status status = each_record(r, ply_take_face);
    if (status || r->cloud->triangle_count == 0) return status;
    void *exact = alloc_resize(r->cloud->triangle, r->cloud->triangle_count, sizeof *r->cloud->triangle);
    if (!exact) return ply_no_memory(r);
    r->cloud->triangle = exact;
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status read_element(struct reader *r) {
    if (r->element->property_count == 0) return STATUS_OK;
    if (r->element == &r->header->element[r->header->vertex]) return read_vertices(r);
    if (strcmp(r->element->name, "face") == 0) return read_faces(r);
    return each_record(r, skip_record);
}

/* What follows the last element goes to the report. */
static enum status ply_note_rest(struct reader *r) {
    while (r->text && (at_blank(r) || at_newline(r))) {
        if (at_newline(r))
            take_newline(r);
        else
            r->at++;
    }
    char note[PADDING_NOTE_BYTES];
    if (r->at == r->end) return STATUS_OK;
    padding_note(note, r->at, (size_t)(r->end - r->at));
    return cloud_leave_out(r->cloud, note) ? ply_no_memory(r) : STATUS_OK;
}

static enum status check_limits(const struct ply_header *h, const struct cloud_limits *limits, struct error *error) {
    const struct ply_element *vertex = &h->element[h->vertex];
    uint64_t most = limits && limits->max_points ? limits->max_points : NONE - 1;
    if (most > NONE - 1) most = NONE - 1;
    if (vertex->count > most)
        return error_set(error, STATUS_LIMIT, "points", "%" PRIu64 " points, at most %" PRIu64 " are allowed",
                         vertex->count, most);
    if (limits && limits->max_properties && vertex->property_count > limits->max_properties)
        return error_set(error, STATUS_LIMIT, "properties", "%zu properties, at most %" PRIu32 " are allowed",
                         vertex->property_count, limits->max_properties);
    return STATUS_OK;
}

/* Hands the vertex element's description over to the cloud. */
static enum status ply_describe(struct reader *r, struct ply_header *header) {
    struct cloud *cloud = r->cloud;
    const struct ply_element *vertex = &header->element[header->vertex];
    cloud->form = ply_form_name(header->form);
    cloud->property = alloc_array(vertex->property_count, sizeof *cloud->property);
    if (!cloud->property) return ply_no_memory(r);
    cloud->property_count = vertex->property_count;
    memcpy(cloud->property, header->property + vertex->first, vertex->property_count * sizeof *cloud->property);
    memset(r->axis, -1, sizeof r->axis);
    for (int axis = 0; axis < 3; axis++) {
        cloud->xyz[axis] = header->xyz[axis];
        r->axis[header->xyz[axis]] = (int8_t)axis;
    }
    for (size_t j = 0; j < cloud->property_count; j++)
        if (!cloud->property[j].is_list) cloud->record_bytes += scalar_bytes(cloud->property[j].type);
    cloud->comments = header->comments;
    header->comments = NULL;
    return STATUS_OK;
}

static enum status read_body(struct reader *r) {
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < r->header->element_count; i++) {
        r->element = &r->header->element[i];
        r->property = NULL;
        r->record = 0;
        status = read_element(r);
    }
    if (!status) status = ply_note_rest(r);
    return status || !r->cloud->count ? status : cloud_drop_unplaced(r->cloud, r->error);
}

const char *cloud_ply_look(const struct first_bytes *first) {
    const char *text = first->text;
    size_t n = first->n;
    if (first_begins(first, "\xef\xbb\xbf", 3)) text += 3, n -= 3;
    if (n < 3 || memcmp(text, "ply", 3) != 0 || (n > 3 && !strchr("\r\n \t", text[3]))) return "";
    for (enum ply_form form = PLY_LITTLE_ENDIAN; form <= PLY_BIG_ENDIAN; form++)
        if (first_contains(first, ply_form_name(form) + strlen("ply/"))) return ply_form_name(form);
    return ply_form_name(PLY_ASCII);
}

enum status cloud_ply_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct ply_header header = {0};
    struct cloud read = {0};
    enum ply_form native = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ ? PLY_LITTLE_ENDIAN : PLY_BIG_ENDIAN;
    enum status status = ply_header_parse(bytes, n, &header, error);
    if (!status) status = ply_header_fits(&header, n, error);
    if (!status) status = check_limits(&header, limits, error);
    if (status) goto out;
    struct reader r = {.header = &header,
                       .begin = bytes,
                       .at = (const unsigned char *)bytes + header.bytes,
                       .end = (const unsigned char *)bytes + n,
                       .text = header.form == PLY_ASCII,
                       .swap = header.form != native,
                       .line = header.lines + 1,
                       .triangles.most = limits ? limits->max_triangles : 0,
                       .progress = progress,
                       .cloud = &read,
                       .error = error};
    status = ply_describe(&r, &header);
    if (!status) {
        read.count = (size_t)header.element[header.vertex].count;
        status = read_body(&r);
    }
    if (status) goto out;
    *cloud = read;
    read = (struct cloud){0};
out:
    cloud_done(&read);
    ply_header_done(&header);
    return status;
}

/* ------------------------------------------------------------------------------------------------ part by part */

/* Points alone: what stands behind them is passed by. */
struct ply_parts {
    struct cloud_parts parts;
    struct ply_header header;
    struct cloud cloud;
    struct reader reader;
    unsigned threads;
    size_t element; /* that is being read */
    bool ended;
};

static void copy_range(void *ctx, size_t begin, size_t end) {
    const struct reader *r = ctx;
    copy_block(r, r->at + begin * r->cloud->record_bytes, begin, end);
}

static enum status next_points(struct ply_parts *p, size_t n) {
    struct reader *r = &p->reader;
    r->slot = r->record;
    if (r->text) return records_until(r, r->record + n, ply_take_vertex);
    if ((size_t)(r->end - r->at) / p->cloud.record_bytes < n) return truncated(r);
    par_for(p->threads, n, BLOCK_RECORDS, copy_range, r);
    r->at += n * p->cloud.record_bytes;
    r->record += n;
    return STATUS_OK;
}

/* Some records of what stands behind the points, so that what follows all that was promised is told. */
static enum status pass_by(struct ply_parts *p) {
    struct reader *r = &p->reader;
    uint64_t left = r->element->count - r->record;
    bool is_empty = left == 0 || r->element->property_count == 0;
    p->parts.goes_on = true;
    if (!is_empty) return records_until(r, r->record + (left < PART_RECORDS ? left : PART_RECORDS), skip_record);
    if (p->element + 1 < p->header.element_count) {
        r->element = &p->header.element[++p->element];
        r->record = 0;
        return STATUS_OK;
    }
    p->parts.goes_on = false;
    enum status status = p->ended ? STATUS_OK : ply_note_rest(r);
    p->ended = true;
    return status;
}

static enum status ply_next_part(struct cloud_parts *parts, struct error *error) {
    struct ply_parts *p = (struct ply_parts *)parts;
    struct reader *r = &p->reader;
    bool is_vertex = p->element == p->header.vertex;
    uint64_t left = is_vertex ? r->element->count - r->record : 0;
    size_t n = left < PART_RECORDS ? (size_t)left : PART_RECORDS;
    r->error = error;
    r->property = NULL;
    p->cloud.count = n;
    enum status status = n ? next_points(p, n) : pass_by(p);
    parts->done_bytes = (size_t)(r->at - r->begin);
    return status;
}

static void ply_free_parts(struct cloud_parts *parts) {
    struct ply_parts *p = (struct ply_parts *)parts;
    cloud_done(&p->cloud);
    ply_header_done(&p->header);
    free(p);
}

/* Reads past what stands before the vertices, and makes room for a part of them. */
static enum status begin_vertices(struct ply_parts *p) {
    struct reader *r = &p->reader;
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < p->header.vertex; i++) {
        r->element = &p->header.element[i];
        if (r->element->property_count) status = each_record(r, skip_record);
    }
    p->element = p->header.vertex;
    r->element = &p->header.element[p->element];
    r->record = 0;
    p->cloud.count = r->element->count < PART_RECORDS ? (size_t)r->element->count : PART_RECORDS;
    if (!status) status = allocate(r);
    p->cloud.count = 0;
    return status;
}

enum status cloud_ply_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct ply_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    enum ply_form native = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__ ? PLY_LITTLE_ENDIAN : PLY_BIG_ENDIAN;
    p->threads = limits ? limits->threads : 1;
    p->parts.free = ply_free_parts;
    enum status status = ply_header_parse(bytes, n, &p->header, error);
    if (!status) status = ply_header_fits(&p->header, n, error);
    p->reader = (struct reader){.header = &p->header,
                                .begin = bytes,
                                .at = (const unsigned char *)bytes + p->header.bytes,
                                .end = (const unsigned char *)bytes + n,
                                .text = p->header.form == PLY_ASCII,
                                .swap = p->header.form != native,
                                .line = p->header.lines + 1,
                                .cloud = &p->cloud,
                                .error = error};
    if (!status) status = ply_describe(&p->reader, &p->header);
    for (size_t j = 0; !status && j < p->cloud.property_count; j++)
        if (p->cloud.property[j].is_list)
            status = error_set(error, STATUS_UNSUPPORTED, p->cloud.property[j].name,
                               "a list at each point, which isn't read part by part");
    if (!status) status = begin_vertices(p);
    if (!status)
        p->parts =
            (struct cloud_parts){&p->cloud, p->reader.element->count, 0, ply_next_part, ply_free_parts, false, 0};
    if (status)
        ply_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
