/* A few threads for work that blocks (fsync, SQL), so that the threads that serve connections never do.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BASE_THREAD_POOL_H
#define WHITTLE_SERVER_BASE_THREAD_POOL_H

#include <stdbool.h>

#include "core/base/status.h"

struct thread_pool;

/* A task lives in what it is about; it may be posted again once run has been called. */
struct thread_pool_task {
    void (*run)(void *ctx);
    void *ctx;
    bool slow; /* it may wait for long: there is always room for others beside those that are */
    struct thread_pool_task *next;
};

enum status thread_pool_open(unsigned threads, struct thread_pool **pool) MUST_CHECK;

/* Runs what has been posted, then ends the threads.  Accepts NULL. */
void thread_pool_close(struct thread_pool *pool);

/* Has task->run(task->ctx) called soon, in the order of posting, but past those that are slow and have no
 * room.  Never fails, never blocks for long. */
void thread_pool_post(struct thread_pool *pool, struct thread_pool_task *task);

#endif
