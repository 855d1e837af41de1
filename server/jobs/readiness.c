/* Readiness: a thread that looks, and what it found.
 *
 * Invariant: the lock is held for no longer than it takes to copy what was found.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/readiness.h"

#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "core/base/clock.h"
#include "server/base/deadline.h"
#include "server/jobs/service.h"

enum { OVERDUE_MS = 5000 };

struct readiness {
    struct service *service;
    int64_t period_ms;
    pthread_mutex_t lock;
    pthread_cond_t ended;
    bool ending;         /* this and what follows: under the lock */
    const char *at;      /* what the look under way is at; NULL = none is under way */
    int64_t at_since_ms; /* clock_ms */
    bool given;
    struct problem problem; /* where it isn't given */
    pthread_t thread;
};

/* ------------------------------------------------------------------------------------------------ looking */

static void begin(struct readiness *readiness, const char *at) {
    pthread_mutex_lock(&readiness->lock);
    readiness->at = at;
    readiness->at_since_ms = clock_ms();
    pthread_mutex_unlock(&readiness->lock);
}

static bool has_room(struct readiness *readiness, struct problem *problem) {
    struct store *store = readiness->service->store;
    struct error error = {0};
    begin(readiness, "the data folder");
    enum status files = scratch_takes_files(store_scratch(store), &error);
    if (!scratch_has_room(store_scratch(store), 0) || files == STATUS_NO_SPACE)
        problem_set(problem, PROBLEM_STORAGE_FULL, "the disk is full");
    else if (files != STATUS_OK)
        problem_set(problem, PROBLEM_NOT_READY, "the data folder takes no files: %s", error.text);
    else
        return true;
    return false;
}

/* Whether there is a program for jobs. */
static bool has_worker(struct readiness *readiness, struct problem *problem) {
    const char *path = readiness->service->config->worker;
    struct stat facts;
    begin(readiness, "the program for jobs");
    bool there = stat(path, &facts) == 0;
    if (there && !S_ISREG(facts.st_mode)) there = false, errno = EISDIR;
    if (there && access(path, X_OK) == 0) return true;
    problem_set(problem, PROBLEM_NOT_READY, "the program for jobs, %.200s, can't be executed: %s", path,
                strerror(errno));
    return false;
}

static bool has_database(struct readiness *readiness, struct problem *problem) {
    struct error error = {0};
    begin(readiness, "the database");
    if (catalog_takes_changes(readiness->service->catalog, &error) == STATUS_OK) return true;
    problem_set(problem, PROBLEM_NOT_READY, "the database takes no changes: %s", error.text);
    return false;
}

static void look(struct readiness *readiness) {
    struct problem problem = {0};
    bool given = has_room(readiness, &problem) && has_worker(readiness, &problem) && has_database(readiness, &problem);
    pthread_mutex_lock(&readiness->lock);
    readiness->at = NULL;
    readiness->given = given;
    readiness->problem = problem;
    pthread_mutex_unlock(&readiness->lock);
}

/* Until the next look; false: there is none. */
static bool rest(struct readiness *readiness) {
    struct timespec until = deadline_in_ms(readiness->period_ms);
    pthread_mutex_lock(&readiness->lock);
    while (!readiness->ending && deadline_wait(&until, &readiness->ended, &readiness->lock)) continue;
    bool again = !readiness->ending;
    pthread_mutex_unlock(&readiness->lock);
    return again;
}

static void *work(void *ctx) {
    while (rest(ctx)) look(ctx);
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ open, close */

enum status readiness_open(struct service *service, int64_t period_ms, struct readiness **readiness,
                           struct error *error) {
    struct readiness *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "readiness", "no memory");
    opened->service = service;
    opened->period_ms = period_ms;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->ended, NULL);
    look(opened);
    if (pthread_create(&opened->thread, NULL, work, opened) == 0) {
        *readiness = opened;
        return STATUS_OK;
    }
    pthread_cond_destroy(&opened->ended);
    pthread_mutex_destroy(&opened->lock);
    free(opened);
    return error_set(error, STATUS_NO_MEMORY, "readiness", "can't start its thread");
}

void readiness_close(struct readiness *readiness) {
    if (!readiness) return;
    pthread_mutex_lock(&readiness->lock);
    readiness->ending = true;
    pthread_cond_signal(&readiness->ended);
    pthread_mutex_unlock(&readiness->lock);
    pthread_join(readiness->thread, NULL);
    pthread_cond_destroy(&readiness->ended);
    pthread_mutex_destroy(&readiness->lock);
    free(readiness);
}

bool readiness_is_given(struct readiness *readiness, struct problem *problem) {
    pthread_mutex_lock(&readiness->lock);
    int64_t silent_ms = readiness->at ? clock_ms() - readiness->at_since_ms : 0;
    bool given = readiness->given && silent_ms <= OVERDUE_MS;
    *problem = readiness->problem;
    if (silent_ms > OVERDUE_MS)
        problem_set(problem, PROBLEM_NOT_READY, "%s hasn't answered for %lld s", readiness->at,
                    (long long)(silent_ms / 1000));
    pthread_mutex_unlock(&readiness->lock);
    return given;
}
