/* LAS and LAZ, after the specification of the ASPRS, versions 1.0 to 1.4 (R15) and what 1.5 adds; all numbers are
 * little endian.
 *
 *     header, whose size it tells itself | variable length records | points, all as long as the header says
 *
 * Where the fields of a point lie is a table of rows for formats 0 to 5 and one for 6 to 10; a row gives a bit field as
 * offset, shift and width.  What a record has beyond its format are extra bytes, described by a record of their own, or
 * else kept as bytes extra_0, extra_1 ...  x, y, z are X * scale + offset in double; so are extra fields that have a
 * scale. 64-bit integers become double.  What LAS can
 * hold again, coordinate systems among it, is kept for it (las_fields.h); waveforms outside the points are left out.
 *
 * Points come in pieces that know nothing of each other: so many of LAS, a chunk of LAZ (core/io/laz/laz.h), COPC among
 * it.  Pieces are read on all threads, each point into its own place, so that nothing depends on which is first; after
 * some the caller's thread asks for progress.  Of several broken pieces the first is told.
 *
 * A file that ends within its points keeps those that are there, with a note: transfers and full disks cut files short.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/las_fields.h"
#include "core/io/reader.h"

#include <inttypes.h>
#include <math.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/base/left_out.h"
#include "core/base/par.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/laz/laz.h"
#include "core/io/parts.h"

enum {
    COMPATIBLE_ID = 22204,
    FORMAT_BITS = 0x3f,
    PIECE_POINTS = 16384,   /* of LAS */
    BATCH_POINTS = 1 << 19, /* about, between two looks at the progress */
    NOTE_BYTES = 160
};

struct reader {
    struct cloud_build build;
    const unsigned char *bytes;
    size_t n;
    unsigned format, minor;
    uint64_t points, first_point, record_bytes, header_bytes, record_count; /* of variable length records */
    double scale[3], add[3];
    uint64_t slot; /* the point that stands first in the cloud: 0, but of a file that is read part by part */
    bool is_laz, has_layout, has_crs;
    size_t kept_bytes;        /* of variable length records that go on */
    struct laz_layout layout; /* of LAZ */
    unsigned threads;
    size_t field_count;
    struct las_field field[CLOUD_MAX_PROPERTIES];
};

#define OLD 0x03f  /* formats 0 to 5 */
#define NEW 0x7c0  /* 6 to 10 */
#define TIME 0x03a /* 1, 3, 4, 5 have the time behind the old fields */
#define U8 SCALAR_UINT8
#define U16 SCALAR_UINT16
#define U32 SCALAR_UINT32
#define F32 SCALAR_FLOAT32
#define F64 SCALAR_FLOAT64

static const struct {
    unsigned formats; /* a bit for each */
    const char *name;
    unsigned type;
    size_t offset;
    unsigned shift, bits;
} rows[] = {
    {OLD | NEW, "intensity", U16, 12, 0, 0},
    {OLD, "return_number", U8, 14, 0, 3},
    {OLD, "number_of_returns", U8, 14, 3, 3},
    {OLD, "scan_direction_flag", U8, 14, 6, 1},
    {OLD, "edge_of_flight_line", U8, 14, 7, 1},
    {OLD, "classification", U8, 15, 0, 5},
    {OLD, "synthetic", U8, 15, 5, 1},
    {OLD, "key_point", U8, 15, 6, 1},
    {OLD, "withheld", U8, 15, 7, 1},
    {OLD, "scan_angle_rank", SCALAR_INT8, 16, 0, 0},
    {OLD, "user_data", U8, 17, 0, 0},
    {OLD, "point_source_id", U16, 18, 0, 0},
    {NEW, "return_number", U8, 14, 0, 4},
    {NEW, "number_of_returns", U8, 14, 4, 4},
    {NEW, "synthetic", U8, 15, 0, 1},
    {NEW, "key_point", U8, 15, 1, 1},
    {NEW, "withheld", U8, 15, 2, 1},
    {NEW, "overlap", U8, 15, 3, 1},
    {NEW, "scanner_channel", U8, 15, 4, 2},
    {NEW, "scan_direction_flag", U8, 15, 6, 1},
    {NEW, "edge_of_flight_line", U8, 15, 7, 1},
    {NEW, "classification", U8, 16, 0, 0},
    {NEW, "user_data", U8, 17, 0, 0},
    {NEW, "scan_angle", SCALAR_INT16, 18, 0, 0},
    {NEW, "point_source_id", U16, 20, 0, 0},
    {TIME, "gps_time", F64, 20, 0, 0},
    {NEW, "gps_time", F64, 22, 0, 0},
    {1 << 2, "red", U16, 20, 0, 0},
    {1 << 2, "green", U16, 22, 0, 0},
    {1 << 2, "blue", U16, 24, 0, 0},
    {1 << 3 | 1 << 5, "red", U16, 28, 0, 0},
    {1 << 3 | 1 << 5, "green", U16, 30, 0, 0},
    {1 << 3 | 1 << 5, "blue", U16, 32, 0, 0},
    {1 << 7 | 1 << 8 | 1 << 10, "red", U16, 30, 0, 0},
    {1 << 7 | 1 << 8 | 1 << 10, "green", U16, 32, 0, 0},
    {1 << 7 | 1 << 8 | 1 << 10, "blue", U16, 34, 0, 0},
    {1 << 8 | 1 << 10, "nir", U16, 36, 0, 0},
};

