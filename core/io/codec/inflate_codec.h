/* What a decompressing library is to core/io/codec/inflate.c.  For core/inflate*.c alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_CODEC_INFLATE_CODEC_H
#define WHITTLE_CORE_IO_CODEC_INFLATE_CODEC_H

#include <stddef.h>
#include <stdint.h>

enum codec_result {
    CODEC_GOES_ON, /* all input is taken, or all room is used */
    CODEC_ENDED,   /* a member is complete; the next one may follow */
    CODEC_BROKEN,  /* the data breaks the format */
    CODEC_NO_MEMORY,
    CODEC_LIMIT /* the window is over the limit */
};

/* Moved on by a step: in and out by what was taken and made. */
struct codec_io {
    const unsigned char *in;
    size_t in_bytes;
    unsigned char *out;
    size_t out_bytes;
    const char *why; /* CODEC_BROKEN: static text, never NULL then */
};

struct inflate_codec {
    void *(*start)(uint64_t max_window_bytes); /* NULL: no memory */
    enum codec_result (*step)(void *state, struct codec_io *io);
    void (*restart)(void *state); /* for the next member */
    void (*stop)(void *state);
};

extern const struct inflate_codec inflate_codec_gzip, inflate_codec_zstd;

#endif
