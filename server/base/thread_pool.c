/* Threads for work that blocks: one list, one lock.
 *
 * Invariant: at most thread_count - KEPT_FREE slow tasks run, so that those that aren't slow never wait for them alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/thread_pool.h"

#include <pthread.h>
#include <stdlib.h>

enum { MAX_THREADS = 64, KEPT_FREE = 2 };

struct thread_pool {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct thread_pool_task *first, **end; /* where the next one is linked in */
    bool closing;
    unsigned thread_count, slow_room, slow_running;
    pthread_t thread[MAX_THREADS];
};

/* Takes the first task that may run now out of the list; NULL = there is none. */
static struct thread_pool_task *pick(struct thread_pool *pool) {
    struct thread_pool_task **at = &pool->first;
    bool full = pool->slow_running >= pool->slow_room;
    while (full && *at && (*at)->slow) at = &(*at)->next;
    struct thread_pool_task *task = *at;
    if (!task) return NULL;
    *at = task->next;
    if (!*at) pool->end = at;
    pool->slow_running += task->slow;
    return task;
}

/* The next task, or NULL when there will be none. */
static struct thread_pool_task *take(struct thread_pool *pool) {
    struct thread_pool_task *task;
    pthread_mutex_lock(&pool->lock);
    while (!(task = pick(pool)) && (pool->first || !pool->closing)) pthread_cond_wait(&pool->changed, &pool->lock);
    pthread_mutex_unlock(&pool->lock);
    return task;
}

/* Another slow one may run now. */
static void end_slow(struct thread_pool *pool) {
    pthread_mutex_lock(&pool->lock);
    pool->slow_running--;
    pthread_cond_broadcast(&pool->changed);
    pthread_mutex_unlock(&pool->lock);
}

static void *work(void *ctx) {
    struct thread_pool *pool = ctx;
    for (struct thread_pool_task *task; (task = take(pool));) {
        bool slow = task->slow; /* the task may be gone after its run */
        task->run(task->ctx);
        if (slow) end_slow(pool);
    }
    return NULL;
}

enum status thread_pool_open(unsigned threads, struct thread_pool **pool) {
    struct thread_pool *opened = calloc(1, sizeof *opened);
    if (!opened) return STATUS_NO_MEMORY;
    opened->end = &opened->first;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->changed, NULL);
    opened->slow_room = threads > KEPT_FREE ? threads - KEPT_FREE : 1;
    while (opened->thread_count < threads && opened->thread_count < MAX_THREADS &&
           pthread_create(&opened->thread[opened->thread_count], NULL, work, opened) == 0)
        opened->thread_count++;
    if (opened->thread_count == 0) {
        thread_pool_close(opened);
        return STATUS_NO_MEMORY;
    }
    *pool = opened;
    return STATUS_OK;
}

void thread_pool_close(struct thread_pool *pool) {
    if (!pool) return;
    pthread_mutex_lock(&pool->lock);
    pool->closing = true;
    pthread_cond_broadcast(&pool->changed);
    pthread_mutex_unlock(&pool->lock);
    for (unsigned i = 0; i < pool->thread_count; i++) pthread_join(pool->thread[i], NULL);
    pthread_cond_destroy(&pool->changed);
    pthread_mutex_destroy(&pool->lock);
    free(pool);
}

void thread_pool_post(struct thread_pool *pool, struct thread_pool_task *task) {
    task->next = NULL;
    pthread_mutex_lock(&pool->lock);
    *pool->end = task;
    pool->end = &task->next;
    pthread_cond_signal(&pool->changed);
    pthread_mutex_unlock(&pool->lock);
}
