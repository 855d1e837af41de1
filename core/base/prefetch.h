/* Loops over items whose data are scattered in memory.
 *
 * A read that misses the caches takes as long as hundreds of instructions.  So what an item takes is fetched while
 * items before it are worked on, and many reads wait at the same time.  Where what is read leads to more there are
 * several stages, the farthest ahead first:
 *
 *     static const struct prefetch share_ahead[PREFETCH_STAGES] = {{6, fetch_triangle}, {4, fetch_samples}};
 *
 *     item              i       i+1     i+2     i+3     i+4             i+5     i+6
 *     at step i         body                            fetch_samples           fetch_triangle
 *
 * for_each_prefetched(share_ahead, ctx, begin, end, body) takes every item through all stages and its body, in order. A
 * stage may note in ctx what it has found on the way.  What a stage reads itself is read at once, so a stage before it
 * has to have fetched that.  Nothing depends on it but the time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_PREFETCH_H
#define WHITTLE_CORE_BASE_PREFETCH_H

#include <stdbool.h>
#include <stddef.h>

enum { PREFETCH_STAGES = 4, PREFETCH_LINE_BYTES = 64 };

struct prefetch {
    size_t ahead;                          /* so many items; fewer than in the stage before */
    void (*fetch)(void *ctx, size_t item); /* NULL after the last stage */
};

/* Fetches the cache line at p, which need not be a place that may be read.  To the compiler it has an effect: a
 * function that does nothing but fetch would be left out. */
static inline void prefetch(const void *p) {
    __builtin_prefetch(p);
    __asm__ volatile("");
}

static inline void prefetch_bytes(const void *p, size_t bytes) {
    for (size_t i = 0; i < bytes; i += PREFETCH_LINE_BYTES) prefetch((const char *)p + i);
}

/* One step of the loop, for loops that are written out: the stages of the items ahead of i. */
static inline void prefetch_ahead(const struct prefetch stage[PREFETCH_STAGES], void *ctx, size_t i, size_t end) {
    for (size_t s = 0; s < PREFETCH_STAGES && stage[s].fetch; s++)
        if (i + stage[s].ahead < end) stage[s].fetch(ctx, i + stage[s].ahead);
}

/* Calls body(ctx, i) for i = begin .. end - 1, until one returns false. */
static inline void for_each_prefetched(const struct prefetch stage[PREFETCH_STAGES], void *ctx, size_t begin,
                                       size_t end, bool (*body)(void *ctx, size_t item)) {
    for (size_t s = 0; s < PREFETCH_STAGES && stage[s].fetch; s++) { /* of the items at the beginning */
        size_t last = stage[s].ahead < end - begin ? begin + stage[s].ahead : end;
        for (size_t i = begin; i < last; i++) stage[s].fetch(ctx, i);
    }
    for (size_t i = begin; i < end; i++) {
        prefetch_ahead(stage, ctx, i, end);
        if (!body(ctx, i)) return;
    }
}

#endif
