/* The points of a PCD file.
 *
 * Each scalar of each field is a column, and each column becomes a property or two, with these exceptions:
 *     "_"                       padding: left out
 *     rgb, rgba (4 bytes)       red, green, blue (and alpha for rgba) as uint8, which other formats can hold
 *     normal_x, _y, _z          nx, ny, nz, as other formats call them
 *     a field of n scalars      NAME_0 .. NAME_n-1
 *     64-bit integers           float64; noted
 *     x, y, z around an origin  float64, the origin added (PCD_ORIGIN_MARK: our own files have that comment)
 * PCD marks a point that wasn't measured by coordinates that aren't numbers.
 *
 * In binary the points follow one another; binary_compressed holds all values of the first field, then all of the next,
 * packed by LZF behind two lengths (uint32).  A column has a start and a stride, so both are read alike; ascii is read
 * word by word.  Binary data may be followed by zeros, since some writers fill the last page.
 *
 * Invariant: start + (points - 1) * stride + bytes lies in the data for each column.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/io/build.h"
#include "core/io/codec/lzf.h"
#include "core/io/first_bytes.h"
#include "core/io/formats/pcd_header.h"
#include "core/io/padding.h"
#include "core/io/parts.h"
#include "core/io/temporary.h"
#include "core/io/text_scanner.h"
#include "core/text/number.h"

enum { LENGTHS_BYTES = 8 };

enum becomes {
    BECOMES_NOTHING,
    BECOMES_SCALAR,
    BECOMES_F64 /* from 64-bit integers */,
    BECOMES_MOVED /* coordinates around an origin */,
    BECOMES_COLOUR
};

struct column {
    const struct pcd_field *field;
    enum becomes becomes;
    enum scalar_type type;  /* of BECOMES_SCALAR */
    size_t start, stride;   /* binary: of the first point's scalar, to the next one's */
    double origin;          /* of BECOMES_MOVED */
    size_t offset, offsets; /* where it goes in our record, and for colours how many bytes: 3 or 4 */
};

struct reader {
    struct cloud_build build;
    struct pcd_header header;
    const unsigned char *bytes;
    size_t n;
    size_t column_count;
    struct column *column; /* owned */
};

/* ------------------------------------------------------------------------------------------------ columns */

static const char *our_name(const char *name) {
    static const char *const pairs[][2] = {{"normal_x", "nx"}, {"normal_y", "ny"}, {"normal_z", "nz"}};
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
        if (strcmp(pairs[i][0], name) == 0) return pairs[i][1];
    return name;
}

static bool is_colour(const struct pcd_field *field) {
    return field->bytes == 4 && field->count == 1 &&
           (strcmp(field->name, "rgb") == 0 || strcmp(field->name, "rgba") == 0);
}

static enum scalar_type pcd_type_of(const struct pcd_field *field) {
    if (field->kind == 'F') return field->bytes == 8 ? SCALAR_FLOAT64 : SCALAR_FLOAT32;
    int log = field->bytes == 4 ? 2 : field->bytes == 2 ? 1 : 0;
    return (enum scalar_type)(2 * log + (field->kind == 'U'));
}

static enum status add_colour(struct reader *r, struct column *column) {
    static const char *const names[] = {"red", "green", "blue", "alpha"};
    enum status status = STATUS_OK;
    column->becomes = BECOMES_COLOUR;
    column->offsets = strcmp(column->field->name, "rgba") == 0 ? 4 : 3;
    for (size_t i = 0; !status && i < column->offsets; i++)
        status = cloud_build_property(&r->build, names[i], SCALAR_UINT8);
    return status;
}

static bool is_around_origin(const struct pcd_header *header) {
    return header->origin[0] != 0 || header->origin[1] != 0 || header->origin[2] != 0;
}

