/* Attributes are cut into blocks of elements, and these into planes of one byte of each element; a plane's differences
 * go out in groups of sixteen, each with as few bits as most of its sixteen need:
 *
 *     0xA0 | block: plane: 2 bits for each group, groups | ... | zeros up to 32 bytes, the first element
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/out/meshopt.h"

#include <assert.h>
#include <string.h>

enum {
    ATTRIBUTES_MARK = 0xA0,
    INDICES_MARK = 0xD1,
    BLOCK_BYTES = 8192,
    BLOCK_MOST = 256,
    GROUP = 16,
    LEAST_TAIL = 32,
    INDICES_TAIL = 4,
    FAR = 30 /* an index that is as far from the last one is told from the other baseline */
};

/* Bits of a difference in a group of each mode; those that need more are all ones, and follow as bytes. */
static const unsigned bits_of[] = {0, 2, 4, 8};

static size_t group_bytes(const unsigned char *difference, unsigned mode) {
    size_t bytes = GROUP * bits_of[mode] / 8;
    unsigned escape = (1u << bits_of[mode]) - 1;
    if (mode == 3) return bytes;
    for (int i = 0; i < GROUP; i++) bytes += difference[i] >= escape;
    return bytes;
}

static unsigned best_mode(const unsigned char *difference) {
    unsigned any = 0, best = 3;
    for (int i = 0; i < GROUP; i++) any |= difference[i];
    if (!any) return 0;
    for (unsigned mode = 2; mode >= 1; mode--)
        if (group_bytes(difference, mode) < group_bytes(difference, best)) best = mode;
    return best;
}

/* The first of several numbers in a byte has its highest bits. */
static unsigned char *put_group(unsigned char *to, const unsigned char *difference, unsigned mode) {
    unsigned bits = bits_of[mode], escape = (1u << bits) - 1;
    for (unsigned i = 0; bits && i < GROUP; i += 8 / bits) {
        unsigned byte = 0;
        for (unsigned k = 0; k < 8 / bits; k++) {
            unsigned value = difference[i + k];
            byte = byte << bits | (value < escape ? value : escape);
        }
        *to++ = mode == 3 ? difference[i] : (unsigned char)byte;
    }
    for (unsigned i = 0; (mode == 1 || mode == 2) && i < GROUP; i++)
        if (difference[i] >= escape) *to++ = difference[i];
    return to;
}

/* Byte `k` of n <= BLOCK_MOST elements, the one before which has `last` there. */
static void put_plane(struct sink *sink, const unsigned char *element, size_t n, size_t stride, size_t k,
                      unsigned char last) {
    unsigned char difference[BLOCK_MOST] = {0}, mode[BLOCK_MOST / GROUP / 4] = {0}, out[BLOCK_MOST + GROUP];
    unsigned char *end = out;
    size_t groups = (n + GROUP - 1) / GROUP;
    for (size_t i = 0; i < n; i++) {
        unsigned char value = element[i * stride + k], step = (unsigned char)(value - last);
        difference[i] = (unsigned char)(step << 1 ^ (step & 0x80 ? 0xff : 0));
        last = value;
    }
    for (size_t g = 0; g < groups; g++) {
        unsigned m = best_mode(difference + g * GROUP);
        mode[g / 4] |= (unsigned char)(m << 2 * (g % 4));
        end = put_group(end, difference + g * GROUP, m);
    }
    sink_bytes(sink, mode, (groups + 3) / 4);
    sink_bytes(sink, out, (size_t)(end - out));
}

void meshopt_put_attributes(struct sink *sink, const unsigned char *element, size_t n, size_t stride) {
    static const unsigned char mark = ATTRIBUTES_MARK, zeros[LEAST_TAIL];
    assert(n > 0 && stride % 4 == 0 && stride <= MESHOPT_MOST_STRIDE);
    size_t block = BLOCK_BYTES / stride / GROUP * GROUP;
    if (block > BLOCK_MOST) block = BLOCK_MOST;
    const unsigned char *last = element;
    sink_bytes(sink, &mark, 1);
    for (size_t at = 0; at < n; at += block) {
        size_t count = n - at < block ? n - at : block;
        const unsigned char *first = element + at * stride;
        for (size_t k = 0; k < stride; k++) put_plane(sink, first, count, stride, k, last[k]);
        last = first + (count - 1) * stride;
    }
    if (stride < LEAST_TAIL) sink_bytes(sink, zeros, LEAST_TAIL - stride);
    sink_bytes(sink, element, stride);
}

/* Seven bits a byte, the lowest first; all but the last have the highest bit. */
static void put_number(struct sink *sink, uint32_t value) {
    unsigned char *to = sink_reserve(sink, 5);
    size_t n = 0;
    for (; value > 0x7f; value >>= 7) to[n++] = (unsigned char)(value | 0x80);
    to[n++] = (unsigned char)value;
    sink_advance(sink, n);
}

void meshopt_put_indices(struct sink *sink, const uint32_t *index, size_t n) {
    static const unsigned char mark = INDICES_MARK, zeros[INDICES_TAIL];
    uint32_t last[2] = {0, 0};
    unsigned current = 0;
    sink_bytes(sink, &mark, 1);
    for (size_t i = 0; i < n; i++) {
        int64_t away = (int64_t)index[i] - last[current];
        if (away >= FAR || away <= -FAR) current ^= 1;
        uint32_t step = index[i] - last[current];
        uint32_t folded = step << 1 ^ (step >> 31 ? UINT32_MAX : 0);
        put_number(sink, folded << 1 | current);
        last[current] = index[i];
    }
    sink_bytes(sink, zeros, INDICES_TAIL);
}
