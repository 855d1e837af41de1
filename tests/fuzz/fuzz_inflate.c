/* Fuzzes decompression: gzip and zstd, cut into pieces by the first byte; however a stream is cut, it becomes the
 * same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>

#include "core/io/codec/inflate.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct sum {
    uint64_t bytes, hash;
};

static enum status take(void *ctx, const void *bytes, size_t n) {
    struct sum *sum = ctx;
    const unsigned char *at = bytes;
    if (n == 0) abort();
    for (size_t i = 0; i < n; i++) sum->hash = (sum->hash ^ at[i]) * 1099511628211u;
    sum->bytes += n;
    return STATUS_OK;
}

static enum status run(const uint8_t *data, size_t size, size_t piece, enum inflate_kind kind, struct sum *sum) {
    struct inflate *inflate = NULL;
    struct error error = {0};
    struct inflate_limits limits = {.max_bytes = 1 << 22, .max_window_bytes = 1 << 20};
    *sum = (struct sum){0};
    enum status status = inflate_new(kind, &limits, (struct inflate_out){take, sum}, &inflate, &error);
    for (size_t at = 0; !status && at < size; at += piece)
        status = inflate_push(inflate, data + at, size - at < piece ? size - at : piece, &error);
    if (!status) status = inflate_end(inflate, &error);
    if (status && (error.code != status || !error.text[0])) abort();
    if (sum->bytes > limits.max_bytes) abort();
    inflate_free(inflate);
    return status;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct sum whole, pieces;
    enum inflate_kind kind = INFLATE_GZIP;
    if (size < 2) return 0;
    if (!inflate_sniff(data + 1, size - 1, &kind)) kind = data[0] & 1 ? INFLATE_GZIP : INFLATE_ZSTD;
    enum status a = run(data + 1, size - 1, size, kind, &whole);
    enum status b = run(data + 1, size - 1, 1u + data[0] % 7u, kind, &pieces);
    /* libzstd takes a frame that is there as a whole another way, which has no window and compares the length with the
     * one that the frame's header may tell. */
    if (a != b && kind == INFLATE_GZIP) abort();
    if (!a && !b && (whole.bytes != pieces.bytes || whole.hash != pieces.hash)) abort();
    return 0;
}
