/* Submitting, deleting, mending and sweeping: where queue and store meet.
 *
 * Invariant: a job's row is committed after its cloud is durable, and removed before its files are.  So a crash leaves
 * files without rows, never rows without files, and the next start removes them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/service.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/problem.h"
#include "server/clouds.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/supervisor.h"
#include "server/tokens.h"

enum { PAGE = 64, TOMBSTONE_MS = 7 * 24 * 3600 * 1000 };

/* ------------------------------------------------------------------------------------------------ mending */

/* Whether the queue knows this cloud or job; on a doubt it is kept. */
static bool is_known(void *ctx, enum store_thing thing, const char *name) {
    struct service *service = ctx;
    struct error error = {0};
    if (thing == STORE_CLOUD) {
        uint64_t uses = 1;
        return queue_cloud_uses(service->queue, name, &uses, &error) != STATUS_OK || uses > 0;
    }
    struct job job;
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    bool known =
        queue_get(service->queue, name, &job, &presence, &tombstone, &error) != STATUS_OK || presence == QUEUE_PRESENT;
    job_done(&job);
    return known;
}

/* A job that was running when the service ended. */
static enum status mend_running(struct service *service, struct job *job, struct error *error) {
    bool changed;
    if (job->attempt < JOB_MAX_ATTEMPTS) {
        log_line(LOG_WARNING, "job=%s was running when the service ended: queued again", job->id);
        return queue_finish(service->queue, JOB_REQUEUE, job, &changed, error);
    }
    struct problem problem;
    problem_set(&problem, PROBLEM_WORKER_CRASHED, "the service ended while the job ran, in each of %d attempts",
                job->attempt);
    problem_add_text(&problem, "stage", job->stage);
    free(job->problem);
    job->problem = problem_encode(&problem);
    job->expires_ms = job_now_ms() + service->config->retention_ms;
    log_line(LOG_ERROR, "job=%s failed: the service ended in each of %d attempts", job->id, job->attempt);
    return queue_finish(service->queue, JOB_FAIL, job, &changed, error);
}

static enum status mend_job(struct service *service, struct job *job, struct error *error) {
    bool changed;
    if (job->state == JOB_RUNNING) return mend_running(service, job, error);
    if (job->state == JOB_ACCEPTED && !store_cloud_exists(service->store, job->cloud))
        log_line(LOG_ERROR, "job=%s has lost its input %s: it will fail", job->id, job->cloud);
    if (job->state != JOB_SUCCESSFUL || store_outputs_exist(service->store, job->id)) return STATUS_OK;
    log_line(LOG_ERROR, "job=%s has lost its outputs: deleted", job->id);
    return queue_delete(service->queue, job->id, "lost", &changed, error);
}

/* Goes through all jobs, newest first. */
static enum status mend_jobs(struct service *service, struct error *error) {
    char after[JOB_ID_BYTES] = "";
    struct job *jobs = calloc(PAGE, sizeof *jobs);
    size_t count = PAGE;
    enum status status = jobs ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    while (status == STATUS_OK && count == PAGE) {
        struct queue_filter filter = {.after = after[0] ? after : NULL};
        status = queue_list(service->queue, &filter, jobs, PAGE, &count, error);
        for (size_t i = 0; status == STATUS_OK && i < count; i++) status = mend_job(service, &jobs[i], error);
        if (status == STATUS_OK && count) memcpy(after, jobs[count - 1].id, sizeof after);
        for (size_t i = 0; i < count; i++) job_done(&jobs[i]);
    }
    free(jobs);
    return status;
}

/* Forgets the clouds whose files are gone. */
static enum status mend_clouds(struct service *service, struct error *error) {
    char name[JOB_HASH_BYTES] = "";
    bool found = true;
    enum status status = STATUS_OK;
    while (status == STATUS_OK && found) {
        status = clouds_next(service->queue, name, name, &found, error);
        if (status != STATUS_OK || !found || store_cloud_exists(service->store, name)) continue;
        log_line(LOG_ERROR, "cloud=%s has lost its file: forgotten", name);
        status = clouds_delete(service->queue, name, NULL, error);
    }
    return status;
}

