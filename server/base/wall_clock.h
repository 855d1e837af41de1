/* Whether somebody has set the clock.
 *
 * What is kept for a time has its end written down by a clock on the wall, which a restart can read.  When that clock
 * is set while the service runs, the ends have to move with it: else a jump forwards would end all of them at once, and
 * one backwards would keep them for long.
 *
 * Between the moment in which somebody sets the clock and the one in which the ends move, others are written.  So what
 * is written goes by a clock of the service's own, which nobody sets: it is that of the machine, which counts from its
 * start, and an offset; and the offset changes in the step that moves what was written by the old one.  Whoever writes
 * an end holds the clock from reading it until the end is written (and doesn't hold it twice).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_WALL_CLOCK_H
#define WHITTLE_SERVER_BASE_WALL_CLOCK_H

#include <stdint.h>

/* Clocks get smaller corrections all the time. */
enum { WALL_CLOCK_STEP_MS = 10000 };

/* Milliseconds since 1970 by the service's own clock, which follows the one on the wall when wall_clock_follow says so.
 */
int64_t wall_clock_now_ms(void);

/* How far the clock on the wall was set since; 0 where that is less than WALL_CLOCK_STEP_MS, and then the service's own
 * follows it already. */
int64_t wall_clock_step_ms(void);

/* The service's own clock moves by so much. */
void wall_clock_follow(int64_t step_ms);

/* It doesn't move between hold and release, in any number of threads; nor does anybody hold it between stop and go_on,
 * where ends and clock are moved. */
void wall_clock_hold(void);
void wall_clock_release(void);
void wall_clock_stop(void);
void wall_clock_go_on(void);

#endif
