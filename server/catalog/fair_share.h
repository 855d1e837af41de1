/* Whose turn it is: the order in which waiting jobs are started.
 *
 * Principals take turns: one with a thousand jobs delays another one's single job by one turn.  Among its own jobs the
 * one with the highest priority comes first, among equals the oldest.  A step of priority is worth aging_ms of waiting,
 * so a job of low priority is overtaken by later ones for a while, never for ever; and since all jobs grow older
 * together, the order changes only when a job comes or goes.
 *
 * Not for several threads at once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_FAIR_SHARE_H
#define WHITTLE_SERVER_CATALOG_FAIR_SHARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "server/catalog/job.h"

struct fair_share;

/* What the order, and an estimate of time, want to know of a job; cost is the caller's (estimate.h). */
struct turn {
    char id[JOB_ID_BYTES], principal[JOB_PRINCIPAL_BYTES];
    int priority;
    int64_t created_ms;
    struct job_cost cost;
};

/* Returns new, NULL when memory runs out.  fair_share_free accepts NULL. */
struct fair_share *fair_share_new(int64_t aging_ms);
void fair_share_free(struct fair_share *fair_share);

/* Puts a job in; false when memory runs out.  O(1). */
bool fair_share_add(struct fair_share *fair_share, const struct turn *turn);

/* Takes a job out, without its having had its turn; nothing when it isn't there.  O(n). */
void fair_share_remove(struct fair_share *fair_share, const char *id);

/* The job whose turn it is: NULL = none waits.  Borrowed until the next change.  The first call after a change is
 * O(n log n). */
const struct turn *fair_share_first(struct fair_share *fair_share);

/* Takes all jobs out; who was served when is remembered. */
void fair_share_clear(struct fair_share *fair_share);

/* It has had its turn: takes it out, and its principal goes to the end of the round. */
void fair_share_take(struct fair_share *fair_share, const char *id);

/* The clock by which jobs were created was set by step_ms: those that wait keep their ages. */
void fair_share_move_times(struct fair_share *fair_share, int64_t step_ms);

/* How many jobs come before this one; 0 when it isn't there.  Each of them is given to visit (NULL = nobody), in the
 * order of their turns. */
size_t fair_share_ahead(struct fair_share *fair_share, const char *id,
                        void (*visit)(void *ctx, const struct turn *turn), void *ctx);

#endif
