/* Decompression as a stream: cut anywhere, joined, broken, and bombs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <zlib.h>
#include <zstd.h>

#include "core/base/alloc.h"
#include "core/io/codec/inflate.h"

enum { TEXT_BYTES = 300000, PACKED_BYTES = 400000, BOMB_BYTES = 64 << 20 };

struct bytes {
    unsigned char *at;
    size_t n, most;
    enum status answer; /* of take, once more than `most` bytes came */
};

static enum status take(void *ctx, const void *bytes, size_t n) {
    struct bytes *b = ctx;
    assert_true(n > 0);
    if (b->at && b->n + n <= TEXT_BYTES) memcpy(b->at + b->n, bytes, n);
    b->n += n;
    return b->n > b->most ? b->answer : STATUS_OK;
}

/* Text that compresses by about three. */
static void fill(unsigned char *text) {
    uint32_t state = 1;
    for (size_t i = 0; i < TEXT_BYTES; i++) {
        state = state * 1664525 + 1013904223;
        text[i] = (unsigned char)("0123456789. \n"[(state >> 24) % 13]);
    }
}

static size_t pack_gzip(const void *text, size_t n, unsigned char *packed, size_t room) {
    z_stream stream = {0};
    assert_int_equal(deflateInit2(&stream, 6, Z_DEFLATED, MAX_WBITS + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
    stream.next_in = (Bytef *)(uintptr_t)text, stream.avail_in = (uInt)n;
    stream.next_out = packed, stream.avail_out = (uInt)room;
    assert_int_equal(deflate(&stream, Z_FINISH), Z_STREAM_END);
    deflateEnd(&stream);
    return stream.total_out;
}

static size_t pack_zstd(const void *text, size_t n, unsigned char *packed, size_t room) {
    size_t made = ZSTD_compress(packed, room, text, n, 5);
    assert_false(ZSTD_isError(made));
    return made;
}

static size_t (*const packers[])(const void *, size_t, unsigned char *,
                                 size_t) = {[INFLATE_GZIP] = pack_gzip, [INFLATE_ZSTD] = pack_zstd};

struct fixture {
    unsigned char *text, *packed, *out;
    size_t packed_bytes[2]; /* of each kind */
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    f->text = malloc(TEXT_BYTES), f->packed = malloc(PACKED_BYTES), f->out = malloc(TEXT_BYTES);
    fill(f->text);
    *state = f;
    return 0;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    free(f->text), free(f->packed), free(f->out), free(f);
    return 0;
}

/* Pushes n bytes in pieces and ends. */
static enum status run(enum inflate_kind kind, const struct inflate_limits *limits, const unsigned char *packed,
                       size_t n, size_t piece, struct bytes *to, struct error *error) {
    struct inflate *inflate = NULL;
    *error = (struct error){0};
    enum status status = inflate_new(kind, limits, (struct inflate_out){take, to}, &inflate, error);
    for (size_t at = 0; !status && at < n; at += piece)
        status = inflate_push(inflate, packed + at, n - at < piece ? n - at : piece, error);
    if (!status) status = inflate_end(inflate, error);
    inflate_free(inflate);
    return status;
}

static void a_stream_may_be_cut_anywhere(void **state) {
    struct fixture *f = *state;
    static const size_t pieces[] = {1, 7, 4096, PACKED_BYTES};
    struct error error;
    for (int kind = 0; kind < 2; kind++) {
        size_t n = packers[kind](f->text, TEXT_BYTES, f->packed, PACKED_BYTES);
        for (size_t i = 0; i < 4; i++) {
            struct bytes to = {.at = f->out, .most = SIZE_MAX};
            assert_int_equal(run((enum inflate_kind)kind, NULL, f->packed, n, pieces[i], &to, &error), STATUS_OK);
            assert_int_equal(to.n, TEXT_BYTES);
            assert_memory_equal(f->out, f->text, TEXT_BYTES);
        }
    }
}

static void members_are_joined(void **state) {
    struct fixture *f = *state;
    struct error error;
    for (int kind = 0; kind < 2; kind++) {
        size_t n = packers[kind](f->text, 1000, f->packed, PACKED_BYTES);
        n += packers[kind](f->text, 0, f->packed + n, PACKED_BYTES - n);
        n += packers[kind](f->text + 1000, TEXT_BYTES - 1000, f->packed + n, PACKED_BYTES - n);
        for (size_t piece = 1; piece < PACKED_BYTES; piece *= 50) {
            struct bytes to = {.at = f->out, .most = SIZE_MAX};
            assert_int_equal(run((enum inflate_kind)kind, NULL, f->packed, n, piece, &to, &error), STATUS_OK);
            assert_int_equal(to.n, TEXT_BYTES);
            assert_memory_equal(f->out, f->text, TEXT_BYTES);
        }
    }
}

static void a_stream_cut_short_at_any_byte_is_refused(void **state) {
    struct fixture *f = *state;
    struct error error;
    for (int kind = 0; kind < 2; kind++) {
        size_t n = packers[kind](f->text, 500, f->packed, PACKED_BYTES);
        for (size_t shorter = 0; shorter < n; shorter++) {
            struct bytes to = {.at = f->out, .most = SIZE_MAX};
            assert_int_equal(run((enum inflate_kind)kind, NULL, f->packed, shorter, 64, &to, &error), STATUS_MALFORMED);
            assert_int_equal(error.byte_offset, shorter);
        }
    }
}

static void a_flipped_bit_never_passes_unseen(void **state) {
    struct fixture *f = *state;
    struct error error;
    size_t n = pack_gzip(f->text, 500, f->packed, PACKED_BYTES), seen = 0;
    for (size_t bit = 80; bit < 8 * n; bit++) { /* after gzip's header, whose bits may change */
        struct bytes to = {.at = f->out, .most = SIZE_MAX};
        f->packed[bit / 8] ^= (unsigned char)(1 << bit % 8);
        seen += run(INFLATE_GZIP, NULL, f->packed, n, 4096, &to, &error) == STATUS_MALFORMED;
        f->packed[bit / 8] ^= (unsigned char)(1 << bit % 8);
    }
    assert_true(seen >= 8 * n - 80 - 8); /* unused bits before the checksum may change too */
}

static void what_follows_the_last_member_is_refused(void **state) {
    struct fixture *f = *state;
    struct error error;
    for (int kind = 0; kind < 2; kind++) {
        struct bytes to = {.at = f->out, .most = SIZE_MAX};
        size_t n = packers[kind](f->text, 500, f->packed, PACKED_BYTES);
        memcpy(f->packed + n, "0 0 0\n", 6);
        assert_int_equal(run((enum inflate_kind)kind, NULL, f->packed, n + 6, 4096, &to, &error), STATUS_MALFORMED);
        assert_non_null(strstr(error.text, kind == INFLATE_GZIP ? "gzip" : "zstd"));
    }
}

static void a_bomb_is_refused_early(void **state) {
    struct fixture *f = *state;
    struct error error;
    void *zeros = calloc(BOMB_BYTES, 1);
    for (int kind = 0; kind < 2; kind++) {
        struct bytes to = {.most = SIZE_MAX};
        size_t n = packers[kind](zeros, BOMB_BYTES, f->packed, PACKED_BYTES);
        assert_int_equal(run((enum inflate_kind)kind, NULL, f->packed, n, n, &to, &error), STATUS_LIMIT);
        assert_true(to.n <= n * 251 || to.n <= 17 << 20);
        assert_string_equal(error.where, "inflate");
        to.n = 0;
        struct inflate_limits lax = {.max_ratio = 1000000};
        assert_int_equal(run((enum inflate_kind)kind, &lax, f->packed, n, n, &to, &error), STATUS_OK);
        assert_int_equal(to.n, BOMB_BYTES);
    }
    free(zeros);
}

static void bytes_are_capped_to_the_byte(void **state) {
    struct fixture *f = *state;
    struct error error;
    for (int kind = 0; kind < 2; kind++) {
        struct bytes to = {.at = f->out, .most = SIZE_MAX};
        size_t n = packers[kind](f->text, TEXT_BYTES, f->packed, PACKED_BYTES);
        struct inflate_limits limits = {.max_bytes = TEXT_BYTES};
        assert_int_equal(run((enum inflate_kind)kind, &limits, f->packed, n, 4096, &to, &error), STATUS_OK);
        to.n = 0;
        limits.max_bytes--;
        assert_int_equal(run((enum inflate_kind)kind, &limits, f->packed, n, 4096, &to, &error), STATUS_LIMIT);
        assert_true(to.n <= limits.max_bytes);
    }
}

static void a_window_over_the_limit_is_refused(void **state) {
    struct fixture *f = *state;
    struct error error;
    struct bytes to = {.at = f->out, .most = SIZE_MAX};
    size_t n = pack_zstd(f->text, TEXT_BYTES, f->packed, PACKED_BYTES);
    assert_int_equal(
        run(INFLATE_ZSTD, &(struct inflate_limits){.max_window_bytes = 65536}, f->packed, n, 4096, &to, &error),
        STATUS_LIMIT);
    assert_non_null(strstr(error.text, "window"));
}

static void what_the_taker_answers_ends_it(void **state) {
    struct fixture *f = *state;
    struct error error;
    struct bytes to = {.at = f->out, .most = 1000, .answer = STATUS_CANCELLED};
    size_t n = pack_gzip(f->text, TEXT_BYTES, f->packed, PACKED_BYTES);
    assert_int_equal(run(INFLATE_GZIP, NULL, f->packed, n, 4096, &to, &error), STATUS_CANCELLED);
    assert_true(to.n < TEXT_BYTES);
}

static void kinds_are_told_by_their_magic(void **state) {
    (void)state;
    enum inflate_kind kind;
    assert_true(inflate_sniff("\x1f\x8b\x08", 3, &kind) && kind == INFLATE_GZIP);
    assert_true(inflate_sniff("\x28\xb5\x2f\xfd", 4, &kind) && kind == INFLATE_ZSTD);
    assert_false(inflate_sniff("\x28\xb5\x2f", 3, &kind) || inflate_sniff("ply", 3, &kind) ||
                 inflate_sniff("", 0, &kind));
}

static bool fail_all(void *ctx) {
    (void)ctx;
    return true;
}

static void no_memory_is_told(void **state) {
    (void)state;
    struct error error = {0};
    struct inflate *inflate = NULL;
    alloc_fail = fail_all;
    enum status status = inflate_new(INFLATE_GZIP, NULL, (struct inflate_out){take, NULL}, &inflate, &error);
    alloc_fail = NULL;
    assert_int_equal(status, STATUS_NO_MEMORY);
    assert_null(inflate);
    inflate_free(NULL);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_stream_may_be_cut_anywhere),
                                       cmocka_unit_test(members_are_joined),
                                       cmocka_unit_test(a_stream_cut_short_at_any_byte_is_refused),
                                       cmocka_unit_test(a_flipped_bit_never_passes_unseen),
                                       cmocka_unit_test(what_follows_the_last_member_is_refused),
                                       cmocka_unit_test(a_bomb_is_refused_early),
                                       cmocka_unit_test(bytes_are_capped_to_the_byte),
                                       cmocka_unit_test(a_window_over_the_limit_is_refused),
                                       cmocka_unit_test(what_the_taker_answers_ends_it),
                                       cmocka_unit_test(kinds_are_told_by_their_magic),
                                       cmocka_unit_test(no_memory_is_told)};
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