static enum status mend(struct service *service, struct error *error) {
    size_t removed;
    enum status status = mend_jobs(service, error);
    if (status == STATUS_OK) status = mend_clouds(service, error);
    if (status == STATUS_OK) status = store_clean(service->store, is_known, service, &removed, error);
    if (status == STATUS_OK && removed)
        log_line(LOG_WARNING, "removed %zu files that an earlier run left behind", removed);
    return status;
}

enum status service_open(struct service *service, const struct config *config, struct error *error) {
    char path[STORE_PATH_BYTES];
    memset(service, 0, sizeof *service);
    service->config = config;
    pthread_rwlock_init(&service->clouds, NULL);
    enum status status = store_open(config->data, &service->store, error);
    if (status == STATUS_OK) {
        store_database_path(service->store, path);
        status = queue_open(path, &service->queue, error);
    }
    if (status == STATUS_OK) {
        store_key_path(service->store, path);
        status = signature_open(path, &service->signing_key, error);
    }
    if (status == STATUS_OK && config->tokens_file[0])
        status = tokens_open(config->tokens_file, &service->tokens, error);
    service->metrics = metrics_new();
    if (status == STATUS_OK && !service->metrics) status = error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK) status = mend(service, error);
    if (status == STATUS_OK) status = events_open(&service->events, error);
    if (status != STATUS_OK) service_close(service);
    return status;
}

void service_close(struct service *service) {
    events_free(service->events);
    tokens_close(service->tokens);
    metrics_free(service->metrics);
    queue_close(service->queue);
    store_close(service->store);
    pthread_rwlock_destroy(&service->clouds);
}

/* ------------------------------------------------------------------------------------------------ submit, delete */

