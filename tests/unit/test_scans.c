/* E57 and PTX, from files that are written here: what the readers make of them, and of damaged ones.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/hash64.h"
#include "core/io/formats/e57_pages.h"
#include "core/io/read.h"
#include "core/io/stream.h"
#include "tests/unit/faults.h"
#include "tests/unit/property.h"

/* ------------------------------------------------------------------------------------------------ a writer */

struct bytes {
    size_t n, room;
    unsigned char *at;
};

static void put(struct bytes *b, const void *p, size_t n) {
    while (b->n + n > b->room) {
        b->room = 2 * b->room + 64;
        b->at = realloc(b->at, b->room);
        assert_non_null(b->at);
    }
    if (n) memcpy(b->at + b->n, p, n);
    b->n += n;
}

static void put_whole(struct bytes *b, uint64_t value, size_t n) {
    for (; n; n--, value >>= 8) put(b, &(unsigned char){(unsigned char)value}, 1);
}

struct field {
    const char *name, *attributes;
    enum { WHOLE, SINGLE, DOUBLE } type;
    unsigned width;
    int64_t minimum;
    double values[4]; /* of a record: values[0] + values[1] * i, less minimum; where values[2] is set, every values[2]th
                         record has values[3] instead */
};

struct scan {
    size_t records, records_each; /* each: about so many in a packet */
    const char *pose;
    struct field field[12];
};

static double value_of(const struct field *f, size_t i) {
    if (f->values[2] != 0 && i % (size_t)f->values[2] == 0) return f->values[3];
    return f->values[0] + f->values[1] * (double)i;
}

/* The stream of a field, whole. */
static struct bytes stream_of(const struct field *f, size_t records) {
    struct bytes b = {0};
    unsigned __int128 held = 0;
    unsigned bits = 0;
    for (size_t i = 0; i < records; i++) {
        double value = value_of(f, i);
        float single = (float)value;
        if (f->type == SINGLE) put(&b, &single, 4);
        if (f->type == DOUBLE) put(&b, &value, 8);
        if (f->type != WHOLE) continue;
        held |= (unsigned __int128)(uint64_t)((int64_t)value - f->minimum) << bits;
        for (bits += f->width; bits >= 8; bits -= 8, held >>= 8) put_whole(&b, (uint64_t)held & 0xff, 1);
    }
    if (bits) put_whole(&b, (uint64_t)held, 1);
    return b;
}

static size_t physical(size_t logical) { return logical / E57_PAYLOAD * E57_PAGE + logical % E57_PAYLOAD; }

/* Packets that end anywhere in values, and others of no use between them. */
static void put_section(struct bytes *out, const struct scan *scan) {
    struct bytes stream[12];
    size_t fields = 0, begin = out->n, at[12] = {0};
    for (; scan->field[fields].name; fields++) stream[fields] = stream_of(&scan->field[fields], scan->records);
    put_whole(out, 1, 8), put_whole(out, 0, 8);
    put_whole(out, physical(begin + 32), 8), put_whole(out, 0, 8);
    size_t packets = (scan->records + scan->records_each - 1) / scan->records_each;
    for (size_t k = 0; k < packets; k++) {
        size_t length = 6 + 2 * fields, n[12];
        for (size_t f = 0; f < fields; f++) {
            size_t end = k + 1 == packets ? stream[f].n : (stream[f].n * (k + 1) / packets + f) % (stream[f].n + 1);
            n[f] = end > at[f] ? end - at[f] : 0;
            length += n[f];
        }
        size_t padding = (4 - length % 4) % 4;
        put_whole(out, 1, 2), put_whole(out, length + padding - 1, 2), put_whole(out, fields, 2);
        for (size_t f = 0; f < fields; f++) put_whole(out, n[f], 2);
        for (size_t f = 0; f < fields; f++) put(out, stream[f].at + at[f], n[f]), at[f] += n[f];
        put_whole(out, 0, padding);
        if (k % 3 == 0) put_whole(out, 2, 2), put_whole(out, 7, 2), put_whole(out, 0, 4); /* an empty one */
    }
    uint64_t length = out->n - begin;
    memcpy(out->at + begin + 8, &length, 8);
    for (size_t f = 0; f < fields; f++) free(stream[f].at);
}

