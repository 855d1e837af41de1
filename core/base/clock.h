/* Time that has passed, by a clock that never jumps: CLOCK_MONOTONIC, which counts from an unknown moment and is the
 * same for all processes of a machine.  For the time of day see job_now_ms (server/catalog/job.h).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_CLOCK_H
#define WHITTLE_CORE_BASE_CLOCK_H

#include <stdint.h>
#include <time.h>

/* Whole milliseconds, rounded down: for deadlines. */
static inline int64_t clock_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Milliseconds with their fractions: for how long a stage took. */
static inline double clock_exact_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e3 + (double)now.tv_nsec * 1e-6;
}

#endif
