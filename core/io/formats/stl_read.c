/* STL.
 *
 *     ascii    { "solid" name  { "facet normal" nx ny nz  "outer loop"  3 * ("vertex" x y z)  "endloop"  "endfacet" }
 *                "endsolid" name }
 *     binary   80 bytes of anything, count (uint32), count * (normal, 3 corners: 12 float32; 2 bytes), little endian,
 *              then anything
 *
 * Words of the ascii form may be in capitals, and blanks may come first.
 *
 * STL names no points, only corners.  Corners with the same coordinates (-0 is 0) become one point, found by hashing;
 * so the faces are joined again, as they were before somebody wrote STL.  Text is read as float64.  Facets with two
 * corners at one place have no surface and are dropped.  Normals of facets follow from their corners and are dropped as
 * well; the two bytes, where they aren't 0, are colours for some programs.
 *
 * What whittle wrote around an origin, as its header says (stl_origin.h), has that added, and is float64.
 *
 * Invariant: the table has room for twice the points, and slots hold ids of points or NONE.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"

#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "core/base/alloc.h"
#include "core/base/endian.h"
#include "core/io/build.h"
#include "core/io/first_bytes.h"
#include "core/io/formats/stl_origin.h"
#include "core/io/padding.h"
#include "core/io/text_scanner.h"

enum { HEADER_BYTES = 84, FACET_BYTES = 50, FIRST_SLOTS = 1024 };

struct reader {
    struct cloud_build build;
    size_t slot_count; /* a power of two */
    uint32_t *slot;    /* owned */
    bool moved;        /* coordinates are from the origin on */
    double origin[3];
};

/* ------------------------------------------------------------------------------------------------ points */

static uint64_t hash(vec3 p) {
    uint64_t bits[3], h = 0;
    memcpy(bits, &p, sizeof bits);
    for (int i = 0; i < 3; i++) {
        h = (h ^ bits[i]) * 0x9e3779b97f4a7c15u;
        h ^= h >> 29;
    }
    return h;
}

/* Zeros have one sign here, so this is equality, and holds for nan too: such corners don't fill the table. */
static bool same_bits(vec3 a, vec3 b) { return memcmp(&a, &b, sizeof a) == 0; }

static enum status grow_table(struct reader *r) {
    size_t slots = r->slot_count ? 2 * r->slot_count : FIRST_SLOTS;
    uint32_t *grown = alloc_array(slots, sizeof *grown);
    if (!grown) return error_set(r->build.error, STATUS_NO_MEMORY, "read", "no memory for a table of points");
    memset(grown, 0xff, slots * sizeof *grown);
    for (uint32_t id = 0; id < r->build.cloud.count; id++) {
        size_t at = hash(r->build.cloud.position[id]) & (slots - 1);
        while (grown[at] != NONE) at = (at + 1) & (slots - 1);
        grown[at] = id;
    }
    free(r->slot);
    r->slot = grown;
    r->slot_count = slots;
    return STATUS_OK;
}

/* The id of the point at p, which is new or was there. */
static enum status point_at(struct reader *r, vec3 p, const void *record, struct cloud_place place, uint32_t *id) {
    struct cloud *cloud = &r->build.cloud;
    enum status status = 2 * cloud->count >= r->slot_count ? grow_table(r) : STATUS_OK;
    if (status) return status;
    size_t at = hash(p) & (r->slot_count - 1);
    while (r->slot[at] != NONE && !same_bits(cloud->position[r->slot[at]], p)) at = (at + 1) & (r->slot_count - 1);
    if (r->slot[at] != NONE) {
        *id = r->slot[at];
        return STATUS_OK;
    }
    *id = (uint32_t)cloud->count;
    status = cloud_build_point(&r->build, record, place);
    if (!status) r->slot[at] = *id;
    return status;
}

static enum status add_facet(struct reader *r, const uint32_t id[3]) {
    if (id[0] == id[1] || id[1] == id[2] || id[2] == id[0]) return STATUS_OK;
    return cloud_build_triangle(&r->build, id[0], id[1], id[2]);
}

static enum status stl_describe(struct reader *r, enum scalar_type type) {
    enum status status = cloud_build_property(&r->build, "x", type);
    if (!status) status = cloud_build_property(&r->build, "y", type);
    return status ? status : cloud_build_property(&r->build, "z", type);
}

/* ------------------------------------------------------------------------------------------------ binary */

