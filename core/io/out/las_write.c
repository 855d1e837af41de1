/* Writing LAS, LAZ and COPC.
 *
 * What a point is made of is decided once, as a list of fields, each with the property that it is taken from: those
 * that the file had, where the cloud was LAS, else those that the point format has by name; what is left becomes extra
 * bytes. Then points go out in pieces: each is put together, and for LAZ compressed, on a thread of its own.  COPC is
 * LAZ whose pieces are cubes, told in its first record and in a record behind the points (COPC Specification 1.0).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/las_write.h"

#include <assert.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/base/par.h"
#include "core/cloud/attribute_names.h"
#include "core/io/formats/las_fields.h"
#include "core/io/laz/laz.h"
#include "core/io/out/sink.h"

enum { SLOTS_MOST = 64, RETURNS = 15, OLD_RETURNS = 5, WKT_BIT = 0x10, KEPT_BITS = 0x19, NEWEST_MINOR = 4 };
static const double WIDEST = 2e9;       /* of 2^31 steps */
static const double ANGLE_STEP = 0.006; /* degrees of a scan_angle */

/* COPC: its first record, which begins at LAS_HEADER_BYTES, and the one behind the points. */
enum { COPC_INFO_BYTES = 160, COPC_INFO_ID = 1, COPC_ENTRY_BYTES = 32, COPC_HIERARCHY_ID = 1000, EVLR_BYTES = 60 };
enum { COPC_ROOT_PLACE = LAS_HEADER_BYTES + LAS_VLR_BYTES + 40, EVLR_PLACE = 235 }; /* of two figures each */

struct target {
    struct las_field field;
    const struct property *from;
    int colour; /* 0 to 2 for red, green, blue; -1 for what is no colour */
};

struct writer {
    const struct cloud *cloud;
    const uint32_t *ids;
    size_t n;
    const char *name; /* in left_out */
    struct left_out *left_out;
    const struct las_cubes *cubes; /* NULL: it isn't COPC */
    bool compressed;
    size_t pieces;
    uint64_t *piece; /* pieces + 1: where each begins, in points; owned */
    size_t most;     /* points of a piece */
    unsigned format, minor, encoding, source;
    size_t record_bytes;
    double scale[3], add[3];
    size_t target_count;
    struct target target[CLOUD_MAX_PROPERTIES + 32];
    struct laz_layout layout;
    struct laz_bytes records; /* variable length; owned */
    uint32_t record_count;
    struct laz_bytes described; /* descriptions of extra bytes; owned */
    int32_t low[3], high[3];    /* of the coordinates as they are written */
    uint64_t of_return[RETURNS];
};

static size_t nth_id(const struct writer *w, size_t i) {
    size_t id = w->ids ? w->ids[i] : i;
    assert(id < w->cloud->count);
    return id;
}

static double las_value_of(const struct writer *w, size_t id, const struct property *property) {
    return scalar_load(w->cloud->record + id * w->cloud->record_bytes + property->offset_bytes, property->type);
}

static bool is_coordinate(const struct cloud *cloud, const struct property *property) {
    return cloud_axis_of(cloud, (size_t)(property - cloud->property)) >= 0;
}

static const struct property *find_scalar(const struct cloud *cloud, const char *name) {
    const struct property *p = attribute_find(cloud, name);
    return p && !is_coordinate(cloud, p) ? p : NULL;
}

static int colour_of(const char *name) {
    static const char *const names[] = {"red", "green", "blue"};
    for (int k = 0; k < 3; k++)
        if (strcmp(names[k], name) == 0) return k;
    return -1;
}

static void add_target(struct writer *w, const struct las_field *field, const struct property *from) {
    bool is_colour = field->type == SCALAR_UINT16 && !field->scaled;
    w->target[w->target_count++] = (struct target){*field, from, is_colour ? colour_of(field->name) : -1};
}

/* ------------------------------------------------------------------------------------------------ coordinates */