/* A waveform packet's description, at the offset that its format has it; 0 = none. */
static const size_t wave_offset[LAS_FORMATS] = {0, 0, 0, 0, 28, 34, 0, 0, 0, 30, 38};
static const struct {
    const char *name;
    unsigned type;
    size_t offset;
} wave_rows[] = {{"wave_packet_descriptor", U8, 0},
                 {"wave_offset", LAS_U64, 1},
                 {"wave_bytes", U32, 9},
                 {"wave_location", F32, 13},
                 {"wave_dx", F32, 17},
                 {"wave_dy", F32, 21},
                 {"wave_dz", F32, 25}};

const size_t las_format_bytes[LAS_FORMATS] = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};

/* ------------------------------------------------------------------------------------------------ numbers */

static double load_f64(const unsigned char *p) {
    uint64_t bits = load_little_endian(p, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* A scalar in the file's byte order to one in ours. */
static void load_scalar(const unsigned char *p, enum scalar_type type, void *to) {
    size_t bytes = scalar_bytes(type);
    uint64_t value = load_little_endian(p, bytes);
    if (bytes == 1) memcpy(to, &(uint8_t){(uint8_t)value}, 1);
    if (bytes == 2) memcpy(to, &(uint16_t){(uint16_t)value}, 2);
    if (bytes == 4) memcpy(to, &(uint32_t){(uint32_t)value}, 4);
    if (bytes == 8) memcpy(to, &value, 8);
}

static enum status las_bad(struct reader *r, const char *where, uint64_t byte, const char *what, uint64_t value) {
    return cloud_build_bad(&r->build, where, (struct cloud_place){0, byte}, "%s (%" PRIu64 ")", what, value);
}

/* ------------------------------------------------------------------------------------------------ header */

static uint64_t count_of_points(const unsigned char *bytes, size_t n) {
    uint64_t older = load_little_endian(bytes + 107, 4);
    if (bytes[25] < 4 || n < LAS_HEADER_BYTES) return older;
    uint64_t newer = load_little_endian(bytes + 247, 8);
    return newer ? newer : older;
}

static enum status check_version(struct reader *r) {
    unsigned major = r->bytes[24];
    r->minor = r->bytes[25];
    if (major != 1 || r->minor > 5)
        return error_set_at(r->build.error, STATUS_UNSUPPORTED, "version", 0, 24,
                            "LAS version %u.%u; 1.0 to 1.5 are read", major, r->minor);
    r->is_laz = r->bytes[104] & LAS_LAZ_BIT;
    r->format = r->is_laz ? r->bytes[104] & FORMAT_BITS : r->bytes[104];
    if (r->format >= LAS_FORMATS)
        return error_set_at(r->build.error, STATUS_UNSUPPORTED, "format", 0, 104, "point format %u; 0 to 10 are read",
                            r->format);
    return STATUS_OK;
}

/* So many points are there; fewer than are promised are told. */
static enum status las_note_cut(struct reader *r, uint64_t there) {
    char note[NOTE_BYTES];
    if (there == r->points) return STATUS_OK;
    snprintf(note, sizeof note, LEFT_OUT_WARNING "the last %" PRIu64 " of %" PRIu64 " points: the file is cut short",
             r->points - there, r->points);
    r->points = there;
    return cloud_build_leave_out(&r->build, note);
}

/* Of LAS: whether all points are there, and what else is. */
static enum status las_check_end(struct reader *r) {
    uint64_t there = (r->n - r->first_point) / r->record_bytes, promised = r->points;
    char note[NOTE_BYTES] = "";
    if (promised > there && (there == 0 || promised >= NONE))
        return cloud_build_bad(&r->build, "points", (struct cloud_place){0, r->n},
                               "%" PRIu64 " points of %" PRIu64 " bytes from byte %" PRIu64
                               " are promised, but the file ends at byte %zu",
                               promised, r->record_bytes, r->first_point, r->n);
    if (promised > there) return las_note_cut(r, there);
    if (r->minor < 3 && promised && there > promised) { /* newer ones may have records and waveforms there */
        snprintf(note, sizeof note,
                 "%" PRIu64 " bytes behind the last of the %" PRIu64 " points that the header counts",
                 r->n - r->first_point - promised * r->record_bytes, promised);
    }
    return note[0] ? cloud_build_leave_out(&r->build, note) : STATUS_OK;
}

static enum status check_sizes(struct reader *r) {
    uint64_t least = r->minor >= 4 ? LAS_HEADER_BYTES : LAS_OLD_HEADER_BYTES;
    if (r->header_bytes < least || r->header_bytes > r->n)
        return las_bad(r, "header", 94, "the size of the header is out of range", r->header_bytes);
    if (r->first_point < r->header_bytes || r->first_point > r->n)
        return las_bad(r, "header", 96, "the points begin out of range", r->first_point);
    if (r->record_bytes < las_format_bytes[r->format])
        return las_bad(r, "header", 105, "the size of a point is too small for its format", r->record_bytes);
    return r->is_laz ? STATUS_OK : las_check_end(r);
}

static enum status las_take_header(struct reader *r) {
    if (r->n < LAS_OLD_HEADER_BYTES)
        return las_bad(r, "header", r->n, "the file ends in its header; bytes there", r->n);
    enum status status = check_version(r);
    if (status) return status;
    r->header_bytes = load_little_endian(r->bytes + 94, 2);
    r->first_point = load_little_endian(r->bytes + 96, 4);
    r->record_count = load_little_endian(r->bytes + 100, 4);
    r->record_bytes = load_little_endian(r->bytes + 105, 2);
    r->points = count_of_points(r->bytes, r->n);
    for (size_t axis = 0; axis < 3; axis++) {
        r->scale[axis] = load_f64(r->bytes + 131 + 8 * axis);
        r->add[axis] = load_f64(r->bytes + 155 + 8 * axis);
        if (!isfinite(r->scale[axis]) || !isfinite(r->add[axis]) || r->scale[axis] == 0)
            return las_bad(r, "header", 131 + 8 * axis, "a scale or an offset is no fit number; axis", axis);
    }
    return check_sizes(r);
}

/* ------------------------------------------------------------------------------------------------ fields */

static enum status las_add_field(struct reader *r, const struct las_field *field) {
    enum scalar_type type = field->type >= SCALAR_TYPE_COUNT || field->scaled ? F64 : (enum scalar_type)field->type;
    enum status status = cloud_build_property(&r->build, field->name, type);
    if (!status && field->type >= SCALAR_TYPE_COUNT)
        status = cloud_build_leave_out(&r->build, "64-bit integers beyond 2^53: they are rounded to double");
    if (!status) {
        r->field[r->field_count] = *field; /* under the property's name, which may be another one */
        memcpy(r->field[r->field_count].name, r->build.cloud.property[r->field_count].name, PROPERTY_NAME_BYTES);
        r->field_count++;
    }
    return status;
}

static enum status las_add_row(struct reader *r, const char *name, unsigned type, size_t offset, unsigned shift,
                               unsigned bits) {
    struct las_field field = {.type = type, .offset = offset, .shift = shift, .bits = bits};
    snprintf(field.name, sizeof field.name, "%s", name);
    return las_add_field(r, &field);
}

size_t las_format_fields(unsigned format, struct las_field field[LAS_FIELDS]) {
    size_t wave = wave_offset[format], n = 0;
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        if (!(rows[i].formats >> format & 1)) continue;
        field[n] = (struct las_field){
            .type = rows[i].type, .offset = rows[i].offset, .shift = rows[i].shift, .bits = rows[i].bits};
        snprintf(field[n++].name, PROPERTY_NAME_BYTES, "%s", rows[i].name);
    }
    for (size_t i = 0; wave && i < sizeof wave_rows / sizeof *wave_rows; i++) {
        field[n] = (struct las_field){.type = wave_rows[i].type, .offset = wave + wave_rows[i].offset};
        snprintf(field[n++].name, PROPERTY_NAME_BYTES, "%s", wave_rows[i].name);
    }
    return n;
}

static enum status add_format_fields(struct reader *r) {
    struct las_field fields[LAS_FIELDS];
    size_t n = las_format_fields(r->format, fields);
    enum status status = STATUS_OK;
    for (size_t axis = 0; !status && axis < 3; axis++) {
        struct las_field field = {.name = {"xyz"[axis]},
                                  .type = SCALAR_INT32,
                                  .offset = 4 * axis,
                                  .scaled = true,
                                  .scale = r->scale[axis],
                                  .add = r->add[axis]};
        status = las_add_field(r, &field);
    }
    for (size_t i = 0; !status && i < n; i++) status = las_add_field(r, &fields[i]);
    return status;
}

static size_t raw_bytes(unsigned type) { return type < SCALAR_TYPE_COUNT ? scalar_bytes((enum scalar_type)type) : 8; }

/* Adds the field or fields of one description of extra bytes; *at is where they lie, moved on. */
static enum status add_described(struct reader *r, const unsigned char *d, size_t *at) {
    static const unsigned types[] = {U8, SCALAR_INT8, U16, SCALAR_INT16, U32, SCALAR_INT32, LAS_U64, LAS_I64, F32, F64};
    unsigned type = d[2], options = d[3], count = type == 0 ? options : 1 + (type - 1) / 10;
    if (type > 30) return STATUS_OK; /* of no known size: what is left becomes bytes */
    unsigned raw = type == 0 ? U8 : types[(type - 1) % 10];
    bool scaled = type != 0 && options & 0x18;
    enum status status = STATUS_OK;
    for (unsigned k = 0; !status && k < count && *at + raw_bytes(raw) <= r->record_bytes; k++) {
        struct las_field field = {.type = raw, .offset = *at, .scaled = scaled, .scale = 1, .add = 0};
        if (options & 0x08) field.scale = load_f64(d + 112 + 8 * (k % 3));
        if (options & 0x10) field.add = load_f64(d + 136 + 8 * (k % 3));
        int length = (int)strnlen((const char *)d + 4, 32);
        snprintf(field.name, sizeof field.name, count > 1 ? "%.*s_%u" : "%.*s", length, (const char *)d + 4, k);
        for (char *c = field.name; *c; c++)
            if (*c == ' ') *c = '_';
        status = las_add_field(r, &field);
        *at += raw_bytes(raw);
    }
    return status;
}

static bool is_user(const unsigned char *vlr, const char *user) {
    return strncmp((const char *)vlr + 2, user, 16) == 0;
}

/* Whether a record goes on into what is written: it tells of coordinates or fields, not of how this file is laid out.
 */
static bool goes_on(const unsigned char *vlr) {
    uint64_t id = load_little_endian(vlr + 18, 2);
    return is_user(vlr, "LASF_Projection") || is_user(vlr, "liblas") ||
           (is_user(vlr, "LASF_Spec") && (id == 0 || id == 3 || id == 4));
}

static enum status take_layout(struct reader *r, uint64_t at, uint64_t length) {
    const char *wrong = laz_layout_take(r->bytes + at, (size_t)length, r->format, (size_t)r->record_bytes, &r->layout);
    r->has_layout = !wrong;
    if (!wrong) return STATUS_OK;
    return error_set_at(r->build.error, STATUS_UNSUPPORTED, "format", 0, at, "LAZ that isn't read: %s", wrong);
}

/* Walks over the variable length records, for extra bytes and what is to be noted. */
static enum status take_records(struct reader *r, size_t *extra) {
    uint64_t at = r->header_bytes;
    enum status status = STATUS_OK;
    for (uint64_t i = 0; !status && i < r->record_count; i++) {
        if (r->first_point - at < LAS_VLR_BYTES)
            return las_bad(r, "header", at, "a variable length record is cut short", i);
        const unsigned char *vlr = r->bytes + at;
        uint64_t id = load_little_endian(vlr + 18, 2), length = load_little_endian(vlr + 20, 2);
        at += LAS_VLR_BYTES;
        if (r->first_point - at < length) return las_bad(r, "header", at, "a variable length record is cut short", i);
        if (is_user(vlr, "LASF_Projection")) r->has_crs = true;
        if (goes_on(vlr)) r->kept_bytes += LAS_VLR_BYTES + length;
        if (r->is_laz && is_user(vlr, "laszip encoded") && id == LAZ_RECORD_ID) status = take_layout(r, at, length);
        if (!status && is_user(vlr, "lascompatible") && id == COMPATIBLE_ID)
            status =
                cloud_build_leave_out(&r->build, "what LAS 1.4 adds to the points: they are in compatibility mode, "
                                                 "as extra bytes");
        if (!status && is_user(vlr, "LASF_Spec") && id == 4)
            for (uint64_t k = 0; !status && k + LAS_EXTRA_BYTES <= length; k += LAS_EXTRA_BYTES)
                status = add_described(r, r->bytes + at + k, extra);
        at += length;
    }
    return status;
}

/* A long coordinate system may stand behind the points: its record, with the length that it has there, or NULL. */
static const unsigned char *find_late_crs(const struct reader *r, uint64_t *length) {
    enum { EVLR_BYTES = 60, FIRST = 235, COUNT = 243 };
    if (r->minor < 4 || r->n < LAS_HEADER_BYTES) return NULL;
    uint64_t at = load_little_endian(r->bytes + FIRST, 8), count = load_little_endian(r->bytes + COUNT, 4);
    for (uint64_t i = 0; i < count && at <= r->n && r->n - at >= EVLR_BYTES; i++) {
        const unsigned char *record = r->bytes + at;
        *length = load_little_endian(record + 20, 8);
        if (*length > r->n - at - EVLR_BYTES) return NULL;
        if (is_user(record, "LASF_Projection")) return record;
        at += EVLR_BYTES + *length;
    }
    return NULL;
}

/* What whoever writes LAS of this cloud takes from it. */
static enum status keep_origin(struct reader *r) {
    enum { EVLR_BYTES = 60 };
    uint64_t late_bytes = 0, at = r->header_bytes;
    const unsigned char *late = find_late_crs(r, &late_bytes);
    if (late && late_bytes > UINT16_MAX) late = NULL;
    size_t bytes = r->kept_bytes + (late ? LAS_VLR_BYTES + (size_t)late_bytes : 0);
    struct cloud_las *las = alloc_array(1, sizeof *las + bytes);
    if (!las) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for %zu bytes of records", bytes);
    *las = (struct cloud_las){.minor = r->minor,
                              .format = r->format,
                              .source = (unsigned)load_little_endian(r->bytes + 4, 2),
                              .encoding = (unsigned)load_little_endian(r->bytes + 6, 2),
                              .record_bytes = (size_t)r->record_bytes,
                              .has_crs = r->has_crs || late,
                              .field_count = r->field_count};
    memcpy(las->field, r->field, r->field_count * sizeof *las->field);
    for (uint64_t i = 0; i < r->record_count; i++) {
        const unsigned char *vlr = r->bytes + at;
        size_t whole = LAS_VLR_BYTES + (size_t)load_little_endian(vlr + 20, 2);
        at += whole;
        if (!goes_on(vlr)) continue;
        memcpy(las->records + las->records_bytes, vlr, whole);
        las->records_bytes += whole;
        las->record_count++;
    }
    if (late) { /* as a short record: lengths have two bytes there, not eight */
        unsigned char *to = las->records + las->records_bytes;
        memset(to, 0, LAS_VLR_BYTES);
        memcpy(to, late, 22);
        memcpy(to + 22, late + 28, 32);
        memcpy(to + LAS_VLR_BYTES, late + EVLR_BYTES, (size_t)late_bytes);
        las->records_bytes = bytes;
        las->record_count++;
    }
    r->build.cloud.las = las;
    return STATUS_OK;
}

static enum status las_describe(struct reader *r) {
    size_t extra = las_format_bytes[r->format], first = extra;
    enum status status = add_format_fields(r);
    if (!status) status = take_records(r, &extra);
    for (; !status && extra < r->record_bytes; extra++) {
        char name[PROPERTY_NAME_BYTES];
        snprintf(name, sizeof name, "extra_%zu", extra - first);
        status = las_add_row(r, name, U8, extra, 0, 0);
    }
    return status ? status : keep_origin(r);
}

/* ------------------------------------------------------------------------------------------------ points */

static void take_field(const struct las_field *field, const unsigned char *from, void *to) {
    from += field->offset;
    if (field->type == LAS_U64 || field->type == LAS_I64 || field->scaled) {
        unsigned char scalar[8];
        double value;
        if (field->type < SCALAR_TYPE_COUNT) {
            load_scalar(from, (enum scalar_type)field->type, scalar);
            value = scalar_load(scalar, (enum scalar_type)field->type);
        } else {
            value = field->type == LAS_U64 ? (double)load_little_endian(from, 8)
                                           : (double)(int64_t)load_little_endian(from, 8);
        }
        if (field->scaled) value = value * field->scale + field->add;
        memcpy(to, &value, sizeof value);
    } else if (field->bits) {
        *(uint8_t *)to = (uint8_t)(*from >> field->shift & ((1u << field->bits) - 1));
    } else {
        load_scalar(from, (enum scalar_type)field->type, to);
    }
}

/* The point of these bytes of the file, which is its i-th. */
static void las_take_point(struct reader *r, const unsigned char *from, uint64_t point) {
    struct cloud *cloud = &r->build.cloud;
    size_t i = (size_t)(point - r->slot);
    unsigned char *record = cloud->record + i * cloud->record_bytes;
    for (size_t j = 0; j < r->field_count; j++)
        take_field(&r->field[j], from, record + cloud->property[j].offset_bytes);
    cloud_build_place(&r->build, i);
}

/* Pieces of points, and what reads them. */
struct pieces {
    struct reader *reader;
    struct laz_chunks chunks; /* of LAZ */
    size_t count;             /* of pieces */
    size_t done;
    const char **wrong; /* of LAZ: of each piece, NULL = nothing; owned */
    size_t codec_count;
    struct codec {
        atomic_flag taken;
        struct laz_codec *codec; /* owned */
    } * codec;                   /* one for each thread */
};

static const char *take_chunk(struct pieces *pieces, struct laz_codec *codec, size_t piece) {
    struct reader *r = pieces->reader;
    const struct laz_chunks *chunks = &pieces->chunks;
    uint64_t from = chunks->byte[piece], first = chunks->point[piece], end = chunks->point[piece + 1];
    if (first == end) return NULL;
    const char *wrong = laz_read_begin(codec, r->bytes + from, (size_t)(chunks->byte[piece + 1] - from), end - first);
    for (uint64_t i = first; !wrong && i < end; i++) {
        const unsigned char *point = laz_read_point(codec);
        if (point)
            las_take_point(r, point, i);
        else
            wrong = "it ends before its points do";
    }
    return wrong ? wrong : laz_read_end(codec);
}

/* Of as many threads as there are codecs: one of them is always free. */
static struct codec *take_codec(struct pieces *pieces) {
    for (size_t i = 0;; i = (i + 1) % pieces->codec_count)
        if (!atomic_flag_test_and_set(&pieces->codec[i].taken)) return &pieces->codec[i];
}

static void take_pieces(void *ctx, size_t begin, size_t end) {
    struct pieces *pieces = ctx;
    struct reader *r = pieces->reader;
    struct codec *codec = r->is_laz ? take_codec(pieces) : NULL;
    for (size_t piece = pieces->done + begin; piece < pieces->done + end; piece++) {
        if (codec) {
            pieces->wrong[piece] = take_chunk(pieces, codec->codec, piece);
            continue;
        }
        uint64_t first = (uint64_t)piece * PIECE_POINTS, last = first + PIECE_POINTS;
        for (uint64_t i = first; i < last && i < r->points; i++)
            las_take_point(r, r->bytes + r->first_point + i * r->record_bytes, i);
    }
    if (codec) atomic_flag_clear(&codec->taken);
}

static enum status make_pieces(struct reader *r, struct pieces *pieces) {
    *pieces = (struct pieces){.reader = r, .count = (size_t)((r->points + PIECE_POINTS - 1) / PIECE_POINTS)};
    if (!r->is_laz) return STATUS_OK;
    enum status status =
        laz_chunks_read(r->bytes, r->n, r->first_point, r->points, &r->layout, &pieces->chunks, r->build.error);
    if (!status && pieces->chunks.searched)
        status = cloud_build_leave_out(&r->build, LEFT_OUT_WARNING
                                       "the table of chunks, which isn't whole: they were found without it");
    if (!status) status = las_note_cut(r, pieces->chunks.point[pieces->chunks.count]);
    if (status) return status;
    pieces->count = pieces->chunks.count;
    pieces->codec_count = r->threads < pieces->count ? r->threads : pieces->count;
    pieces->wrong = alloc_zeroed(pieces->count, sizeof *pieces->wrong);
    pieces->codec = alloc_zeroed(pieces->codec_count, sizeof *pieces->codec);
    bool room = pieces->wrong && pieces->codec;
    for (size_t i = 0; room && i < pieces->codec_count; i++) {
        atomic_flag_clear(&pieces->codec[i].taken);
        room = (pieces->codec[i].codec = laz_codec_new(&r->layout)) != NULL;
    }
    return room ? STATUS_OK : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory to decompress with");
}

static void free_pieces(struct pieces *pieces) {
    for (size_t i = 0; pieces->codec && i < pieces->codec_count; i++) laz_codec_free(pieces->codec[i].codec);
    free(pieces->codec), free(pieces->wrong);
    laz_chunks_free(&pieces->chunks);
}

/* How many pieces are read before the next look at the progress: at least one for each thread. */
static size_t batch_of(const struct pieces *pieces) {
    const struct reader *r = pieces->reader;
    size_t left = pieces->count - pieces->done, batch = (size_t)(BATCH_POINTS / (r->points / pieces->count + 1)) + 1;
    if (batch < 2 * (size_t)r->threads) batch = 2 * (size_t)r->threads;
    return batch < left ? batch : left;
}

static enum status check_batch(const struct pieces *pieces, size_t batch) {
    const struct laz_chunks *chunks = &pieces->chunks;
    for (size_t i = pieces->done; pieces->wrong && i < pieces->done + batch; i++)
        if (pieces->wrong[i])
            return error_set_at(pieces->reader->build.error, STATUS_MALFORMED, "chunks", 0, chunks->byte[i],
                                "chunk %zu, of points %" PRIu64 " to %" PRIu64 ": %s", i, chunks->point[i],
                                chunks->point[i + 1] - 1, pieces->wrong[i]);
    return STATUS_OK;
}

static enum status check_layout(struct reader *r) {
    if (!r->is_laz || r->has_layout) return STATUS_OK;
    return las_bad(r, "header", r->header_bytes, "no record says how the points are compressed; records",
                   r->record_count);
}

static enum status las_take_points(struct reader *r) {
    struct pieces pieces = {0};
    if (check_layout(r)) return STATUS_MALFORMED;
    if (r->points == 0) return STATUS_OK;
    enum status status = make_pieces(r, &pieces);
    if (!status) status = cloud_build_slots(&r->build, r->points);
    while (!status && pieces.done < pieces.count) {
        if (progress_tick(r->build.progress, "read", (double)pieces.done / (double)pieces.count)) {
            status = error_set(r->build.error, STATUS_CANCELLED, "read", "cancelled");
            break;
        }
        size_t batch = batch_of(&pieces);
        par_for(r->threads, batch, 1, take_pieces, &pieces);
        status = check_batch(&pieces, batch);
        pieces.done += batch;
    }
    free_pieces(&pieces);
    return status;
}

const char *cloud_las_look(const struct first_bytes *first) {
    enum { FORMAT_BYTE = 104 };
    if (!first_begins(first, "LASF", 4)) return "";
    return first->n > FORMAT_BYTE && first->text[FORMAT_BYTE] & LAS_LAZ_BIT ? "laz" : "las";
}

bool las_summary_of(const void *bytes, size_t n, struct las_summary *summary) {
    const unsigned char *p = bytes;
    if (n < LAS_OLD_HEADER_BYTES || memcmp(p, "LASF", 4) != 0 || p[24] != 1) return false;
    unsigned format = p[104] & LAS_LAZ_BIT ? p[104] & FORMAT_BITS : p[104];
    if (format >= LAS_FORMATS) return false;
    *summary = (struct las_summary){.format = format, .points = count_of_points(p, n), .has_box = true};
    for (size_t axis = 0; axis < 3; axis++) {
        double max = load_f64(p + 179 + 16 * axis), min = load_f64(p + 187 + 16 * axis);
        summary->min[axis] = min, summary->max[axis] = max;
        summary->has_box &= isfinite(min) && isfinite(max) && min <= max;
    }
    summary->has_box &= summary->points > 0;
    return true;
}

enum status cloud_las_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.bytes = bytes, .n = n};
    const struct first_bytes first = first_bytes_of(bytes, n);
    r.threads = limits && limits->threads ? limits->threads : par_processors();
    cloud_build_start(&r.build, cloud_las_look(&first), n, limits, progress, error);
    enum status status = las_take_header(&r);
    if (!status) status = las_describe(&r);
    if (!status) status = las_take_points(&r);
    return cloud_build_end(&r.build, status, cloud);
}