/* In pages, with header and checksums. */
static struct bytes in_pages(struct bytes *logical, size_t xml, size_t xml_bytes) {
    struct bytes out = {0};
    static const unsigned char nothing[E57_PAYLOAD];
    if (logical->n % E57_PAYLOAD) put(logical, nothing, E57_PAYLOAD - logical->n % E57_PAYLOAD);
    uint64_t head[5] = {1, physical(logical->n), physical(xml), xml_bytes, E57_PAGE};
    memcpy(logical->at, "ASTM-E57", 8);
    memcpy(logical->at + 8, head, sizeof head);
    for (size_t at = 0; at < logical->n; at += E57_PAYLOAD) {
        uint32_t sum = e57_checksum(logical->at + at, E57_PAYLOAD);
        put(&out, logical->at + at, E57_PAYLOAD);
        for (int k = 3; k >= 0; k--) put_whole(&out, sum >> 8 * k, 1);
    }
    free(logical->at);
    return out;
}

static struct bytes make_e57(const struct scan *scan, size_t scans, const char *more) {
    struct bytes logical = {0};
    size_t place[4], text_bytes, xml;
    char *text = NULL;
    FILE *out = open_memstream(&text, &text_bytes);
    put_whole(&logical, 0, E57_HEADER_BYTES > 8 ? 8 : 0);
    for (size_t i = 8; i < E57_HEADER_BYTES; i += 8) put_whole(&logical, 0, 8);
    fprintf(out, "<?xml version=\"1.0\"?>\n<e57Root type=\"Structure\" xmlns=\"e57\" xmlns:nor=\"nor\">\n<data3D>\n");
    for (size_t s = 0; s < scans; s++) {
        place[s] = physical(logical.n);
        put_section(&logical, &scan[s]);
        fprintf(out,
                "<vectorChild><name>a scan</name>%s<points type=\"CompressedVector\" fileOffset=\"%zu\" "
                "recordCount=\"%zu\"><prototype>",
                scan[s].pose ? scan[s].pose : "", place[s], scan[s].records);
        for (const struct field *f = scan[s].field; f->name; f++) fprintf(out, "<%s %s/>", f->name, f->attributes);
        fprintf(out, "</prototype><codecs/></points></vectorChild>\n");
    }
    fprintf(out, "</data3D>%s</e57Root>", more);
    fclose(out);
    xml = logical.n;
    put(&logical, text, text_bytes);
    free(text);
    return in_pages(&logical, xml, text_bytes);
}

#define INTEGER(low, high) "type=\"Integer\" minimum=\"" #low "\" maximum=\"" #high "\""
#define SCALED(low, high, s, o)                                                                                        \
    "type=\"ScaledInteger\" minimum=\"" #low "\" maximum=\"" #high "\" scale=\"" #s "\" offset=\"" #o "\""
#define FLOAT "type=\"Float\" precision=\"single\""
#define REAL "type=\"Float\""

/* ------------------------------------------------------------------------------------------------ reading */

static struct cloud read_all(const void *bytes, size_t n) {
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(bytes, n, NULL, NULL, &cloud, &error)) fail_msg("%s: %s", error.where, error.text);
    return cloud;
}

static enum scalar_type type_of(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return cloud->property[j].type;
    fail_msg("no property %s", name);
    return 0;
}

