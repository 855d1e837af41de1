/* zstd by libzstd.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <zstd.h>
#include <zstd_errors.h>

#include "core/base/alloc.h"
#include "core/io/codec/inflate_codec.h"

static int log2_of(uint64_t bytes) {
    int log = 10; /* the format's smallest window */
    while (log < 31 && UINT64_C(2) << log <= bytes) log++;
    return log;
}

static void *zstd_start(uint64_t max_window_bytes) {
    ZSTD_DCtx *context = ZSTD_createDCtx();
    if (context) (void)ZSTD_DCtx_setParameter(context, ZSTD_d_windowLogMax, log2_of(max_window_bytes));
    return context;
}

static enum codec_result zstd_step(void *state, struct codec_io *io) {
    ZSTD_inBuffer in = {io->in, io->in_bytes, 0};
    ZSTD_outBuffer out = {io->out, io->out_bytes, 0};
    size_t result = ZSTD_decompressStream(state, &out, &in);
    io->in += in.pos, io->in_bytes -= in.pos;
    io->out += out.pos, io->out_bytes -= out.pos;
    if (!ZSTD_isError(result)) return result == 0 ? CODEC_ENDED : CODEC_GOES_ON;
    ZSTD_ErrorCode code = ZSTD_getErrorCode(result);
    if (code == ZSTD_error_memory_allocation) return CODEC_NO_MEMORY;
    if (code == ZSTD_error_frameParameter_windowTooLarge) return CODEC_LIMIT;
    io->why = ZSTD_getErrorString(code);
    return CODEC_BROKEN;
}

static void zstd_restart(void *state) { (void)ZSTD_DCtx_reset(state, ZSTD_reset_session_only); }

static void zstd_stop(void *state) { ZSTD_freeDCtx(state); }

const struct inflate_codec inflate_codec_zstd = {zstd_start, zstd_step, zstd_restart, zstd_stop};
