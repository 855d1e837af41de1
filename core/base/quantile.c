/* Hoare's selection with the middle element as pivot: no randomness, so the same answer and the same time always.
 *
 * Hoare: Algorithm 65, FIND (1961).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/base/quantile.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"

enum { SAMPLE_MOST = 1 << 17 };

static void swap(float *a, float *b) {
    float t = *a;
    *a = *b, *b = t;
}

float quantile_of(float *value, size_t n, double share) {
    assert(n >= 1 && share >= 0 && share <= 1);
    ptrdiff_t low = 0, high = (ptrdiff_t)n - 1, rank = (ptrdiff_t)floor(share * (double)(n - 1));
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
