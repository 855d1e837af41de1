/* Steps behind the writer, which take turns with those of other files on the same few threads.
 *
 *     0 ...... hashed ......... written ............... reserved ...... expected
 *       step by step   to be done       room on the disk
 *
 * Room is made a little ahead of the writer alone, so a client that promises much and sends nothing holds nothing; and
 * only where the length is known, so none is left behind the end.
 *
 * Invariants: `posted` says that a step is in the threads' list or under way; while it is set, `digest`, `hashed` and
 * `reserved` are the step's, and the last step frees what behind_free has left.
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

struct behind {
    struct offload *threads;
    struct offload_task task;
    int fd;
    pthread_mutex_t lock;
    pthread_cond_t stepped;
    uint64_t written, hashed, reserved, expected;
    struct digest *digest;
    int failure; /* errno of a step; 0 = none */
    bool posted, left;
};

static void destroy(struct behind *behind) {
    if (behind->fd >= 0) close(behind->fd);
    digest_free(behind->digest);
    pthread_cond_destroy(&behind->stepped);
    pthread_mutex_destroy(&behind->lock);
    free(behind);
}

/* Posts the next step where there is enough for one; under the lock. */
static void post(struct behind *behind) {
    bool enough = behind->written - behind->hashed >= STEP_BYTES;
    behind->posted = behind->threads && enough && !behind->left && !behind->failure;
    if (behind->posted) offload_post(behind->threads, &behind->task);
}

static uint64_t count_written(struct behind *behind) {
    pthread_mutex_lock(&behind->lock);
    uint64_t written = behind->written;
    pthread_mutex_unlock(&behind->lock);
    return written;
}

/* Where there is none, or the file system can't tell, write will. */
static void make_room(struct behind *behind) {
    uint64_t written = count_written(behind), from = behind->reserved > written ? behind->reserved : written;
    if (behind->expected == UINT64_MAX || from >= behind->expected || from - written > AHEAD_BYTES / 2) return;
    uint64_t left = behind->expected - from, count = left < AHEAD_BYTES ? left : AHEAD_BYTES;
    fallocate(behind->fd, FALLOC_FL_KEEP_SIZE, (off_t)from, (off_t)count);
    behind->reserved = from + count;
}

/* On one of the threads.  That the kernel begins to store the step is no promise, so its failure is fsync's to tell. */
static void step(void *ctx) {
    struct behind *behind = ctx;
    make_room(behind);
    int failure = digest_range(behind->digest, behind->fd, behind->hashed, STEP_BYTES) == 0 ? 0 : errno;
    sync_file_range(behind->fd, (off_t)behind->hashed, STEP_BYTES, SYNC_FILE_RANGE_WRITE);
    pthread_mutex_lock(&behind->lock);
    behind->hashed += STEP_BYTES;
    behind->failure = failure;
    post(behind);
    bool last = behind->left && !behind->posted;
    pthread_cond_signal(&behind->stepped);
    pthread_mutex_unlock(&behind->lock);
    if (last) destroy(behind);
}

struct behind *behind_new(struct offload *threads, int fd, uint64_t expected) {
    struct behind *behind = alloc_zeroed(1, sizeof *behind);
    if (!behind) return NULL;
    behind->threads = threads;
    behind->expected = expected;
    behind->task = (struct offload_task){.run = step, .ctx = behind};
    pthread_mutex_init(&behind->lock, NULL);
    pthread_cond_init(&behind->stepped, NULL);
    behind->digest = digest_new();
    behind->fd = fcntl(fd, F_DUPFD_CLOEXEC, 0);
    if (behind->digest && behind->fd >= 0) return behind;
    destroy(behind);
    return NULL;
}

void behind_advance(struct behind *behind, size_t count) {
    pthread_mutex_lock(&behind->lock);
    behind->written += count;
    if (!behind->posted) post(behind);
    pthread_mutex_unlock(&behind->lock);
}

int behind_finish(struct behind *behind, char hex[DIGEST_HEX_BYTES]) {
    pthread_mutex_lock(&behind->lock);
    while (behind->posted) pthread_cond_wait(&behind->stepped, &behind->lock);
    pthread_mutex_unlock(&behind->lock);
    errno = behind->failure;
    if (errno || digest_range(behind->digest, behind->fd, behind->hashed, behind->written - behind->hashed) != 0)
        return -1;
    behind->hashed = behind->written;
    digest_finish(behind->digest, hex);
    return 0;
}

void behind_free(struct behind *behind) {
    if (!behind) return;
    pthread_mutex_lock(&behind->lock);
    behind->left = true;
    bool last = !behind->posted;
    pthread_mutex_unlock(&behind->lock);
    if (last) destroy(behind);
}
