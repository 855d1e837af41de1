/* Sorting of integers, in linear time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_RADIX_H
#define WHITTLE_CORE_BASE_RADIX_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* An item: what is sorted by, and what comes along. */
static inline uint64_t radix_item(uint32_t key, uint32_t value) { return (uint64_t)key << 32 | value; }
static inline uint32_t radix_key(uint64_t item) { return (uint32_t)(item >> 32); }
static inline uint32_t radix_value(uint64_t item) { return (uint32_t)item; }

/* The key of a number that isn't negative: positive floats are in the order of their bits. */
static inline uint32_t radix_key_of(double x) {
    float value = (float)x;
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* The key of any number: the order of the bits is turned round for those below zero. */
static inline uint32_t radix_key_of_signed(double x) {
    uint32_t bits = radix_key_of(x);
    return bits >> 31 ? ~bits : bits | UINT32_C(1) << 31;
}

/* Sorts n < 2^32 items by their keys, ascending; equal keys stay in the order that they come in.  spare is scratch for
 * n more.  Returns whichever of the two arrays holds the result.  0 threads = all processors; the result doesn't depend
 * on them.  O(n). */
uint64_t *radix_sort(uint64_t *item, uint64_t *spare, size_t n, unsigned threads);

/* Keeps the `count` lowest of n < 2^32 different items (by key, then by value) in the order that they come in; returns
 * their number, which is n where there are no more.  spare is scratch for n.  O(n), in less time than sorting takes. */
size_t radix_keep_lowest(uint64_t *item, uint64_t *spare, size_t n, size_t count);

#endif
