/* What is left of a tile once it has been run: points with their quadrics, and which others each is joined to.
 *
 *     head | positions | ids | quadrics | normals | degrees | links | checksum
 *
 * ids and links are numbers of points in the input.  A link may lead to a point of another tile, or to one that the
 * other tile hasn't left, where both saw too little of each other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_LEFT_H
#define WHITTLE_CORE_TILES_LEFT_H

#include <stdint.h>

#include "core/base/radix.h"

struct left_head {
    char mark[16];
    uint64_t plan; /* scratch_identity of the tile's */
    uint64_t count, links;
    uint64_t distinct; /* points of the tile, without repetitions */
    float error;       /* as of a contraction */
};

#define LEFT_MARK "whittle left 2\0"

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
