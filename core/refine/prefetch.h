/* What is known of a triangle, for the stages of base/prefetch.h: first what its number leads to, then what is found
 * there.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_PREFETCH_H
#define WHITTLE_CORE_REFINE_PREFETCH_H

#include "core/base/prefetch.h"
#include "core/refine/fit.h"

static inline void fit_fetch_block(const struct fit *fit, uint32_t id) {
    if (id != NONE) prefetch_bytes(&fit->lists.block[id], sizeof *fit->lists.block);
}

/* What a triangle joins. */
static inline void fit_fetch_links(const struct fit *fit, uint32_t t) {
    prefetch(&fit->mesh->triangle[t]);
    prefetch(&fit->he.twin[(size_t)3 * t]);
}

/* All that is known of it. */
static inline void fit_fetch_triangle(const struct fit *fit, uint32_t t) {
    fit_fetch_links(fit, t);
    prefetch(&fit->facing[t]);
    prefetch(&fit->cost[t]);
    prefetch(&fit->lists.first[t]);
}

/* Its corners, its neighbours, and the first of its samples. */
static inline void fit_fetch_around(const struct fit *fit, uint32_t t) {
    fit_fetch_block(fit, fit->lists.first[t]);
    for (size_t k = 0; k < 3; k++) {
        uint32_t twin = fit->he.twin[(size_t)3 * t + k];
        prefetch(&fit->mesh->vertex[fit->mesh->triangle[t][k]]);
        if (twin != NONE) prefetch(&fit->facing[twin / 3]);
    }
}

/* More of its samples, where there are. */
static inline void fit_fetch_more(const struct fit *fit, uint32_t t) {
    if (fit->lists.first[t] != NONE) fit_fetch_block(fit, fit->lists.block[fit->lists.first[t]].next);
}

/* What is known of its samples beyond their blocks. */
static inline void fit_fetch_samples(const struct fit *fit, uint32_t t) {
    for (uint32_t b = fit->lists.first[t]; b != NONE; b = fit->lists.block[b].next)
        for (size_t i = 0; i < fit->lists.block[b].count; i++)
            prefetch(&fit->samples.sample[fit->lists.block[b].sample[i]]);
}

/* The same, and how they face. */
static inline void fit_fetch_disks(const struct fit *fit, uint32_t t) {
    fit_fetch_samples(fit, t);
    for (uint32_t b = fit->lists.first[t]; b != NONE; b = fit->lists.block[b].next)
        for (size_t i = 0; i < fit->lists.block[b].count; i++)
            prefetch(&fit->samples.normal[fit->lists.block[b].sample[i]]);
}

#endif