static enum status take_binary_corner(struct reader *r, const unsigned char *at, uint64_t byte, uint32_t *id) {
    float record[3];
    double moved[3];
    for (int axis = 0; axis < 3; axis++) {
        uint32_t bits = (uint32_t)load_little_endian(at + 4 * axis, 4);
        memcpy(&record[axis], &bits, sizeof bits);
        record[axis] += 0.0f; /* -0 becomes 0 */
        moved[axis] = (double)record[axis] + r->origin[axis];
    }
    vec3 p = {moved[0], moved[1], moved[2]};
    return point_at(r, p, r->moved ? (const void *)moved : record, (struct cloud_place){0, byte}, id);
}

/* Whether as many facets as are promised are there; what follows them goes to the report. */
static enum status check_length(struct reader *r, const unsigned char *bytes, size_t n, uint64_t facets) {
    uint64_t expected = facets * FACET_BYTES + HEADER_BYTES;
    if (expected == n) return STATUS_OK;
    if (expected > n)
        return cloud_build_bad(&r->build, "count", (struct cloud_place){0, 80},
                               "%" PRIu64 " facets are promised: %" PRIu64 " bytes expected, %zu bytes are there",
                               facets, expected, n);
    char note[PADDING_NOTE_BYTES];
    padding_note(note, bytes + expected, n - (size_t)expected);
    return cloud_build_leave_out(&r->build, note);
}

/* The origin that the header's first 80 bytes tell, where they do. */
static void stl_find_origin(struct reader *r, const unsigned char *bytes) {
    static const char begin[] = STL_ORIGIN_BEGIN, end[] = STL_ORIGIN_END;
    const char *text = (const char *)bytes, *stop = text + HEADER_BYTES - 4;
    if (memcmp(text, begin, sizeof begin - 1) != 0) return;
    struct scan scan = scan_start(text + sizeof begin - 1, (size_t)(stop - text) - (sizeof begin - 1));
    struct scan_word word;
    double value[3];
    for (int axis = 0; axis < 3; axis++)
        if (!scan_word(&scan, &word) || !scan_f64(&word, &value[axis]) || !isfinite(value[axis])) return;
    if ((size_t)(scan.end - scan.at) < sizeof end - 1 || memcmp(scan.at, end, sizeof end - 1) != 0) return;
    memcpy(r->origin, value, sizeof value);
    r->moved = true;
}

