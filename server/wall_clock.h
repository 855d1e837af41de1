/* Whether somebody has set the clock.
 *
 * What is kept for a time has its end written down by the clock on the wall, which a restart can read.  When that clock
 * is set while the service runs, the ends have to move with it: else a jump forwards would end all of them at once, and
 * one backwards would keep them for long.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_WALL_CLOCK_H
#define WHITTLE_SERVER_WALL_CLOCK_H

#include <stdint.h>

/* Clocks get smaller corrections all the time. */
enum { WALL_CLOCK_STEP_MS = 10000 };

/* By how much the clock on the wall is ahead of the one that nobody sets, in milliseconds; it counts while the machine
 * sleeps, too. */
int64_t wall_clock_ahead_ms(void);

/* How far the clock was set since *ahead_ms was taken, which becomes the present one; 0 where that is less than
 * WALL_CLOCK_STEP_MS. */
int64_t wall_clock_step_ms(int64_t *ahead_ms);

#endif
