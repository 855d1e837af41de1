/* Two clocks, compared.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/wall_clock.h"

#include <stdlib.h>
#include <time.h>

static int64_t read_ms(clockid_t clock) {
    struct timespec now;
    clock_gettime(clock, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

int64_t wall_clock_ahead_ms(void) { return read_ms(CLOCK_REALTIME) - read_ms(CLOCK_BOOTTIME); }

int64_t wall_clock_step_ms(int64_t *ahead_ms) {
    int64_t ahead = wall_clock_ahead_ms(), step = ahead - *ahead_ms;
    *ahead_ms = ahead;
    return llabs(step) < WALL_CLOCK_STEP_MS ? 0 : step;
}
