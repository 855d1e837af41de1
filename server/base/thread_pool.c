/* Threads for work that blocks: one list, one lock.
 *
 * Invariant: at most thread_count - KEPT_FREE slow tasks run, so that those that aren't slow never wait for them alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/thread_pool.h"

#include <pthread.h>
#include <stdlib.h>

enum { MAX_THREADS = 64, KEPT_FREE = 2 };

struct offload {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct offload_task *first, **end; /* where the next one is linked in */
    bool closing;
    unsigned thread_count, slow_room, slow_running;
    pthread_t thread[MAX_THREADS];
};

/* Takes the first task that may run now out of the list; NULL = there is none. */
static struct offload_task *pick(struct offload *offload) {
    struct offload_task **at = &offload->first;
    bool full = offload->slow_running >= offload->slow_room;
    while (full && *at && (*at)->slow) at = &(*at)->next;
    struct offload_task *task = *at;
    if (!task) return NULL;
    *at = task->next;
    if (!*at) offload->end = at;
    offload->slow_running += task->slow;
    return task;
}

/* The next task, or NULL when there will be none. */
static struct offload_task *take(struct offload *offload) {
    struct offload_task *task;
    pthread_mutex_lock(&offload->lock);
    while (!(task = pick(offload)) && (offload->first || !offload->closing))
        pthread_cond_wait(&offload->changed, &offload->lock);
    pthread_mutex_unlock(&offload->lock);
    return task;
}

/* Another slow one may run now. */
static void end_slow(struct offload *offload) {
    pthread_mutex_lock(&offload->lock);
    offload->slow_running--;
    pthread_cond_broadcast(&offload->changed);
    pthread_mutex_unlock(&offload->lock);
}

static void *work(void *ctx) {
    struct offload *offload = ctx;
    for (struct offload_task *task; (task = take(offload));) {
        bool slow = task->slow; /* the task may be gone after its run */
        task->run(task->ctx);
        if (slow) end_slow(offload);
    }
    return NULL;
}

enum status offload_open(unsigned threads, struct offload **offload) {
    struct offload *opened = calloc(1, sizeof *opened);
    if (!opened) return STATUS_NO_MEMORY;
    opened->end = &opened->first;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->changed, NULL);
    opened->slow_room = threads > KEPT_FREE ? threads - KEPT_FREE : 1;
    while (opened->thread_count < threads && opened->thread_count < MAX_THREADS &&
           pthread_create(&opened->thread[opened->thread_count], NULL, work, opened) == 0)
        opened->thread_count++;
    if (opened->thread_count == 0) {
        offload_close(opened);
        return STATUS_NO_MEMORY;
    }
    *offload = opened;
    return STATUS_OK;
}

void offload_close(struct offload *offload) {
    if (!offload) return;
    pthread_mutex_lock(&offload->lock);
    offload->closing = true;
    pthread_cond_broadcast(&offload->changed);
    pthread_mutex_unlock(&offload->lock);
    for (unsigned i = 0; i < offload->thread_count; i++) pthread_join(offload->thread[i], NULL);
    pthread_cond_destroy(&offload->changed);
    pthread_mutex_destroy(&offload->lock);
    free(offload);
}

void offload_post(struct offload *offload, struct offload_task *task) {
    task->next = NULL;
    pthread_mutex_lock(&offload->lock);
    *offload->end = task;
    offload->end = &task->next;
    pthread_cond_signal(&offload->changed);
    pthread_mutex_unlock(&offload->lock);
}
