/* The XML section of E57, by libexpat.
 *
 *     e57Root / data3D / (each child: a scan) / pose / rotation / w x y z
 *                                                    / translation / x y z
 *                                             / points fileOffset recordCount / prototype / (each child: a field)
 *             / images2D / (each child: an image)
 *
 * Elements are known by their place in this tree; all others are passed over.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/e57_xml.h"

#include <expat.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/text/number.h"

enum {
    DEEPEST = 64,
    KNOWN_DEPTH = 6, /* names are of use down to there */
    TEXT_BYTES = 64,
    MOST_FIELDS = 256,
    ROOT = 0,
    SECTION,
    SCAN,
    PART,
    GROUP,
    LEAF
};

struct parse {
    XML_Parser parser;
    struct e57_description made;
    size_t scan_room, field_room;
    unsigned depth;
    char name[KNOWN_DEPTH][E57_NAME_BYTES];
    char text[TEXT_BYTES]; /* of the leaf */
    size_t text_bytes;
    struct error failure; /* code 0: none */
};

static void fail(struct parse *p, enum status status, const char *text, const char *name) {
    if (p->failure.code) return;
    error_set_at(&p->failure, status, "xml", (uint64_t)XML_GetCurrentLineNumber(p->parser), UINT64_MAX, text, name);
    XML_StopParser(p->parser, XML_FALSE);
}

static bool is_at(const struct parse *p, unsigned level, const char *name) { return strcmp(p->name[level], name) == 0; }