static enum status add_scalar(struct reader *r, struct column *column, uint32_t k) {
    char name[PROPERTY_NAME_BYTES + 16];
    const struct pcd_field *field = column->field;
    if (field->count > 1)
        snprintf(name, sizeof name, "%s_%" PRIu32, field->name, k);
    else
        snprintf(name, sizeof name, "%s", our_name(field->name));
    bool wide = field->kind != 'F' && field->bytes == 8;
    column->becomes = wide ? BECOMES_F64 : BECOMES_SCALAR;
    column->type = wide ? SCALAR_FLOAT64 : pcd_type_of(field);
    for (int axis = 0; axis < 3 && is_around_origin(&r->header) && field->kind == 'F'; axis++) {
        if (strcmp(name, (const char[2]){"xyz"[axis]}) != 0) continue;
        column->becomes = BECOMES_MOVED;
        column->type = SCALAR_FLOAT64;
        column->origin = r->header.origin[axis];
    }
    enum status status = cloud_build_property(&r->build, name, column->type);
    if (!status && wide)
        status = cloud_build_leave_out(&r->build, "64-bit integers beyond 2^53: they are rounded to double");
    return status;
}

static enum status add_column(struct reader *r, const struct pcd_field *field, uint32_t k) {
    struct column *column = &r->column[r->column_count++];
    *column = (struct column){.field = field, .offset = r->build.cloud.record_bytes};
    if (strcmp(field->name, "_") == 0) return STATUS_OK;
    return is_colour(field) ? add_colour(r, column) : add_scalar(r, column, k);
}

static enum status check_xyz(struct reader *r) {
    static const char *const names[] = {"x", "y", "z"};
    for (int axis = 0; axis < 3; axis++) {
        bool found = false;
        for (size_t j = 0; j < r->build.cloud.property_count; j++)
            found = found || strcmp(r->build.cloud.property[j].name, names[axis]) == 0;
        if (!found)
            return error_set(r->build.error, STATUS_MALFORMED, names[axis], "there is no field %s", names[axis]);
    }
    return STATUS_OK;
}

static enum status pcd_describe(struct reader *r) {
    const struct pcd_header *h = &r->header;
    size_t columns = 0;
    for (size_t i = 0; i < h->field_count; i++) columns += h->field[i].count;
    r->column = alloc_array(columns, sizeof *r->column);
    if (!r->column) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for %zu columns", columns);
    enum status status = STATUS_OK;
    for (size_t i = 0, at = 0; !status && i < h->field_count; i++)
        for (uint32_t k = 0; !status && k < h->field[i].count; k++, at += h->field[i].bytes) {
            status = add_column(r, &h->field[i], k);
            r->column[r->column_count - 1].start = at;
            r->column[r->column_count - 1].stride = h->record_bytes;
        }
    return status ? status : check_xyz(r);
}

/* ------------------------------------------------------------------------------------------------ points */

/* A scalar's bits to our record. */
static void pcd_store(const struct column *column, uint64_t bits, unsigned char *record) {
    unsigned char *to = record + column->offset;
    if (column->becomes == BECOMES_COLOUR) {
        for (size_t i = 0; i < column->offsets; i++) to[i] = (unsigned char)(bits >> (i < 3 ? 16 - 8 * i : 24));
    } else if (column->becomes == BECOMES_F64) {
        double value = column->field->kind == 'U' ? (double)bits : (double)(int64_t)bits;
        memcpy(to, &value, sizeof value);
    } else if (column->becomes == BECOMES_MOVED) {
        float f32;
        double f64;
        uint32_t narrow = (uint32_t)bits;
        memcpy(&f32, &narrow, sizeof f32);
        memcpy(&f64, &bits, sizeof f64);
        f64 = column->origin + (column->field->bytes == 8 ? f64 : (double)f32);
        memcpy(to, &f64, sizeof f64);
    } else if (column->becomes == BECOMES_SCALAR) {
        size_t bytes = scalar_bytes(column->type);
        if (bytes == 1) memcpy(to, &(uint8_t){(uint8_t)bits}, 1);
        if (bytes == 2) memcpy(to, &(uint16_t){(uint16_t)bits}, 2);
        if (bytes == 4) memcpy(to, &(uint32_t){(uint32_t)bits}, 4);
        if (bytes == 8) memcpy(to, &bits, 8);
    }
}

