/* What a point of each format is made of, and the record that says so.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "core/io/laz/items.h"

enum { FORMATS = 11, HEAD_BYTES = 34, ITEM_BYTES = 6, NEWEST_OLD = 2, NEWEST = 4, OURS = 3, UNKNOWN_NUMBER = 8 };

static size_t bytes_of(enum laz_type type) {
    static const size_t bytes[] = {
        [LAZ_POINT10] = 20, [LAZ_TIME11] = 8,   [LAZ_RGB12] = 6,   [LAZ_WAVE13] = 29, [LAZ_POINT14] = 30,
        [LAZ_RGB14] = 6,    [LAZ_RGBNIR14] = 8, [LAZ_WAVE14] = 29, [LAZ_BYTES14] = 0};
    return bytes[type];
}

/* Items of each point format but extra bytes. */
static const enum laz_type items_of[FORMATS][4] = {
    {LAZ_POINT10},
    {LAZ_POINT10, LAZ_TIME11},
    {LAZ_POINT10, LAZ_RGB12},
    {LAZ_POINT10, LAZ_TIME11, LAZ_RGB12},
    {LAZ_POINT10, LAZ_TIME11, LAZ_WAVE13},
    {LAZ_POINT10, LAZ_TIME11, LAZ_RGB12, LAZ_WAVE13},
    {LAZ_POINT14},
    {LAZ_POINT14, LAZ_RGB14},
    {LAZ_POINT14, LAZ_RGBNIR14},
    {LAZ_POINT14, LAZ_WAVE14},
    {LAZ_POINT14, LAZ_RGBNIR14, LAZ_WAVE14},
};

static void add_item(struct laz_layout *layout, enum laz_type type, unsigned version, size_t bytes) {
    layout->item[layout->item_count++] = (struct laz_item){type, version, bytes, layout->record_bytes};
    layout->record_bytes += bytes;
}

/* Every item but waveforms of old formats has a second version. */
void laz_layout_make(unsigned format, size_t record_bytes, struct laz_layout *layout) {
    bool layered = format >= 6;
    *layout = (struct laz_layout){.compressor = layered ? LAZ_LAYERED : LAZ_POINTWISE_CHUNKED,
                                  .chunk_points = LAZ_USUAL_CHUNK};
    for (size_t i = 0; i < 4 && items_of[format][i]; i++) {
        enum laz_type type = items_of[format][i];
        add_item(layout, type, layered ? OURS : type == LAZ_WAVE13 ? 1 : NEWEST_OLD, bytes_of(type));
    }
    size_t extra = record_bytes - layout->record_bytes;
    if (extra) add_item(layout, layered ? LAZ_BYTES14 : LAZ_BYTES, layered ? OURS : NEWEST_OLD, extra);
}

size_t laz_layout_store(const struct laz_layout *layout, unsigned char record[LAZ_LAYOUT_BYTES]) {
    memset(record, 0, LAZ_LAYOUT_BYTES);
    laz_store16(record, layout->compressor);
    record[4] = 3, record[5] = 4; /* the version of LASzip whose format this is: 3.4 */
    laz_store32(record + 12, layout->chunk_points);
    memset(record + 16, 0xff, 2 * UNKNOWN_NUMBER); /* special records behind the points: none told */
    laz_store16(record + 32, (uint32_t)layout->item_count);
    for (size_t i = 0; i < LAZ_ITEMS_MOST && i < layout->item_count; i++) {
        unsigned char *item = record + HEAD_BYTES + ITEM_BYTES * i;
        laz_store16(item, layout->item[i].type);
        laz_store16(item + 2, (uint32_t)layout->item[i].bytes);
        laz_store16(item + 4, layout->item[i].version);
    }
    return HEAD_BYTES + ITEM_BYTES * layout->item_count;
}

static bool is_known_version(unsigned type, unsigned version) {
    if (type >= LAZ_POINT14) return version == OURS || version == NEWEST;
    return version == 1 || (version == NEWEST_OLD && type != LAZ_WAVE13);
}

const char *laz_layout_take(const unsigned char *record, size_t n, unsigned format, size_t record_bytes,
                            struct laz_layout *layout) {
    struct laz_layout expected;
    if (n < HEAD_BYTES) return "the record that says how it is compressed is cut short";
    if (record_bytes > LAZ_RECORD_MOST) return "the points are longer than 4096 bytes";
    laz_layout_make(format, record_bytes, &expected);
    unsigned compressor = laz_load16(record), coder = laz_load16(record + 2);
    size_t count = laz_load16(record + 32);
    bool layered = expected.compressor == LAZ_LAYERED;
    if (layered ? compressor != LAZ_LAYERED : compressor != LAZ_POINTWISE && compressor != LAZ_POINTWISE_CHUNKED)
        return "it is compressed in a way that isn't known for its point format";
    if (coder != 0) return "its entropy coder isn't known";
    if (n < HEAD_BYTES + ITEM_BYTES * count) return "the record that says how it is compressed is cut short";
    if (count != expected.item_count) return "the items that are compressed aren't those of its point format";
    for (size_t i = 0; i < count; i++) {
        const unsigned char *item = record + HEAD_BYTES + ITEM_BYTES * i;
        if (laz_load16(item) != expected.item[i].type || laz_load16(item + 2) != expected.item[i].bytes)
            return "the items that are compressed aren't those of its point format";
        expected.item[i].version = laz_load16(item + 4);
        if (!is_known_version(expected.item[i].type, expected.item[i].version))
            return "the version of an item isn't known";
        if (expected.item[i].type == LAZ_BYTES && expected.item[i].version == 1 &&
            expected.item[i].bytes > LAZ_CONTEXTS)
            return "old LAZ with so many extra bytes isn't read";
    }
    expected.compressor = compressor;
    expected.chunk_points = compressor == LAZ_POINTWISE ? UINT32_MAX : laz_load32(record + 12);
    if (expected.chunk_points == 0) return "its chunks have no points";
    *layout = expected;
    return NULL;
}