static const char *e57_find(const char **attributes, const char *name) {
    for (; attributes[0]; attributes += 2)
        if (strcmp(attributes[0], name) == 0) return attributes[1];
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ numbers */

static bool read_whole(const char *text, int64_t *value) {
    char *end;
    if (!text[0]) return false;
    long long read = strtoll(text, &end, 10);
    *value = read;
    return !*end;
}

static bool read_number(const char *text, double *value) {
    char *end;
    if (!text[0] || text[strspn(text, "+-.0123456789eE \t\r\n")]) return false;
    *value = number_read(text, &end);
    return end != text && isfinite(*value);
}

/* An attribute that may be left out. */
static void take_whole(struct parse *p, const char **attributes, const char *name, int64_t *value) {
    const char *text = e57_find(attributes, name);
    if (text && !read_whole(text, value)) fail(p, STATUS_MALFORMED, "%s is no whole number", name);
}

static void take_real(struct parse *p, const char **attributes, const char *name, double *value) {
    const char *text = e57_find(attributes, name);
    if (text && !read_number(text, value)) fail(p, STATUS_MALFORMED, "%s is no number", name);
}

/* ------------------------------------------------------------------------------------------------ elements */

static void add_scan(struct parse *p) {
    struct e57_description *made = &p->made;
    if (made->scan_count == p->scan_room) {
        size_t room = p->scan_room + p->scan_room / 2 + 4;
        void *grown = alloc_resize(made->scan, room, sizeof *made->scan);
        if (!grown) {
            fail(p, STATUS_NO_MEMORY, "no memory for a %s", "scan");
            return;
        }
        made->scan = grown;
        p->scan_room = room;
    }
    made->scan[made->scan_count++] = (struct e57_scan){.rotation = {1, 0, 0, 0}};
    p->field_room = 0;
}

static void add_points(struct parse *p, const char **attributes) {
    struct e57_scan *scan = &p->made.scan[p->made.scan_count - 1];
    int64_t offset = 0, records = 0;
    take_whole(p, attributes, "fileOffset", &offset);
    take_whole(p, attributes, "recordCount", &records);
    if (offset < 0 || records < 0) fail(p, STATUS_MALFORMED, "%s or its place is below 0", "recordCount");
    scan->file_offset = (uint64_t)offset, scan->records = (uint64_t)records;
}

static enum e57_type e57_type_of(const char **attributes) {
    const char *type = e57_find(attributes, "type"), *precision = e57_find(attributes, "precision");
    if (!type) return E57_OTHER;
    if (strcmp(type, "Integer") == 0) return E57_INTEGER;
    if (strcmp(type, "ScaledInteger") == 0) return E57_SCALED;
    if (strcmp(type, "Float") == 0) return precision && strcmp(precision, "single") == 0 ? E57_FLOAT : E57_DOUBLE;
    return E57_OTHER;
}

static void e57_add_field(struct parse *p, const char *name, const char **attributes) {
    struct e57_scan *scan = &p->made.scan[p->made.scan_count - 1];
    struct e57_field field = {.type = e57_type_of(attributes), .minimum = INT64_MIN, .maximum = INT64_MAX, .scale = 1};
    if (scan->field_count == MOST_FIELDS) {
        fail(p, STATUS_LIMIT, "more fields in a record than are %s", "read");
        return;
    }
    snprintf(field.name, sizeof field.name, "%s", name);
    if (field.type == E57_INTEGER || field.type == E57_SCALED) {
        take_whole(p, attributes, "minimum", &field.minimum);
        take_whole(p, attributes, "maximum", &field.maximum);
        take_real(p, attributes, "scale", &field.scale);
        take_real(p, attributes, "offset", &field.offset);
        if (field.minimum > field.maximum) fail(p, STATUS_MALFORMED, "the minimum of %s is over its maximum", name);
    }
    if (scan->field_count == p->field_room) {
        size_t room = p->field_room + p->field_room / 2 + 8;
        void *grown = alloc_resize(scan->field, room, sizeof *scan->field);
        if (!grown) {
            fail(p, STATUS_NO_MEMORY, "no memory for a %s", "field");
            return;
        }
        scan->field = grown;
        p->field_room = room;
    }
    scan->field[scan->field_count++] = field;
}

static bool in_scan(const struct parse *p) { return is_at(p, ROOT, "e57Root") && is_at(p, SECTION, "data3D"); }

static void begin_element(void *context, const char *name, const char **attributes) {
    struct parse *p = context;
    unsigned level = p->depth++;
    if (p->failure.code) return;
    if (p->depth > DEEPEST) {
        fail(p, STATUS_MALFORMED, "elements are nested too deep, at %s", name);
        return;
    }
    p->text_bytes = 0;
    if (level >= KNOWN_DEPTH) return;
    snprintf(p->name[level], sizeof p->name[level], "%s", name);
    if (level == SCAN && in_scan(p)) add_scan(p);
    if (level == SCAN && is_at(p, ROOT, "e57Root") && is_at(p, SECTION, "images2D")) p->made.has_images = true;
    if (level == PART && in_scan(p) && is_at(p, PART, "points")) add_points(p, attributes);
    if (level == LEAF && in_scan(p) && is_at(p, PART, "points") && is_at(p, GROUP, "prototype"))
        e57_add_field(p, name, attributes);
}

/* A number of a pose; 0 where nothing stands in the element. */
static void take_pose(struct parse *p) {
    static const char *const names[] = {"w", "x", "y", "z"};
    struct e57_scan *scan = &p->made.scan[p->made.scan_count - 1];
    bool turns = is_at(p, GROUP, "rotation");
    double value = 0;
    p->text[p->text_bytes] = 0;
    if (p->text_bytes && !read_number(p->text, &value)) {
        fail(p, STATUS_MALFORMED, "a number of a pose is none: %s", p->text);
        return;
    }
    scan->has_pose = true;
    for (int k = turns ? 0 : 1; k < 4; k++)
        if (is_at(p, LEAF, names[k])) *(turns ? &scan->rotation[k] : &scan->translation[k - 1]) = value;
}

static void end_element(void *context, const char *name) {
    struct parse *p = context;
    unsigned level = --p->depth;
    (void)name;
    if (p->failure.code) return;
    bool of_pose = level == LEAF && in_scan(p) && is_at(p, PART, "pose");
    if (of_pose && (is_at(p, GROUP, "rotation") || is_at(p, GROUP, "translation"))) take_pose(p);
    p->text_bytes = 0;
}

static void add_text(void *context, const char *text, int n) {
    struct parse *p = context;
    for (int i = 0; i < n && p->text_bytes + 1 < sizeof p->text; i++)
        if (p->text_bytes || (unsigned char)text[i] > 32) p->text[p->text_bytes++] = text[i];
}

static void refuse_entities(void *context, const char *name, const char *system, const char *public, int subset) {
    (void)system, (void)public, (void)subset;
    fail(context, STATUS_MALFORMED, "a document type of its own isn't read: %s", name);
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status explain(struct parse *p, struct error *error) {
    if (p->failure.code)
        return error_set_at(error, p->failure.code, p->failure.where, p->failure.line, UINT64_MAX, "%s",
                            p->failure.text);
    enum XML_Error code = XML_GetErrorCode(p->parser);
    if (code == XML_ERROR_NO_MEMORY) return error_set(error, STATUS_NO_MEMORY, "xml", "no memory for the XML");
    return error_set_at(error, STATUS_MALFORMED, "xml", (uint64_t)XML_GetCurrentLineNumber(p->parser), UINT64_MAX,
                        "the XML is broken: %s", XML_ErrorString(code));
}

static enum status feed(struct parse *p, const struct e57_pages *pages, uint64_t logical, uint64_t bytes,
                        struct error *error) {
    while (bytes) {
        size_t n;
        const unsigned char *at = e57_pages_at(pages, logical, &n);
        if (n > bytes) n = (size_t)bytes;
        if (XML_Parse(p->parser, (const char *)at, (int)n, n == bytes) != XML_STATUS_OK || p->failure.code)
            return explain(p, error);
        logical += n, bytes -= n;
    }
    return STATUS_OK;
}

enum status e57_xml_parse(const struct e57_pages *pages, uint64_t logical, uint64_t bytes,
                          struct e57_description *description, struct error *error) {
    struct parse p = {.parser = NULL};
    if (logical >= pages->logical_bytes || bytes == 0 || bytes > pages->logical_bytes - logical)
        return error_set_at(error, STATUS_MALFORMED, "header", 0, 24, "the XML lies outside the file");
    p.parser = XML_ParserCreate(NULL);
    if (!p.parser) return error_set(error, STATUS_NO_MEMORY, "xml", "no memory for the XML");
    XML_SetUserData(p.parser, &p);
    XML_SetElementHandler(p.parser, begin_element, end_element);
    XML_SetCharacterDataHandler(p.parser, add_text);
    XML_SetStartDoctypeDeclHandler(p.parser, refuse_entities);
    enum status status = feed(&p, pages, logical, bytes, error);
    XML_ParserFree(p.parser);
    if (status)
        e57_description_done(&p.made);
    else
        *description = p.made;
    return status;
}

void e57_description_done(struct e57_description *description) {
    for (size_t i = 0; i < description->scan_count; i++) free(description->scan[i].field);
    free(description->scan);
    *description = (struct e57_description){0};
}
