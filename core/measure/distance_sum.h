/* Distances added up: those of some points, and those of parts to those of all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_DISTANCE_SUM_H
#define WHITTLE_CORE_MEASURE_DISTANCE_SUM_H

#include <math.h>
#include <stdint.h>

#include "core/report.h"

/* Zero-initialised: of none. */
struct distance_sum {
    uint64_t count;
    double sum, sum_sq, max;
};

static inline void distance_sum_add(struct distance_sum *sum, double distance) {
    sum->count++;
    sum->sum += distance;
    sum->sum_sq += distance * distance;
    sum->max = fmax(sum->max, distance);
}

static inline void distance_sum_join(struct distance_sum *sum, const struct distance_sum *other) {
    sum->count += other->count;
    sum->sum += other->sum;
    sum->sum_sq += other->sum_sq;
    sum->max = fmax(sum->max, other->max);
}

/* scale: of the units that are wanted, in those that were added up. */
static inline struct distance_stats distance_sum_stats(const struct distance_sum *sum, double scale) {
    double n = sum->count ? (double)sum->count : 1;
    return (struct distance_stats){sum->count, sum->sum / n * scale, sqrt(sum->sum_sq / n) * scale, sum->max * scale};
}

#endif