/* Fields of every kind, over many packets and pages. */
static const struct scan all_kinds = {
    .records = 1000,
    .records_each = 37,
    .field = {{"cartesianX", FLOAT, SINGLE, 0, 0, {1, 0.5}},
              {"cartesianY", FLOAT, SINGLE, 0, 0, {-3, 0.25}},
              {"cartesianZ", FLOAT, SINGLE, 0, 0, {0.125, 1}},
              {"intensity", SCALED(-5, 2040, 0.5, 10), WHOLE, 11, -5, {-5, 2}},
              {"colorRed", INTEGER(0, 255), WHOLE, 8, 0, {0, 0.25}},
              {"colorGreen", INTEGER(0, 65535), WHOLE, 16, 0, {65535, -60}},
              {"rowIndex", INTEGER(-1000, 999), WHOLE, 11, -1000, {-1000, 1}},
              {"columnIndex", INTEGER(7, 7), WHOLE, 0, 7, {7, 0}},
              {"timeStamp", REAL, DOUBLE, 0, 0, {1e9, 0.001}},
              {"ext:odd", INTEGER(-9223372036854775808, 9223372036854775807), WHOLE, 64, INT64_MIN, {-9e15, 9e12}},
              {"cartesianInvalidState", INTEGER(0, 2), WHOLE, 2, 0, {0, 0, 10, 2}}}};

static void every_kind_of_field_is_read(void **state) {
    (void)state;
    struct bytes file = make_e57(&all_kinds, 1, "<images2D><vectorChild/></images2D>");
    struct cloud cloud = read_all(file.at, file.n);
    assert_string_equal(cloud.form, "e57");
    assert_int_equal(cloud.count, 900);
    assert_int_equal(cloud.view_count, 0); /* neither a pose nor ranges from a scanner */
    assert_non_null(strstr(cloud.left_out, "images"));
    assert_int_equal(cloud.property_count, 10);
    for (size_t k = 0, i = 0; i < 1000; i++) {
        if (i % 10 == 0) continue;
        double n = (double)i;
        assert_true(cloud.position[k].x == 1 + 0.5 * n && property_value(&cloud, k, "x") == 1 + 0.5 * n);
        assert_true(cloud.position[k].y == -3 + 0.25 * n && cloud.position[k].z == 0.125 + n);
        assert_true(property_value(&cloud, k, "intensity") == (-5 + 2 * n) * 0.5 + 10);
        assert_true(property_value(&cloud, k, "red") == (double)(i / 4) &&
                    property_value(&cloud, k, "green") == 65535 - 60 * n);
        assert_true(property_value(&cloud, k, "row") == n - 1000 && property_value(&cloud, k, "column") == 7);
        assert_true(property_value(&cloud, k, "timestamp") == 1e9 + 0.001 * n);
        assert_true(property_value(&cloud, k++, "ext_odd") == -9e15 + 9e12 * n);
    }
    static const struct {
        const char *name;
        enum scalar_type type;
    } types[] = {{"x", SCALAR_FLOAT32},         {"red", SCALAR_UINT8},      {"green", SCALAR_UINT16},
                 {"intensity", SCALAR_FLOAT64}, {"row", SCALAR_INT16},      {"column", SCALAR_UINT8},
                 {"timestamp", SCALAR_FLOAT64}, {"ext_odd", SCALAR_FLOAT64}};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        assert_int_equal(type_of(&cloud, types[i].name), types[i].type);
    cloud_done(&cloud);
    free(file.at);
}

/* The third one's place, at the origin, is seven units away from points less than one apart: it isn't believed. */
static const struct scan turned_and_moved[] = {
    {.records = 300,
     .records_each = 50,
     .pose = "<pose><rotation><w>2</w><x/><y/><z>2</z></rotation>" /* a quarter turn about z, of any length */
             "<translation><x>100</x><y>-20</y><z> 3 </z></translation></pose>",
     .field = {{"sphericalRange", REAL, DOUBLE, 0, 0, {1, 0.01}},
               {"sphericalAzimuth", REAL, DOUBLE, 0, 0, {-3, 0.02}},
               {"sphericalElevation", FLOAT, SINGLE, 0, 0, {0.25, 0}},
               {"sphericalInvalidState", INTEGER(0, 2), WHOLE, 2, 0, {0, 0, 3, 1}},
               {"nor:normalX", FLOAT, SINGLE, 0, 0, {1, 0}},
               {"nor:normalY", FLOAT, SINGLE, 0, 0, {0, 0}},
               {"nor:normalZ", FLOAT, SINGLE, 0, 0, {0, 0}},
               {"intensity", INTEGER(0, 255), WHOLE, 8, 0, {4, 0}}}},
    {.records = 0, .records_each = 1, .field = {{"nothing", "type=\"String\"", WHOLE, 1, 0, {0}}}},
    {.records = 200,
     .records_each = 7,
     .pose = "<pose><translation><x>5000</x></translation></pose>",
     .field = {{"cartesianX", SCALED(0, 511, 0.001, -7), WHOLE, 9, 0, {0, 2}},
               {"cartesianY", SCALED(0, 511, 0.001, 0), WHOLE, 9, 0, {511, -1}},
               {"cartesianZ", SCALED(-8, 511, 0.001, 0), WHOLE, 10, -8, {-8, 1}},
               {"text", "type=\"String\"", WHOLE, 8, 0, {65, 0}},
               {"x", INTEGER(0, 3), WHOLE, 2, 0, {3, 0}},
               {"intensity", FLOAT, SINGLE, 0, 0, {0.5, 0}}}},
};

