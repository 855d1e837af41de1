/* The table of chunks, and a chunk's points.
 *
 * The table is where the 8 bytes before the first chunk say; a writer that could not go back put -1 there, and the
 * place at the file's end.  Its numbers are coded as differences from the entry before.  Where there is no table, since
 * the file was cut short or its writer ended too early, chunks are found by reading them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/laz/items.h"

enum { PLACE_BYTES = 8, TABLE_HEAD_BYTES = 8, COUNT_BYTES = 4 };

struct laz_codec {
    struct laz_layout layout;
    struct laz_pointwise *pointwise; /* one of the two is there; owned */
    struct laz_layered *layered;
    struct laz_coder coder; /* pointwise: of the chunk */
    const unsigned char *first;
    bool is_first;
    unsigned char record[LAZ_RECORD_MOST];
};

/* ------------------------------------------------------------------------------------------------ the table */

struct table {
    struct laz_coder coder;
    struct laz_integer number;
    uint16_t *data; /* owned */
};

static enum status begin_table(struct table *table) {
    struct laz_room room = {0};
    memset(table, 0, sizeof *table);
    laz_integer_lay(&table->number, 32, 2, &room);
    room.data = table->data = alloc_array(room.used, sizeof *room.data);
    room.used = 0;
    if (!table->data) return STATUS_NO_MEMORY;
    laz_integer_lay(&table->number, 32, 2, &room);
    laz_integer_begin(&table->number);
    return STATUS_OK;
}

static enum status bad_table(struct error *error, uint64_t byte, const char *what, uint64_t value) {
    return error_set_at(error, STATUS_MALFORMED, "chunks", 0, byte, "%s (%" PRIu64 ")", what, value);
}

/* Where the table begins: as the file says, from its beginning. */
static enum status find_table(const unsigned char *bytes, size_t n, uint64_t begin, uint64_t *at, struct error *error) {
    if (n < begin || n - begin < PLACE_BYTES)
        return bad_table(error, n, "the file ends before its chunks; bytes there", n);
    *at = laz_load64(bytes + begin);
    if (*at == UINT64_MAX) *at = laz_load64(bytes + n - PLACE_BYTES);
    if (*at < begin + PLACE_BYTES || *at > n || n - *at < TABLE_HEAD_BYTES)
        return bad_table(error, begin, "the table of chunks is out of range", *at);
    return STATUS_OK;
}

static enum status read_entries(struct table *table, uint64_t at, uint64_t points, uint64_t end,
                                const struct laz_layout *layout, struct laz_chunks *chunks, struct error *error) {
    uint32_t last_points = 0, last_bytes = 0;
    for (size_t i = 0; i < chunks->count; i++) {
        uint64_t left = points - chunks->point[i];
        if (layout->chunk_points == UINT32_MAX)
            last_points = laz_code_integer(&table->coder, &table->number, last_points, 0, 0, false);
        else
            last_points = left < layout->chunk_points ? (uint32_t)left : layout->chunk_points;
        last_bytes = laz_code_integer(&table->coder, &table->number, last_bytes, 1, 0, false);
        if (table->coder.missing || table->coder.broken)
            return bad_table(error, at, "the table of chunks ends in chunk", i);
        if (last_points > left) return bad_table(error, at, "there are more points than promised, from chunk", i);
        if (last_bytes > end - chunks->byte[i])
            return bad_table(error, at, "more bytes than there are before the table, from chunk", i);
        if (last_bytes < layout->record_bytes && last_points > 0)
            return bad_table(error, at, "too few bytes for a point, in chunk", i);
        chunks->point[i + 1] = chunks->point[i] + last_points;
        chunks->byte[i + 1] = chunks->byte[i] + last_bytes;
    }
    if (chunks->point[chunks->count] < points)
        return bad_table(error, at, "the chunks have fewer points than promised", chunks->point[chunks->count]);
    return STATUS_OK;
}

static enum status make_chunks(size_t count, uint64_t begin, struct laz_chunks *chunks, struct error *error) {
    *chunks = (struct laz_chunks){.count = count,
                                  .point = alloc_zeroed(count + 1, sizeof *chunks->point),
                                  .byte = alloc_zeroed(count + 1, sizeof *chunks->byte)};
    if (!chunks->point || !chunks->byte)
        return error_set(error, STATUS_NO_MEMORY, "chunks", "no memory for a table of %zu chunks", count);
    chunks->byte[0] = begin;
    return STATUS_OK;
}

