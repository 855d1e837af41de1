/* In three loops: how long each list gets, who goes into it, and sorting.  A point that names q without being named by
 * q adds itself to q's list, whoever comes first; sorting makes the order of those that of their ids.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/adjacency.h"

#include <assert.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/simd.h"

enum { GRAIN = 4096, DEGREE_LIMIT = UINT8_MAX };

struct building {
    const struct neighbourhood *neighbours;
    struct adjacency *out;
    atomic_uint *used;   /* n: entries that p's list needs; then those that it has */
    uint64_t *one_sided; /* n: bit i is set where p's i-th neighbour doesn't name p */
};

static bool lists(const struct neighbourhood *neighbours, uint32_t p, uint32_t q) {
    return ids_list(&neighbours->id[(size_t)p * neighbours->stride], neighbours->stride, neighbours->count[p], q);
}

/* The neighbour that the lowest of p's bits that are left stands for. */
static uint32_t other_of(const struct building *b, size_t p, uint64_t left) {
    return b->neighbours->id[p * b->neighbours->stride + (unsigned)__builtin_ctzll(left)];
}

static void start_count(void *ctx, size_t begin, size_t end) {
    const struct building *b = ctx;
    for (size_t p = begin; p < end; p++) atomic_init(&b->used[p], b->neighbours->count[p]);
}

static void count_others(void *ctx, size_t begin, size_t end) {
    const struct building *b = ctx;
    for (size_t p = begin; p < end; p++) {
        uint64_t one_sided = 0;
        for (unsigned i = 0; i < b->neighbours->count[p]; i++) {
            uint32_t q = b->neighbours->id[p * b->neighbours->stride + i];
            one_sided |= (uint64_t)!lists(b->neighbours, q, (uint32_t)p) << i;
        }
        b->one_sided[p] = one_sided;
        for (uint64_t left = one_sided; left; left &= left - 1) /* apart, so that no branch above is guessed wrong */
            atomic_fetch_add_explicit(&b->used[other_of(b, p, left)], 1, memory_order_relaxed);
    }
}

static void fill_own(void *ctx, size_t begin, size_t end) {
    const struct building *b = ctx;
    for (size_t p = begin; p < end; p++) {
        unsigned count = b->neighbours->count[p];
        memcpy(&b->out->list[b->out->start[p]], &b->neighbours->id[p * b->neighbours->stride],
               count * sizeof *b->out->list);
        atomic_store_explicit(&b->used[p], count, memory_order_relaxed);
    }
}

static void fill_others(void *ctx, size_t begin, size_t end) {
    const struct building *b = ctx;
    for (size_t p = begin; p < end; p++)
        for (uint64_t left = b->one_sided[p]; left; left &= left - 1) {
            uint32_t q = other_of(b, p, left);
            b->out->list[b->out->start[q] + atomic_fetch_add_explicit(&b->used[q], 1, memory_order_relaxed)] =
                (uint32_t)p;
        }
}

static int compare_ids(const void *a, const void *b) {
    uint32_t i = *(const uint32_t *)a, j = *(const uint32_t *)b;
    return (i > j) - (i < j);
}

static void sort_few(uint32_t *id, size_t n) {
    for (size_t i = 1; i < n; i++) {
        uint32_t x = id[i];
        size_t j = i;
        for (; j > 0 && id[j - 1] > x; j--) id[j] = id[j - 1];
        id[j] = x;
    }
}

/* Who names a crowd's centre from outside its own list is left out once the list is full: that only happens around
 * outliers' favourite points. */
static void sort_range(void *ctx, size_t begin, size_t end) {
    const struct building *b = ctx;
    for (size_t p = begin; p < end; p++) {
        size_t used = atomic_load_explicit(&b->used[p], memory_order_relaxed), own = b->neighbours->count[p];
        uint32_t *others = &b->out->list[b->out->start[p] + own];
        if (used > DEGREE_LIMIT)
            qsort(others, used - own, sizeof *others, compare_ids);
        else
            sort_few(others, used - own);
        b->out->degree[p] = (uint8_t)(used < DEGREE_LIMIT ? used : DEGREE_LIMIT);
    }
}

/* Gives each list its place. */
static enum status place_both_ways(struct building *b) {
    struct adjacency *out = b->out;
    for (size_t p = 0; p < out->n; p++) {
        out->start[p] = (uint32_t)out->capacity;
        out->capacity += b->used[p];
        if (out->capacity >= UINT32_MAX) return STATUS_NO_MEMORY;
    }
    out->list = alloc_array(out->capacity, sizeof *out->list);
    return out->list ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status adjacency_from(const struct neighbourhood *neighbours, unsigned threads, struct adjacency *out) {
    struct adjacency made = {.n = neighbours->n};
    struct building b = {.neighbours = neighbours, .out = &made};
    assert(neighbours->stride <= KNN_MAX_K);
    static_assert(KNN_MAX_K <= 64, "a bit for each neighbour");
    b.used = alloc_array(neighbours->n, sizeof *b.used);
    b.one_sided = alloc_array(neighbours->n, sizeof *b.one_sided);
    made.start = alloc_array(neighbours->n, sizeof *made.start);
    made.degree = alloc_array(neighbours->n, sizeof *made.degree);
    enum status status = b.used && b.one_sided && made.start && made.degree ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        par_for(threads, neighbours->n, GRAIN, start_count, &b);
        par_for(threads, neighbours->n, GRAIN, count_others, &b);
        status = place_both_ways(&b);
    }
    if (!status) {
        par_for(threads, neighbours->n, GRAIN, fill_own, &b);
        par_for(threads, neighbours->n, GRAIN, fill_others, &b);
        par_for(threads, neighbours->n, GRAIN, sort_range, &b);
    }
    free(b.used), free(b.one_sided);
    if (status)
        adjacency_done(&made);
    else
        *out = made;
    return status;
}

void adjacency_done(struct adjacency *adjacency) {
    if (!adjacency) return;
    free(adjacency->start);
    free(adjacency->degree);
    free(adjacency->list);
    *adjacency = (struct adjacency){0};
}
