/* E57, the binary exchange format of laser scanners (ASTM E2807-11).
 *
 *     file    = header  sections  XML          in pages (core/io/formats/e57_pages.h), which tells where scans are
 *     section = 1, 7 bytes, length 8, place of the first packet 8, place of the index 8       of one scan's points
 *     packet  = 1, flags, length - 1 2, streams 2, length of each stream 2 2 ..., streams     or of another kind
 *
 * A stream has the values of one field of the records, one behind the other without gaps, and goes on in the next
 * packet: floats of 4 or 8 bytes, or integers less their minimum in as few bits as their range takes, the lowest first.
 * Streams are read side by side, each by a cursor of its own.
 *
 * All scans become one cloud.  Coordinates are cartesian ones, or made of spherical ones, turned and moved by the
 * scan's pose, in double; in float32 where all scans have that and no pose.  Points that are marked as invalid are
 * none.  A scan's pose is its viewpoint.  The property `scan` tells scans apart where there are several.  Colours,
 * intensity, row, column, returns, times and normals get their usual names, other numbers keep theirs; text and images
 * are left out, and noted.
 *
 * Invariant: no section is read twice and a record has half a byte at least, so the file's length bounds the points;
 * and packets are visited as often as the file has bytes at most, so it bounds the time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/cloud/viewpoints.h"
#include "core/io/build.h"
#include "core/io/formats/e57_pages.h"
#include "core/io/formats/e57_xml.h"
#include "core/io/parts.h"
#include "core/io/reader.h"

enum {
    XML_AT = 24,
    XML_BYTES_AT = 32,
    SECTION_HEADER_BYTES = 32,
    SECTION_OF_POINTS = 1,
    PACKET_HEADER_BYTES = 6,
    SHORTEST_PACKET = 4,
    MOST_SCANS = UINT16_MAX,
    RECORDS_PER_BYTE = 2,
    NOTE_BYTES = 160
};
enum { PACKET_INDEX, PACKET_DATA, PACKET_EMPTY };

/* What a field is for.  The first six in this order: those of a kind belong together. */
enum role {
    CARTESIAN_X,
    CARTESIAN_Y,
    CARTESIAN_Z,
    RANGE,
    AZIMUTH,
    ELEVATION,
    CARTESIAN_STATE,
    SPHERICAL_STATE,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    OF_NO_USE,
    OTHER,
    ROLES = OTHER
};

static const struct {
    const char *field;
    enum role role;
    const char *name; /* of the property */
} known[] = {
    {"cartesianX", CARTESIAN_X, "x"},
    {"cartesianY", CARTESIAN_Y, "y"},
    {"cartesianZ", CARTESIAN_Z, "z"},
    {"sphericalRange", RANGE, ""},
    {"sphericalAzimuth", AZIMUTH, ""},
    {"sphericalElevation", ELEVATION, ""},
    {"cartesianInvalidState", CARTESIAN_STATE, ""},
    {"sphericalInvalidState", SPHERICAL_STATE, ""},
    {"nor:normalX", NORMAL_X, "nx"},
    {"nor:normalY", NORMAL_Y, "ny"},
    {"nor:normalZ", NORMAL_Z, "nz"},
    {"isTimeStampInvalid", OF_NO_USE, ""},
    {"isIntensityInvalid", OF_NO_USE, ""},
    {"isColorInvalid", OF_NO_USE, ""},
    {"colorRed", OTHER, "red"},
    {"colorGreen", OTHER, "green"},
    {"colorBlue", OTHER, "blue"},
    {"rowIndex", OTHER, "row"},
    {"columnIndex", OTHER, "column"},
    {"returnIndex", OTHER, "return_index"},
    {"returnCount", OTHER, "return_count"},
    {"timeStamp", OTHER, "timestamp"},
};

/* One stream of a scan: the bytes of a field. */
struct cursor {
    unsigned stream;     /* which of the packet's */
    uint64_t packet;     /* logical offset of the next packet */
    uint64_t next, left; /* what is left of the stream in this packet, behind the chunk */
    const unsigned char *chunk;
    size_t chunk_bytes;
    unsigned char byte; /* of which `bits` bits, the upper ones, aren't taken yet */
    unsigned bits;
};

/* A field that is read. */
struct column {
    const struct e57_field *field;
    enum role role;
    unsigned width;  /* bits of a value */
    size_t property; /* SIZE_MAX: it is in the cloud only through others */
    struct cursor cursor;
};

