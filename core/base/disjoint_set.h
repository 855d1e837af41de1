/* Sets that are united step by step: each is a tree of ids, known by its root.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_DISJOINT_SET_H
#define WHITTLE_CORE_BASE_DISJOINT_SET_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/alloc.h"

/* n sets of one; the caller's, to be given to free(); NULL = no memory. */
static inline uint32_t *disjoint_set_new(size_t n) {
    uint32_t *parent = alloc_array(n, sizeof *parent);
    for (uint32_t i = 0; parent && i < n; i++) parent[i] = i;
    return parent;
}

static inline uint32_t disjoint_set_root(uint32_t *parent, uint32_t i) {
    for (; parent[i] != i; i = parent[i]) parent[i] = parent[parent[i]];
    return i;
}

/* Whether they weren't in one set before.  The smaller root wins. */
static inline bool disjoint_set_unite(uint32_t *parent, uint32_t i, uint32_t j) {
    uint32_t a = disjoint_set_root(parent, i), b = disjoint_set_root(parent, j);
    parent[a < b ? b : a] = a < b ? a : b;
    return a != b;
}

#endif