enum status service_submit(struct service *service, struct upload *upload, const struct upload_facts *facts,
                           struct job *job, struct error *error) {
    enum status status = upload_sync(upload, error);
    if (status != STATUS_OK) return status;
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    job_new_id(&now, job->id);
    job->created_ms = job->updated_ms = (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
    memcpy(job->cloud, facts->sha256, sizeof job->cloud);
    memcpy(job->input_format, facts->format, sizeof job->input_format);
    job->input_bytes = facts->bytes;
    job->input_points = facts->points;

    pthread_rwlock_rdlock(&service->clouds);
    status = upload_keep(upload, error);
    if (status == STATUS_OK) status = queue_submit(service->queue, job, (uint64_t)service->config->max_queue, error);
    pthread_rwlock_unlock(&service->clouds);
    if (status != STATUS_OK) return status;
    log_line(LOG_INFO, "job=%s accepted: %llu bytes of %s who=%s", job->id, (unsigned long long)job->input_bytes,
             job->input_format, job->principal[0] ? job->principal : "-");
    metrics_submitted(service->metrics);
    supervisor_notify(service->supervisor);
    events_publish(service->events, job->id);
    return STATUS_OK;
}

/* Removes a cloud that nothing refers to any more. */
static void forget_cloud(struct service *service, const char *cloud) {
    struct error error = {0};
    uint64_t uses = 1;
    pthread_rwlock_wrlock(&service->clouds);
    if (queue_cloud_uses(service->queue, cloud, &uses, &error) == STATUS_OK && uses == 0)
        store_cloud_delete(service->store, cloud);
    pthread_rwlock_unlock(&service->clouds);
}

enum status service_delete(struct service *service, const struct job *job, const char *reason, bool *changed,
                           struct error *error) {
    enum status status = queue_delete(service->queue, job->id, reason, changed, error);
    if (status != STATUS_OK || !*changed) return status;
    store_job_delete(service->store, job->id);
    forget_cloud(service, job->cloud);
    log_line(LOG_INFO, "job=%s %s", job->id, reason);
    events_publish(service->events, job->id);
    return STATUS_OK;
}

enum status service_keep_cloud(struct service *service, struct upload *upload, const struct upload_facts *facts,
                               const char *principal, bool *known, struct error *error) {
    int64_t now = job_now_ms();
    struct clouds_record record = {.created_ms = now,
                                   .expires_ms = now + service->config->retention_ms,
                                   .bytes = facts->bytes,
                                   .points = facts->points},
                         before = {0};
    memcpy(record.sha256, facts->sha256, sizeof record.sha256);
    memcpy(record.format, facts->format, sizeof record.format);
    snprintf(record.principal, sizeof record.principal, "%s", principal);
    enum status status = upload_sync(upload, error);
    if (status != STATUS_OK) return status;
    pthread_rwlock_rdlock(&service->clouds);
    status = clouds_get(service->queue, record.sha256, principal, &before, known, error);
    if (status == STATUS_OK) status = upload_keep(upload, error);
    if (status == STATUS_OK) status = clouds_put(service->queue, &record, error);
    pthread_rwlock_unlock(&service->clouds);
    clouds_record_done(&before);
    if (status == STATUS_OK)
        log_line(LOG_INFO, "cloud=%s kept: %llu bytes of %s", record.sha256, (unsigned long long)record.bytes,
                 record.format);
    return status;
}

enum status service_delete_cloud(struct service *service, const char *sha256, const char *principal, uint64_t *jobs,
                                 struct error *error) {
    struct clouds_record record;
    uint64_t uses = 1;
    bool found;
    pthread_rwlock_wrlock(&service->clouds);
    enum status status = clouds_get(service->queue, sha256, principal, &record, &found, error);
    *jobs = record.jobs;
    if (status == STATUS_OK && !*jobs) status = clouds_delete(service->queue, sha256, principal, error);
    if (status == STATUS_OK && !*jobs) status = queue_cloud_uses(service->queue, sha256, &uses, error);
    if (status == STATUS_OK && !uses) store_cloud_delete(service->store, sha256);
    pthread_rwlock_unlock(&service->clouds);
    clouds_record_done(&record);
    if (status == STATUS_OK && !*jobs) log_line(LOG_INFO, "cloud=%s deleted", sha256);
    return status;
}

static void sweep_clouds(struct service *service) {
    char names[PAGE][JOB_HASH_BYTES];
    struct error error = {0};
    size_t count = PAGE;
    while (count == PAGE) {
        if (clouds_expire(service->queue, job_now_ms(), names, PAGE, &count, &error) != STATUS_OK) {
            log_line(LOG_ERROR, "can't look for expired clouds: %s", error.text);
            return;
        }
        for (size_t i = 0; i < count; i++) {
            log_line(LOG_INFO, "cloud=%s expired", names[i]);
            forget_cloud(service, names[i]);
        }
    }
}

static void expire(struct service *service, const char *id) {
    struct job job;
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    struct error error = {0};
    bool changed;
    enum status status = queue_get(service->queue, id, &job, &presence, &tombstone, &error);
    if (status == STATUS_OK && presence == QUEUE_PRESENT)
        status = service_delete(service, &job, "expired", &changed, &error);
    if (status != STATUS_OK) log_line(LOG_ERROR, "job=%s can't expire: %s", id, error.text);
    job_done(&job);
}

static void sweep_jobs(struct service *service) {
    char ids[PAGE][JOB_ID_BYTES];
    struct error error = {0};
    size_t count = PAGE;
    while (count == PAGE) {
        int64_t now = job_now_ms();
        if (queue_expired(service->queue, now, now - TOMBSTONE_MS, ids, PAGE, &count, &error) != STATUS_OK) {
            log_line(LOG_ERROR, "can't look for expired jobs: %s", error.text);
            return;
        }
        for (size_t i = 0; i < count; i++) expire(service, ids[i]);
    }
}

bool service_answers(struct service *service) {
    static const char nobody[] = "00000000-0000-0000-0000-000000000000";
    struct job job;
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    struct error error = {0};
    enum status status = queue_get(service->queue, nobody, &job, &presence, &tombstone, &error);
    job_done(&job);
    if (status != STATUS_OK) log_line(LOG_ERROR, "the queue doesn't answer: %s", error.text);
    bool supervised = supervisor_answers(service->supervisor);
    if (!supervised) log_line(LOG_ERROR, "the supervisor's threads don't ask for jobs");
    return status == STATUS_OK && supervised;
}

void service_sweep(struct service *service) {
    sweep_jobs(service);
    sweep_clouds(service);
}