/* Old files are one chunk, to their end, without a table. */
static enum status one_chunk(size_t n, uint64_t begin, uint64_t points, struct laz_chunks *chunks,
                             struct error *error) {
    enum status status = make_chunks(1, begin, chunks, error);
    if (status) return status;
    chunks->point[1] = points;
    chunks->byte[1] = n;
    return STATUS_OK;
}

/* Points compress well, but not without end. */
static enum status check_points(uint64_t points, size_t n, uint64_t begin, struct error *error) {
    if (points / LAZ_POINTS_PER_BYTE <= n - begin) return STATUS_OK;
    return error_set_at(error, STATUS_MALFORMED, "points", 0, n,
                        "%" PRIu64 " points are promised, more than any that %" PRIu64 " compressed bytes can hold",
                        points, n - begin);
}

/* *is_cut: the file ends before the table does, so far as can be told. */
static enum status read_table(const unsigned char *bytes, size_t n, uint64_t begin, uint64_t points,
                              const struct laz_layout *layout, struct laz_chunks *chunks, bool *is_cut,
                              struct error *error) {
    struct table table = {0};
    uint64_t at = 0, count = 0, wanted = points / layout->chunk_points + (points % layout->chunk_points > 0);
    enum status status = find_table(bytes, n, begin, &at, error);
    *is_cut = status && n > begin && n - begin >= PLACE_BYTES &&
              (at > n - TABLE_HEAD_BYTES || laz_load64(bytes + begin) == UINT64_MAX);
    if (status) return status;
    count = laz_load32(bytes + at + 4);
    if (laz_load32(bytes + at) != 0)
        status = bad_table(error, at, "the version of the table of chunks isn't known", laz_load32(bytes + at));
    else if (layout->chunk_points != UINT32_MAX && count < wanted)
        status = bad_table(error, at + 4, "there are fewer chunks than the points take", count);
    else if (layout->chunk_points != UINT32_MAX)
        count = wanted;
    else if (count > (at - begin) / layout->record_bytes + 1)
        status = bad_table(error, at + 4, "there are more chunks than the bytes can hold", count);
    if (!status) status = make_chunks((size_t)count, begin + PLACE_BYTES, chunks, error);
    if (!status && begin_table(&table))
        status = error_set(error, STATUS_NO_MEMORY, "chunks", "no memory for the table of chunks");
    if (!status && count > 0) {
        table.coder = laz_coder_read(bytes + at + TABLE_HEAD_BYTES, n - (size_t)at - TABLE_HEAD_BYTES);
        status = read_entries(&table, at, points, at, layout, chunks, error);
        *is_cut = status && table.coder.missing;
    }
    free(table.data);
    return status;
}

/* ------------------------------------------------------------------------------------------------ without a table */

/* A chunk at these n bytes, of at most so many points: how many it has, and how long it is; 0: none that is whole. */
static uint64_t measure_layered(const struct laz_layout *layout, const unsigned char *bytes, size_t n, size_t *length) {
    size_t layers = laz_layers(layout), sizes = layout->record_bytes + COUNT_BYTES, at = sizes + 4 * layers;
    if (n < at) return 0;
    for (size_t i = 0; i < layers; i++) {
        size_t size = laz_load32(bytes + sizes + 4 * i);
        if (size > n - at) return 0;
        at += size;
    }
    *length = at;
    return laz_load32(bytes + layout->record_bytes);
}

/* The same of a pointwise one, whose end is where the code of its points ends. */
static uint64_t measure_pointwise(struct laz_codec *codec, const unsigned char *bytes, size_t n, uint64_t points,
                                  size_t *length) {
    if (laz_read_begin(codec, bytes, n, points)) return 0;
    for (uint64_t i = 0; i < points; i++)
        if (!laz_read_point(codec)) return 0;
    if (codec->coder.missing || codec->coder.broken) return 0;
    *length = (size_t)(codec->coder.at - bytes);
    return points;
}

static enum status append_chunk(struct laz_chunks *chunks, uint64_t points, size_t length) {
    size_t count = chunks->count, room = count + 2;
    if ((count & (count + 1)) == 0) { /* 0, 1, 3, 7 ... are full */
        uint64_t *point = alloc_resize(chunks->point, 2 * room, sizeof *point);
        if (point) chunks->point = point;
        uint64_t *byte = point ? alloc_resize(chunks->byte, 2 * room, sizeof *byte) : NULL;
        if (!byte) return STATUS_NO_MEMORY;
        chunks->byte = byte;
    }
    chunks->point[count + 1] = chunks->point[count] + points;
    chunks->byte[count + 1] = chunks->byte[count] + length;
    chunks->count++;
    return STATUS_OK;
}

