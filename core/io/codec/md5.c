/* MD5 of short texts: blocks of 64 bytes, of which the last end in a one, zeros and the length in bits.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/codec/md5.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "core/base/endian.h"

enum { BLOCK = 64, LENGTH_BYTES = 8, ROUNDS = 64 };

static uint32_t rotate(uint32_t value, unsigned bits) { return value << bits | value >> (32 - bits); }

static void add_block(const unsigned char *block, uint32_t state[4]) {
    static const unsigned turn[4][4] = {{7, 12, 17, 22}, {5, 9, 14, 20}, {4, 11, 16, 23}, {6, 10, 15, 21}};
    uint32_t a = state[0], b = state[1], c = state[2], d = state[3];
    for (unsigned i = 0; i < ROUNDS; i++) {
        unsigned round = i / 16;
        uint32_t mixed = round == 0   ? (b & c) | (~b & d)
                         : round == 1 ? (d & b) | (~d & c)
                         : round == 2 ? b ^ c ^ d
                                      : c ^ (b | ~d);
        unsigned word = (round == 0 ? i : round == 1 ? 5 * i + 1 : round == 2 ? 3 * i + 5 : 7 * i) % 16;
        uint32_t sine = (uint32_t)floor(fabs(sin((double)i + 1)) * 0x1p32);
        uint32_t sum = a + mixed + sine + (uint32_t)load_little_endian(block + 4 * (size_t)word, 4);
        a = d, d = c, c = b;
        b += rotate(sum, turn[round][i % 4]);
    }
    state[0] += a, state[1] += b, state[2] += c, state[3] += d;
}

void md5_short(const void *bytes, size_t n, unsigned char digest[MD5_BYTES]) {
    unsigned char text[MD5_MOST + 1 + LENGTH_BYTES] = {0};
    uint32_t state[4] = {0x67452301, 0xefcdab89, 0x98badcfe, 0x10325476};
    assert(n <= MD5_MOST);
    size_t whole = (n + 1 + LENGTH_BYTES + BLOCK - 1) / BLOCK * BLOCK;
    memcpy(text, bytes, n);
    text[n] = 0x80;
    store_little_endian(text + whole - LENGTH_BYTES, 8 * (uint64_t)n, LENGTH_BYTES);
    for (size_t at = 0; at < whole; at += BLOCK) add_block(text + at, state);
    for (int i = 0; i < 4; i++) store_little_endian(digest + 4 * (size_t)i, state[i], 4);
}