static void spherical_scans_and_poses_are_put_together(void **state) {
    (void)state;
    struct bytes file = make_e57(turned_and_moved, 3, "");
    struct cloud cloud = read_all(file.at, file.n);
    assert_int_equal(cloud.count, 400);
    assert_int_equal(cloud.view_count, 2);
    assert_true(vec3_equal(cloud.view[0], (vec3){100, -20, 3}));
    assert_true(isnan(cloud.view[1].x)); /* seven units away from a scan of less than one */
    assert_non_null(strstr(cloud.left_out, "nx: only some of the scans have it"));
    assert_non_null(strstr(cloud.left_out, "text: no number"));
    assert_null(strstr(cloud.left_out, "intensity"));
    for (size_t k = 0, i = 0; i < 300; i++) {
        if (i % 3 == 0) continue;
        double range = 1 + 0.01 * (double)i, azimuth = -3 + 0.02 * (double)i;
        vec3 local = {range * cos(0.25) * cos(azimuth), range * cos(0.25) * sin(azimuth), range * sin(0.25)};
        vec3 there = {100 - local.y, -20 + local.x, 3 + local.z};
        assert_true(vec3_distance(cloud.position[k], there) < 1e-12 * 100);
        assert_true(property_value(&cloud, k, "scan") == 0 && property_value(&cloud, k, "intensity") == 4);
        assert_true(fabs(property_value(&cloud, k, "nx")) < 1e-7 && fabs(property_value(&cloud, k++, "ny") - 1) < 1e-7);
    }
    for (size_t i = 0; i < 200; i++) {
        vec3 there = {5000 - 7 + 0.001 * (double)(2 * i), 0.001 * (double)(511 - i), 0.001 * ((double)i - 8)};
        assert_true(vec3_distance(cloud.position[200 + i], there) < 1e-9);
        assert_true(property_value(&cloud, 200 + i, "scan") == 1 &&
                    property_value(&cloud, 200 + i, "intensity") == 0.5);
        assert_true(property_value(&cloud, 200 + i, "x_") == 3 && property_value(&cloud, 200 + i, "nx") == 0);
    }
    assert_int_equal(type_of(&cloud, "x"), SCALAR_FLOAT64);
    assert_int_equal(type_of(&cloud, "intensity"), SCALAR_FLOAT64);
    cloud_done(&cloud);
    free(file.at);
}

/* Reads files part by part to the end; returns what is known then, with the number of the last point's scan. */
static struct cloud_stream *read_parts(const char *const *path, size_t files, double *last) {
    struct cloud_stream *stream = NULL;
    const struct cloud *part;
    struct error error = {0};
    assert_int_equal(cloud_stream_open(path, files, NULL, &stream, &error), STATUS_OK);
    for (;;) {
        assert_int_equal(cloud_stream_next(stream, &part, &error), STATUS_OK);
        if (part->count == 0) break;
        *last = property_value(part, part->count - 1, "scan");
    }
    return stream;
}

