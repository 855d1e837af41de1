/* LAZ: points of LAS, compressed in chunks, as LASzip has it (LAZ Specification 1.4).  Reading and writing of chunks;
 * what stands around them is LAS and is told in core/io/formats/las_read.c and las_write.c.
 *
 *     at "offset to point data":  where the table of chunks is (8 bytes) | chunk | chunk ... | table of chunks
 *     a chunk, pointwise:         its first point as it is | all others in one arithmetic code
 *     a chunk, layered:           its first point as it is | count | sizes of layers | layers, each a code of its own
 *
 * A record of the file ("laszip encoded" 22204) says which items a point is made of and how many points a chunk has.
 * Formats 0 to 5 are pointwise (compressor 2; 1 is the same without chunks, and older items), 6 to 10 layered (3).
 * Chunks know nothing of each other, so they are coded on as many threads as there are.
 *
 * A file has no checksum.  What can be checked is: every size, and that a chunk's bytes are used up by its points, not
 * fewer and not more.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_LAZ_LAZ_H
#define WHITTLE_CORE_IO_LAZ_LAZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/io/laz/coder.h"

enum {
    LAZ_ITEMS_MOST = 5,
    LAZ_RECORD_MOST = 4096, /* bytes of a point; no cloud holds as many properties */
    LAZ_USUAL_CHUNK = 50000,
    LAZ_RECORD_ID = 22204,
    LAZ_LAYOUT_BYTES = 34 + 6 * LAZ_ITEMS_MOST, /* of the record, at most */
    LAZ_POINTS_PER_BYTE = 2048 /* above what any model can reach: a point takes five symbols of 2^-9 bits and more */
};

enum laz_compressor { LAZ_POINTWISE = 1, LAZ_POINTWISE_CHUNKED = 2, LAZ_LAYERED = 3 };

/* What the record says.  Items are in the order of a point's bytes. */
struct laz_layout {
    unsigned compressor;   /* enum laz_compressor */
    uint32_t chunk_points; /* UINT32_MAX: the table tells it of each chunk */
    size_t record_bytes;
    size_t item_count;
    struct laz_item {
        unsigned type, version;
        size_t bytes, offset;
    } item[LAZ_ITEMS_MOST];
};

/* Takes the n bytes of the record.  NULL, or what is wrong with it: its items must be those of the point format (0 to
 * 10) and the length of the points.  Static. */
const char *laz_layout_take(const unsigned char *record, size_t n, unsigned format, size_t record_bytes,
                            struct laz_layout *layout);

/* The layout that we write of such points, and its record (LAZ_LAYOUT_BYTES or fewer; returns how many). */
void laz_layout_make(unsigned format, size_t record_bytes, struct laz_layout *layout);
size_t laz_layout_store(const struct laz_layout *layout, unsigned char record[LAZ_LAYOUT_BYTES]);

/* ------------------------------------------------------------------------------------------------ chunks */

/* Bounds of chunks: chunk i has points point[i] .. point[i + 1] - 1 in bytes byte[i] .. byte[i + 1] - 1. */
struct laz_chunks {
    size_t count;
    uint64_t *point, *byte; /* count + 1; owned */
    bool searched;          /* there was no table that could be read */
};

/* Reads the table of the chunks of so many points, which begin at byte `begin` of the n, with where the table is. Where
 * the file was cut short there are as many points as its whole chunks have, at least one.  STATUS_MALFORMED (error says
 * where and what), STATUS_NO_MEMORY. */
enum status laz_chunks_read(const unsigned char *bytes, size_t n, uint64_t begin, uint64_t points,
                            const struct laz_layout *layout, struct laz_chunks *chunks, struct error *error) MUST_CHECK;
void laz_chunks_free(struct laz_chunks *chunks);

/* The table for chunks of these sizes in bytes; points NULL: all have as many points, as the layout says. */
void laz_chunks_write(struct laz_bytes *out, const uint64_t *points, const uint64_t *bytes, size_t count);

/* ------------------------------------------------------------------------------------------------ points */

/* What codes chunks, one after the other; for one thread.  Takes laz_codec_bytes, in any number of uses.  Returns new;
 * NULL where there is no memory. */
struct laz_codec;
struct laz_codec *laz_codec_new(const struct laz_layout *layout);
void laz_codec_free(struct laz_codec *codec);
size_t laz_codec_bytes(unsigned format, size_t record_bytes);

/* Begins a chunk of n bytes and so many points.  NULL, or what is wrong. */
const char *laz_read_begin(struct laz_codec *codec, const unsigned char *bytes, size_t n, uint64_t points);
/* The next point.  NULL: the bytes end before it. */
const unsigned char *laz_read_point(struct laz_codec *codec);
/* After the last point: NULL, or what is wrong: bytes are missing, left, or no code. */
const char *laz_read_end(const struct laz_codec *codec);

/* Appends a chunk of n > 0 points.  Where memory runs out, out->failed says so. */
void laz_write_chunk(struct laz_codec *codec, const unsigned char *records, size_t n, struct laz_bytes *out);

#endif
