/* Kinds of files by their first bytes.
 *
 * A known beginning decides; else the first words of a text; else, for binary data, whether it can be STL.  A control
 * character that no text has means binary data.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud_sniff.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>
#include <strings.h>

#include "core/inflate.h"
#include "core/little.h"
#include "core/padding.h"
#include "core/scan.h"

enum {
    LOOK_BYTES = 4096,
    LONG_LOOK_BYTES = 65536, /* for comments before the first word */
    STL_HEADER_BYTES = 84,
    STL_FACET_BYTES = 50,
    LAS_FORMAT_BYTE = 104
};

static const struct cloud_guess ply = {CLOUD_KIND_PLY, "PLY", "ply"};
static const struct cloud_guess pcd = {CLOUD_KIND_PCD, "a PCD cloud", "pcd/ascii"};
static const struct cloud_guess obj = {CLOUD_KIND_OBJ, "an OBJ mesh", "obj"};
static const struct cloud_guess off = {CLOUD_KIND_OFF, "an OFF mesh", "off"};
static const struct cloud_guess stl_text = {CLOUD_KIND_STL, "an STL mesh", "stl/ascii"};
static const struct cloud_guess stl_binary = {CLOUD_KIND_STL, "an STL mesh", "stl/binary"};
static const struct cloud_guess las = {CLOUD_KIND_LAS, "a LAS cloud", "las"};
static const struct cloud_guess laz = {CLOUD_KIND_OTHER, "a LAZ cloud, which is compressed LAS: decompress it", ""};
static const struct cloud_guess text_of_any = {CLOUD_KIND_TEXT, "text", "xyz"};

static const struct cloud_guess compressed[] = {
    [INFLATE_GZIP] = {CLOUD_KIND_GZIP, "gzip-compressed data", "gzip"},
    [INFLATE_ZSTD] = {CLOUD_KIND_ZSTD, "zstd-compressed data", "zstd"},
};

static const struct {
    const char *beginning;
    size_t bytes;
    struct cloud_guess guess;
} known[] = {
    {"\x89PNG", 4, {CLOUD_KIND_OTHER, "a PNG image", ""}},
    {"\xff\xd8\xff", 3, {CLOUD_KIND_OTHER, "a JPEG image", ""}},
    {"GIF8", 4, {CLOUD_KIND_OTHER, "a GIF image", ""}},
    {"\xfd\x37zXZ", 5, {CLOUD_KIND_OTHER, "xz-compressed data", ""}},
    {"BZh", 3, {CLOUD_KIND_OTHER, "bzip2-compressed data", ""}},
    {"PK\x03\x04", 4, {CLOUD_KIND_OTHER, "a ZIP archive", ""}},
    {"%PDF", 4, {CLOUD_KIND_OTHER, "a PDF document", ""}},
    {"\x7f\x45LF", 4, {CLOUD_KIND_OTHER, "an ELF program", ""}},
    {"ASTM-E57", 8, {CLOUD_KIND_OTHER, "an E57 cloud", ""}},
    {"# vtk DataFile", 14, {CLOUD_KIND_OTHER, "a VTK file", ""}},
    {"glTF", 4, {CLOUD_KIND_OTHER, "a binary glTF scene", ""}},
    {"SQLite format 3", 15, {CLOUD_KIND_OTHER, "an SQLite database", ""}},
    {"\xff\xfe", 2, {CLOUD_KIND_OTHER, "UTF-16 text (iconv -f UTF-16 -t UTF-8 converts it)", ""}},
    {"\xfe\xff", 2, {CLOUD_KIND_OTHER, "UTF-16 text (iconv -f UTF-16 -t UTF-8 converts it)", ""}},
    {"{", 1, {CLOUD_KIND_OTHER, "JSON", ""}},
    {"<", 1, {CLOUD_KIND_OTHER, "XML or HTML", ""}},
};

static bool begins(const char *text, size_t n, const char *beginning, size_t bytes) {
    return n >= bytes && memcmp(text, beginning, bytes) == 0;
}

static bool has_control_character(const char *text, size_t n) {
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)text[i] < 32 && !(text[i] >= '\t' && text[i] <= '\r')) return true;
    return false;
}

/* ------------------------------------------------------------------------------------------------ by words */

static bool is_number(const struct scan_word *word) {
    double value;
    return scan_f64(word, &value);
}

/* "v 1", "vn 0", "f 1", "mtllib x", "o name", ... */
static bool is_obj_line(const struct scan_word *word, struct scan *rest) {
    static const char *const before_numbers[] = {"v", "vn", "vt", NULL};
    static const char *const before_names[] = {"mtllib", "usemtl", "o", "g", "f", "s", NULL};
    struct scan_word next;
    if (!scan_word(rest, &next)) return scan_is(word, "g") || scan_is(word, "o");
    for (size_t i = 0; before_numbers[i]; i++)
        if (scan_is(word, before_numbers[i])) return is_number(&next);
    if (scan_is(word, "s") && !scan_is(&next, "off")) return is_number(&next);
    for (size_t i = 0; before_names[i]; i++)
        if (scan_is(word, before_names[i])) return true;
    return false;
}

