/* Writes the same generated points as LAS and as LAZ, for tests with other readers, fixtures and benchmarks.
 *
 *     make_laz FORMAT EXTRA POINTS CHUNK ITEMS LAS LAZ
 *
 * FORMAT 0 to 10, with EXTRA extra bytes; CHUNK points in a chunk, 0: of other sizes, as COPC has them; ITEMS "new",
 * "old" (formats 0 to 5: version 1 of items, without chunks) or "4" (formats 6 to 10: version 4).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/tools/laz_points.h"

enum { VLR_BYTES = 54, OLD_HEADER_BYTES = 227, HEADER_BYTES = 375, CHUNKS_MOST = 100000 };

static void put_f64(unsigned char *p, double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    laz_store64(p, bits);
}

/* The header, and for LAZ the record that tells how: all before the points. */
static void put_head(struct laz_bytes *out, unsigned format, size_t n, const struct laz_layout *layout, bool is_laz) {
    unsigned char head[HEADER_BYTES] = "LASF", vlr[VLR_BYTES] = {0}, record[LAZ_LAYOUT_BYTES];
    size_t header = format < 6 ? OLD_HEADER_BYTES : HEADER_BYTES, length = laz_layout_store(layout, record);
    head[24] = 1, head[25] = format < 6 ? 2 : 4;
    laz_store16(head + 94, (uint32_t)header);
    laz_store32(head + 96, (uint32_t)(header + (is_laz ? VLR_BYTES + length : 0)));
    laz_store32(head + 100, is_laz);
    head[104] = (unsigned char)(format | (is_laz ? 0x80 : 0));
    laz_store16(head + 105, (uint32_t)layout->record_bytes);
    if (format < 6) laz_store32(head + 107, (uint32_t)n);
    for (size_t axis = 0; axis < 3; axis++) put_f64(head + 131 + 8 * axis, 0.01);
    laz_store64(head + 247, format < 6 ? 0 : n);
    laz_put(out, head, header);
    memcpy(vlr + 2, "laszip encoded", 14);
    laz_store16(vlr + 18, LAZ_RECORD_ID);
    laz_store16(vlr + 20, (uint32_t)length);
    if (is_laz) laz_put(out, vlr, VLR_BYTES), laz_put(out, record, length);
}

static void put_chunks(struct laz_bytes *out, const struct laz_layout *layout, const unsigned char *records, size_t n) {
    static uint64_t bytes[CHUNKS_MOST], points[CHUNKS_MOST];
    struct laz_codec *codec = laz_codec_new(layout);
    size_t place = out->used, count = 0;
    bool whole = layout->compressor == LAZ_POINTWISE;
    uint64_t seed = 3;
    if (!whole) laz_put_number(out, 0, 8);
    for (size_t i = 0; codec && i < n && count < CHUNKS_MOST; count++) {
        size_t size = whole ? n : layout->chunk_points, from = out->used;
        if (size == UINT32_MAX) size = 1 + laz_points_next(&seed) % 3000;
        points[count] = n - i < size ? n - i : size;
        laz_write_chunk(codec, records + i * layout->record_bytes, points[count], out);
        i += points[count];
        bytes[count] = out->used - from;
    }
    laz_codec_free(codec);
    if (whole) return;
    laz_store64(out->bytes + place, out->used);
    laz_chunks_write(out, layout->chunk_points == UINT32_MAX ? points : NULL, bytes, count);
}

static int save(struct laz_bytes *out, const char *path) {
    FILE *file = out->failed ? NULL : fopen(path, "wb");
    int good = file && fwrite(out->bytes, 1, out->used, file) == out->used;
    good = file && fclose(file) == 0 && good;
    free(out->bytes);
    return good;
}

int main(int argc, char **argv) {
    if (argc != 8) return fprintf(stderr, "see the top of make_laz.c\n"), 2;
    unsigned format = (unsigned)strtoul(argv[1], NULL, 10);
    size_t extra = strtoul(argv[2], NULL, 10), n = strtoul(argv[3], NULL, 10), chunk = strtoul(argv[4], NULL, 10);
    if (format >= LAZ_POINTS_FORMATS) return 2;
    struct laz_layout layout;
    struct laz_bytes las = {0}, laz = {0};
    laz_layout_make(format, laz_points_bytes[format] + extra, &layout);
    layout.chunk_points = chunk ? (uint32_t)chunk : UINT32_MAX;
    if (strcmp(argv[5], "old") == 0) layout.compressor = LAZ_POINTWISE;
    for (size_t i = 0; strcmp(argv[5], "new") != 0 && i < layout.item_count; i++)
        layout.item[i].version = argv[5][0] == '4' ? 4 : 1;
    unsigned char *records = laz_points_make(format, layout.record_bytes, n, 1 + format);
    put_head(&las, format, n, &layout, false);
    laz_put(&las, records, n * layout.record_bytes);
    put_head(&laz, format, n, &layout, true);
    put_chunks(&laz, &layout, records, n);
    free(records);
    return save(&las, argv[6]) & save(&laz, argv[7]) ? 0 : 1;
}