/* All chunks that are whole, from the first on, by reading them.  Where each has a number of points of its own, which
 * the table alone knows of pointwise ones, there are none. */
static enum status search_chunks(const unsigned char *bytes, size_t n, uint64_t begin, uint64_t points,
                                 const struct laz_layout *layout, struct laz_chunks *chunks, struct error *error) {
    struct laz_codec *codec = laz_codec_new(layout);
    enum status status = make_chunks(0, begin + PLACE_BYTES, chunks, error);
    if (!status && !codec) status = error_set(error, STATUS_NO_MEMORY, "chunks", "no memory to decompress with");
    bool is_layered = layout->compressor == LAZ_LAYERED, known = is_layered || layout->chunk_points != UINT32_MAX;
    while (!status && known && chunks->point[chunks->count] < points) {
        uint64_t at = chunks->byte[chunks->count], left = points - chunks->point[chunks->count];
        uint64_t most = left < layout->chunk_points ? left : layout->chunk_points;
        size_t length = 0;
        uint64_t found = is_layered ? measure_layered(layout, bytes + at, n - (size_t)at, &length)
                                    : measure_pointwise(codec, bytes + at, n - (size_t)at, most, &length);
        if (found == 0 || found > most) break;
        if (append_chunk(chunks, found, length))
            status = error_set(error, STATUS_NO_MEMORY, "chunks", "no memory for a table of %zu chunks", chunks->count);
    }
    laz_codec_free(codec);
    return status;
}

enum status laz_chunks_read(const unsigned char *bytes, size_t n, uint64_t begin, uint64_t points,
                            const struct laz_layout *layout, struct laz_chunks *chunks, struct error *error) {
    struct laz_chunks made = {0};
    bool is_cut = false;
    enum status status = check_points(points, n, begin, error);
    if (!status && layout->compressor == LAZ_POINTWISE)
        status = one_chunk(n, begin, points, &made, error);
    else if (!status)
        status = read_table(bytes, n, begin, points, layout, &made, &is_cut, error);
    if (status == STATUS_MALFORMED && n > begin && n - begin > PLACE_BYTES && layout->compressor != LAZ_POINTWISE) {
        struct error of_search;
        laz_chunks_free(&made);
        enum status searched = search_chunks(bytes, n, begin, points, layout, &made, &of_search);
        uint64_t found = searched ? 0 : made.point[made.count];
        made.searched = true;
        if (searched)
            status = searched, *error = of_search;
        else if (found == points || (is_cut && found > 0))
            status = STATUS_OK;
    }
    if (status)
        laz_chunks_free(&made);
    else
        *chunks = made;
    return status;
}

void laz_chunks_free(struct laz_chunks *chunks) {
    free(chunks->point), free(chunks->byte);
    *chunks = (struct laz_chunks){0};
}

void laz_chunks_write(struct laz_bytes *out, const uint64_t *points, const uint64_t *bytes, size_t count) {
    struct table table;
    uint32_t last = 0, last_points = 0;
    if (begin_table(&table)) {
        out->failed = true;
        return;
    }
    laz_put_number(out, 0, 4);
    laz_put_number(out, count, 4);
    table.coder = laz_coder_write(out);
    for (size_t i = 0; i < count; i++) {
        if (points)
            last_points = laz_code_integer(&table.coder, &table.number, last_points, 0, (uint32_t)points[i], true);
        last = laz_code_integer(&table.coder, &table.number, last, 1, (uint32_t)bytes[i], true);
    }
    if (count) laz_coder_finish(&table.coder);
    free(table.data);
}

/* ------------------------------------------------------------------------------------------------ a chunk */

struct laz_codec *laz_codec_new(const struct laz_layout *layout) {
    struct laz_codec *codec = alloc_zeroed(1, sizeof *codec);
    if (!codec) return NULL;
    codec->layout = *layout;
    if (layout->compressor == LAZ_LAYERED)
        codec->layered = laz_layered_new(layout);
    else
        codec->pointwise = laz_pointwise_new(layout);
    if (codec->layered || codec->pointwise) return codec;
    free(codec);
    return NULL;
}

void laz_codec_free(struct laz_codec *codec) {
    if (!codec) return;
    laz_pointwise_free(codec->pointwise);
    laz_layered_free(codec->layered);
    free(codec);
}

/* Of pointwise codecs, models of all values of three bytes; of layered ones, those of four channels; and of each extra
 * byte one or four. */
