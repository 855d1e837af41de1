/* Hoare's selection with the middle element as pivot: no randomness, so the same answer and the same time always.  Of
 * few values each comparison there is a branch that nobody can foretell; so among these the value is found by halving
 * the range of numbers that it is in, where all comparisons with the middle are made at once; few.c has the fewest.
 *
 * Hoare: Algorithm 65, FIND (1961).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/math/quantile.h"

#include <assert.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/math/few.h"

enum { SAMPLE_MOST = 1 << 17, FEW = 1024, SHARES_MOST = 4 };

static void swap(float *a, float *b) {
    float t = *a;
    *a = *b, *b = t;
}

/* A whole number in the order of the values, and back. */
static int32_t key_of(int32_t bits) { return bits ^ (int32_t)((uint32_t)(bits >> 31) >> 1); }

static size_t count_up_to(const int32_t *key, size_t n, int32_t most) {
    int32_t count = 0;
    for (size_t i = 0; i < n; i++) count += key[i] <= most;
    return (size_t)count;
}

/* Moves the keys from low to high to the front; how many. */
static size_t keep_between(int32_t *key, size_t n, int32_t low, int32_t high) {
    size_t kept = 0;
    for (size_t i = 0; i < n; i++) {
        int32_t k = key[i];
        key[kept] = k;
        kept += (k >= low) & (k <= high);
    }
    return kept;
}

/* The key of a rank, among those from low to high: `below` are less than low.  When one is left it is the least from
 * low on.  Once few are left the others go. */
static int32_t select_key(int32_t *key, size_t n, size_t rank) {
    enum { FOURTH = 4 };
    int32_t low = INT32_MAX, high = INT32_MIN, found = INT32_MAX;
    size_t below = 0, up_to = n;
    for (size_t i = 0; i < n; i++) low = key[i] < low ? key[i] : low, high = key[i] > high ? key[i] : high;
    while (up_to - below > 1 && low < high) {
        int32_t middle = (int32_t)(((int64_t)low + high) >> 1);
        size_t count = count_up_to(key, n, middle);
        if (count > rank)
            high = middle, up_to = count;
        else
            low = middle + 1, below = count;
        if (FOURTH * (up_to - below) > n) continue;
        n = keep_between(key, n, low, high);
        rank -= below, up_to -= below, below = 0;
    }
    for (size_t i = 0; i < n; i++) found = key[i] >= low && key[i] < found ? key[i] : found;
    return found;
}

static float value_of(int32_t key) {
    int32_t bits = key_of(key);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static size_t rank_of(size_t n, double share) {
    assert(n >= 1 && share >= 0 && share <= 1);
    return (size_t)floor(share * (double)(n - 1));
}

static float quantile_of_few(const float *value, size_t n, size_t rank) {
    int32_t key[FEW];
    memcpy(key, value, n * sizeof *value);
    for (size_t i = 0; i < n; i++) key[i] = key_of(key[i]);
    return value_of(select_key(key, n, rank));
}

void quantiles_of(float *value, size_t n, const double *share, size_t shares, float *found) {
    size_t rank[SHARES_MOST];
    assert(shares <= SHARES_MOST);
    for (size_t i = 0; i < shares; i++) rank[i] = rank_of(n, share[i]);
    if (n <= FEW_MOST)
        few_of_ranks(value, n, rank, shares, found);
    else
        for (size_t i = 0; i < shares; i++) found[i] = quantile_of(value, n, share[i]);
}

float quantile_of(float *value, size_t n, double share) {
    ptrdiff_t low = 0, high = (ptrdiff_t)n - 1, rank = (ptrdiff_t)rank_of(n, share);
    float found;
    if (n <= FEW_MOST) {
        few_of_ranks(value, n, &(size_t){(size_t)rank}, 1, &found);
        return found;
    }
    if (n <= FEW) return quantile_of_few(value, n, (size_t)rank);
    while (low < high) {
        float pivot = value[low + (high - low) / 2];
        ptrdiff_t i = low, j = high;
        while (i <= j) {
            while (value[i] < pivot) i++;
            while (value[j] > pivot) j--;
            if (i <= j) swap(&value[i++], &value[j--]);
        }
        if (rank > j && rank < i) break;
        if (rank <= j)
            high = j;
        else
            low = i;
    }
    return value[rank];
}

enum status quantile_spread(const float *value, size_t n, double *median, double *mad) {
    size_t step = n / SAMPLE_MOST + 1, taken = (n - 1) / step + 1;
    float *sample = alloc_array(taken, sizeof *sample);
    if (!sample) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < taken; i++) sample[i] = value[i * step];
    float middle = quantile_of(sample, taken, 0.5);
    for (size_t i = 0; i < taken; i++) sample[i] = fabsf(sample[i] - middle);
    *median = (double)middle;
    *mad = (double)quantile_of(sample, taken, 0.5);
    free(sample);
    return STATUS_OK;
}
