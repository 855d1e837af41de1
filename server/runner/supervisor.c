/* The supervisor: one thread for each job that may run, each in a loop of claim and run.
 *
 * Claiming happens under the lock, so that a job that this host has claimed is always found in a slot, and can be
 * cancelled.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include "core/base/clock.h"
#include "server/base/deadline.h"
#include "server/base/log.h"
#include "server/runner/job_run.h"
#include "server/runner/supervisor.h"

/* A thread that runs a job may be silent for long: its outputs are hashed and flushed meanwhile. */
enum { LOOK_AGAIN_S = 1, REST_S = 10, OVERDUE_MS = 30000, STALLS = 3, MAX_SLOTS = 256 };

struct slot {
    struct supervisor *supervisor;
    pthread_t thread;
    char id[JOB_ID_BYTES]; /* of the job that runs here; "" = none */
    int attempt;           /* of that job */
    uint64_t claimed;      /* the round of renewing that it was claimed in */
    uint64_t memory_bytes; /* that it is predicted to take */
    int64_t looked_ms;     /* when it last asked for a job, or could have */
    struct job_run_control control;
};

struct supervisor {
    struct service *service;
    struct confinement *confinement;
    pthread_mutex_t lock;
    pthread_cond_t submitted;
    bool stopping;
    unsigned slot_count, threads_alive;
    int idle_fd;
    bool renews, renewed_enough; /* there is a thread that renews leases; it is to end */
    uint64_t round;              /* of renewing, counted at its beginning */
    pthread_t renewer;
    pthread_cond_t enough;
    struct slot slot[MAX_SLOTS];
};

static void ring(int fd) {
    ssize_t n = write(fd, &(uint64_t){1}, sizeof(uint64_t));
    (void)n; /* full means that it rings already */
}

/* What the next job may take, under the lock; anything where none runs, so that none waits for ever. */
static int64_t memory_left(const struct supervisor *supervisor) {
    int64_t left = supervisor->service->config->total_memory_bytes;
    bool runs = false;
    for (unsigned i = 0; i < supervisor->slot_count; i++) {
        const struct slot *slot = &supervisor->slot[i];
        if (!slot->id[0]) continue;
        runs = true;
        left = slot->memory_bytes < (uint64_t)left ? left - (int64_t)slot->memory_bytes : 0;
    }
    return runs ? left : INT64_MAX;
}

/* Claims the next job, under the lock; logs what goes wrong. */
static bool claim(struct slot *slot, struct job *job) {
    struct error error = {0};
    bool found;
    struct supervisor *supervisor = slot->supervisor;
    struct service *service = supervisor->service;
    struct catalog_claim by = {service->host, service->config->lease_ms, memory_left(supervisor)};
    if (catalog_claim(service->catalog, &by, job, &found, &error) != STATUS_OK) {
        log_line(LOG_ERROR, "can't claim a job: %s", error.text);
        return false;
    }
    if (!found) return false;
    memcpy(slot->id, job->id, sizeof slot->id);
    slot->memory_bytes = job->memory_bytes;
    slot->attempt = job->attempt;
    slot->claimed = supervisor->round;
    atomic_store(&slot->control.command, JOB_RUN_GO_ON);
    atomic_store(&slot->control.seen_ms, clock_ms());
    return true;
}

/* Waits for a job; false when there will be none. */
static bool next_job(struct slot *slot, struct job *job) {
    struct supervisor *supervisor = slot->supervisor;
    bool found = false;
    pthread_mutex_lock(&supervisor->lock);
    while (!supervisor->stopping && !(found = claim(slot, job))) {
        struct timespec until = deadline_in_ms(LOOK_AGAIN_S * 1000);
        slot->looked_ms = clock_ms();
        (void)deadline_wait(&until, &supervisor->submitted, &supervisor->lock);
    }
    pthread_mutex_unlock(&supervisor->lock);
    return found;
}

/* Takes no job for a while, under the lock: another host is to have what this one couldn't run. */
static void rest_slot(struct slot *slot) {
    struct supervisor *supervisor = slot->supervisor;
    struct timespec until = deadline_in_ms(REST_S * 1000);
    while (!supervisor->stopping && deadline_wait(&until, &supervisor->submitted, &supervisor->lock)) continue;
}

