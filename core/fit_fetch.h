/* What is known of triangles lies all over memory, and is asked for here some time before it is read, so that the waits
 * for many reads overlap.  First what a triangle's number leads to, then, when that has come, what is found there.
 *
 * All of this is inlined by force: a function that does nothing but ask has no effect as far as GCC is concerned, and
 * calls of it are left out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_FIT_FETCH_H
#define WHITTLE_CORE_FIT_FETCH_H

#include "core/fit.h"
#include "core/processor.h"

enum { FETCH_LINE_BYTES = 64 };

INLINE void fit_fetch_block(const struct fit *fit, uint32_t id) {
    if (id == NONE) return;
    const char *block = (const char *)&fit->lists.block[id];
    for (size_t i = 0; i < sizeof *fit->lists.block; i += FETCH_LINE_BYTES) __builtin_prefetch(block + i);
}

/* What a triangle joins. */
INLINE void fit_fetch_links(const struct fit *fit, uint32_t t) {
    __builtin_prefetch(&fit->mesh->triangle[t]);
    __builtin_prefetch(&fit->he.twin[(size_t)3 * t]);
}

/* All that is known of it. */
INLINE void fit_fetch_triangle(const struct fit *fit, uint32_t t) {
    fit_fetch_links(fit, t);
    __builtin_prefetch(&fit->facing[t]);
    __builtin_prefetch(&fit->cost[t]);
    __builtin_prefetch(&fit->lists.first[t]);
}

/* Its corners, its neighbours, and the first of its samples. */
INLINE void fit_fetch_around(const struct fit *fit, uint32_t t) {
    fit_fetch_block(fit, fit->lists.first[t]);
    for (size_t k = 0; k < 3; k++) {
        uint32_t twin = fit->he.twin[(size_t)3 * t + k];
        __builtin_prefetch(&fit->mesh->vertex[fit->mesh->triangle[t][k]]);
        if (twin != NONE) __builtin_prefetch(&fit->facing[twin / 3]);
    }
}

/* More of its samples, where there are. */
INLINE void fit_fetch_more(const struct fit *fit, uint32_t t) {
    if (fit->lists.first[t] != NONE) fit_fetch_block(fit, fit->lists.block[fit->lists.first[t]].next);
}

/* What is known of its samples beyond their blocks. */
INLINE void fit_fetch_samples(const struct fit *fit, uint32_t t) {
    for (uint32_t b = fit->lists.first[t]; b != NONE; b = fit->lists.block[b].next)
        for (size_t i = 0; i < fit->lists.block[b].count; i++)
            __builtin_prefetch(&fit->samples.sample[fit->lists.block[b].sample[i]]);
}

/* The same, and how they face. */
INLINE void fit_fetch_disks(const struct fit *fit, uint32_t t) {
    fit_fetch_samples(fit, t);
    for (uint32_t b = fit->lists.first[t]; b != NONE; b = fit->lists.block[b].next)
        for (size_t i = 0; i < fit->lists.block[b].count; i++)
            __builtin_prefetch(&fit->samples.normal[fit->lists.block[b].sample[i]]);
}

#endif
