/* Streams of compressed members, and the limits on what comes out.
 *
 * A codec decompresses one member; here members are joined, what comes out is counted and given away buffer by buffer.
 * A member that has begun must end: begun says that bytes of the current one were taken.
 *
 * The ratio is looked at after each buffer, against the bytes pushed so far and not those of the current piece alone,
 * so how the caller cuts the stream into pieces changes nothing but by less than a piece.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/codec/inflate.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/codec/inflate_codec.h"

enum { BUFFER_BYTES = 64 * 1024, DEFAULT_RATIO = 250, MADE_MOST_BYTES = 4 << 20 };
#define RATIO_FROM_BYTES (UINT64_C(16) << 20)
#define DEFAULT_BYTES (UINT64_C(64) << 30)
#define DEFAULT_WINDOW_BYTES (UINT64_C(128) << 20)

static const struct {
    const char *name;
    const unsigned char magic[4];
    size_t magic_bytes;
    const struct inflate_codec *codec;
} kinds[] = {
    [INFLATE_GZIP] = {"gzip", {0x1f, 0x8b}, 2, &inflate_codec_gzip},
    [INFLATE_ZSTD] = {"zstd", {0x28, 0xb5, 0x2f, 0xfd}, 4, &inflate_codec_zstd},
};

struct inflate {
    enum inflate_kind kind;
    struct inflate_limits limits; /* resolved */
    struct inflate_out out;
    void *state; /* of the codec; owned */
    uint64_t bytes_in, bytes_out;
    bool begun;         /* a member that isn't complete */
    bool ended;         /* a member that is */
    enum status failed; /* sticks */
    unsigned char buffer[BUFFER_BYTES];
};

/* A frame of zstd that holds no data may come first: 0x184d2a50 to 0x184d2a5f. */
static bool is_skippable(const unsigned char *bytes, size_t n) {
    return n >= 4 && (bytes[0] & 0xf0) == 0x50 && bytes[1] == 0x2a && bytes[2] == 0x4d && bytes[3] == 0x18;
}

bool inflate_sniff(const void *first, size_t n, enum inflate_kind *kind) {
    *kind = INFLATE_ZSTD;
    if (is_skippable(first, n)) return true;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        if (n < kinds[i].magic_bytes || memcmp(first, kinds[i].magic, kinds[i].magic_bytes) != 0) continue;
        *kind = (enum inflate_kind)i;
        return true;
    }
    return false;
}

enum status inflate_new(enum inflate_kind kind, const struct inflate_limits *limits, struct inflate_out out,
                        struct inflate **inflate, struct error *error) {
    struct inflate *made = alloc_array(1, sizeof *made);
    if (!made) return error_set(error, STATUS_NO_MEMORY, "inflate", "no memory");
    struct inflate_limits l = limits ? *limits : (struct inflate_limits){0};
    made->kind = kind;
    made->limits.max_bytes = l.max_bytes ? l.max_bytes : DEFAULT_BYTES;
    made->limits.max_ratio = l.max_ratio ? l.max_ratio : DEFAULT_RATIO;
    made->limits.max_window_bytes = l.max_window_bytes ? l.max_window_bytes : DEFAULT_WINDOW_BYTES;
    made->out = out;
    made->bytes_in = made->bytes_out = 0;
    made->begun = made->ended = false;
    made->failed = STATUS_OK;
    made->state = kinds[kind].codec->start(made->limits.max_window_bytes);
    if (made->state) {
        *inflate = made;
        return STATUS_OK;
    }
    free(made);
    return error_set(error, STATUS_NO_MEMORY, "inflate", "no memory");
}

static enum status over(const struct inflate *inflate, struct error *error) {
    const struct inflate_limits *limits = &inflate->limits;
    const char *name = kinds[inflate->kind].name;
    if (inflate->bytes_out > limits->max_bytes)
        return error_set(error, STATUS_LIMIT, "inflate",
                         "the %s data becomes more than the %" PRIu64 " bytes that are allowed", name,
                         limits->max_bytes);
    if (inflate->bytes_out > RATIO_FROM_BYTES && inflate->bytes_out / limits->max_ratio > inflate->bytes_in)
        return error_set(error, STATUS_LIMIT, "inflate",
                         "the %s data becomes more than %" PRIu32 " times as large as it is, which no cloud does", name,
                         limits->max_ratio);
    return STATUS_OK;
}