static void *work(void *ctx) {
    struct slot *slot = ctx;
    struct supervisor *supervisor = slot->supervisor;
    struct job job;
    while (next_job(slot, &job)) {
        bool is_fit = job_run(supervisor->service, supervisor->confinement, &job, &slot->control);
        job_done(&job);
        pthread_mutex_lock(&supervisor->lock);
        slot->id[0] = 0;
        pthread_cond_broadcast(&supervisor->submitted); /* who waits for memory may have it now */
        slot->looked_ms = clock_ms();
        if (!is_fit) rest_slot(slot);
        pthread_mutex_unlock(&supervisor->lock);
    }
    pthread_mutex_lock(&supervisor->lock);
    if (--supervisor->threads_alive == 0) ring(supervisor->idle_fd);
    pthread_mutex_unlock(&supervisor->lock);
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ leases */

static void command(struct slot *slot, enum job_run_command command) {
    int none = JOB_RUN_GO_ON;
    atomic_compare_exchange_strong(&slot->control.command, &none, command);
    ring(slot->control.wake_fd);
}

/* What the leases say of the job in a slot, under the lock. */
static void compare_slot(struct slot *slot, const struct catalog_lease *leases, size_t count, uint64_t round) {
    size_t i = 0;
    while (i < count && (leases[i].attempt != slot->attempt || strcmp(leases[i].job, slot->id) != 0)) i++;
    if (i < count && leases[i].is_cancelled) command(slot, JOB_RUN_DISMISS);
    if (i == count && slot->claimed < round) command(slot, JOB_RUN_LOST); /* else it was claimed since they were read */
}

/* Renews all leases; a job without one is another host's, and ends here.  Where the catalog doesn't answer they go on:
 * what they come to is fenced. */
static void renew_leases(struct supervisor *supervisor, uint64_t round) {
    struct service *service = supervisor->service;
    struct catalog_lease leases[MAX_SLOTS];
    struct error error = {0};
    size_t count = 0;
    if (catalog_renew(service->catalog, service->host, service->config->lease_ms, leases, MAX_SLOTS, &count, &error) !=
        STATUS_OK) {
        log_line_seldom(LOG_ERROR, "leases can't be renewed: %s", error.text);
        return;
    }
    pthread_mutex_lock(&supervisor->lock);
    for (unsigned i = 0; i < supervisor->slot_count; i++)
        if (supervisor->slot[i].id[0]) compare_slot(&supervisor->slot[i], leases, count, round);
    pthread_mutex_unlock(&supervisor->lock);
}

/* A third of a lease from now, under the lock. */
static void rest(struct supervisor *supervisor) {
    struct timespec until = deadline_in_ms(supervisor->service->config->lease_ms / 3);
    while (!supervisor->renewed_enough && deadline_wait(&until, &supervisor->enough, &supervisor->lock)) continue;
}

static void *keep_leases(void *ctx) {
    struct supervisor *supervisor = ctx;
    pthread_mutex_lock(&supervisor->lock);
    for (rest(supervisor); !supervisor->renewed_enough; rest(supervisor)) {
        bool runs = false;
        for (unsigned i = 0; i < supervisor->slot_count; i++) runs = runs || supervisor->slot[i].id[0];
        uint64_t round = ++supervisor->round;
        pthread_mutex_unlock(&supervisor->lock);
        if (runs) renew_leases(supervisor, round);
        pthread_mutex_lock(&supervisor->lock);
    }
    pthread_mutex_unlock(&supervisor->lock);
    return NULL;
}

/* ------------------------------------------------------------------------------------------------ open */

static const struct service_runner runner = {supervisor_notify, supervisor_cancel, supervisor_answers};

static bool start_slot(struct supervisor *supervisor) {
    struct slot *slot = &supervisor->slot[supervisor->slot_count];
    slot->supervisor = supervisor;
    slot->looked_ms = clock_ms();
    slot->control.wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (slot->control.wake_fd < 0) return false;
    pthread_mutex_lock(&supervisor->lock);
    bool ok = pthread_create(&slot->thread, NULL, work, slot) == 0;
    if (ok) supervisor->slot_count++, supervisor->threads_alive++;
    pthread_mutex_unlock(&supervisor->lock);
    if (!ok) close(slot->control.wake_fd);
    return ok;
}

static enum status open_confinement(struct supervisor *supervisor, struct error *error) {
    const struct config *config = supervisor->service->config;
    char text[CONFINE_TEXT_BYTES];
    if (supervisor->idle_fd < 0)
        return error_set(error, STATUS_IO, "supervisor", "no descriptors: %s", strerror(errno));
    enum status status =
        confine_open(config->worker, config->worker_sandbox, config->job_user, &supervisor->confinement, error);
    if (status != STATUS_OK) return status;
    confine_describe(supervisor->confinement, text);
    log_line(LOG_INFO, "jobs are confined by %s", text);
    struct service_measure *measure = supervisor->service->confinement;
    for (size_t i = 0; i < SERVICE_MEASURES; i++)
        if (!confine_measure(supervisor->confinement, i, &measure[i].name, &measure[i].value)) break;
    return STATUS_OK;
}

enum status supervisor_open(struct service *service, struct supervisor **supervisor, struct error *error) {
    struct supervisor *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "supervisor", "no memory");
    opened->service = service;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_cond_init(&opened->submitted, NULL);
    pthread_cond_init(&opened->enough, NULL);
    opened->idle_fd = eventfd(0, EFD_CLOEXEC);
    int64_t workers = strcmp(service->config->roles, "http") == 0 ? 0 : service->config->workers;
    enum status status = open_confinement(opened, error);
    for (int64_t i = 0; status == STATUS_OK && i < workers; i++)
        if (!start_slot(opened))
            status = error_set(error, STATUS_IO, "supervisor", "can't start its threads: %s", strerror(errno));
    opened->renews = status == STATUS_OK && pthread_create(&opened->renewer, NULL, keep_leases, opened) == 0;
    if (status == STATUS_OK && !opened->renews)
        status = error_set(error, STATUS_IO, "supervisor", "can't start the thread that renews leases");
    if (status == STATUS_OK) {
        service->runner = &runner;
        *supervisor = opened;
        return STATUS_OK;
    }
    supervisor_stop(opened);
    supervisor_close(opened);
    return status;
}

