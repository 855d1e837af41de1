/* Steps behind the writer, which take turns with those of other files on the same few threads.
 *
 *     0 ...... hashed ......... written ............... reserved ...... expected
 *       step by step   to be done       room on the disk
 *
 * Room is made a little ahead of the writer alone, so a client that promises much and sends nothing holds nothing; and
 * only where the length is known, so none is left behind the end.
 *
 * Invariants: `posted` says that a step is in the threads' list or under way; while it is set, `digest`, `hashed` and
 * `reserved` are the step's, and the last step frees what upload_hasher_free has left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/upload_hasher.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <unistd.h>

#include "core/base/alloc.h"

enum { STEP_BYTES = 2 * 1024 * 1024, AHEAD_BYTES = 32 * 1024 * 1024 };

struct upload_hasher {
    struct thread_pool *threads;
    struct thread_pool_task task;
    int fd;
    pthread_mutex_t lock;
    pthread_cond_t stepped;
    uint64_t written, hashed, reserved, expected;
    struct digest *digest;
    int failure; /* errno of a step; 0 = none */
    bool posted, left;
};

static void destroy(struct upload_hasher *hasher) {
    if (hasher->fd >= 0) close(hasher->fd);
    digest_free(hasher->digest);
    pthread_cond_destroy(&hasher->stepped);
    pthread_mutex_destroy(&hasher->lock);
    free(hasher);
}

/* Posts the next step where there is enough for one; under the lock. */
static void post(struct upload_hasher *hasher) {
    bool enough = hasher->written - hasher->hashed >= STEP_BYTES;
    hasher->posted = hasher->threads && enough && !hasher->left && !hasher->failure;
    if (hasher->posted) thread_pool_post(hasher->threads, &hasher->task);
}

static uint64_t count_written(struct upload_hasher *hasher) {
    pthread_mutex_lock(&hasher->lock);
    uint64_t written = hasher->written;
    pthread_mutex_unlock(&hasher->lock);
    return written;
}

/* Where there is none, or the file system can't tell, write will. */
static void make_room(struct upload_hasher *hasher) {
    uint64_t written = count_written(hasher), from = hasher->reserved > written ? hasher->reserved : written;
    if (hasher->expected == UINT64_MAX || from >= hasher->expected || from - written > AHEAD_BYTES / 2) return;
    uint64_t left = hasher->expected - from, count = left < AHEAD_BYTES ? left : AHEAD_BYTES;
    fallocate(hasher->fd, FALLOC_FL_KEEP_SIZE, (off_t)from, (off_t)count);
    hasher->reserved = from + count;
}

/* On one of the threads.  That the kernel begins to store the step is no promise, so its failure is fsync's to tell. */
static void step(void *ctx) {
    struct upload_hasher *hasher = ctx;
    make_room(hasher);
    int failure = digest_range(hasher->digest, hasher->fd, hasher->hashed, STEP_BYTES) == 0 ? 0 : errno;
    sync_file_range(hasher->fd, (off_t)hasher->hashed, STEP_BYTES, SYNC_FILE_RANGE_WRITE);
    pthread_mutex_lock(&hasher->lock);
    hasher->hashed += STEP_BYTES;
    hasher->failure = failure;
    post(hasher);
    bool last = hasher->left && !hasher->posted;
    pthread_cond_signal(&hasher->stepped);
    pthread_mutex_unlock(&hasher->lock);
    if (last) destroy(hasher);
}

struct upload_hasher *upload_hasher_new(struct thread_pool *threads, int fd, uint64_t expected) {
    struct upload_hasher *hasher = alloc_zeroed(1, sizeof *hasher);
    if (!hasher) return NULL;
    hasher->threads = threads;
    hasher->expected = expected;
    hasher->task = (struct thread_pool_task){.run = step, .ctx = hasher};
    pthread_mutex_init(&hasher->lock, NULL);
    pthread_cond_init(&hasher->stepped, NULL);
    hasher->digest = digest_new();
    hasher->fd = fcntl(fd, F_DUPFD_CLOEXEC, 0);
    if (hasher->digest && hasher->fd >= 0) return hasher;
    destroy(hasher);
    return NULL;
}

void upload_hasher_advance(struct upload_hasher *hasher, size_t count) {
    pthread_mutex_lock(&hasher->lock);
    hasher->written += count;
    if (!hasher->posted) post(hasher);
    pthread_mutex_unlock(&hasher->lock);
}

int upload_hasher_finish(struct upload_hasher *hasher, char hex[DIGEST_HEX_BYTES]) {
    pthread_mutex_lock(&hasher->lock);
    while (hasher->posted) pthread_cond_wait(&hasher->stepped, &hasher->lock);
    pthread_mutex_unlock(&hasher->lock);
    errno = hasher->failure;
    if (errno || digest_range(hasher->digest, hasher->fd, hasher->hashed, hasher->written - hasher->hashed) != 0)
        return -1;
    hasher->hashed = hasher->written;
    digest_finish(hasher->digest, hex);
    return 0;
}

void upload_hasher_free(struct upload_hasher *hasher) {
    if (!hasher) return;
    pthread_mutex_lock(&hasher->lock);
    hasher->left = true;
    bool last = !hasher->posted;
    pthread_mutex_unlock(&hasher->lock);
    if (last) destroy(hasher);
}
