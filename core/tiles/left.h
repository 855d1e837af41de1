/* What is left of a tile once it has been run: points with their quadrics, and which others each is joined to.
 *
 *     head | records | quadrics | normals | degrees | links | what is told of others (told.h) | checksum
 *
 * Records are those of points.N (scratch.h): position and number in the input.  A link tells how far on or back
 * among the tile's points the other one is, which is near for most, or names one of another tile by its number in the
 * input; that tile may not have left it, where both saw too little of each other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_LEFT_H
#define WHITTLE_CORE_TILES_LEFT_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "core/base/radix.h"

struct left_head {
    char mark[16];
    uint64_t plan; /* scratch_identity of the tile's */
    uint64_t count, links, link_bytes;
    uint64_t distinct; /* points of the tile, without repetitions */
    uint64_t told, gap_bytes;
    float error; /* as of a contraction */
};

#define LEFT_MARK "whittle left 4\0"

/* A link from the point `from` of those left to the point `to` of them, another one: the distance and, lowest, on which
 * side, seven bits a byte, the lowest first, all but the last with the eighth.  To a point of another tile (`to` is
 * UINT32_MAX): 0, and its number in the input.  Returns the number of bytes. */
enum { LEFT_LINK_BYTES = 5 };

static inline size_t left_put_link(uint32_t from, uint32_t to, uint32_t id, unsigned char link[LEFT_LINK_BYTES]) {
    uint64_t rest = to < from ? (uint64_t)(from - to) << 1 | 1 : (uint64_t)(to - from) << 1;
    size_t n = 0;
    if (to == UINT32_MAX) {
        link[0] = 0;
        memcpy(link + 1, &id, sizeof id);
        return 1 + sizeof id;
    }
    for (; rest > 0x7f; rest >>= 7) link[n++] = (unsigned char)(rest | 0x80);
    link[n++] = (unsigned char)rest;
    return n;
}

/* The same back from n bytes; returns how many of them it took, 0 where they end before it does. */
static inline size_t left_get_link(uint32_t from, const unsigned char *link, size_t n, uint32_t *to, uint32_t *id) {
    uint64_t value = 0;
    size_t i = 0;
    *id = 0;
    if (n > 0 && link[0] == 0) {
        *to = UINT32_MAX;
        if (n < 1 + sizeof *id) return 0;
        memcpy(id, link + 1, sizeof *id);
        return 1 + sizeof *id;
    }
    do {
        if (i == n || i == LEFT_LINK_BYTES) return 0;
        value |= (uint64_t)(link[i] & 0x7f) << 7 * i;
    } while (link[i++] & 0x80);
    *to = value & 1 ? from - (uint32_t)(value >> 1) : from + (uint32_t)(value >> 1);
    return i;
}

/* And of the points that aren't left, where these are kept too:
 *
 *     head | errors | items | checksum
 *
 * errors are a float for each pass, as of a contraction; an item is a key, of which a lower one is more important, and
 * the number of its point in the input. */
struct gone_head {
    char mark[16];
    uint64_t count, passes;
};

#define GONE_MARK "whittle gone 2\0"

struct gone_item {
    uint32_t key, id;
};

/* Above all ranks of points that are left: what goes later is more important, then what costs more. */
#define GONE_FIRST (UINT32_C(1) << 31)

static inline uint32_t gone_key(uint64_t passes, uint64_t pass, float cost) {
    enum { COST_BITS = 23 };
    uint32_t coarse = radix_key_of((double)cost) >> (31 - COST_BITS);
    return GONE_FIRST | (uint32_t)(passes - 1 - pass) << COST_BITS | (((UINT32_C(1) << COST_BITS) - 1) - coarse);
}

static inline uint64_t gone_pass(uint64_t passes, uint32_t key) { return passes - 1 - (key >> 23 & 0xff); }

/* Keys of the whole cloud: each once, points of about the same cost in no order. */
static inline uint64_t whole_key(uint32_t key, uint32_t id) {
    uint32_t x = id;
    x = (x ^ x >> 16) * UINT32_C(0x7feb352d);
    x = (x ^ x >> 15) * UINT32_C(0x846ca68b);
    return (uint64_t)key << 32 | (x ^ x >> 16);
}

#endif
