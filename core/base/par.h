/* Parallel loops.  The only place in core/ that starts threads; none outlives the call, or the team that the caller has
 * made.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_BASE_PAR_H
#define WHITTLE_CORE_BASE_PAR_H

#include <stddef.h>

/* Number of processors that this process may use, at least 1. */
unsigned par_processors(void);

/* Calls body(ctx, begin, end) for disjoint ranges that cover 0 .. n-1, each range of grain indices but the last, on up
 * to `threads` threads (0 = all processors; the caller's thread is one of them).  Which thread runs which range isn't
 * fixed, so body must write only to what its indices own: then results don't depend on the number of threads.  Ranges
 * are the same for any number of threads, so a sum can be kept for each range (index begin / grain) and added up in
 * order.  Where no thread can be started the caller's own thread does everything. */
void par_for(unsigned threads, size_t n, size_t grain, void (*body)(void *ctx, size_t begin, size_t end), void *ctx);

/* Threads that stay from one loop to the next: until par_team_free all par_for of the calling thread, but for loops
 * inside a loop's body, share them.  They are started when a loop first wants them, and sleep where none does.  Returns
 * new; NULL where there is no memory.  A thread has one team at most. */
struct par_team;
struct par_team *par_team_new(void);

/* Calls mine(ctx) on the caller's thread and others(ctx) beside it, on another one of the caller's team, and returns
 * when both are done; with one thread, without a team, or where all of it are busy until then, others comes after mine.
 * Loops of either are shared out among all threads of the team that are free, the caller's too once mine is done.  What
 * the two do must not depend on which is first. */
void par_beside(unsigned threads, void (*mine)(void *ctx), void (*others)(void *ctx), void *ctx);

/* By the thread that made it, outside loops.  Accepts NULL. */
void par_team_free(struct par_team *team);

#endif