static enum status explain(const struct inflate *inflate, enum codec_result result, const struct codec_io *io,
                           struct error *error) {
    const char *name = kinds[inflate->kind].name;
    if (result == CODEC_NO_MEMORY) return error_set(error, STATUS_NO_MEMORY, "inflate", "no memory");
    if (result == CODEC_LIMIT)
        return error_set(error, STATUS_LIMIT, "inflate", "the %s data needs a window of more than %" PRIu64 " bytes",
                         name, inflate->limits.max_window_bytes);
    return error_set_at(error, STATUS_MALFORMED, "inflate", 0, inflate->bytes_in - io->in_bytes,
                        "the %s data is broken: %s", name, io->why);
}

/* Zeros after a member of gzip are padding, as gzip itself has it. */
static void skip_padding(const struct inflate *inflate, struct codec_io *io) {
    if (inflate->kind != INFLATE_GZIP || inflate->begun || !inflate->ended) return;
    while (io->in_bytes > 0 && *io->in == 0) io->in++, io->in_bytes--;
}

/* One step of the codec; what it makes is given away. */
static enum status inflate_step(struct inflate *inflate, struct codec_io *io, bool *full, struct error *error) {
    const struct inflate_codec *codec = kinds[inflate->kind].codec;
    io->out = inflate->buffer;
    io->out_bytes = BUFFER_BYTES;
    enum codec_result result = codec->step(inflate->state, io);
    size_t made = BUFFER_BYTES - io->out_bytes;
    *full = io->out_bytes == 0 && result == CODEC_GOES_ON;
    inflate->bytes_out += made;
    enum status status = over(inflate, error);
    if (!status && result > CODEC_ENDED) status = explain(inflate, result, io, error);
    if (!status && made) status = inflate->out.take(inflate->out.ctx, inflate->buffer, made);
    inflate->begun = result != CODEC_ENDED;
    inflate->ended |= result == CODEC_ENDED;
    if (result == CODEC_ENDED) codec->restart(inflate->state);
    return status;
}

enum status inflate_push(struct inflate *inflate, const void *bytes, size_t n, struct error *error) {
    struct codec_io io = {.in = bytes, .in_bytes = n};
    enum status status = inflate->failed;
    if (!status) inflate->bytes_in += n;
    for (bool full = false; !status; status = inflate_step(inflate, &io, &full, error)) {
        if (!full) skip_padding(inflate, &io);
        if (io.in_bytes == 0 && !full) break;
    }
    return inflate->failed = status;
}

enum status inflate_end(struct inflate *inflate, struct error *error) {
    if (inflate->failed) return inflate->failed;
    if (!inflate->begun && inflate->bytes_in > 0) return STATUS_OK;
    return inflate->failed = error_set_at(error, STATUS_MALFORMED, "inflate", 0, inflate->bytes_in,
                                          "the %s data ends before it is complete", kinds[inflate->kind].name);
}

void inflate_free(struct inflate *inflate) {
    if (!inflate) return;
    kinds[inflate->kind].codec->stop(inflate->state);
    free(inflate);
}

/* ------------------------------------------------------------------------------------------------ the beginning */

struct beginning {
    unsigned char *to;
    size_t n, room, made; /* made: with what there was no room for, so that the guess knows whole blocks */
};

static enum status collect(void *ctx, const void *bytes, size_t n) {
    struct beginning *beginning = ctx;
    size_t room = beginning->room - beginning->n, taken = n < room ? n : room;
    memcpy(beginning->to + beginning->n, bytes, taken);
    beginning->n += taken;
    beginning->made += n;
    return beginning->made < beginning->room + MADE_MOST_BYTES ? STATUS_OK : STATUS_CANCELLED;
}

size_t inflate_beginning(enum inflate_kind kind, const void *packed, size_t n, unsigned char *to, size_t room,
                         uint64_t *total) {
    enum { SMALL_PIECE = 4096 };
    struct beginning beginning = {.to = to, .room = room};
    struct inflate *inflate = NULL;
    struct error error;
    size_t taken = 0;
    enum status status = inflate_new(kind, NULL, (struct inflate_out){collect, &beginning}, &inflate, &error);
    while (status == STATUS_OK && taken < n && beginning.n < room) {
        size_t piece = n - taken < SMALL_PIECE ? n - taken : SMALL_PIECE;
        status = inflate_push(inflate, (const char *)packed + taken, piece, &error);
        taken += piece;
    }
    inflate_free(inflate);
    if (*total != UINT64_MAX && taken) *total = (uint64_t)((double)*total / (double)taken * (double)beginning.made);
    return beginning.n;
}