/* ------------------------------------------------------------------------------------------------ part by part */

struct las_parts {
    struct cloud_parts parts;
    struct reader reader;
    struct pieces pieces;
};

static uint64_t point_of_piece(const struct las_parts *p, size_t piece) {
    uint64_t point = (uint64_t)piece * PIECE_POINTS;
    if (p->reader.is_laz) return p->pieces.chunks.point[piece];
    return point < p->reader.points ? point : p->reader.points;
}

static enum status las_next_part(struct cloud_parts *parts, struct error *error) {
    struct las_parts *p = (struct las_parts *)parts;
    struct reader *r = &p->reader;
    struct pieces *pieces = &p->pieces;
    r->build.error = error;
    r->build.cloud.count = 0;
    if (pieces->done == pieces->count) return STATUS_OK;
    size_t batch = batch_of(pieces), last = pieces->done + batch;
    r->slot = point_of_piece(p, pieces->done);
    enum status status = cloud_build_slots(&r->build, point_of_piece(p, last) - r->slot);
    if (status) return status;
    par_for(r->threads, batch, 1, take_pieces, pieces);
    status = check_batch(pieces, batch);
    pieces->done = last;
    parts->done_bytes =
        (size_t)(r->is_laz ? pieces->chunks.byte[last] : r->first_point + point_of_piece(p, last) * r->record_bytes);
    return status;
}

