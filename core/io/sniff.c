/* Kinds of files by their first bytes: what compresses, beginnings that are known and not read, then the formats in the
 * order of their table.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/sniff.h"

#include <string.h>

#include "core/io/codec/inflate.h"
#include "core/io/first_bytes.h"
#include "core/io/reader.h"

/* ------------------------------------------------------------------------------------------------ what is read */

static const struct {
    enum cloud_kind kind;
    const char *looks_like, *(*look)(const struct first_bytes *);
} formats[] = {
#define ROW(constant, name, title, looks_like, forms) {CLOUD_KIND_##constant, looks_like, cloud_##name##_look},
    CLOUD_FORMAT_ROWS(ROW)
#undef ROW
};
enum { FORMATS = sizeof formats / sizeof formats[0] };

#define ROW(constant, name, title, looks_like, forms) "," forms
static const char all_forms[] = "" CLOUD_FORMAT_ROWS(ROW);
#undef ROW
#define ROW(constant, name, title, looks_like, forms) ", " title
static const char all_titles[] = "" CLOUD_FORMAT_ROWS(ROW);
#undef ROW

const char *cloud_sniff_formats(void) { return all_forms + strlen(","); }

const char *cloud_sniff_titles(void) { return all_titles + strlen(", "); }

/* ------------------------------------------------------------------------------------------------ what isn't */

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
    {"# vtk DataFile", 14, {CLOUD_KIND_OTHER, "a VTK file", ""}},
    {"SQLite format 3", 15, {CLOUD_KIND_OTHER, "an SQLite database", ""}},
    {"\xff\xfe", 2, {CLOUD_KIND_OTHER, "UTF-16 text (iconv -f UTF-16 -t UTF-8 converts it)", ""}},
    {"\xfe\xff", 2, {CLOUD_KIND_OTHER, "UTF-16 text (iconv -f UTF-16 -t UTF-8 converts it)", ""}},
    {"{", 1, {CLOUD_KIND_OTHER, "JSON", ""}},
    {"<", 1, {CLOUD_KIND_OTHER, "XML or HTML", ""}},
};

struct cloud_guess cloud_sniff(const void *bytes, size_t n) {
    struct first_bytes first = first_bytes_of(bytes, n);
    enum inflate_kind packing;
    if (n == 0) return (struct cloud_guess){CLOUD_KIND_EMPTY, "an empty file", ""};
    if (inflate_sniff(bytes, n, &packing)) return compressed[packing];
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (first_begins(&first, known[i].beginning, known[i].bytes)) return known[i].guess;
    for (size_t i = 0; i < FORMATS; i++) {
        const char *form = formats[i].look(&first);
        if (form[0]) return (struct cloud_guess){formats[i].kind, formats[i].looks_like, form};
    }
    return (struct cloud_guess){CLOUD_KIND_OTHER, "binary data", ""};
}
