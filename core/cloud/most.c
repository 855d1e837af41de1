/* Quantiles along each axis, of double: as float all coordinates of a cluster that is far off would be alike.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/most.h"

#include <assert.h>
#include <stdlib.h>

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

bool most_of(vec3 *sample, size_t n, vec3 *least, vec3 *most) {
    double value[MOST_SAMPLES];
    size_t count = 0;
    assert(n <= MOST_SAMPLES);
    for (size_t i = 0; i < n; i++)
        if (count == 0 || !vec3_equal(sample[i], sample[count - 1])) sample[count++] = sample[i];
    if (count < MOST_FEWEST) return false;
    vec3 low, high;
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < count; i++) value[i] = (&sample[i].x)[axis];
        qsort(value, count, sizeof *value, ascending);
        (&low.x)[axis] = value[count / MOST_OUTERMOST];
        (&high.x)[axis] = value[count - 1 - count / MOST_OUTERMOST];
    }
    if (vec3_equal(low, high)) return false;
    *least = low, *most = high;
    return true;
}