static void las_free_parts(struct cloud_parts *parts) {
    struct las_parts *p = (struct las_parts *)parts;
    free_pieces(&p->pieces);
    cloud_done(&p->reader.build.cloud);
    free(p);
}

static enum status check_parts(const struct las_parts *p, struct error *error) {
    for (size_t i = 0; i < p->pieces.count; i++)
        if (point_of_piece(p, i + 1) - point_of_piece(p, i) > CLOUD_PART_MOST)
            return error_set_at(error, STATUS_UNSUPPORTED, "chunks", 0, p->pieces.chunks.byte[i],
                                "a chunk of over %d points, which can't be read part by part; write the file anew",
                                CLOUD_PART_MOST);
    return STATUS_OK;
}

enum status cloud_las_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct las_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    struct reader *r = &p->reader;
    const struct first_bytes first = first_bytes_of(bytes, n);
    *r = (struct reader){.bytes = bytes, .n = n};
    r->threads = limits && limits->threads ? limits->threads : par_processors();
    cloud_build_start(&r->build, cloud_las_look(&first), n, limits, NULL, error);
    enum status status = las_take_header(r);
    if (!status) status = las_describe(r);
    if (!status) status = check_layout(r);
    if (!status && r->points) status = make_pieces(r, &p->pieces);
    if (!status) status = check_parts(p, error);
    p->parts = (struct cloud_parts){&r->build.cloud, r->points, 0, las_next_part, las_free_parts, false, 0};
    if (status)
        las_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