static void places_of_scanners_are_known_part_by_part(void **state) {
    (void)state;
    struct bytes file = make_e57(turned_and_moved, 3, "");
    char name[32];
    const char *const paths[] = {name, name};
    int fd = memfd_create("scans", 0);
    assert_true(fd >= 0 && write(fd, file.at, file.n) == (ssize_t)file.n);
    snprintf(name, sizeof name, "/proc/self/fd/%d", fd);
    for (size_t files = 1; files <= 2; files++) {
        double last = -1;
        uint64_t count = 0;
        struct cloud_stream *stream = read_parts(paths, files, &last);
        const vec3 *view = cloud_stream_views(stream, &count);
        assert_int_equal(count, 2 * files);
        assert_true(last == (double)(count - 1));
        for (size_t i = 0; i < count; i += 2)
            assert_true(vec3_equal(view[i], (vec3){100, -20, 3}) && isnan(view[i + 1].x));
        cloud_stream_free(stream);
    }
    close(fd);
    free(file.at);
}

/* Puts the right checksum behind each page. */
static void mend(struct bytes *file) {
    for (size_t at = 0; at + E57_PAGE <= file->n; at += E57_PAGE) {
        uint32_t sum = e57_checksum(file->at + at, E57_PAYLOAD);
        for (int k = 0; k < 4; k++) file->at[at + E57_PAYLOAD + (size_t)k] = (unsigned char)(sum >> 8 * (3 - k));
    }
}

static void refuse(const struct bytes *file, enum status expected, const char *part) {
    struct cloud cloud = {0};
    struct error error = {0};
    enum status status = cloud_read_memory(file->at, file->n, NULL, NULL, &cloud, &error);
    if (status != expected || !strstr(error.text, part))
        fail_msg("%s, not '%s': %s", status_name(status), part, error.text);
}

static void a_bit_that_flips_is_found(void **state) {
    (void)state;
    struct bytes file = make_e57(&all_kinds, 1, "");
    for (size_t i = 0; i < 50; i++) {
        size_t at = 48 + hash64(i) % (file.n - 48);
        unsigned char bit = (unsigned char)(1u << hash64(i + 99) % 8);
        file.at[at] ^= bit;
        refuse(&file, STATUS_MALFORMED, "checksum of page");
        file.at[at] ^= bit;
    }
    file.n -= 5;
    refuse(&file, STATUS_MALFORMED, "middle of a page");
    file.n = 20;
    refuse(&file, STATUS_MALFORMED, "ends in its header");
    free(file.at);
}

/* Replaces one text by another of the same length, once. */
static void replace(struct bytes *file, const char *text, const char *by) {
    size_t n = strlen(text);
    assert_int_equal(n, strlen(by));
    for (size_t at = 0; at + n <= file->n; at++) {
        if (memcmp(file->at + at, text, n) != 0) continue;
        memcpy(file->at + at, by, n);
        mend(file);
        return;
    }
    fail_msg("no %s", text);
}

