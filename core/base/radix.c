/* Least significant digit first, three digits.  Each thread counts and moves a part of its own: where a part's items of
 * a digit begin follows from the counts of all parts, so that the order is the one of a single thread.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/radix.h"

#include <stdbool.h>
#include <string.h>

#include "core/base/par.h"

enum { DIGIT_BITS = 11, DIGITS = 1 << DIGIT_BITS, PASSES = 3, MOST_PARTS = 8, LEAST_PART = 1 << 13 };

struct sort {
    const uint64_t *from;
    uint64_t *to;
    size_t n, part; /* items; of a part */
    unsigned parts, shift;
    uint32_t count[MOST_PARTS][DIGITS]; /* of each digit in each part; then where the next one goes to */
};

static unsigned digit_of(const struct sort *sort, size_t i) { return sort->from[i] >> sort->shift & (DIGITS - 1); }

static void count_part(void *ctx, size_t begin, size_t end) {
    struct sort *sort = ctx;
    uint32_t *count = sort->count[begin / sort->part];
    memset(count, 0, DIGITS * sizeof *count);
    for (size_t i = begin; i < end; i++) count[digit_of(sort, i)]++;
}

static void move_part(void *ctx, size_t begin, size_t end) {
    struct sort *sort = ctx;
    uint32_t *next = sort->count[begin / sort->part];
    for (size_t i = begin; i < end; i++) sort->to[next[digit_of(sort, i)]++] = sort->from[i];
}

/* Turns counts into beginnings; false where all items have the same digit, so that nothing would move. */
static bool place_parts(struct sort *sort) {
    uint32_t sum = 0;
    for (unsigned d = 0; d < DIGITS; d++) {
        uint32_t before = sum;
        for (unsigned p = 0; p < sort->parts; p++) {
            uint32_t count = sort->count[p][d];
            sort->count[p][d] = sum;
            sum += count;
        }
        if (sum - before == sort->n) return false;
    }
    return true;
}

uint64_t *radix_sort(uint64_t *item, uint64_t *spare, size_t n, unsigned threads) {
    struct sort sort = {.from = item, .to = spare, .n = n, .parts = threads ? threads : par_processors()};
    if (n < 2) return item;
    if (sort.parts > MOST_PARTS) sort.parts = MOST_PARTS;
    if (sort.parts > n / LEAST_PART) sort.parts = n < LEAST_PART ? 1 : (unsigned)(n / LEAST_PART);
    sort.part = (n + sort.parts - 1) / sort.parts;
    for (unsigned pass = 0; pass < PASSES; pass++) {
        sort.shift = 32 + pass * DIGIT_BITS;
        par_for(sort.parts, n, sort.part, count_part, &sort);
        if (!place_parts(&sort)) continue;
        par_for(sort.parts, n, sort.part, move_part, &sort);
        uint64_t *swap = sort.to;
        sort.to = item;
        sort.from = item = swap;
    }
    return item;
}

/* The lowest digit that as many as `rank` items, or fewer, lie below; *rank becomes the rank among those that have it.
 */
static unsigned digit_at_rank(const uint64_t *item, size_t n, unsigned shift, size_t *rank) {
    uint32_t count[DIGITS] = {0};
    unsigned digit = 0;
    for (size_t i = 0; i < n; i++) count[item[i] >> shift & (DIGITS - 1)]++;
    for (; count[digit] <= *rank; digit++) *rank -= count[digit];
    return digit;
}

/* Most significant digit first: only items with the digits of the wanted one are looked at any further. */
static uint64_t item_at_rank(const uint64_t *item, uint64_t *spare, size_t n, size_t rank) {
    for (unsigned shift = 64 - DIGIT_BITS; n > 1; shift = shift > DIGIT_BITS ? shift - DIGIT_BITS : 0) {
        unsigned digit = digit_at_rank(item, n, shift, &rank);
        size_t left = 0;
        for (size_t i = 0; i < n; i++)
            if ((item[i] >> shift & (DIGITS - 1)) == digit) spare[left++] = item[i];
        item = spare;
        n = left;
    }
    return item[0];
}

size_t radix_keep_lowest(uint64_t *item, uint64_t *spare, size_t n, size_t count) {
    if (count >= n) return n;
    if (count == 0) return 0;
    uint64_t last = item_at_rank(item, spare, n, count - 1);
    size_t kept = 0;
    for (size_t i = 0; i < n; i++)
        if (item[i] <= last) item[kept++] = item[i];
    return kept;
}