struct reader {
    struct cloud_build build;
    struct e57_pages pages;
    struct e57_description file;
    struct viewpoints views;
    uint64_t n, visits, section_bytes;
    size_t scans;  /* that have records */
    bool narrow;   /* coordinates are float32 */
    bool numbered; /* points say of which scan they are */
    /* Of the scan that is read: */
    uint64_t end; /* of its section, logical */
    size_t columns;
    struct column *column; /* owned */
    size_t of_role[ROLES]; /* which column; SIZE_MAX: none */
    double turn[3][3];
};

static enum status e57_bad(struct reader *r, const char *what) {
    return error_set_at(r->build.error, STATUS_MALFORMED, "read", 0, UINT64_MAX, "%s", what);
}

/* ------------------------------------------------------------------------------------------------ streams */

/* Goes to the stream's part in the next packet that has points. */
static enum status next_packet(struct reader *r, struct cursor *c) {
    unsigned char head[PACKET_HEADER_BYTES] = {0}, two[2];
    if (++r->visits > r->n)
        return e57_bad(r, "there are more packets without points than a file of that length can have");
    if (c->packet > r->end || r->end - c->packet < SHORTEST_PACKET ||
        !e57_pages_copy(&r->pages, c->packet, head, r->end - c->packet < sizeof head ? SHORTEST_PACKET : sizeof head))
        return e57_bad(r, "the points of a scan end before the number of them that is told");
    uint64_t at = c->packet, length = load_little_endian(head + 2, 2) + 1, streams = load_little_endian(head + 4, 2);
    if (length < SHORTEST_PACKET || length > r->end - at) return e57_bad(r, "a packet is longer than its section");
    c->packet += length;
    if (head[0] == PACKET_INDEX || head[0] == PACKET_EMPTY) return STATUS_OK;
    if (head[0] != PACKET_DATA) return e57_bad(r, "a packet is of no known kind");
    if (c->stream >= streams || PACKET_HEADER_BYTES + 2 * streams > length)
        return e57_bad(r, "a packet has not all fields of its points");
    uint64_t before = PACKET_HEADER_BYTES + 2 * streams;
    for (unsigned i = 0; i <= c->stream; i++) {
        before += c->left = i ? c->left : 0;
        if (!e57_pages_copy(&r->pages, at + PACKET_HEADER_BYTES + 2 * i, two, 2))
            return e57_bad(r, "a packet is cut off");
        c->left = load_little_endian(two, 2);
    }
    if (before + c->left > length) return e57_bad(r, "the streams of a packet are longer than it is");
    c->next = at + before;
    return STATUS_OK;
}

static enum status next_chunk(struct reader *r, struct cursor *c) {
    while (c->left == 0) {
        enum status status = next_packet(r, c);
        if (status) return status;
    }
    c->chunk = e57_pages_at(&r->pages, c->next, &c->chunk_bytes);
    if (c->chunk_bytes > c->left) c->chunk_bytes = (size_t)c->left;
    c->next += c->chunk_bytes, c->left -= c->chunk_bytes;
    return STATUS_OK;
}

/* The next `width` <= 64 bits. */
static enum status take_bits(struct reader *r, struct cursor *c, unsigned width, uint64_t *value) {
    uint64_t made = 0;
    unsigned got = 0;
    if (c->bits == 0 && width % 8 == 0 && c->chunk_bytes >= width / 8 && width) {
        *value = load_little_endian(c->chunk, width / 8);
        c->chunk += width / 8, c->chunk_bytes -= width / 8;
        return STATUS_OK;
    }
    while (got < width) {
        if (c->bits == 0) {
            enum status status = c->chunk_bytes ? STATUS_OK : next_chunk(r, c);
            if (status) return status;
            c->byte = *c->chunk++, c->chunk_bytes--;
            c->bits = 8;
        }
        unsigned n = width - got < c->bits ? width - got : c->bits;
        made |= (uint64_t)(c->byte & ((1u << n) - 1)) << got;
        c->byte = (unsigned char)(c->byte >> n);
        c->bits -= n, got += n;
    }
    *value = made;
    return STATUS_OK;
}

static unsigned e57_width_of(const struct e57_field *field) {
    uint64_t range = (uint64_t)field->maximum - (uint64_t)field->minimum;
    if (field->type == E57_FLOAT) return 32;
    if (field->type == E57_DOUBLE) return 64;
    return range ? 64 - (unsigned)__builtin_clzll(range) : 0;
}