static bool is_off_word(const struct scan_word *word) {
    static const char *const marks[] = {"ST", "st", "C", "c", "N", "4", "n"};
    const char *at = word->text, *end = at + word->n;
    for (size_t i = 0; i < sizeof marks / sizeof *marks; i++)
        if (begins(at, (size_t)(end - at), marks[i], strlen(marks[i]))) at += strlen(marks[i]);
    return end - at == 3 && (memcmp(at, "OFF", 3) == 0 || memcmp(at, "off", 3) == 0);
}

/* What the first word that is no comment says; NULL: nothing. */
static const struct cloud_guess *by_word(const char *text, size_t n) {
    struct scan scan = scan_start(text, n < LONG_LOOK_BYTES ? n : LONG_LOOK_BYTES);
    struct scan_word word;
    scan.comment = '#';
    if (!scan_token(&scan, &word)) return NULL;
    if (is_off_word(&word)) return &off;
    if (scan_is(&word, "VERSION") || scan_is(&word, "FIELDS") || scan_is(&word, "COLUMNS")) return &pcd;
    return is_obj_line(&word, &scan) ? &obj : NULL;
}

static bool contains(const char *text, size_t n, const char *word) {
    size_t bytes = strlen(word);
    for (size_t i = 0; i + bytes <= n; i++)
        if (strncasecmp(text + i, word, bytes) == 0) return true;
    return false;
}

static bool is_stl_text(const char *text, size_t n) {
    struct scan scan = scan_start(text, n);
    struct scan_word word;
    if (!scan_token(&scan, &word) || !scan_is_any_case(&word, "solid")) return false;
    return contains(text, n, "facet") || contains(text, n, "endsolid");
}

/* Which of the three forms of PCD; a comment may fool it, but no reader. */
static struct cloud_guess pcd_of(const char *text, size_t n) {
    struct cloud_guess guess = pcd;
    if (contains(text, n, "DATA binary_compressed"))
        guess.format = "pcd/binary_compressed";
    else if (contains(text, n, "DATA binary"))
        guess.format = "pcd/binary";
    return guess;
}

/* ------------------------------------------------------------------------------------------------ by figures */

/* Whether numbers and a normal are such as STL has; fewer than a whole facet say nothing against it. */
static bool is_facet(const unsigned char *at) {
    float value[12];
    for (int i = 0; i < 12; i++) {
        uint32_t bits = (uint32_t)little_load(at + 4 * i, 4);
        memcpy(&value[i], &bits, sizeof bits);
        if (!isfinite(value[i]) || fabsf(value[i]) > 1e12f || (value[i] != 0 && fabsf(value[i]) < 1e-30f)) return false;
    }
    float length_sq = value[0] * value[0] + value[1] * value[1] + value[2] * value[2];
    return length_sq == 0 || (length_sq > 0.8f && length_sq < 1.2f);
}

static bool is_stl_binary(const unsigned char *bytes, size_t n) {
    if (n < STL_HEADER_BYTES) return false;
    uint64_t facets = little_load(bytes + STL_HEADER_BYTES - 4, 4);
    uint64_t length = STL_HEADER_BYTES + facets * STL_FACET_BYTES;
    if (length == n && facets > 0) return true;
    if (n < STL_HEADER_BYTES + STL_FACET_BYTES || facets == 0) return false;
    if (length < n && n - length > PADDING_MOST_BYTES) return false;
    size_t looked = length < n ? (size_t)length : n;
    if (looked > LOOK_BYTES) looked = LOOK_BYTES;
    for (size_t at = STL_HEADER_BYTES; at + STL_FACET_BYTES <= looked; at += STL_FACET_BYTES)
        if (!is_facet(bytes + at)) return false;
    return true;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static bool is_ply(const char *text, size_t n) {
    if (begins(text, n, "\xef\xbb\xbf", 3)) text += 3, n -= 3;
    return begins(text, n, "ply", 3) && (n == 3 || strchr("\r\n \t", text[3]));
}

struct cloud_guess cloud_sniff(const void *first, size_t n) {
    const char *text = first;
    size_t looked = n < LOOK_BYTES ? n : LOOK_BYTES;
    if (n == 0) return (struct cloud_guess){CLOUD_KIND_EMPTY, "an empty file", ""};
    enum inflate_kind kind;
    if (inflate_sniff(first, n, &kind)) return compressed[kind];
    if (is_ply(text, n)) return ply;
    if (begins(text, n, "# .PCD", 6)) return pcd_of(text, looked);
    if (begins(text, n, "LASF", 4)) return n > LAS_FORMAT_BYTE && text[LAS_FORMAT_BYTE] & 0x80 ? laz : las;
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (begins(text, n, known[i].beginning, known[i].bytes)) return known[i].guess;
    const struct cloud_guess *word = by_word(text, n);
    if (word == &pcd) return pcd_of(text, looked);
    if (word == &off) return off;
    if (has_control_character(text, looked < n ? looked : padding_text_bytes(text, n)))
        return is_stl_binary(first, n) ? stl_binary : (struct cloud_guess){CLOUD_KIND_OTHER, "binary data", ""};
    if (word) return *word;
    return is_stl_text(text, looked) ? stl_text : text_of_any;
}

const char *cloud_sniff_formats(void) {
    return "ply/ascii,ply/binary_little_endian,ply/binary_big_endian,xyz,pcd/ascii,pcd/binary,pcd/binary_compressed,"
           "obj,off,stl/ascii,stl/binary,las";
}
