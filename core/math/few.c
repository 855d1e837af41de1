/* Each is compared with all, several at once and without a branch: nobody can foretell how a comparison ends.  What has
 * a rank is the greatest of those that no more than so many are less than.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/math/few.h"

#include <assert.h>

#include "core/math/simd.h"

static_assert(FEW_MOST / 4 % F32_LANES == 0, "room for whole registers");

/* Values as whole numbers in their order, and how many are less than each. */
struct counted {
    i32v key[FEW_MOST / F32_LANES], less[FEW_MOST / F32_LANES];
};

/* A whole number in the order of the values, and back. */
INLINE int32_t order_of(int32_t bits) { return bits ^ (int32_t)((uint32_t)(bits >> 31) >> 1); }

/* Of `room` places, of which those beyond n have the greatest key. */
INLINE void count_less(const float *value, size_t n, size_t room, struct counted *counted) {
    int32_t key[FEW_MOST];
    memcpy(key, value, n * sizeof *value);
    for (size_t i = 0; i < room; i++) key[i] = i < n ? order_of(key[i]) : INT32_MAX;
    for (size_t v = 0; v < room / F32_LANES; v++)
        counted->key[v] = i32_load(&key[v * F32_LANES]), counted->less[v] = i32_all(0);
    for (size_t j = 0; j < n; j++)
        for (size_t v = 0; v < room / F32_LANES; v++) counted->less[v] -= i32_less(i32_all(key[j]), counted->key[v]);
}

INLINE float value_of_rank(const struct counted *counted, size_t room, size_t rank) {
    i32v most = i32_all(INT32_MIN);
    int32_t best = INT32_MIN;
    float value;
    for (size_t v = 0; v < room / F32_LANES; v++) {
        i32v fits = i32_pick(i32_less(counted->less[v], i32_all((int32_t)rank + 1)), counted->key[v], most);
        most = i32_pick(i32_less(most, fits), fits, most);
    }
    for (size_t k = 0; k < F32_LANES; k++) best = SIMD_LANE(most, k) > best ? SIMD_LANE(most, k) : best;
    best = order_of(best);
    memcpy(&value, &best, sizeof value);
    return value;
}

INLINE void select_among(const float *value, size_t n, size_t room, const size_t *rank, size_t ranks, float *found) {
    struct counted counted;
    count_less(value, n, room, &counted);
    for (size_t k = 0; k < ranks; k++) found[k] = value_of_rank(&counted, room, rank[k]);
}

FOR_EACH_PROCESSOR(void, few_of_ranks)
(const float *value, size_t n, const size_t *rank, size_t ranks, float *found) {
    if (n <= FEW_MOST / 4)
        select_among(value, n, FEW_MOST / 4, rank, ranks, found);
    else if (n <= FEW_MOST / 2)
        select_among(value, n, FEW_MOST / 2, rank, ranks, found);
    else
        select_among(value, n, FEW_MOST, rank, ranks, found);
}
