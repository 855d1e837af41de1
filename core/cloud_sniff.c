/* Kinds of files by their first bytes.
 *
 * A known beginning decides; else a control character that no text has means binary data; else it is text.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud_sniff.h"

#include <string.h>

enum { LOOK_BYTES = 4096 };

static const struct {
    const char *beginning;
    size_t bytes;
    const char *looks_like;
} known[] = {
    {"\x89PNG", 4, "a PNG image"},
    {"\xff\xd8\xff", 3, "a JPEG image"},
    {"GIF8", 4, "a GIF image"},
    {"\x1f\x8b", 2, "gzip-compressed data"},
    {"\x28\xb5\x2f\xfd", 4, "zstd-compressed data"},
    {"\xfd\x37zXZ", 5, "xz-compressed data"},
    {"BZh", 3, "bzip2-compressed data"},
    {"PK\x03\x04", 4, "a ZIP archive"},
    {"%PDF", 4, "a PDF document"},
    {"\x7f\x45LF", 4, "an ELF program"},
    {"LASF", 4, "a LAS or LAZ cloud"},
    {"ASTM-E57", 8, "an E57 cloud"},
    {"# .PCD", 6, "a PCD cloud"},
    {"VERSION .7", 10, "a PCD cloud"},
    {"# vtk DataFile", 14, "a VTK file"},
    {"glTF", 4, "a binary glTF scene"},
    {"OFF", 3, "an OFF mesh"},
    {"COFF", 4, "an OFF mesh"},
    {"NOFF", 4, "an OFF mesh"},
    {"CNOFF", 5, "an OFF mesh"},
    {"solid ", 6, "an STL mesh"},
    {"SQLite format 3", 15, "an SQLite database"},
    {"\xff\xfe", 2, "UTF-16 text"},
    {"\xfe\xff", 2, "UTF-16 text"},
    {"{", 1, "JSON"},
    {"<", 1, "XML or HTML"},
};

static int begins(const char *text, size_t n, const char *beginning, size_t bytes) {
    return n >= bytes && memcmp(text, beginning, bytes) == 0;
}

static int is_ply(const char *text, size_t n) {
    return begins(text, n, "ply", 3) && (n == 3 || strchr("\r\n \t", text[3]));
}

static int has_control_character(const char *text, size_t n) {
    for (size_t i = 0; i < n; i++)
        if ((unsigned char)text[i] < 32 && !(text[i] >= '\t' && text[i] <= '\r')) return 1;
    return 0;
}

struct cloud_guess cloud_sniff(const void *first, size_t n) {
    const char *text = first;
    if (n == 0) return (struct cloud_guess){CLOUD_KIND_EMPTY, "an empty file"};
    if (is_ply(text, n)) return (struct cloud_guess){CLOUD_KIND_PLY, "PLY"};
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (begins(text, n, known[i].beginning, known[i].bytes))
            return (struct cloud_guess){CLOUD_KIND_OTHER, known[i].looks_like};
    if (has_control_character(text, n < LOOK_BYTES ? n : LOOK_BYTES))
        return (struct cloud_guess){CLOUD_KIND_OTHER, "binary data"};
    return (struct cloud_guess){CLOUD_KIND_TEXT, "text"};
}