/* Points first .. first + n - 1. */
static enum status pcd_take_binary(struct reader *r, const unsigned char *data, uint64_t byte, size_t stride,
                                   uint64_t first, uint64_t n) {
    unsigned char record[CLOUD_MAX_PROPERTIES * 8];
    enum status status = STATUS_OK;
    for (uint64_t i = first; !status && i < first + n; i++) {
        for (size_t j = 0; j < r->column_count; j++) {
            const struct column *column = &r->column[j];
            pcd_store(column, load_little_endian(data + column->start + i * column->stride, column->field->bytes),
                      record);
        }
        status = cloud_build_point(&r->build, record, (struct cloud_place){0, byte + i * stride});
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ ascii */

/* The word's bits as the column's type has them in the file. */
static bool parse(const struct column *column, const struct scan_word *word, uint64_t *bits) {
    const struct pcd_field *field = column->field;
    float f32;
    double f64;
    int64_t whole;
    if (field->kind == 'F' && field->bytes == 4) {
        uint32_t narrow;
        if (!scan_f32(word, &f32)) return false;
        memcpy(&narrow, &f32, sizeof narrow);
        *bits = narrow;
        return true;
    }
    if (field->kind == 'F') {
        if (!scan_f64(word, &f64)) return false;
        memcpy(bits, &f64, sizeof *bits);
        return true;
    }
    if (field->kind == 'U') return scan_u64(word, bits) && (field->bytes == 8 || *bits >> (8 * field->bytes) == 0);
    if (!scan_i64(word, &whole)) return false;
    int64_t most = field->bytes == 8 ? INT64_MAX : (INT64_C(1) << (8 * field->bytes - 1)) - 1;
    *bits = (uint64_t)whole;
    return whole <= most && whole >= -most - 1;
}

static enum status pcd_take_line(struct reader *r, struct scan *scan) {
    unsigned char record[CLOUD_MAX_PROPERTIES * 8];
    struct scan_word word;
    char quote[NUMBER_QUOTE_BYTES];
    struct cloud_place place = {scan->line, (uint64_t)(scan->at - scan->begin)};
    for (size_t j = 0; j < r->column_count; j++) {
        const struct column *column = &r->column[j];
        uint64_t bits = 0;
        bool there = j == 0 ? scan_token(scan, &word) : scan_word(scan, &word);
        place.line = scan->line;
        if (!there)
            return cloud_build_bad(&r->build, column->field->name, place,
                                   scan->at == scan->end && j == 0 ? "the file ends before the last point"
                                                                   : "the line ends before all values are there");
        if (column->becomes != BECOMES_NOTHING && !parse(column, &word, &bits))
            return cloud_build_bad(&r->build, column->field->name, place, "'%s' is no number in the range of its type",
                                   scan_quote(&word, quote));
        pcd_store(column, bits, record);
    }
    if (scan_word(scan, &word))
        return cloud_build_bad(&r->build, "points", place, "more values on the line than the header has");
    return cloud_build_point(&r->build, record, place);
}

/* The lines, which may be as many as are promised. */
static enum status begin_lines(struct reader *r, struct scan *scan) {
    *scan = scan_start(r->bytes, r->n);
    scan->at = scan->begin + r->header.bytes;
    scan->line = r->header.lines + 1;
    if (r->header.points > (r->n - r->header.bytes + 1) / (2 * r->column_count))
        return cloud_build_bad(&r->build, "POINTS", (struct cloud_place){scan->line, 0},
                               "%" PRIu64 " points are promised, which %zu bytes can't hold", r->header.points,
                               r->n - r->header.bytes);
    return STATUS_OK;
}

/* What follows the last point goes to the report. */
static enum status pcd_note_rest(struct reader *r, const void *rest, size_t n) {
    char note[PADDING_NOTE_BYTES];
    if (n == 0) return STATUS_OK;
    padding_note(note, rest, n);
    return cloud_build_leave_out(&r->build, note);
}

static enum status end_lines(struct reader *r, struct scan *scan) {
    struct scan_word word;
    return scan_token(scan, &word) ? pcd_note_rest(r, word.text, (size_t)(scan->end - word.text)) : STATUS_OK;
}

static enum status read_ascii(struct reader *r) {
    struct scan scan;
    enum status status = begin_lines(r, &scan);
    if (!status) status = cloud_build_room(&r->build, r->header.points);
    for (uint64_t i = 0; !status && i < r->header.points; i++) status = pcd_take_line(r, &scan);
    return status ? status : end_lines(r, &scan);
}

/* ------------------------------------------------------------------------------------------------ binary */

static enum status wrong_length(struct reader *r, uint64_t expected, uint64_t there) {
    return cloud_build_bad(&r->build, "POINTS", (struct cloud_place){0, r->n},
                           "%" PRIu64 " points are promised: %" PRIu64 " bytes expected, %" PRIu64 " bytes are there",
                           r->header.points, expected, there);
}

static enum status check_binary(struct reader *r, uint64_t *end) {
    uint64_t begin = r->header.bytes, bytes;
    if (__builtin_mul_overflow(r->header.points, r->header.record_bytes, &bytes) || bytes > r->n - begin)
        return wrong_length(r, r->header.points > UINT64_MAX / r->header.record_bytes ? UINT64_MAX : bytes + begin,
                            r->n);
    *end = begin + bytes;
    return STATUS_OK;
}

static enum status pcd_read_binary(struct reader *r) {
    uint64_t begin = r->header.bytes, end = 0;
    enum status status = check_binary(r, &end);
    if (!status) status = cloud_build_room(&r->build, r->header.points);
    if (!status) status = pcd_take_binary(r, r->bytes + begin, begin, r->header.record_bytes, 0, r->header.points);
    return status ? status : pcd_note_rest(r, r->bytes + end, r->n - end);
}

/* From point by point to field by field. */
static void turn_columns(struct reader *r) {
    size_t at = 0;
    for (size_t j = 0; j < r->column_count;) {
        const struct pcd_field *field = r->column[j].field;
        size_t stride = (size_t)field->bytes * field->count;
        for (uint32_t k = 0; k < field->count; k++, j++) {
            r->column[j].start = at + (size_t)k * field->bytes;
            r->column[j].stride = stride;
        }
        at += stride * (size_t)r->header.points;
    }
}

/* What is packed is *packed bytes, which become *bytes. */
static enum status check_compressed(struct reader *r, size_t *packed_bytes, size_t *unpacked_bytes) {
    size_t begin = r->header.bytes, left = r->n - begin;
    uint64_t expected;
    if (left < LENGTHS_BYTES) return wrong_length(r, begin + LENGTHS_BYTES, r->n);
    uint64_t packed = load_little_endian(r->bytes + begin, 4), bytes = load_little_endian(r->bytes + begin + 4, 4);
    if (__builtin_mul_overflow(r->header.points, r->header.record_bytes, &expected) || expected != bytes)
        return cloud_build_bad(&r->build, "DATA", (struct cloud_place){0, begin + 4},
                               "%" PRIu64 " bytes are packed, which isn't what %" PRIu64 " points have", bytes,
                               r->header.points);
    if (packed > left - LENGTHS_BYTES) return wrong_length(r, begin + LENGTHS_BYTES + packed, r->n);
    if (bytes / PCD_LZF_MOST > packed)
        return cloud_build_bad(&r->build, "DATA", (struct cloud_place){0, begin},
                               "%" PRIu64 " bytes of LZF can't become %" PRIu64, packed, bytes);
    *packed_bytes = (size_t)packed;
    *unpacked_bytes = (size_t)bytes;
    return STATUS_OK;
}

static enum status unpack(struct reader *r, size_t packed, unsigned char *data, size_t bytes) {
    size_t begin = r->header.bytes + LENGTHS_BYTES;
    turn_columns(r);
    if (lzf_decompress(r->bytes + begin, packed, data, bytes)) return STATUS_OK;
    return cloud_build_bad(&r->build, "DATA", (struct cloud_place){0, begin}, "the packed data is broken");
}

static enum status read_compressed(struct reader *r) {
    size_t packed = 0, bytes = 0, begin = r->header.bytes + LENGTHS_BYTES;
    enum status status = check_compressed(r, &packed, &bytes);
    if (status) return status;
    unsigned char *data = alloc_array(bytes, 1);
    status = data ? cloud_build_room(&r->build, r->header.points)
                  : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for %zu bytes", bytes);
    if (!status) status = unpack(r, packed, data, bytes);
    if (!status) status = pcd_take_binary(r, data, begin, 0, 0, r->header.points);
    if (!status) status = pcd_note_rest(r, r->bytes + begin + packed, r->n - (begin + packed));
    free(data);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

/* Keeps the header's lines of comment, but for the first one, which names the format. */
static enum status keep_comments(struct reader *r) {
    const char *at = (const char *)r->bytes, *end = at + r->header.bytes;
    enum status status = STATUS_OK;
    while (!status && at < end) {
        const char *stop = at;
        while (stop < end && *stop != '\n' && *stop != '\r') stop++;
        double origin[3];
        bool names_format = stop - at >= 6 && memcmp(at, "# .PCD", 6) == 0;
        bool tells_origin = *at == '#' && pcd_header_origin(at, (size_t)(stop - at), origin);
        if (*at == '#' && !names_format && !tells_origin)
            status = cloud_build_comment(&r->build, at + 1, (size_t)(stop - at) - 1);
        at = stop + 1;
    }
    return status;
}

static enum status keep_viewpoint(struct reader *r) {
    static const char name[] = "viewpoint";
    char text[sizeof name + (size_t)7 * NUMBER_TEXT_BYTES], *end = text + sizeof name - 1;
    double v[7];
    memcpy(text, name, sizeof name);
    memcpy(v, r->header.viewpoint, sizeof v);
    bool plain = v[0] == 0 && v[1] == 0 && v[2] == 0 && v[3] == 1 && v[4] == 0 && v[5] == 0 && v[6] == 0;
    for (int axis = 0; axis < 3; axis++) v[axis] += r->header.origin[axis];
    for (int k = 0; k < 7; k++) {
        *end++ = ' ';
        number_print(end, 17, v[k]);
        end += strlen(end);
    }
    return plain ? STATUS_OK : cloud_build_comment(&r->build, text, strlen(text));
}

static enum status pcd_read_file(struct reader *r) {
    static enum status (*const readers[])(struct reader *) = {
        [PCD_ASCII] = read_ascii, [PCD_BINARY] = pcd_read_binary, [PCD_COMPRESSED] = read_compressed};
    enum status status = pcd_describe(r);
    if (!status) status = readers[r->header.data](r);
    if (!status) status = keep_comments(r);
    return status ? status : keep_viewpoint(r);
}

static const char *const forms[] = {
    [PCD_ASCII] = "pcd/ascii", [PCD_BINARY] = "pcd/binary", [PCD_COMPRESSED] = "pcd/binary_compressed"};

/* A comment may fool it about the form, but no reader. */
const char *cloud_pcd_look(const struct first_bytes *first) {
    struct scan_word word;
    struct scan rest;
    bool is_pcd = first_begins(first, "# .PCD", 6) ||
                  (first_word(first, &word, &rest) &&
                   (scan_is(&word, "VERSION") || scan_is(&word, "FIELDS") || scan_is(&word, "COLUMNS")));
    if (!is_pcd) return "";
    return first_contains(first, "DATA binary_compressed") ? forms[PCD_COMPRESSED]
           : first_contains(first, "DATA binary")          ? forms[PCD_BINARY]
                                                           : forms[PCD_ASCII];
}

enum status cloud_pcd_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.bytes = bytes, .n = n};
    enum status status = pcd_header_parse(bytes, n, &r.header, error);
    if (status) return status;
    cloud_build_start(&r.build, forms[r.header.data], n, limits, progress, error);
    status = pcd_read_file(&r);
    free(r.column);
    return cloud_build_end(&r.build, status, cloud);
}

/* ------------------------------------------------------------------------------------------------ part by part */

struct pcd_parts {
    struct cloud_parts parts;
    struct reader reader;
    struct scan lines;         /* ascii */
    const unsigned char *data; /* binary: the first point */
    uint64_t byte;             /* where that is in the file */
    size_t stride, tail;       /* bytes of a point in the file, 0: they are packed; where the points end */
    unsigned char *unpacked;   /* mapped; NULL: they aren't packed */
    size_t unpacked_bytes;
    uint64_t done; /* points */
};

static enum status pcd_next_part(struct cloud_parts *parts, struct error *error) {
    struct pcd_parts *p = (struct pcd_parts *)parts;
    struct reader *r = &p->reader;
    uint64_t left = r->header.points - p->done, n = left < CLOUD_PART_USUAL ? left : CLOUD_PART_USUAL;
    enum status status = STATUS_OK;
    r->build.error = error;
    r->build.cloud.count = 0;
    if (n == 0) return STATUS_OK;
    if (r->header.data == PCD_ASCII)
        for (uint64_t i = 0; !status && i < n; i++) status = pcd_take_line(r, &p->lines);
    else
        status = pcd_take_binary(r, p->data, p->byte, p->stride, p->done, n);
    p->done += n;
    if (r->header.data == PCD_ASCII)
        parts->done_bytes = (size_t)(p->lines.at - p->lines.begin);
    else
        parts->done_bytes = p->stride ? (size_t)(p->byte + p->done * p->stride) : n == left ? p->tail : 0;
    if (status || n < left) return status;
    return r->header.data == PCD_ASCII ? end_lines(r, &p->lines) : pcd_note_rest(r, r->bytes + p->tail, r->n - p->tail);
}

static void pcd_free_parts(struct cloud_parts *parts) {
    struct pcd_parts *p = (struct pcd_parts *)parts;
    cloud_done(&p->reader.build.cloud);
    free(p->reader.column);
    if (p->unpacked) munmap(p->unpacked, p->unpacked_bytes);
    free(p);
}

/* What is packed goes onto the disk. */
static enum status begin_compressed(struct pcd_parts *p, const struct cloud_limits *limits) {
    struct reader *r = &p->reader;
    size_t packed = 0;
    enum status status = check_compressed(r, &packed, &p->unpacked_bytes);
    if (!status && (!limits || !limits->scratch))
        status = error_set(r->build.error, STATUS_UNSUPPORTED, "read",
                           "binary_compressed isn't read part by part without a folder for it");
    if (!status) status = temporary_map(limits->scratch, p->unpacked_bytes, &p->unpacked, r->build.error);
    if (!status) status = unpack(r, packed, p->unpacked, p->unpacked_bytes);
    p->data = p->unpacked;
    p->byte = r->header.bytes + LENGTHS_BYTES;
    p->tail = (size_t)p->byte + packed;
    return status;
}

static enum status begin_points(struct pcd_parts *p, const struct cloud_limits *limits) {
    struct reader *r = &p->reader;
    uint64_t end = 0;
    if (r->header.points == 0)
        return error_set_at(r->build.error, STATUS_MALFORMED, "read", 0, UINT64_MAX, "no points");
    if (r->header.data == PCD_ASCII) return begin_lines(r, &p->lines);
    if (r->header.data == PCD_COMPRESSED) return begin_compressed(p, limits);
    enum status status = check_binary(r, &end);
    p->data = r->bytes + r->header.bytes;
    p->byte = r->header.bytes;
    p->stride = r->header.record_bytes;
    p->tail = (size_t)end;
    return status;
}

enum status cloud_pcd_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct pcd_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    struct reader *r = &p->reader;
    *r = (struct reader){.bytes = bytes, .n = n};
    cloud_build_start(&r->build, "pcd", n, NULL, NULL, error);
    enum status status = pcd_header_parse(bytes, n, &r->header, error);
    if (!status) r->build.cloud.form = forms[r->header.data];
    if (!status) status = pcd_describe(r);
    if (!status) status = begin_points(p, limits);
    if (!status) status = keep_comments(r);
    if (!status) status = keep_viewpoint(r);
    p->parts = (struct cloud_parts){&r->build.cloud,
                                    r->header.points,
                                    0,
                                    pcd_next_part,
                                    pcd_free_parts,
                                    false,
                                    p->unpacked ? p->unpacked_bytes : 0};
    if (status)
        pcd_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