void supervisor_notify(struct supervisor *supervisor) {
    pthread_mutex_lock(&supervisor->lock);
    pthread_cond_signal(&supervisor->submitted);
    pthread_mutex_unlock(&supervisor->lock);
}

bool supervisor_cancel(struct supervisor *supervisor, const char *id) {
    bool found = false;
    pthread_mutex_lock(&supervisor->lock);
    for (unsigned i = 0; i < supervisor->slot_count; i++) {
        if (strcmp(supervisor->slot[i].id, id) != 0) continue;
        command(&supervisor->slot[i], JOB_RUN_DISMISS);
        found = true;
    }
    pthread_mutex_unlock(&supervisor->lock);
    return found;
}

/* Whether the slot's thread has shown in time that it goes on, under the lock. */
static bool goes_on(const struct slot *slot, int64_t now) {
    int64_t patience_ms = STALLS * slot->supervisor->service->config->job_stall_ms;
    if (!slot->id[0]) return slot->looked_ms > now - OVERDUE_MS;
    if (!patience_ms) return true;
    if (patience_ms < OVERDUE_MS) patience_ms = OVERDUE_MS;
    if (atomic_load(&slot->control.seen_ms) > now - patience_ms) return true;
    log_line(LOG_ERROR, "job=%s: the thread that runs it has made no progress for %d s", slot->id,
             (int)(patience_ms / 1000));
    return false;
}

bool supervisor_answers(struct supervisor *supervisor) {
    bool all = true;
    pthread_mutex_lock(&supervisor->lock);
    int64_t now = clock_ms();
    for (unsigned i = 0; i < supervisor->slot_count && !supervisor->stopping; i++)
        all = goes_on(&supervisor->slot[i], now) && all;
    pthread_mutex_unlock(&supervisor->lock);
    return all;
}

void supervisor_stop(struct supervisor *supervisor) {
    pthread_mutex_lock(&supervisor->lock);
    supervisor->stopping = true;
    if (!supervisor->threads_alive) ring(supervisor->idle_fd); /* a host that runs no jobs */
    pthread_cond_broadcast(&supervisor->submitted);
    pthread_mutex_unlock(&supervisor->lock);
}

int supervisor_idle_fd(const struct supervisor *supervisor) { return supervisor->idle_fd; }

void supervisor_requeue(struct supervisor *supervisor) {
    pthread_mutex_lock(&supervisor->lock);
    for (unsigned i = 0; i < supervisor->slot_count; i++)
        if (supervisor->slot[i].id[0]) command(&supervisor->slot[i], JOB_RUN_REQUEUE);
    pthread_mutex_unlock(&supervisor->lock);
}

void supervisor_close(struct supervisor *supervisor) {
    if (!supervisor) return;
    for (unsigned i = 0; i < supervisor->slot_count; i++) {
        pthread_join(supervisor->slot[i].thread, NULL);
        close(supervisor->slot[i].control.wake_fd);
    }
    pthread_mutex_lock(&supervisor->lock);
    supervisor->renewed_enough = true;
    pthread_cond_broadcast(&supervisor->enough);
    pthread_mutex_unlock(&supervisor->lock);
    if (supervisor->renews) pthread_join(supervisor->renewer, NULL);
    if (supervisor->idle_fd >= 0) close(supervisor->idle_fd);
    confine_close(supervisor->confinement);
    pthread_cond_destroy(&supervisor->enough);
    pthread_cond_destroy(&supervisor->submitted);
    pthread_mutex_destroy(&supervisor->lock);
    free(supervisor);
}
