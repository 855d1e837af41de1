/* Each is compared with all, several at once and without a branch: nobody can foretell how a comparison ends.  What has
 * a rank is the greatest of those that no more than so many are less than.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/few.h"

#include <stdint.h>
#include <string.h>

#include "core/base/processor.h"

/* A whole number in the order of the values, and back. */
INLINE int32_t order_of(int32_t bits) { return bits ^ (int32_t)((uint32_t)(bits >> 31) >> 1); }

/* Loops are over `room` places, of which those beyond n have the greatest key. */
INLINE void select_among(const float *value, size_t n, size_t room, const size_t *rank, size_t ranks, float *found) {
    int32_t bits[FEW_MOST], key[FEW_MOST], less[FEW_MOST];
    memcpy(bits, value, n * sizeof *value);
    for (size_t i = 0; i < room; i++) key[i] = i < n ? order_of(bits[i]) : INT32_MAX, less[i] = 0;
    for (size_t j = 0; j < n; j++)
        for (size_t i = 0; i < room; i++) less[i] += key[j] < key[i];
    for (size_t k = 0; k < ranks; k++) {
        int32_t best = INT32_MIN;
        for (size_t i = 0; i < room; i++) {
            int32_t fits = less[i] <= (int32_t)rank[k] ? key[i] : INT32_MIN;
            best = fits > best ? fits : best;
        }
        best = order_of(best);
        memcpy(&found[k], &best, sizeof best);
    }
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
