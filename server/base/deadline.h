/* Waiting for a condition until a time, by a clock that nobody sets.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_DEADLINE_H
#define WHITTLE_SERVER_BASE_DEADLINE_H

#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <time.h>

/* So many milliseconds from now. */
static inline struct timespec deadline_in_ms(int64_t ms) {
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    int64_t ns = until.tv_nsec + ms % 1000 * 1000000;
    until.tv_sec += ms / 1000 + ns / 1000000000;
    until.tv_nsec = ns % 1000000000;
    return until;
}

/* Waits under the lock until the condition is signalled (or for no reason: ask again what was waited for); false: the
 * deadline has passed. */
static inline bool deadline_wait(const struct timespec *until, pthread_cond_t *signal, pthread_mutex_t *lock) {
    return pthread_cond_clockwait(signal, lock, CLOCK_MONOTONIC, until) == 0;
}

#endif
