/* Two clocks, compared.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/wall_clock.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <time.h>

static pthread_once_t once = PTHREAD_ONCE_INIT;
static pthread_rwlock_t lock = PTHREAD_RWLOCK_WRITER_NONRECURSIVE_INITIALIZER_NP;
static _Atomic int64_t ahead_ms; /* the service's own clock, of the machine's */

static int64_t read_ms(clockid_t clock) {
    struct timespec now;
    clock_gettime(clock, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int64_t wall_ahead_ms(void) { return read_ms(CLOCK_REALTIME) - read_ms(CLOCK_BOOTTIME); }

static void begin(void) { ahead_ms = wall_ahead_ms(); }

int64_t wall_clock_now_ms(void) {
    pthread_once(&once, begin);
    return read_ms(CLOCK_BOOTTIME) + ahead_ms;
}

int64_t wall_clock_step_ms(void) {
    pthread_once(&once, begin);
    int64_t step = wall_ahead_ms() - ahead_ms;
    if (llabs(step) >= WALL_CLOCK_STEP_MS) return step;
    wall_clock_follow(step);
    return 0;
}

void wall_clock_follow(int64_t step_ms) {
    pthread_once(&once, begin);
    ahead_ms += step_ms;
}

void wall_clock_hold(void) { pthread_rwlock_rdlock(&lock); }

void wall_clock_release(void) { pthread_rwlock_unlock(&lock); }

void wall_clock_stop(void) { pthread_rwlock_wrlock(&lock); }

void wall_clock_go_on(void) { pthread_rwlock_unlock(&lock); }
