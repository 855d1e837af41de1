/* Decompression of gzip and zstd as a stream: bytes are pushed in, decompressed bytes come out through a callback.
 *
 *     struct inflate *inflate = NULL;
 *     status = inflate_new(kind, &limits, (struct inflate_out){take, ctx}, &inflate, error);
 *     for each piece, of any length:  status = inflate_push(inflate, piece, n, error);
 *     at the end:                     status = inflate_end(inflate, error);
 *     inflate_free(inflate);
 *
 * Concatenated members (gzip) and frames (zstd, skippable ones too) are one stream.  Checksums are checked.  Memory is
 * 64 KiB and the window: 32 KiB for gzip, what the data asks for up to max_window_bytes for zstd.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_CODEC_INFLATE_H
#define WHITTLE_CORE_IO_CODEC_INFLATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum inflate_kind { INFLATE_GZIP, INFLATE_ZSTD };

/* What a stream may become.  A small file that becomes a large one is refused as soon as it is found out. */
struct inflate_limits {
    uint64_t max_bytes;        /* decompressed; 0 = 64 GiB */
    uint32_t max_ratio;        /* decompressed to compressed, looked at beyond 16 MiB decompressed; 0 = 250 */
    uint64_t max_window_bytes; /* zstd's window, a power of two; 0 = 128 MiB */
};

/* take is called with at most 64 KiB at a time, never with 0 bytes; a status but STATUS_OK ends the stream, and is
 * what inflate_push then returns (take fills the error that it shares with its caller). */
struct inflate_out {
    enum status (*take)(void *ctx, const void *bytes, size_t n);
    void *ctx;
};

struct inflate;

/* Whether the n first bytes of a file begin such a stream (4 are enough to tell). */
bool inflate_sniff(const void *first, size_t n, enum inflate_kind *kind);

/* So many packed bytes have the beginning of what they become: zstd gives nothing of a block before its end, and a
 * block has up to 128 KiB. */
enum { INFLATE_HEAD_BYTES = 192 * 1024 };

/* Decompresses as much of a stream that begins with these n bytes as there is room for; what is broken ends it.  *total
 * (UINT64_MAX: not known) is how long the whole stream is, and becomes how long it may become, guessed by this part.
 * Returns how many bytes `to` has, 0 where there is no memory. */
size_t inflate_beginning(enum inflate_kind kind, const void *packed, size_t n, unsigned char *to, size_t room,
                         uint64_t *total);

/* Returns new *inflate, for inflate_free.  limits may be NULL.  STATUS_NO_MEMORY. */
enum status inflate_new(enum inflate_kind kind, const struct inflate_limits *limits, struct inflate_out out,
                        struct inflate **inflate, struct error *error) MUST_CHECK;

/* Takes the next n bytes.  STATUS_MALFORMED with the byte offset in the compressed data near which it breaks the
 * format; STATUS_LIMIT with where "inflate"; STATUS_NO_MEMORY; what out.take answered.  After a failure every call
 * returns the same status. */
enum status inflate_push(struct inflate *inflate, const void *bytes, size_t n, struct error *error) MUST_CHECK;

/* All bytes were pushed.  STATUS_MALFORMED where the stream isn't complete. */
enum status inflate_end(struct inflate *inflate, struct error *error) MUST_CHECK;

/* Accepts NULL. */
void inflate_free(struct inflate *inflate);

#endif