static enum status stl_read_binary(struct reader *r, const unsigned char *bytes, size_t n) {
    if (n < HEADER_BYTES)
        return cloud_build_bad(&r->build, "header", (struct cloud_place){0, n}, "%zu bytes are no binary STL", n);
    stl_find_origin(r, bytes);
    enum status status = stl_describe(r, r->moved ? SCALAR_FLOAT64 : SCALAR_FLOAT32);
    uint64_t facets = load_little_endian(bytes + 80, 4);
    if (!status) status = check_length(r, bytes, n, facets);
    for (uint64_t i = 0; !status && i < facets; i++) {
        uint64_t byte = HEADER_BYTES + i * FACET_BYTES;
        uint32_t id[3];
        for (unsigned k = 0; !status && k < 3; k++)
            status = take_binary_corner(r, bytes + byte + 12 + 12 * k, byte + 12 + 12 * k, &id[k]);
        if (!status) status = add_facet(r, id);
        if (!status && (bytes[byte + 48] || bytes[byte + 49]))
            status = cloud_build_leave_out(&r->build, "attribute bytes of facets (colours, for some programs)");
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ ascii */

static enum status expected(struct reader *r, const struct scan *scan, const struct scan_word *word, const char *what) {
    char quote[NUMBER_QUOTE_BYTES];
    struct cloud_place place = {scan->line, 0};
    if (!word->n) return cloud_build_bad(&r->build, "facet", place, "the file ends where %s should be", what);
    return cloud_build_bad(&r->build, "facet", place, "'%s' where %s should be", scan_quote(word, quote), what);
}

static enum status stl_take_keyword(struct reader *r, struct scan *scan, const char *keyword) {
    struct scan_word word;
    return scan_token(scan, &word) && scan_is_any_case(&word, keyword) ? STATUS_OK : expected(r, scan, &word, keyword);
}

static enum status stl_take_numbers(struct reader *r, struct scan *scan, double value[3]) {
    struct scan_word word;
    for (int axis = 0; axis < 3; axis++) {
        if (!scan_token(scan, &word) || !scan_f64(&word, &value[axis])) return expected(r, scan, &word, "a number");
        value[axis] += 0.0;
    }
    return STATUS_OK;
}

/* After "facet". */
static enum status take_facet(struct reader *r, struct scan *scan) {
    double value[3];
    uint32_t id[3];
    enum status status = stl_take_keyword(r, scan, "normal");
    if (!status) status = stl_take_numbers(r, scan, value);
    if (!status) status = stl_take_keyword(r, scan, "outer");
    if (!status) status = stl_take_keyword(r, scan, "loop");
    for (int k = 0; !status && k < 3; k++) {
        status = stl_take_keyword(r, scan, "vertex");
        if (!status) status = stl_take_numbers(r, scan, value);
        struct cloud_place place = {scan->line, (uint64_t)(scan->at - scan->begin)};
        if (!status) status = point_at(r, (vec3){value[0], value[1], value[2]}, value, place, &id[k]);
    }
    if (!status) status = stl_take_keyword(r, scan, "endloop");
    if (!status) status = stl_take_keyword(r, scan, "endfacet");
    return status ? status : add_facet(r, id);
}

/* After "solid". */
static enum status take_solid(struct reader *r, struct scan *scan) {
    struct scan_word word;
    scan_next_line(scan);
    for (enum status status = STATUS_OK;;) {
        if (!scan_token(scan, &word)) return expected(r, scan, &word, "facet or endsolid");
        if (scan_is_any_case(&word, "endsolid")) break;
        if (!scan_is_any_case(&word, "facet")) return expected(r, scan, &word, "facet or endsolid");
        status = take_facet(r, scan);
        if (status) return status;
    }
    scan_next_line(scan);
    return STATUS_OK;
}

static enum status read_text(struct reader *r, struct scan scan) {
    struct scan_word word;
    enum status status = stl_describe(r, SCALAR_FLOAT64);
    while (!status && scan_token(&scan, &word))
        status = scan_is_any_case(&word, "solid") ? take_solid(r, &scan) : expected(r, &scan, &word, "solid");
    return status;
}

/* Whether the first bytes (134 are enough) begin the ascii form; some binary files begin with "solid" too. */
static bool is_text_form(const void *first, size_t n) {
    const char *text = first;
    struct scan scan = scan_start(first, n);
    struct scan_word word;
    if (!scan_token(&scan, &word) || word.n < 5 || strncasecmp(word.text, "solid", 5) != 0) return false;
    for (size_t i = (size_t)(word.text - text); i < n && i < HEADER_BYTES + FACET_BYTES; i++)
        if ((unsigned char)text[i] < 32 && !(text[i] >= '\t' && text[i] <= '\r')) return false;
    return true;
}

/* Whether numbers and a normal are such as STL has; fewer than a whole facet say nothing against it. */
static bool is_facet(const unsigned char *at) {
    float value[12];
    for (int i = 0; i < 12; i++) {
        uint32_t bits = (uint32_t)load_little_endian(at + 4 * i, 4);
        memcpy(&value[i], &bits, sizeof bits);
        if (!isfinite(value[i]) || fabsf(value[i]) > 1e12f || (value[i] != 0 && fabsf(value[i]) < 1e-30f)) return false;
    }
    float length_sq = value[0] * value[0] + value[1] * value[1] + value[2] * value[2];
    return length_sq == 0 || (length_sq > 0.8f && length_sq < 1.2f);
}

/* The binary form has no mark of its own: it is told by its length, or where there is only its beginning, by facets
 * that make sense. */
static bool looks_binary(const struct first_bytes *first) {
    const unsigned char *bytes = (const unsigned char *)first->text;
    size_t n = first->n;
    if (n < HEADER_BYTES) return false;
    uint64_t facets = load_little_endian(bytes + HEADER_BYTES - 4, 4);
    uint64_t length = HEADER_BYTES + facets * FACET_BYTES;
    if (length == n && facets > 0) return true;
    if (n < HEADER_BYTES + FACET_BYTES || facets == 0) return false;
    if (length < n && n - length > PADDING_MOST_BYTES) return false;
    size_t looked = length < first->looked ? (size_t)length : first->looked;
    for (size_t at = HEADER_BYTES; at + FACET_BYTES <= looked; at += FACET_BYTES)
        if (!is_facet(bytes + at)) return false;
    return true;
}

/* scan_token, not first_word: "#" begins no comment here. */
static bool looks_text(const struct first_bytes *first) {
    struct scan scan = scan_start(first->text, first->looked);
    struct scan_word word;
    if (!scan_token(&scan, &word) || !scan_is_any_case(&word, "solid")) return false;
    return first_contains(first, "facet") || first_contains(first, "endsolid");
}

const char *cloud_stl_look(const struct first_bytes *first) {
    if (first->is_text) return looks_text(first) ? "stl/ascii" : "";
    return looks_binary(first) ? "stl/binary" : "";
}

enum status cloud_stl_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct reader r = {0};
    bool text = is_text_form(bytes, n);
    cloud_build_start(&r.build, text ? "stl/ascii" : "stl/binary", n, limits, progress, error);
    enum status status = text ? read_text(&r, scan_start(bytes, n)) : stl_read_binary(&r, bytes, n);
    free(r.slot);
    return cloud_build_end(&r.build, status, cloud);
}