static void broken_files_are_refused(void **state) {
    (void)state;
    static const struct {
        const char *text, *by, *part;
    } cases[] = {
        {"recordCount=\"1000\"", "recordCount=\"9000\"", "end before the number of them"},
        {"recordCount=\"1000\"", "recordCount=\"1e00\"", "recordCount is no whole number"},
        {"recordCount=\"1000\"", "recordCount=\"-100\"", "below 0"},
        {"recordCount=\"1000\"", "recordCount=\"0000\"", "no points"},
        {"fileOffset=\"48\"", "fileOffset=\"52\"", "no section of points"},
        {"fileOffset=\"48\"", "fileOffset=\"-4\"", "below 0"},
        {"cartesianY", "cartesianX", "no coordinates"},
        {"rowIndex", "colorRed", ""},
        {"minimum=\"7\" maximum=\"7\"", "minimum=\"7\" maximum=\"6\"", "minimum of columnIndex is over its maximum"},
        {"</data3D>", "</data4D>", "the XML is broken"},
        {"<data3D>\n", "<dbta3D>\n", "the XML is broken"},
        {"scale=\"0.5\"", "scale=\"x.5\"", "scale is no number"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct bytes file = make_e57(&all_kinds, 1, "");
        replace(&file, cases[i].text, cases[i].by);
        struct cloud cloud = {0};
        if (cases[i].part[0])
            refuse(&file, STATUS_MALFORMED, cases[i].part);
        else if (!cloud_read_memory(file.at, file.n, NULL, NULL, &cloud, NULL)) /* two fields of one name: the last */
            assert_int_equal(cloud.count, 900);
        cloud_done(&cloud);
        free(file.at);
    }
    struct bytes file = make_e57(&all_kinds, 1, "");
    uint64_t many = UINT64_MAX;
    memcpy(file.at + 48 + 8, &many, 8); /* the section's length */
    mend(&file);
    refuse(&file, STATUS_MALFORMED, "no section of points");
    free(file.at);
    file = make_e57(&all_kinds, 1, "");
    memcpy(file.at + 24, &many, 8); /* the XML's place */
    mend(&file);
    refuse(&file, STATUS_MALFORMED, "the XML lies outside");
    free(file.at);
}

/* Entities that become more and more, elements in elements, one section as many scans. */
static void hostile_descriptions_are_refused(void **state) {
    (void)state;
    struct bytes file = make_e57(&all_kinds, 1, "");
    replace(&file, "<?xml version=\"1.0\"?>\n<e57Root type=\"Structure\" xmlns=\"e57\"",
            "<!DOCTYPE e57Root [<!ENTITY a \"b\">]><e57Root    xmlns=\"e57\"");
    refuse(&file, STATUS_MALFORMED, "document type");
    free(file.at);
    char deep[4000] = "";
    for (size_t i = 0; i < 200; i++) snprintf(deep + 3 * i, sizeof deep - 3 * i, "<a>");
    file = make_e57(&all_kinds, 1, deep);
    refuse(&file, STATUS_MALFORMED, "nested too deep");
    free(file.at);
    struct scan twice[] = {all_kinds, all_kinds};
    twice[1].records = 10;
    file = make_e57(twice, 2, "");
    struct cloud cloud = read_all(file.at, file.n);
    size_t second = physical(48);
    assert_int_equal(cloud.count, 909);
    cloud_done(&cloud);
    for (size_t at = 0, found = 0; at + 14 < file.n; at++)
        if (memcmp(file.at + at, "fileOffset=\"", 12) == 0 && ++found == 2) {
            size_t digits = strspn((char *)file.at + at + 12, "0123456789");
            char text[32];
            snprintf(text, sizeof text, "%0*zu", (int)digits, second);
            memcpy(file.at + at + 12, text, digits);
        }
    mend(&file);
    refuse(&file, STATUS_MALFORMED, "the same ones");
    free(file.at);
    struct scan nothing = all_kinds; /* records of no bits */
    for (int k = 0; k < 3; k++)
        nothing.field[k] = (struct field){all_kinds.field[k].name, INTEGER(1, 1), WHOLE, 0, 1, {1}};
    nothing.field[3].name = NULL;
    nothing.records = 1000000;
    nothing.records_each = 1000000;
    file = make_e57(&nothing, 1, "");
    refuse(&file, STATUS_MALFORMED, "can't hold");
    free(file.at);
}

/* ------------------------------------------------------------------------------------------------ PTX */

static const char ptx[] =
    "2\n3\n10 20 30\n1 0 0\n0 1 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 30 1\n"
    "1 2 3 0.5 255 0 7\n0 0 0 0.5 0 0 0\n4 5 6 0.25 1 2 3\n0 0 0 0 0 0 0\n1 0 0 1 9 9 9\n0 0 2 0 1 1 1\n";

static void grids_without_returns_and_poses(void **state) {
    (void)state;
    struct cloud cloud = read_all(ptx, strlen(ptx));
    assert_string_equal(cloud.form, "ptx");
    assert_int_equal(cloud.count, 4);
    assert_int_equal(cloud.property_count, 7);
    assert_true(vec3_equal(cloud.position[0], (vec3){10 - 2, 20 + 1, 33}));
    assert_true(vec3_equal(cloud.position[3], (vec3){10, 20, 32}));
    assert_true(property_value(&cloud, 1, "intensity") == 0.25 && property_value(&cloud, 1, "blue") == 3);
    assert_int_equal(cloud.view_count, 1);
    assert_true(vec3_equal(cloud.view[0], (vec3){10, 20, 30}));
    cloud_done(&cloud);
    char several[2 * sizeof ptx + 200];
    snprintf(several, sizeof several,
             "%s\n1\r\n1\r\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n500 500 9 0.125\n", ptx);
    cloud = read_all(several, strlen(several));
    assert_int_equal(cloud.count, 5);
    assert_int_equal(cloud.property_count, 5);
    assert_non_null(strstr(cloud.left_out, "colours: only some of the scans"));
    assert_true(property_value(&cloud, 3, "scan") == 0 && property_value(&cloud, 4, "scan") == 1);
    assert_int_equal(cloud.view_count, 2);
    assert_true(vec3_equal(cloud.view[0], (vec3){10, 20, 30}) && isnan(cloud.view[1].x));
    cloud_done(&cloud);
}

static void broken_grids_are_refused(void **state) {
    (void)state;
    static const struct {
        const char *text, *by, *part;
    } cases[] = {{"2\n3\n", "2\n4\n", "ends after 6 of 8 points of scan 1"},
                 {"2\n3\n", "2\n2\n", "is not the end of that line"},
                 {"2\n3\n", "9999999\n9999999\n", "bytes can't hold"},
                 {"4 5 6 0.25 1 2 3", "4 5 6 0.25 1 2", "the line ends where a number should be"},
                 {"4 5 6 0.25 1 2 3", "4 5 6 0.25 1 2 3 4", "the end of the line"},
                 {"4 5 6 0.25 1 2 3", "4 5 6 0.25 1 2 300", "a colour from 0 to 255"},
                 {"4 5 6", "4 five 6", "'five' is not a number"},
                 {"1 2 3 0.5 255 0 7", "1 2 3 0.5 255", "5 numbers on a line"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char text[2 * sizeof ptx];
        const char *at = strstr(ptx, cases[i].text);
        assert_non_null(at);
        snprintf(text, sizeof text, "%.*s%s%s", (int)(at - ptx), ptx, cases[i].by, at + strlen(cases[i].text));
        struct bytes file = {strlen(text), 0, (unsigned char *)text};
        refuse(&file, STATUS_MALFORMED, cases[i].part);
    }
}

/* ------------------------------------------------------------------------------------------------ memory */

static void every_allocation_may_fail(void **state) {
    (void)state;
    const struct scan twice[] = {all_kinds, all_kinds};
    struct bytes file = make_e57(twice, 2, "");
    char several[2 * sizeof ptx];
    snprintf(several, sizeof several, "%s%s", ptx, ptx);
    const struct bytes files[] = {file, {strlen(several), 0, (unsigned char *)several}};
    for (int i = 0; i < 2; i++) {
        bool happened = true;
        for (int nth = 1; happened; nth++) {
            struct cloud cloud = {0};
            faults_in_memory(nth, false);
            enum status status = cloud_read_memory(files[i].at, files[i].n, NULL, NULL, &cloud, NULL);
            happened = faults_stop();
            if (status) assert_int_equal(status, STATUS_NO_MEMORY);
            cloud_done(&cloud);
        }
    }
    free(file.at);
}

int main(int argc, char **argv) {
    if (argc > 1 && strcmp(argv[1], "--write") == 0) { /* a small file to begin a fuzzer with, to standard output */
        struct scan few = all_kinds;
        few.records = 12, few.records_each = 5;
        struct bytes file = make_e57(&few, 1, "<images2D><vectorChild/></images2D>");
        return fwrite(file.at, 1, file.n, stdout) != file.n;
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_kind_of_field_is_read),
        cmocka_unit_test(spherical_scans_and_poses_are_put_together),
        cmocka_unit_test(places_of_scanners_are_known_part_by_part),
        cmocka_unit_test(a_bit_that_flips_is_found),
        cmocka_unit_test(broken_files_are_refused),
        cmocka_unit_test(hostile_descriptions_are_refused),
        cmocka_unit_test(grids_without_returns_and_poses),
        cmocka_unit_test(broken_grids_are_refused),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return cmocka_run_group_tests_name("scans", tests, NULL, NULL);
}