size_t laz_codec_bytes(unsigned format, size_t record_bytes) {
    enum { POINTWISE = 1300000, LAYERED = 1800000, MODEL = 1300 };
    return format < 6 ? POINTWISE + record_bytes * MODEL : LAYERED + 4 * record_bytes * MODEL;
}

static const char *begin_layers(struct laz_codec *codec, const unsigned char *bytes, size_t n, uint64_t points) {
    size_t layers = laz_layers(&codec->layout), at = codec->layout.record_bytes, sizes = at + COUNT_BYTES;
    if (n - at < COUNT_BYTES + 4 * layers) return "it ends in the sizes of its layers";
    if (laz_load32(bytes + at) != points) return "it counts other points than the table of chunks";
    at = sizes + 4 * layers;
    for (size_t i = 0; i < layers; i++) {
        size_t size = laz_load32(bytes + sizes + 4 * i);
        if (size > n - at) return "a layer reaches behind its end";
        laz_layered_read_layer(codec->layered, i, bytes + at, size);
        at += size;
    }
    if (points > 1 && laz_load32(bytes + sizes) == 0) return "its first layer is empty";
    return at == n ? NULL : "bytes are left behind its layers";
}

const char *laz_read_begin(struct laz_codec *codec, const unsigned char *bytes, size_t n, uint64_t points) {
    size_t first = codec->layout.record_bytes;
    if (n < first) return "it ends in its first point";
    codec->first = bytes;
    codec->is_first = true;
    if (codec->layered) {
        laz_layered_begin(codec->layered, bytes);
        return begin_layers(codec, bytes, n, points);
    }
    laz_pointwise_begin(codec->pointwise, bytes);
    codec->coder = laz_coder_read(bytes + first, n - first);
    if (points == 1 && n == first) codec->coder.missing = 0;
    return NULL;
}

/* Whether a coder has gone on behind its end: the zeros there may go on for ever. */
static bool has_run_out(const struct laz_codec *codec) {
    enum { BEHIND = 8 };
    if (codec->pointwise) return codec->coder.missing > BEHIND || codec->coder.broken;
    const struct laz_coder *coder = laz_layered_coder(codec->layered, 0);
    return coder->missing > BEHIND || coder->broken;
}

const unsigned char *laz_read_point(struct laz_codec *codec) {
    if (codec->is_first) {
        codec->is_first = false;
        return codec->first;
    }
    if (has_run_out(codec)) return NULL;
    if (codec->layered)
        laz_layered_read(codec->layered, codec->record);
    else
        laz_pointwise_read(codec->pointwise, &codec->coder, codec->record);
    return codec->record;
}

/* left_most: bytes that a writer may have put behind the end of its code. */
static const char *check_coder(const struct laz_coder *coder, size_t left_most) {
    if (coder->broken) return "its bytes are no arithmetic code";
    if (coder->missing) return "it ends before its points do";
    if ((size_t)(coder->end - coder->at) > left_most) return "bytes are left behind its points";
    return NULL;
}

const char *laz_read_end(const struct laz_codec *codec) {
    enum { LAYER_LEFT_MOST = 4 }; /* readers find the next layer by its size, so some writers end them carelessly */
    const char *wrong = NULL;
    bool to_the_end = codec->layout.compressor == LAZ_POINTWISE; /* of the file, where records may follow */
    if (codec->pointwise) return check_coder(&codec->coder, to_the_end ? SIZE_MAX : 0);
    for (size_t i = 0; !wrong && i < laz_layers(&codec->layout); i++) {
        const struct laz_coder *coder = laz_layered_coder(codec->layered, i);
        if (coder->length) wrong = check_coder(coder, LAYER_LEFT_MOST);
    }
    return wrong;
}

void laz_write_chunk(struct laz_codec *codec, const unsigned char *records, size_t n, struct laz_bytes *out) {
    size_t each = codec->layout.record_bytes;
    laz_put(out, records, each);
    if (codec->layered) {
        laz_layered_begin(codec->layered, records);
        for (size_t i = 1; i < n; i++) laz_layered_write(codec->layered, records + i * each);
        laz_put_number(out, n, COUNT_BYTES);
        laz_layered_finish(codec->layered, out);
        return;
    }
    laz_pointwise_begin(codec->pointwise, records);
    struct laz_coder coder = laz_coder_write(out);
    for (size_t i = 1; i < n; i++) laz_pointwise_write(codec->pointwise, &coder, records + i * each);
    laz_coder_finish(&coder);
}