static double limit(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

static int32_t coordinate_of(const struct writer *w, size_t id, size_t axis) {
    double value = (&w->cloud->position[id].x)[axis];
    return (int32_t)limit(rint((value - w->add[axis]) / w->scale[axis]), INT32_MIN, INT32_MAX);
}

/* Those of the file that the cloud was; else a power of ten that leads from the smallest to the largest in 31 bits. */
static void choose_scale(struct writer *w) {
    const struct cloud_las *las = w->cloud->las;
    for (size_t axis = 0; axis < 3; axis++) {
        if (las && las->field_count) {
            w->scale[axis] = las->field[axis].scale, w->add[axis] = las->field[axis].add;
            continue;
        }
        double low = INFINITY, high = -INFINITY;
        for (size_t i = 0; i < w->n; i++) {
            double value = (&w->cloud->position[nth_id(w, i)].x)[axis];
            low = fmin(low, value), high = fmax(high, value);
        }
        if (w->n == 0) low = high = 0;
        w->add[axis] = high - low >= 1 ? floor(low) : low;
        double range = high - w->add[axis];
        w->scale[axis] = range > 0 ? pow(10, ceil(log10(range / WIDEST))) : 0.001;
    }
}

static void note_scale(const struct writer *w) {
    double worst = 0;
    for (size_t i = 0; i < w->n; i++)
        for (size_t axis = 0; axis < 3; axis++) {
            size_t id = nth_id(w, i);
            double written = coordinate_of(w, id, axis) * w->scale[axis] + w->add[axis];
            worst = fmax(worst, fabs(written - (&w->cloud->position[id].x)[axis]));
        }
    if (worst > 0)
        left_out_add(w->left_out, w->name, "precision: x, y, z are multiples of %g, %g, %g, off by up to %.2g",
                     w->scale[0], w->scale[1], w->scale[2], worst);
}

/* ------------------------------------------------------------------------------------------------ fields */

static double greatest(const struct las_field *field) {
    static const double most[] = {INT8_MAX, UINT8_MAX, INT16_MAX, UINT16_MAX, INT32_MAX, UINT32_MAX};
    return field->bits ? (1u << field->bits) - 1 : most[field->type];
}

static double least(const struct las_field *field) {
    bool is_signed = field->type == SCALAR_INT8 || field->type == SCALAR_INT16 || field->type == SCALAR_INT32;
    return is_signed ? -greatest(field) - 1 : 0;
}

/* Whether the field can have every value that the property has, a scaled one to its step. */
static bool holds(const struct writer *w, const struct las_field *field, const struct property *property) {
    if (field->type == SCALAR_FLOAT64) return true;
    if (field->type == SCALAR_FLOAT32) return property->type == SCALAR_FLOAT32;
    for (size_t i = 0; i < w->n; i++) {
        double value = las_value_of(w, nth_id(w, i), property);
        if (field->scaled) value = rint((value - field->add) / field->scale);
        if (!(value >= least(field) && value <= greatest(field) && value == floor(value))) return false;
    }
    return true;
}

/* The least format whose fields the cloud has. */
static unsigned choose_format(const struct cloud *cloud) {
    static const char *const newer[] = {"overlap", "scanner_channel", "scan_angle", "nir"};
    bool colour = find_scalar(cloud, "red") && find_scalar(cloud, "green") && find_scalar(cloud, "blue");
    for (size_t i = 0; i < sizeof newer / sizeof *newer; i++)
        if (find_scalar(cloud, newer[i])) return colour && find_scalar(cloud, "nir") ? 8 : colour ? 7 : 6;
    return (find_scalar(cloud, "gps_time") ? 1u : 0u) + (colour ? 2u : 0u);
}

static bool las_is_taken(const struct writer *w, const struct property *property) {
    for (size_t i = 0; i < w->target_count; i++)
        if (w->target[i].from == property) return true;
    return false;
}

/* Describes a property as extra bytes, behind what the record has. */
static void add_extra(struct writer *w, const struct property *property) {
    static const unsigned char types[SCALAR_TYPE_COUNT] = {2, 1, 4, 3, 6, 5, 9, 10};
    unsigned char description[LAS_EXTRA_BYTES] = {0};
    struct las_field field = {.type = property->type, .offset = w->record_bytes};
    description[2] = types[property->type];
    memcpy(description + 4, property->name, strnlen(property->name, 32));
    laz_put(&w->described, description, sizeof description);
    add_target(w, &field, property);
    w->record_bytes += scalar_bytes(property->type);
}

static bool is_description(const unsigned char *vlr) {
    return strncmp((const char *)vlr + 2, "LASF_Spec", 16) == 0 && load_little_endian(vlr + 18, 2) == 4;
}

/* How many bytes of a point this describes. */
static size_t described_bytes(const unsigned char *description) {
    static const size_t bytes[] = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
    unsigned type = description[2];
    return type == 0 ? description[3] : type > 30 ? 0 : (1 + (type - 1) / 10) * bytes[(type - 1) % 10];
}

/* The file's own records.  Descriptions of extra bytes are set apart, so that more can follow. */
static void keep_records(struct writer *w, const struct cloud_las *las) {
    size_t described = las_format_bytes[las->format];
    for (size_t at = 0; at < las->records_bytes;) {
        const unsigned char *vlr = las->records + at;
        size_t length = (size_t)load_little_endian(vlr + 20, 2), whole = LAS_VLR_BYTES + length;
        at += whole;
        if (!is_description(vlr)) {
            laz_put(&w->records, vlr, whole);
            w->record_count++;
            continue;
        }
        for (size_t k = 0; k + LAS_EXTRA_BYTES <= length; k += LAS_EXTRA_BYTES) {
            const unsigned char *description = vlr + LAS_VLR_BYTES + k;
            laz_put(&w->described, description, LAS_EXTRA_BYTES);
            described += described_bytes(description);
        }
    }
    for (size_t i = 0; i < w->cloud->property_count && described < w->record_bytes; i++) {
        const struct property *p = &w->cloud->property[i];
        bool more = !p->is_list && !is_coordinate(w->cloud, p) && !las_is_taken(w, p);
        unsigned char gap[LAS_EXTRA_BYTES] = {0}; /* bytes that nobody described come before those that we add */
        size_t bytes = w->record_bytes - described;
        if (!more) continue;
        gap[3] = (unsigned char)(bytes < 255 ? bytes : 255);
        memcpy(gap + 4, "undescribed", 11);
        laz_put(&w->described, gap, sizeof gap);
        described += gap[3], i--;
    }
}

static void plan_from_las(struct writer *w, const struct cloud_las *las) {
    w->format = las->format;
    w->minor = las->minor < NEWEST_MINOR ? las->minor : NEWEST_MINOR;
    w->source = las->source;
    w->encoding = las->encoding & KEPT_BITS;
    w->record_bytes = las->record_bytes;
    for (size_t i = 3; i < las->field_count; i++) {
        const struct las_field *field = &las->field[i];
        const struct property *from = find_scalar(w->cloud, field->name);
        if (from) add_target(w, field, from);
    }
    keep_records(w, las);
    bool has_wave = las->format == 4 || las->format == 5 || las->format >= 9;
    if (has_wave) left_out_add(w->left_out, w->name, "waveforms: points keep where they were in the original file");
    if (las->minor > NEWEST_MINOR && las->encoding & 0x40)
        left_out_add(w->left_out, w->name, "gps_time: the offset of times that LAS 1.5 has");
}

/* Fields of the format from what the cloud has by those names.  Older formats have scan angles in degrees. */
static void take_fields(struct writer *w) {
    struct las_field field[LAS_FIELDS];
    size_t n = las_format_fields(w->format, field);
    for (size_t i = 0; i < n; i++) {
        const struct property *from = find_scalar(w->cloud, field[i].name);
        if (!from && strcmp(field[i].name, "scan_angle") == 0) {
            from = find_scalar(w->cloud, "scan_angle_rank");
            field[i].scaled = from != NULL, field[i].scale = ANGLE_STEP;
        }
        if (from && holds(w, &field[i], from)) add_target(w, &field[i], from);
    }
}

/* The file's records but for descriptions of what another format's points have.  Newer formats are to name coordinate
 * systems as text; where a file has keys alone, it goes on as it is, and says so. */
static void take_records(struct writer *w, const struct cloud_las *las) {
    for (size_t at = 0; at < las->records_bytes;) {
        const unsigned char *vlr = las->records + at;
        size_t whole = LAS_VLR_BYTES + (size_t)load_little_endian(vlr + 20, 2);
        at += whole;
        if (is_description(vlr)) continue;
        laz_put(&w->records, vlr, whole);
        w->record_count++;
    }
    if (w->minor >= 4 && las_system_is_keys(las)) w->encoding &= ~(unsigned)WKT_BIT;
}

/* In a format of our own choice.  las: where there is one, what it says of coordinates goes on. */
static void plan_anew(struct writer *w, const struct cloud_las *las) {
    w->format = choose_format(w->cloud);
    if (w->cubes && w->format < 6) w->format = w->format & 2 ? 7 : 6;
    w->minor = w->format < 6 ? 2 : NEWEST_MINOR;
    w->encoding = w->format < 6 ? 0 : WKT_BIT;
    w->record_bytes = las_format_bytes[w->format];
    w->encoding |= las ? las->encoding & KEPT_BITS & ~(unsigned)WKT_BIT : 0;
    w->source = las ? las->source : 0;
    take_fields(w);
    if (las) take_records(w, las);
}

static void put_record(struct writer *w, const char *user, unsigned id, const void *bytes, size_t n) {
    unsigned char vlr[LAS_VLR_BYTES] = {0};
    memcpy(vlr + 2, user, strlen(user));
    vlr[18] = (unsigned char)id, vlr[19] = (unsigned char)(id >> 8);
    vlr[20] = (unsigned char)n, vlr[21] = (unsigned char)(n >> 8);
    laz_put(&w->records, vlr, sizeof vlr);
    laz_put(&w->records, bytes, n);
    w->record_count++;
}

/* Where pieces begin. */
static enum status cut(struct writer *w) {
    w->pieces = w->cubes ? w->cubes->count : (w->n + LAZ_USUAL_CHUNK - 1) / LAZ_USUAL_CHUNK;
    w->piece = alloc_array(w->pieces + 1, sizeof *w->piece);
    if (!w->piece) return STATUS_NO_MEMORY;
    w->piece[0] = 0;
    for (size_t i = 0; i < w->pieces; i++) {
        size_t left = w->n - (size_t)w->piece[i], usual = left < LAZ_USUAL_CHUNK ? left : LAZ_USUAL_CHUNK;
        size_t n = w->cubes ? w->cubes->cube[i].points : usual;
        w->piece[i + 1] = w->piece[i] + n;
        if (n > w->most) w->most = n;
    }
    return STATUS_OK;
}

/* COPC has points of the formats 6 to 8. */
static bool goes_on(const struct writer *w, const struct cloud_las *las) {
    return las && las->field_count && (!w->cubes || (las->format >= 6 && las->format <= 8));
}

static void plan(struct writer *w) {
    unsigned char layout[LAZ_LAYOUT_BYTES], info[COPC_INFO_BYTES] = {0};
    const struct cloud_las *las = w->cloud->las;
    choose_scale(w);
    if (w->cubes) put_record(w, "copc", COPC_INFO_ID, info, sizeof info);
    if (goes_on(w, las))
        plan_from_las(w, las);
    else
        plan_anew(w, las);
    note_scale(w);
    for (size_t j = 0; j < w->cloud->property_count; j++) {
        const struct property *p = &w->cloud->property[j];
        if (p->is_list)
            left_out_add(w->left_out, w->name, "%s: LAS has no lists", p->name);
        else if (!is_coordinate(w->cloud, p) && !las_is_taken(w, p))
            add_extra(w, p);
    }
    if (w->described.used) put_record(w, "LASF_Spec", 4, w->described.bytes, w->described.used);
    laz_layout_make(w->format, w->record_bytes, &w->layout);
    if (w->cubes) w->layout.chunk_points = UINT32_MAX;
    size_t bytes = laz_layout_store(&w->layout, layout);
    if (w->compressed) put_record(w, "laszip encoded", LAZ_RECORD_ID, layout, bytes);
}

/* ------------------------------------------------------------------------------------------------ points */

static void put_f64(unsigned char *p, double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    store_little_endian(p, bits, sizeof bits);
}

/* A value in the type that the file has it in. */
static void las_put_number(unsigned char *p, unsigned type, double value) {
    uint64_t bits = 0;
    uint32_t four;
    uint16_t two;
    if (type < SCALAR_TYPE_COUNT) {
        unsigned char scalar[8];
        size_t bytes = scalar_bytes((enum scalar_type)type);
        scalar_store(scalar, (enum scalar_type)type, value);
        if (bytes == 1) bits = scalar[0];
        if (bytes == 2) bits = (memcpy(&two, scalar, 2), two);
        if (bytes == 4) bits = (memcpy(&four, scalar, 4), four);
        if (bytes == 8) memcpy(&bits, scalar, 8);
        store_little_endian(p, bits, bytes);
        return;
    }
    if (type == LAS_U64)
        bits = value >= 0x1p64 ? UINT64_MAX : value > 0 ? (uint64_t)value : 0;
    else
        bits = (uint64_t)(value >= 0x1p63 ? INT64_MAX : value > -0x1p63 ? (int64_t)value : INT64_MIN);
    store_little_endian(p, bits, 8);
}

static void put_target(const struct writer *w, const struct target *target, size_t id, unsigned char *record) {
    const struct las_field *field = &target->field;
    unsigned char *p = record + field->offset;
    double value = las_value_of(w, id, target->from);
    if (target->colour >= 0 && w->cloud->colour)
        value = w->cloud->colour[id][target->colour];
    else if (target->colour >= 0 && target->from->type == SCALAR_UINT8)
        value *= 257;
    if (field->scaled) value = (value - field->add) / field->scale;
    if (field->scaled && field->type != SCALAR_FLOAT32 && field->type != SCALAR_FLOAT64) value = rint(value);
    if (field->bits)
        *p |= (unsigned char)((uint32_t)limit(value, 0, greatest(field)) << field->shift);
    else if (field->type < SCALAR_TYPE_COUNT && field->type == target->from->type && target->colour < 0 &&
             __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__) /* as it is, a NaN's bits too */
        memcpy(p, w->cloud->record + id * w->cloud->record_bytes + target->from->offset_bytes,
               scalar_bytes(target->from->type));
    else
        las_put_number(p, field->type, value);
}

static void las_put_point(const struct writer *w, size_t id, unsigned char *record) {
    memset(record, 0, w->record_bytes);
    for (size_t axis = 0; axis < 3; axis++)
        store_little_endian(record + 4 * axis, (uint32_t)coordinate_of(w, id, axis), 4);
    for (size_t i = 0; i < w->target_count; i++) put_target(w, &w->target[i], id, record);
}

/* Piece `first + slot` of the points, in its slot. */
struct slots {
    const struct writer *w;
    size_t count, first;
    struct slot {
        struct laz_codec *codec; /* NULL: LAS; owned */
        unsigned char *records;  /* w->most of them; owned */
        struct laz_bytes out;    /* owned */
        size_t n;                /* points */
    } slot[SLOTS_MOST];
};

static void make_slots(void *ctx, size_t begin, size_t end) {
    struct slots *slots = ctx;
    const struct writer *w = slots->w;
    for (size_t s = begin; s < end; s++) {
        struct slot *slot = &slots->slot[s];
        size_t from = (size_t)w->piece[slots->first + s];
        slot->n = (size_t)w->piece[slots->first + s + 1] - from;
        slot->out.used = 0;
        for (size_t i = 0; i < slot->n; i++) las_put_point(w, nth_id(w, from + i), slot->records + i * w->record_bytes);
        if (slot->codec) laz_write_chunk(slot->codec, slot->records, slot->n, &slot->out);
    }
}

static enum status begin_slots(struct slots *slots, unsigned threads) {
    const struct writer *w = slots->w;
    slots->count = threads ? threads : par_processors();
    if (slots->count > SLOTS_MOST) slots->count = SLOTS_MOST;
    if (slots->count > w->pieces) slots->count = w->pieces;
    for (size_t s = 0; s < slots->count; s++) {
        struct slot *slot = &slots->slot[s];
        slot->records = alloc_array(w->most, w->record_bytes);
        slot->codec = w->compressed ? laz_codec_new(&w->layout) : NULL;
        if (!slot->records || (w->compressed && !slot->codec)) return STATUS_NO_MEMORY;
    }
    return STATUS_OK;
}

static void end_slots(struct slots *slots) {
    for (size_t s = 0; s < slots->count; s++) {
        laz_codec_free(slots->slot[s].codec);
        free(slots->slot[s].records), free(slots->slot[s].out.bytes);
    }
}

/* Writes all pieces; of LAZ, the size of each goes to size_of. */
static enum status put_points(struct writer *w, struct sink *sink, unsigned threads, uint64_t *size_of) {
    struct slots slots = {.w = w};
    enum status status = begin_slots(&slots, threads);
    while (!status && slots.first < w->pieces && !sink->failure) {
        size_t batch = w->pieces - slots.first < slots.count ? w->pieces - slots.first : slots.count;
        par_for(threads, batch, 1, make_slots, &slots);
        for (size_t s = 0; s < batch && !status; s++) {
            const struct slot *slot = &slots.slot[s];
            if (slot->out.failed) status = STATUS_NO_MEMORY;
            if (!status && w->compressed)
                sink_bytes(sink, slot->out.bytes, size_of[slots.first + s] = slot->out.used);
            else if (!status)
                sink_bytes(sink, slot->records, slot->n * w->record_bytes);
        }
        slots.first += batch;
    }
    end_slots(&slots);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the header */

static void survey(struct writer *w) {
    const struct property *number = find_scalar(w->cloud, "return_number");
    for (size_t axis = 0; axis < 3; axis++) w->low[axis] = INT32_MAX, w->high[axis] = INT32_MIN;
    for (size_t i = 0; i < w->n; i++) {
        size_t id = nth_id(w, i);
        for (size_t axis = 0; axis < 3; axis++) {
            int32_t value = coordinate_of(w, id, axis);
            if (value < w->low[axis]) w->low[axis] = value;
            if (value > w->high[axis]) w->high[axis] = value;
        }
        double of = number ? las_value_of(w, id, number) : 1;
        if (of >= 1 && of <= RETURNS) w->of_return[(size_t)of - 1]++;
    }
}

static size_t header_bytes(const struct writer *w) {
    enum { WITH_WAVEFORMS = 235 };
    return w->minor >= 4 ? LAS_HEADER_BYTES : w->minor == 3 ? WITH_WAVEFORMS : LAS_OLD_HEADER_BYTES;
}

static void las_put_header(const struct writer *w, struct sink *sink) {
    unsigned char head[LAS_HEADER_BYTES] = "LASF";
    size_t bytes = header_bytes(w);
    bool is_old = w->format < 6;
    store_little_endian(head + 4, w->source, 2);
    store_little_endian(head + 6, w->minor < 4 ? w->encoding & ~(unsigned)WKT_BIT : w->encoding, 2);
    head[24] = 1, head[25] = (unsigned char)w->minor;
    memcpy(head + 26, "EXTRACTION", 10);
    memcpy(head + 58, "whittle", 7);
    store_little_endian(head + 94, bytes, 2);
    store_little_endian(head + 96, bytes + w->records.used, 4);
    store_little_endian(head + 100, w->record_count, 4);
    head[104] = (unsigned char)(w->format | (w->compressed ? LAS_LAZ_BIT : 0));
    store_little_endian(head + 105, w->record_bytes, 2);
    if (is_old) store_little_endian(head + 107, w->n, 4);
    for (size_t i = 0; is_old && i < OLD_RETURNS; i++) store_little_endian(head + 111 + 4 * i, w->of_return[i], 4);
    for (size_t axis = 0; axis < 3; axis++) {
        put_f64(head + 131 + 8 * axis, w->scale[axis]);
        put_f64(head + 155 + 8 * axis, w->add[axis]);
        put_f64(head + 179 + 16 * axis, w->n ? w->high[axis] * w->scale[axis] + w->add[axis] : 0);
        put_f64(head + 187 + 16 * axis, w->n ? w->low[axis] * w->scale[axis] + w->add[axis] : 0);
    }
    store_little_endian(head + 247, w->n, 8);
    for (size_t i = 0; i < RETURNS; i++) store_little_endian(head + 255 + 8 * i, w->of_return[i], 8);
    sink_bytes(sink, head, bytes);
    if (w->records.used) sink_bytes(sink, w->records.bytes, w->records.used);
}

/* ------------------------------------------------------------------------------------------------ COPC */

static void measure_times(const struct writer *w, double times[2]) {
    const struct property *time = find_scalar(w->cloud, "gps_time");
    times[0] = times[1] = time && w->n ? las_value_of(w, nth_id(w, 0), time) : 0;
    for (size_t i = 1; time && i < w->n; i++) {
        double value = las_value_of(w, nth_id(w, i), time);
        times[0] = fmin(times[0], value), times[1] = fmax(times[1], value);
    }
}

/* The first record as far as it is known before the points are written. */
static void fill_info(struct writer *w) {
    unsigned char *info = w->records.bytes + LAS_VLR_BYTES;
    const struct las_cubes *cubes = w->cubes;
    double times[2];
    measure_times(w, times);
    const double figures[] = {cubes->centre.x, cubes->centre.y, cubes->centre.z, cubes->half, cubes->spacing};
    for (size_t i = 0; i < sizeof figures / sizeof *figures; i++) put_f64(info + 8 * i, figures[i]);
    put_f64(info + 56, times[0]), put_f64(info + 64, times[1]);
}

/* Which cube is where, as one page, and in the head where that stands.  at: the end of the chunks' table. */
static void put_hierarchy(const struct writer *w, struct sink *sink, off_t begin, uint64_t at,
                          const uint64_t *size_of) {
    unsigned char head[EVLR_BYTES] = {0}, entry[COPC_ENTRY_BYTES], place[16];
    uint64_t bytes = COPC_ENTRY_BYTES * (uint64_t)w->pieces, chunk = header_bytes(w) + w->records.used + 8;
    memcpy(head + 2, "copc", 4);
    store_little_endian(head + 18, COPC_HIERARCHY_ID, 2);
    store_little_endian(head + 20, bytes, 8);
    sink_bytes(sink, head, sizeof head);
    for (size_t i = 0; i < w->pieces; i++) {
        const struct las_cube *cube = &w->cubes->cube[i];
        const uint32_t key[] = {cube->level, cube->at[0], cube->at[1], cube->at[2]};
        for (size_t k = 0; k < 4; k++) store_little_endian(entry + 4 * k, key[k], 4);
        store_little_endian(entry + 16, chunk, 8);
        store_little_endian(entry + 24, size_of[i], 4);
        store_little_endian(entry + 28, cube->points, 4);
        sink_bytes(sink, entry, sizeof entry);
        chunk += size_of[i];
    }
    store_little_endian(place, at, 8), store_little_endian(place + 8, 1, 4);
    sink_rewrite(sink, place, 12, begin + EVLR_PLACE);
    store_little_endian(place, at + EVLR_BYTES, 8), store_little_endian(place + 8, bytes, 8);
    sink_rewrite(sink, place, 16, begin + COPC_ROOT_PLACE);
}

/* ------------------------------------------------------------------------------------------------ the file */

/* Where the file stands, if its bytes can be written anew; -1 for a pipe, or what is only appended to. */
static off_t rewritable(int fd) {
    int flags = fcntl(fd, F_GETFL);
    return flags < 0 || flags & O_APPEND ? -1 : lseek(fd, 0, SEEK_CUR);
}

bool cloud_takes_copc(int fd) { return rewritable(fd) >= 0; }

/* The chunks, with where their table is, and the table. */
static enum status put_compressed(struct writer *w, struct sink *sink, off_t begin, unsigned threads) {
    uint64_t first = header_bytes(w) + w->records.used, at = first + 8;
    uint64_t *size_of = alloc_zeroed(2 * w->pieces, sizeof *size_of), *points_of = size_of ? size_of + w->pieces : NULL;
    unsigned char place[8];
    struct laz_bytes table = {0};
    memset(place, 0xff, sizeof place); /* it is told at the end */
    sink_bytes(sink, place, sizeof place);
    enum status status = size_of ? put_points(w, sink, threads, size_of) : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < w->pieces; i++) at += size_of[i], points_of[i] = w->piece[i + 1] - w->piece[i];
    if (!status) laz_chunks_write(&table, w->cubes ? points_of : NULL, size_of, w->pieces);
    if (table.failed) status = STATUS_NO_MEMORY;
    store_little_endian(place, at, sizeof place);
    if (!status) sink_bytes(sink, table.bytes, table.used);
    if (!status && begin < 0) sink_bytes(sink, place, sizeof place);
    if (!status && begin >= 0) sink_rewrite(sink, place, sizeof place, begin + (off_t)first);
    if (!status && w->cubes) put_hierarchy(w, sink, begin, at + table.used, size_of);
    free(size_of), free(table.bytes);
    return status;
}

static enum status las_write_file(struct writer *w, int fd, unsigned threads, struct error *error) {
    struct sink sink;
    if (sink_init(&sink, fd)) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for a buffer");
    enum status status = cut(w);
    if (!status) plan(w), survey(w);
    if (w->records.failed || w->described.failed) status = STATUS_NO_MEMORY;
    if (!status && w->cubes) fill_info(w);
    off_t begin = rewritable(fd);
    if (!status) las_put_header(w, &sink);
    if (!status)
        status = w->compressed ? put_compressed(w, &sink, begin, threads) : put_points(w, &sink, threads, NULL);
    if (status == STATUS_NO_MEMORY)
        status = error_set(error, STATUS_NO_MEMORY, "write", "no memory to write %zu points", w->n);
    free(w->records.bytes), free(w->described.bytes), free(w->piece);
    return sink_done(&sink, status, error);
}

static enum status write_new(int fd, const struct writer *like, unsigned threads, struct error *error) {
    struct writer *w = alloc_array(1, sizeof *w);
    if (!w) return error_set(error, STATUS_NO_MEMORY, "write", "no memory to write %zu points", like->n);
    *w = *like;
    enum status status = las_write_file(w, fd, threads, error);
    free(w);
    return status;
}

enum status cloud_write_las(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n, bool compressed,
                            unsigned threads, struct left_out *left_out, struct error *error) {
    const char *name = compressed ? "cloud.laz" : "cloud.las";
    const struct writer w = {
        .cloud = cloud, .ids = ids, .n = n, .name = name, .left_out = left_out, .compressed = compressed};
    return write_new(fd, &w, threads, error);
}

enum status cloud_write_copc(int fd, const struct cloud *cloud, const uint32_t *ids, size_t n,
                             const struct las_cubes *cubes, unsigned threads, struct left_out *left_out,
                             struct error *error) {
    const struct writer w = {.cloud = cloud,
                             .ids = ids,
                             .n = n,
                             .name = "cloud.copc.laz",
                             .left_out = left_out,
                             .compressed = true,
                             .cubes = cubes};
    if (!cloud_takes_copc(fd))
        return error_set(error, STATUS_BAD_PARAMETER, "output",
                         "COPC can't go into a pipe: where its index is stands in its head");
    return write_new(fd, &w, threads, error);
}

void las_places(const struct cloud *cloud, const uint32_t *ids, size_t n, vec3 *place) {
    struct writer w = {.cloud = cloud, .ids = ids, .n = n};
    choose_scale(&w);
    for (size_t i = 0; i < n; i++)
        for (size_t axis = 0; axis < 3; axis++)
            (&place[i].x)[axis] = coordinate_of(&w, nth_id(&w, i), axis) * w.scale[axis] + w.add[axis];
}

enum status cloud_keep_colours(struct cloud *cloud, struct error *error) {
    static const char *const names[] = {"red", "green", "blue"};
    const struct property *from[3];
    for (int k = 0; k < 3; k++) {
        from[k] = find_scalar(cloud, names[k]);
        if (!from[k] || from[k]->type != SCALAR_UINT16) return STATUS_OK;
    }
    cloud->colour = alloc_array(cloud->count, sizeof *cloud->colour);
    if (!cloud->colour) return error_set(error, STATUS_NO_MEMORY, "write", "no memory for colours");
    for (size_t i = 0; i < cloud->count; i++)
        for (int k = 0; k < 3; k++)
            memcpy(&cloud->colour[i][k], cloud->record + i * cloud->record_bytes + from[k]->offset_bytes, 2);
    return STATUS_OK;
}
