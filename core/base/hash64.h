/* Numbers that look random and are the same everywhere.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_HASH64_H
#define WHITTLE_CORE_BASE_HASH64_H

#include <stdint.h>

/* Scrambles 64 bits, one to one (the finisher of SplitMix64; Steele, Lea, Flood 2014). */
static inline uint64_t hash64(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

#endif
