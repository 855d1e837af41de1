/* gzip by zlib.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <zlib.h>

#include "core/base/alloc.h"
#include "core/io/codec/inflate_codec.h"

enum { GZIP_ONLY = 16 }; /* zlib's window bits plus this: a gzip header is a must */

static void *gzip_start(uint64_t max_window_bytes) {
    (void)max_window_bytes;
    z_stream *stream = alloc_zeroed(1, sizeof *stream);
    if (stream && inflateInit2(stream, MAX_WBITS + GZIP_ONLY) == Z_OK) return stream;
    free(stream);
    return NULL;
}

static uInt at_most(size_t n) { return n < 1u << 30 ? (uInt)n : 1u << 30; }

static enum codec_result gzip_step(void *state, struct codec_io *io) {
    z_stream *stream = state;
    stream->next_in = (Bytef *)(uintptr_t)io->in; /* zlib doesn't write to it */
    stream->next_out = io->out;
    uInt in = stream->avail_in = at_most(io->in_bytes), out = stream->avail_out = at_most(io->out_bytes);
    int result = inflate(stream, Z_NO_FLUSH);
    io->in += in - stream->avail_in, io->in_bytes -= in - stream->avail_in;
    io->out += out - stream->avail_out, io->out_bytes -= out - stream->avail_out;
    if (result == Z_STREAM_END) return CODEC_ENDED;
    if (result == Z_OK || result == Z_BUF_ERROR) return CODEC_GOES_ON;
    if (result == Z_MEM_ERROR) return CODEC_NO_MEMORY;
    io->why = stream->msg ? stream->msg : "not gzip";
    return CODEC_BROKEN;
}

static void gzip_restart(void *state) { (void)inflateReset(state); }

static void gzip_stop(void *state) {
    if (state) (void)inflateEnd(state);
    free(state);
}

const struct inflate_codec inflate_codec_gzip = {gzip_start, gzip_step, gzip_restart, gzip_stop};