static enum status take_value(struct reader *r, struct column *column, double *value) {
    const struct e57_field *field = column->field;
    uint64_t bits = 0;
    uint32_t half;
    float single;
    enum status status = take_bits(r, &column->cursor, column->width, &bits);
    if (status) return status;
    switch (field->type) {
    case E57_FLOAT:
        half = (uint32_t)bits;
        memcpy(&single, &half, sizeof single);
        *value = (double)single;
        break;
    case E57_DOUBLE: memcpy(value, &bits, sizeof bits); break;
    case E57_INTEGER: *value = (double)(int64_t)((uint64_t)field->minimum + bits); break;
    case E57_SCALED: *value = (double)(int64_t)((uint64_t)field->minimum + bits) * field->scale + field->offset; break;
    case E57_OTHER: break;
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ properties */

static enum role role_of(const struct e57_field *field, const char **name) {
    if (field->type == E57_OTHER) return OF_NO_USE;
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (strcmp(field->name, known[i].field) == 0) {
            *name = known[i].name;
            return known[i].role;
        }
    *name = field->name;
    return OTHER;
}

/* The narrowest that holds all values. */
static enum scalar_type scalar_of(const struct e57_field *field) {
    static const struct {
        int64_t low, high;
        enum scalar_type type;
    } rows[] = {{0, UINT8_MAX, SCALAR_UINT8},   {INT8_MIN, INT8_MAX, SCALAR_INT8},
                {0, UINT16_MAX, SCALAR_UINT16}, {INT16_MIN, INT16_MAX, SCALAR_INT16},
                {0, UINT32_MAX, SCALAR_UINT32}, {INT32_MIN, INT32_MAX, SCALAR_INT32}};
    if (field->type == E57_FLOAT) return SCALAR_FLOAT32;
    for (size_t i = 0; field->type == E57_INTEGER && i < sizeof rows / sizeof *rows; i++)
        if (field->minimum >= rows[i].low && field->maximum <= rows[i].high) return rows[i].type;
    return SCALAR_FLOAT64;
}

static bool has_role(const struct e57_scan *scan, enum role role) {
    const char *name;
    for (size_t i = 0; i < scan->field_count; i++)
        if (role_of(&scan->field[i], &name) == role) return true;
    return false;
}

static bool has_all(const struct e57_scan *scan, enum role first) {
    return has_role(scan, first) && has_role(scan, first + 1) && has_role(scan, first + 2);
}

/* Whether coordinates are what the scan's floats say. */
static bool is_narrow(const struct e57_scan *scan) {
    const char *name;
    if (scan->has_pose) return false;
    for (size_t i = 0; i < scan->field_count; i++)
        if (role_of(&scan->field[i], &name) <= CARTESIAN_Z && scan->field[i].type != E57_FLOAT) return false;
    return has_all(scan, CARTESIAN_X);
}

/* A name as properties have them; one that means something here, but not there, gets a dash behind it. */
static void clean_name(const char *name, char clean[PROPERTY_NAME_BYTES]) {
    static const char *const ours[] = {"x", "y", "z", CLOUD_SCAN};
    bool taken = false;
    for (size_t i = 0; i < sizeof ours / sizeof *ours; i++) taken |= strcmp(name, ours[i]) == 0;
    snprintf(clean, PROPERTY_NAME_BYTES, "%.*s%s", PROPERTY_NAME_BYTES - 2, name, taken ? "_" : "");
    for (char *c = clean; *c; c++)
        if (*c <= 32 || *c > 126 || *c == ':') *c = '_';
}

static size_t e57_find_property(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return j;
    return SIZE_MAX;
}

/* The property of a field, SIZE_MAX: it has none. */
static size_t property_of(const struct reader *r, const struct e57_field *field, enum role *role) {
    char clean[PROPERTY_NAME_BYTES];
    const char *name = "";
    *role = role_of(field, &name);
    if (*role == OF_NO_USE || !name[0]) return SIZE_MAX;
    clean_name(name, clean);
    return e57_find_property(&r->build.cloud, clean);
}

static enum status e57_note(struct reader *r, const char *name, const char *what) {
    char text[NOTE_BYTES];
    snprintf(text, sizeof text, "%.64s: %s", name, what);
    return cloud_build_leave_out(&r->build, text);
}

/* A property for each field that has none by an earlier scan. */
static enum status describe_scan(struct reader *r, const struct e57_scan *scan) {
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < scan->field_count; i++) {
        const struct e57_field *field = &scan->field[i];
        const char *name = "";
        enum role role = role_of(field, &name);
        char clean[PROPERTY_NAME_BYTES];
        if (field->type == E57_OTHER) status = e57_note(r, field->name, "no number");
        if (role == OF_NO_USE || role <= ELEVATION || !name[0]) continue;
        clean_name(name, clean);
        if (!status && e57_find_property(&r->build.cloud, clean) == SIZE_MAX)
            status = cloud_build_property(&r->build, clean, scalar_of(field));
    }
    return status;
}

/* Whether all scans have the property in the same type. */
static bool is_of_one_type(const struct reader *r, const struct property *property, bool *everywhere) {
    bool one = true;
    *everywhere = true;
    for (size_t s = 0; s < r->file.scan_count; s++) {
        const struct e57_scan *scan = &r->file.scan[s];
        bool there = false;
        for (size_t i = 0; i < scan->field_count; i++) {
            enum role role;
            size_t j = property_of(r, &scan->field[i], &role);
            if (j == SIZE_MAX || &r->build.cloud.property[j] != property) continue;
            there = true;
            one &= scalar_of(&scan->field[i]) == property->type;
        }
        *everywhere &= there || scan->records == 0;
    }
    return one;
}

/* Types that differ become double, and all properties their places. */
static enum status settle_types(struct reader *r) {
    struct cloud *cloud = &r->build.cloud;
    enum status status = STATUS_OK;
    cloud->record_bytes = 0;
    for (size_t j = 0; !status && j < cloud->property_count; j++) {
        struct property *p = &cloud->property[j];
        bool everywhere, own = j < 3 || strcmp(p->name, CLOUD_SCAN) == 0;
        if (!own && !is_of_one_type(r, p, &everywhere)) p->type = SCALAR_FLOAT64;
        if (!own && !everywhere) status = e57_note(r, p->name, "only some of the scans have it; it is 0 in the others");
        p->offset_bytes = cloud->record_bytes;
        cloud->record_bytes += scalar_bytes(p->type);
    }
    return status;
}

static enum status e57_describe(struct reader *r, const struct cloud_limits *limits) {
    static const char *const axes[] = {"x", "y", "z"};
    enum status status = STATUS_OK;
    r->narrow = true;
    for (size_t s = 0; s < r->file.scan_count; s++) {
        const struct e57_scan *scan = &r->file.scan[s];
        if (scan->records == 0) continue;
        r->scans++;
        r->narrow &= is_narrow(scan);
        if (!has_all(scan, CARTESIAN_X) && !has_all(scan, RANGE)) return e57_bad(r, "a scan has no coordinates");
    }
    if (r->scans == 0) return e57_bad(r, "no points");
    if (r->scans > MOST_SCANS)
        return error_set(r->build.error, STATUS_LIMIT, "read", "%zu scans, at most %d are read", r->scans, MOST_SCANS);
    for (int k = 0; !status && k < 3; k++)
        status = cloud_build_property(&r->build, axes[k], r->narrow ? SCALAR_FLOAT32 : SCALAR_FLOAT64);
    r->numbered = r->scans > 1 || (limits && limits->numbers_scans);
    if (!status && r->numbered) status = cloud_build_property(&r->build, CLOUD_SCAN, SCALAR_UINT16);
    for (size_t s = 0; !status && s < r->file.scan_count; s++)
        if (r->file.scan[s].records) status = describe_scan(r, &r->file.scan[s]);
    if (!status) status = settle_types(r);
    if (!status && r->file.has_images) status = cloud_build_leave_out(&r->build, "images");
    return status;
}

/* ------------------------------------------------------------------------------------------------ scans */

/* Where the packets begin, and the section ends. */
static enum status open_section(struct reader *r, const struct e57_scan *scan, uint64_t *first) {
    unsigned char head[SECTION_HEADER_BYTES];
    uint64_t at = e57_pages_logical(&r->pages, scan->file_offset);
    if (at == UINT64_MAX || !e57_pages_copy(&r->pages, at, head, sizeof head))
        return e57_bad(r, "the points of a scan lie outside the file");
    uint64_t length = load_little_endian(head + 8, 8);
    if (head[0] != SECTION_OF_POINTS || length < sizeof head || length > r->pages.logical_bytes - at)
        return e57_bad(r, "there is no section of points where the XML says");
    *first = e57_pages_logical(&r->pages, load_little_endian(head + 16, 8));
    r->end = at + length;
    if (*first == UINT64_MAX || *first < at || *first > r->end)
        return e57_bad(r, "the packets of a section lie outside it");
    r->section_bytes += length;
    if (r->section_bytes > r->pages.logical_bytes) return e57_bad(r, "the points of several scans are the same ones");
    return STATUS_OK;
}

/* Which fields are read. */
static enum status open_columns(struct reader *r, const struct e57_scan *scan, uint64_t first) {
    bool cartesian = has_all(scan, CARTESIAN_X);
    r->columns = 0;
    free(r->column);
    r->column = alloc_zeroed(scan->field_count, sizeof *r->column);
    if (!r->column) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for the fields of a scan");
    for (int i = 0; i < ROLES; i++) r->of_role[i] = SIZE_MAX;
    for (size_t i = 0; i < scan->field_count; i++) {
        struct column column = {.field = &scan->field[i], .width = e57_width_of(&scan->field[i])};
        column.property = property_of(r, column.field, &column.role);
        bool is_place = column.role <= ELEVATION;
        if (column.role == OF_NO_USE || (is_place && cartesian != (column.role <= CARTESIAN_Z))) continue;
        if (column.role == (cartesian ? SPHERICAL_STATE : CARTESIAN_STATE)) continue;
        if (column.role < ROLES && r->of_role[column.role] != SIZE_MAX) return e57_bad(r, "a field is there twice");
        if (column.role < ROLES) r->of_role[column.role] = r->columns;
        column.cursor = (struct cursor){.stream = (unsigned)i, .packet = first};
        r->column[r->columns++] = column;
    }
    return STATUS_OK;
}

/* The matrix of a quaternion of any length. */
static enum status set_turn(struct reader *r, const struct e57_scan *scan) {
    double w = scan->rotation[0], x = scan->rotation[1], y = scan->rotation[2], z = scan->rotation[3];
    double length = sqrt(w * w + x * x + y * y + z * z);
    if (!(length > 0) || !isfinite(length)) return e57_bad(r, "the rotation of a pose is none");
    w /= length, x /= length, y /= length, z /= length;
    const double turn[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                               {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                               {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    memcpy(r->turn, turn, sizeof turn);
    return STATUS_OK;
}

static vec3 turned(const struct reader *r, vec3 p) {
    const double(*t)[3] = r->turn;
    return (vec3){t[0][0] * p.x + t[0][1] * p.y + t[0][2] * p.z, t[1][0] * p.x + t[1][1] * p.y + t[1][2] * p.z,
                  t[2][0] * p.x + t[2][1] * p.y + t[2][2] * p.z};
}

static void e57_store(const struct reader *r, unsigned char *record, size_t property, double value) {
    const struct property *p = &r->build.cloud.property[property];
    scalar_store(record + p->offset_bytes, p->type, value);
}

static vec3 place_of(const struct reader *r, const struct e57_scan *scan, const double *value) {
    const size_t *of = r->of_role;
    vec3 p;
    if (of[CARTESIAN_X] != SIZE_MAX) {
        p = (vec3){value[of[CARTESIAN_X]], value[of[CARTESIAN_Y]], value[of[CARTESIAN_Z]]};
    } else {
        double range = value[of[RANGE]], azimuth = value[of[AZIMUTH]], elevation = value[of[ELEVATION]];
        p = (vec3){range * cos(elevation) * cos(azimuth), range * cos(elevation) * sin(azimuth),
                   range * sin(elevation)};
    }
    if (!scan->has_pose) return p;
    return vec3_add(turned(r, p), (vec3){scan->translation[0], scan->translation[1], scan->translation[2]});
}

/* A record of the cloud of one value of each column. */
static void fill_record(struct reader *r, const struct e57_scan *scan, size_t number, const double *value,
                        unsigned char *record) {
    const size_t *of = r->of_role;
    memset(record, 0, r->build.cloud.record_bytes);
    vec3 place = place_of(r, scan, value);
    e57_store(r, record, 0, place.x), e57_store(r, record, 1, place.y), e57_store(r, record, 2, place.z);
    viewpoints_see(&r->views, place);
    if (r->numbered) e57_store(r, record, 3, (double)number);
    for (size_t i = 0; i < r->columns; i++)
        if (r->column[i].role > ELEVATION && r->column[i].property != SIZE_MAX)
            e57_store(r, record, r->column[i].property, value[i]);
    if (!scan->has_pose || of[NORMAL_X] == SIZE_MAX || of[NORMAL_Y] == SIZE_MAX || of[NORMAL_Z] == SIZE_MAX) return;
    vec3 n = turned(r, (vec3){value[of[NORMAL_X]], value[of[NORMAL_Y]], value[of[NORMAL_Z]]});
    e57_store(r, record, r->column[of[NORMAL_X]].property, n.x);
    e57_store(r, record, r->column[of[NORMAL_Y]].property, n.y);
    e57_store(r, record, r->column[of[NORMAL_Z]].property, n.z);
}

static bool is_marked(const struct reader *r, enum role role, const double *value) {
    return r->of_role[role] != SIZE_MAX && value[r->of_role[role]] != 0;
}

/* The next n records of the scan. */
static enum status e57_take_points(struct reader *r, const struct e57_scan *scan, size_t number, uint64_t n,
                                   double *value, unsigned char *record) {
    enum status status = STATUS_OK;
    for (uint64_t i = 0; !status && i < n; i++) {
        for (size_t j = 0; !status && j < r->columns; j++) status = take_value(r, &r->column[j], &value[j]);
        if (status || is_marked(r, CARTESIAN_STATE, value) || is_marked(r, SPHERICAL_STATE, value)) continue;
        fill_record(r, scan, number, value, record);
        status = cloud_build_point(&r->build, record, (struct cloud_place){0, r->column[0].cursor.next});
    }
    return status;
}

/* Where it was taken from, unknown where nothing but points says so: many a file has neither scanner nor pose. */
static vec3 viewpoint_of(const struct e57_scan *scan) {
    const double *at = scan->translation;
    return scan->has_pose || has_all(scan, RANGE) ? (vec3){at[0], at[1], at[2]} : (vec3){NAN, NAN, NAN};
}

static enum status begin_scan(struct reader *r, const struct e57_scan *scan) {
    uint64_t first = 0;
    enum status status = open_section(r, scan, &first);
    if (!status) status = open_columns(r, scan, first);
    return status ? status : set_turn(r, scan);
}

static enum status e57_take_scan(struct reader *r, const struct e57_scan *scan, size_t number) {
    enum status status = begin_scan(r, scan);
    if (status) return status;
    double *value = alloc_zeroed(r->columns, sizeof *value);
    unsigned char *record = alloc_zeroed(r->build.cloud.record_bytes, 1);
    viewpoints_begin(&r->views, viewpoint_of(scan));
    status = value && record ? e57_take_points(r, scan, number, scan->records, value, record)
                             : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for a point");
    if (!status) viewpoints_end(&r->views);
    free(value), free(record);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the file */

static enum status check_records(struct reader *r) {
    uint64_t records = 0;
    for (size_t s = 0; s < r->file.scan_count; s++) {
        uint64_t more = r->file.scan[s].records;
        if (more > RECORDS_PER_BYTE * r->n - records)
            return error_set_at(r->build.error, STATUS_MALFORMED, "read", 0, UINT64_MAX,
                                "%" PRIu64 " points are promised, which %" PRIu64 " bytes can't hold", more, r->n);
        records += more;
    }
    return STATUS_OK;
}

/* Everything that stands before the points. */
static enum status e57_begin_file(struct reader *r, const void *bytes, size_t n, bool is_mapped,
                                  const struct cloud_limits *limits) {
    const unsigned char *head = bytes;
    enum status status = e57_pages_open(bytes, n, is_mapped, &r->pages, r->build.error);
    if (!status)
        status = e57_xml_parse(&r->pages, e57_pages_logical(&r->pages, load_little_endian(head + XML_AT, 8)),
                               load_little_endian(head + XML_BYTES_AT, 8), &r->file, r->build.error);
    if (!status) status = check_records(r);
    if (!status) status = e57_describe(r, limits);
    if (!status && viewpoints_init(&r->views, r->scans))
        status = error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for %zu scans", r->scans);
    return status;
}

static enum status e57_read_file(struct reader *r, const void *bytes, size_t n, const struct cloud_limits *limits) {
    size_t number = 0;
    enum status status = e57_begin_file(r, bytes, n, false, limits);
    for (size_t s = 0; !status && s < r->file.scan_count; s++)
        if (r->file.scan[s].records) status = e57_take_scan(r, &r->file.scan[s], number++);
    if (!status) viewpoints_give(&r->views, &r->build.cloud);
    return status;
}

enum status cloud_e57_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {.n = n};
    cloud_build_start(&r.build, "e57", n, limits, progress, error);
    enum status status = e57_read_file(&r, bytes, n, limits);
    free(r.column);
    viewpoints_done(&r.views);
    e57_description_done(&r.file);
    return cloud_build_end(&r.build, status, cloud);
}

/* ------------------------------------------------------------------------------------------------ part by part */

struct e57_parts {
    struct cloud_parts parts;
    struct reader reader;
    size_t scan, number; /* the next one, and its number among those with records */
    uint64_t left;       /* records of the one before, which is being read */
    double *value;       /* of the columns; owned, as is the next */
    unsigned char *record;
};

/* Goes to the next scan that has records, if there is one. */
static enum status next_scan(struct e57_parts *p) {
    struct reader *r = &p->reader;
    while (p->scan < r->file.scan_count && r->file.scan[p->scan].records == 0) p->scan++;
    if (p->scan == r->file.scan_count) return STATUS_OK;
    const struct e57_scan *scan = &r->file.scan[p->scan++];
    enum status status = begin_scan(r, scan);
    if (status) return status;
    free(p->value);
    p->value = alloc_zeroed(r->columns, sizeof *p->value);
    p->left = scan->records;
    p->number++;
    viewpoints_begin(&r->views, viewpoint_of(scan));
    return p->value ? STATUS_OK : error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for a point");
}

/* Where in the file the stream that is least far is. */
static size_t least_done(const struct reader *r) {
    uint64_t least = UINT64_MAX;
    for (size_t i = 0; i < r->columns; i++)
        if (r->column[i].cursor.next && r->column[i].cursor.next < least) least = r->column[i].cursor.next;
    return least == UINT64_MAX ? 0 : (size_t)(least / E57_PAYLOAD * E57_PAGE);
}

static enum status e57_next_part(struct cloud_parts *parts, struct error *error) {
    struct e57_parts *p = (struct e57_parts *)parts;
    struct reader *r = &p->reader;
    enum status status = STATUS_OK;
    r->build.error = error;
    r->build.cloud.count = 0;
    while (!status && r->build.cloud.count < CLOUD_PART_USUAL) {
        if (p->left == 0) status = next_scan(p);
        if (status || p->left == 0) break;
        uint64_t room = CLOUD_PART_USUAL - r->build.cloud.count, n = p->left < room ? p->left : room;
        status = e57_take_points(r, &r->file.scan[p->scan - 1], p->number - 1, n, p->value, p->record);
        p->left -= n;
        if (!status && p->left == 0) viewpoints_end(&r->views);
    }
    bool is_end = !status && p->left == 0 && p->scan == r->file.scan_count;
    if (is_end) viewpoints_give(&r->views, &r->build.cloud);
    size_t done = is_end ? (size_t)r->n : least_done(r);
    if (done > parts->done_bytes) parts->done_bytes = done;
    return status;
}

static void e57_free_parts(struct cloud_parts *parts) {
    struct e57_parts *p = (struct e57_parts *)parts;
    cloud_done(&p->reader.build.cloud);
    viewpoints_done(&p->reader.views);
    e57_description_done(&p->reader.file);
    free(p->reader.column), free(p->value), free(p->record);
    free(p);
}

enum status cloud_e57_parts(const void *bytes, size_t n, const struct cloud_limits *limits, struct cloud_parts **out,
                            struct error *error) {
    struct e57_parts *p = alloc_zeroed(1, sizeof *p);
    if (!p) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    struct reader *r = &p->reader;
    uint64_t promised = 0;
    r->n = n;
    cloud_build_start(&r->build, "e57", n, NULL, NULL, error);
    enum status status = e57_begin_file(r, bytes, n, true, limits);
    if (!status) p->record = alloc_zeroed(r->build.cloud.record_bytes, 1);
    if (!status && !p->record) status = error_set(error, STATUS_NO_MEMORY, "read", "no memory for a point");
    for (size_t s = 0; s < r->file.scan_count; s++) promised += r->file.scan[s].records;
    p->parts = (struct cloud_parts){&r->build.cloud, promised, 0, e57_next_part, e57_free_parts, false, 0};
    if (status)
        e57_free_parts(&p->parts);
    else
        *out = &p->parts;
    return status;
}
