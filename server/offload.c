/* Threads for work that blocks: one list, one lock.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/offload.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>

enum { MAX_THREADS = 64 };

struct offload {
    pthread_mutex_t lock;
    pthread_cond_t posted;
    struct offload_task *first, *last;
    bool closing;
    unsigned thread_count;
    pthread_t thread[MAX_THREADS];
};

/* The next task, or NULL when there will be none. */
static struct offload_task *take(struct offload *offload) {
    pthread_mutex_lock(&offload->lock);
    while (!offload->first && !offload->closing) pthread_cond_wait(&offload->posted, &offload->lock);
    struct offload_task *task = offload->first;
    if (task) offload->first = task->next;
    pthread_mutex_unlock(&offload->lock);
    return task;
}

static void *work(void *ctx) {
    for (struct offload_task *task; (task = take(ctx));) task->run(task->ctx);
    return NULL;
}

enum status offload_open(unsigned threads, struct offload **offload) {
    struct offload *opened = calloc(1, sizeof *opened);
    if (!opened) return STATUS_NO_MEMORY;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->posted, NULL);
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
    pthread_cond_broadcast(&offload->posted);
    pthread_mutex_unlock(&offload->lock);
    for (unsigned i = 0; i < offload->thread_count; i++) pthread_join(offload->thread[i], NULL);
    pthread_cond_destroy(&offload->posted);
    pthread_mutex_destroy(&offload->lock);
    free(offload);
}

void offload_post(struct offload *offload, struct offload_task *task) {
    task->next = NULL;
    pthread_mutex_lock(&offload->lock);
    if (offload->first)
        offload->last->next = task;
    else
        offload->first = task;
    offload->last = task;
    pthread_cond_signal(&offload->posted);
    pthread_mutex_unlock(&offload->lock);
}
