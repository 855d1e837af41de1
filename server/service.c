/* Submitting, deleting, mending and sweeping: where queue and store meet.
 *
 * Invariant: a job's row is committed after its cloud is durable, and removed before its files are.  So a crash leaves
 * files without rows, never rows without files, and the next start removes them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/service.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/problem.h"
#include "core/fault.h"
#include "core/version.h"
#include "server/clouds.h"
#include "server/digest.h"
#include "server/log.h"
#include "server/metrics.h"
#include "server/supervisor.h"
#include "server/tls.h"
#include "server/tokens.h"
#include "server/wall_clock.h"

enum { PAGE = 64, TOMBSTONE_MS = 7 * 24 * 3600 * 1000 };

/* ------------------------------------------------------------------------------------------------ mending */

/* Whether the queue knows this cloud or job; on a doubt it is kept. */
static bool is_known(void *ctx, enum store_thing thing, const char *name) {
    struct service *service = ctx;
    struct error error = {0};
    struct uploads_info upload;
    if (thing == STORE_PART) return uploads_find(service->uploads, name, &upload) && !upload.cloud[0];
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

/* What the start did. */
struct mending {
    size_t requeued, failed, inputs_lost, outputs_lost, clouds_lost, files_removed;
    int64_t latest_ms; /* when a job has changed last */
};

/* A job that was running when the service ended. */
static enum status mend_running(struct service *service, struct job *job, struct mending *mending,
                                struct error *error) {
    bool changed;
    store_outputs_delete(service->store, job->id); /* of a run whose end was never recorded */
    if (job->attempt < JOB_MAX_ATTEMPTS) {
        log_line(LOG_WARNING, "job=%s was running when the service ended: queued again", job->id);
        mending->requeued++;
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
    mending->failed++;
    return queue_finish(service->queue, JOB_FAIL, job, &changed, error);
}

static enum status mend_job(struct service *service, struct job *job, struct mending *mending, struct error *error) {
    bool changed;
    if (job->updated_ms > mending->latest_ms) mending->latest_ms = job->updated_ms;
    if (job->state == JOB_RUNNING) return mend_running(service, job, mending, error);
    struct job_cost cost = estimate_cost(job);
    if (job->state == JOB_SUCCESSFUL) estimate_learn(service->estimate, &cost, job->wall_s, job->finished_ms);
    if (job->state == JOB_ACCEPTED && !store_cloud_exists(service->store, job->cloud)) {
        log_line(LOG_ERROR, "job=%s has lost its input %s: it will fail", job->id, job->cloud);
        mending->inputs_lost++;
    }
    if (job->state != JOB_SUCCESSFUL || store_outputs_exist(service->store, job->id)) return STATUS_OK;
    log_line(LOG_ERROR, "job=%s has lost its outputs: deleted", job->id);
    mending->outputs_lost++;
    return queue_delete(service->queue, job->id, "lost", &changed, error);
}

/* Goes through all jobs, newest first. */
static enum status mend_jobs(struct service *service, struct mending *mending, struct error *error) {
    char after[JOB_ID_BYTES] = "";
    struct job *jobs = calloc(PAGE, sizeof *jobs);
    size_t count = PAGE;
    enum status status = jobs ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    while (status == STATUS_OK && count == PAGE) {
        struct queue_filter filter = {.after = after[0] ? after : NULL};
        status = queue_list(service->queue, &filter, jobs, PAGE, &count, error);
        for (size_t i = 0; status == STATUS_OK && i < count; i++) status = mend_job(service, &jobs[i], mending, error);
        if (status == STATUS_OK && count) memcpy(after, jobs[count - 1].id, sizeof after);
        for (size_t i = 0; i < count; i++) job_done(&jobs[i]);
    }
    free(jobs);
    return status;
}

/* Forgets the clouds whose files are gone. */
static enum status mend_clouds(struct service *service, struct mending *mending, struct error *error) {
    char name[JOB_HASH_BYTES] = "";
    bool found = true;
    enum status status = STATUS_OK;
    while (status == STATUS_OK && found) {
        status = clouds_next(service->queue, name, name, &found, error);
        if (status != STATUS_OK || !found || store_cloud_exists(service->store, name)) continue;
        log_line(LOG_ERROR, "cloud=%s has lost its file: forgotten", name);
        mending->clouds_lost++;
        status = clouds_delete(service->queue, name, NULL, error);
    }
    return status;
}

/* Moves all ends with a clock that was set by so much. */
static enum status move_ends(struct service *service, int64_t step_ms, struct error *error) {
    log_line(LOG_WARNING, "the clock was set by %lld s: what is kept for a time is kept for the same time",
             (long long)(step_ms / 1000));
    enum status status = queue_move_times(service->queue, step_ms, error);
    if (status == STATUS_OK) uploads_move_ends(service->uploads, step_ms);
    documents_forget(service->documents, NULL);
    return status;
}

/* A job that changed in the future: the clock was set back while there was no service. */
static enum status mend_clock(struct service *service, const struct mending *mending, struct error *error) {
    int64_t step_ms = job_now_ms() - mending->latest_ms;
    return step_ms <= -WALL_CLOCK_STEP_MS ? move_ends(service, step_ms, error) : STATUS_OK;
}

static enum status mend(struct service *service, struct error *error) {
    struct mending m = {0};
    enum status status = mend_jobs(service, &m, error);
    if (status == STATUS_OK) status = mend_clock(service, &m, error);
    if (status == STATUS_OK) status = mend_clouds(service, &m, error);
    if (status == STATUS_OK) status = store_clean(service->store, is_known, service, &m.files_removed, error);
    bool anything = m.requeued || m.failed || m.inputs_lost || m.outputs_lost || m.clouds_lost || m.files_removed;
    log_line(anything ? LOG_WARNING : LOG_INFO,
             "mended requeued=%zu failed=%zu inputs_lost=%zu outputs_lost=%zu clouds_lost=%zu files_removed=%zu",
             m.requeued, m.failed, m.inputs_lost, m.outputs_lost, m.clouds_lost, m.files_removed);
    return status;
}

/* As many threads as can hash at once. */
static enum status open_hashing(struct offload **threads, struct error *error) {
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    unsigned count = processors > 0 ? (unsigned)processors : 1;
    enum status status = offload_open(count, threads);
    return status == STATUS_OK ? STATUS_OK : error_set(error, status, "service", "can't start threads");
}

enum status service_open(struct service *service, const struct config *config, struct error *error) {
    char path[STORE_PATH_BYTES];
    memset(service, 0, sizeof *service);
    service->config = config;
    service->clock_ahead_ms = wall_clock_ahead_ms();
    pthread_rwlock_init(&service->clouds, NULL);
    service->estimate = estimate_new();
    service->idempotency = idempotency_new();
    service->documents = documents_new();
    enum status status = service->estimate && service->idempotency && service->documents
                             ? STATUS_OK
                             : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK) status = store_open(config->data, &service->store, error);
    if (status == STATUS_OK) status = open_hashing(&service->hashing, error);
    if (status == STATUS_OK) {
        store_keep_free(service->store, (uint64_t)config->min_free_bytes);
        store_database_path(service->store, path);
        status = queue_open(path, &service->queue, error);
    }
    if (status == STATUS_OK) {
        store_key_path(service->store, path);
        status = signature_open(path, &service->signing_key, error);
    }
    if (status == STATUS_OK && config->tokens_file[0])
        status = tokens_open(config->tokens_file, &service->tokens, error);
    if (status == STATUS_OK && (config->tls_cert[0] || config->tls_key[0]))
        status = tls_open(config->tls_cert, config->tls_key, &service->tls, error);
    service->metrics = metrics_new();
    if (status == STATUS_OK && !service->metrics) status = error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK) status = uploads_open(service->queue, service->store, &service->uploads, error);
    if (status == STATUS_OK) status = mend(service, error);
    if (status == STATUS_OK) status = events_open(&service->events, error);
    if (status != STATUS_OK) service_close(service);
    return status;
}

void service_close(struct service *service) {
    events_free(service->events);
    tokens_close(service->tokens);
    tls_close(service->tls);
    metrics_free(service->metrics);
    uploads_close(service->uploads);
    queue_close(service->queue);
    offload_close(service->hashing);
    store_close(service->store);
    estimate_free(service->estimate);
    idempotency_free(service->idempotency);
    documents_free(service->documents);
    pthread_rwlock_destroy(&service->clouds);
}

/* ------------------------------------------------------------------------------------------------ submit, delete */

/* Removes a cloud that nothing refers to any more. */
static void forget_cloud(struct service *service, const char *cloud) {
    struct error error = {0};
    uint64_t uses = 1;
    pthread_rwlock_wrlock(&service->clouds);
    if (queue_cloud_uses(service->queue, cloud, &uses, &error) == STATUS_OK && uses == 0)
        store_cloud_delete(service->store, cloud);
    pthread_rwlock_unlock(&service->clouds);
}

/* The hash of what the job computes. */
static enum status name_result(struct job *job, struct error *error) {
    char *text = job_result_text(job, whittle_version());
    struct digest *digest = digest_new();
    bool ok = text && digest;
    if (ok) {
        digest_update(digest, text, strlen(text));
        digest_finish(digest, job->result);
    }
    free(text);
    digest_free(digest);
    return ok ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
}

/* Takes over from an earlier job with the same result what it made.  false: there is none, or its files are gone. */
static bool borrow(struct service *service, struct job *job) {
    struct error error = {0};
    struct job earlier;
    bool found = false;
    enum status status = queue_find_result(service->queue, job->result, job->principal, &earlier, &found, &error);
    if (status == STATUS_OK && found) status = store_outputs_share(service->store, earlier.id, job->id, &error);
    if (status != STATUS_OK) log_line(LOG_WARNING, "job=%s can't share outputs: %s", job->id, error.text);
    if (!found) return false;
    if (status == STATUS_OK) {
        memcpy(job->output, earlier.output, sizeof job->output);
        job->output_count = earlier.output_count;
        job->report = earlier.report;
        earlier.report = NULL;
        job->started_ms = job->created_ms;
        job->expires_ms = job->created_ms + service->config->retention_ms;
    }
    job_done(&earlier);
    return status == STATUS_OK;
}

/* Adds the job's row: of one that waits, or of one whose result is there already. */
static enum status enqueue(struct service *service, struct job *job, bool fresh, struct error *error) {
    const struct config *config = service->config;
    struct queue_limits limits = {(uint64_t)config->max_queue, (uint64_t)config->principal_jobs,
                                  (uint64_t)config->principal_bytes};
    enum status status = name_result(job, error);
    if (status != STATUS_OK) return status;
    if (fresh || !service->config->result_cache || !borrow(service, job))
        return queue_submit(service->queue, job, &limits, error);
    status = queue_submit_ended(service->queue, job, error);
    if (status == STATUS_OK)
        job->state = JOB_SUCCESSFUL;
    else
        store_job_delete(service->store, job->id);
    return status;
}

enum status service_submit(struct service *service, struct upload *upload, const struct upload_facts *facts,
                           struct job *job, bool fresh, struct error *error) {
    enum status status = upload ? upload_sync(upload, error) : STATUS_OK;
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
    if (upload)
        status = upload_keep(upload, error);
    else if (!store_cloud_exists(service->store, job->cloud))
        status = error_set(error, STATUS_BAD_PARAMETER, "input", "there is no cloud %s any more", job->cloud);
    fault_at("submit-kept");
    if (status == STATUS_OK) status = enqueue(service, job, fresh, error);
    pthread_rwlock_unlock(&service->clouds);
    if (status != STATUS_OK) forget_cloud(service, job->cloud);
    if (status != STATUS_OK) return status;
    fault_at("submit-committed");
    metrics_submitted(service->metrics);
    log_line(LOG_INFO, "job=%s %s: %llu bytes of %s who=%s", job->id,
             job->state == JOB_SUCCESSFUL ? "successful, as an earlier one" : "accepted",
             (unsigned long long)job->input_bytes, job->input_format, job->principal[0] ? job->principal : "-");
    supervisor_notify(service->supervisor);
    events_publish(service->events, job->id);
    return STATUS_OK;
}

uint64_t service_threads(const struct service *service, const struct params *params) {
    return params->threads ? params->threads : (uint64_t)service->config->threads_per_job;
}

/* ------------------------------------------------------------------------------------------------ time left */

struct forecast {
    struct service *service;
    int64_t now_ms;
    unsigned workers;
    double busy_s[256]; /* how long each worker will be; NAN = not known */
    double never;       /* becomes NAN where anything isn't known */
};

static void forecast_job(void *ctx, const struct job_cost *cost, int64_t started_ms) {
    struct forecast *forecast = ctx;
    double seconds = estimate_seconds(forecast->service->estimate, cost);
    if (started_ms) seconds = estimate_rest(seconds, (double)(forecast->now_ms - started_ms) / 1000, 0);
    forecast->never += estimate_assign(forecast->busy_s, forecast->workers, seconds);
}

double service_time_left(struct service *service, const struct job *job) {
    struct job_cost cost = estimate_cost(job);
    double seconds = estimate_seconds(service->estimate, &cost);
    int64_t now = job_now_ms();
    if (job->state == JOB_RUNNING) return estimate_rest(seconds, (double)(now - job->started_ms) / 1000, job->fraction);
    if (job->state != JOB_ACCEPTED) return NAN;
    struct forecast forecast = {.service = service, .now_ms = now, .workers = (unsigned)service->config->workers};
    queue_outlook(service->queue, job->id, forecast_job, &forecast);
    double end = estimate_assign(forecast.busy_s, forecast.workers, seconds);
    return isnan(forecast.never) ? NAN : end;
}

/* ------------------------------------------------------------------------------------------------ letting go */

enum status service_delete(struct service *service, const struct job *job, const char *reason, bool *changed,
                           struct error *error) {
    enum status status = queue_delete(service->queue, job->id, reason, changed, error);
    if (status != STATUS_OK || !*changed) return status;
    documents_forget(service->documents, job->id);
    fault_at("delete-committed");
    store_job_delete(service->store, job->id);
    forget_cloud(service, job->cloud);
    log_line(LOG_INFO, "job=%s %s", job->id, reason);
    events_publish(service->events, job->id);
    return STATUS_OK;
}

static struct clouds_record record_of(struct service *service, const struct upload_facts *facts,
                                      const char *principal) {
    int64_t now = job_now_ms();
    struct clouds_record record = {.created_ms = now,
                                   .expires_ms = now + service->config->retention_ms,
                                   .bytes = facts->bytes,
                                   .points = facts->points};
    memcpy(record.sha256, facts->sha256, sizeof record.sha256);
    memcpy(record.format, facts->format, sizeof record.format);
    snprintf(record.principal, sizeof record.principal, "%s", principal);
    return record;
}

/* The end of keeping a cloud: of a failure, no file remains. */
static enum status cloud_kept(struct service *service, const struct clouds_record *record, enum status status) {
    if (status != STATUS_OK) forget_cloud(service, record->sha256);
    if (status == STATUS_OK)
        log_line(LOG_INFO, "cloud=%s kept: %llu bytes of %s", record->sha256, (unsigned long long)record->bytes,
                 record->format);
    return status;
}

enum status service_keep_cloud(struct service *service, struct upload *upload, const struct upload_facts *facts,
                               const char *principal, bool *known, struct error *error) {
    struct clouds_record record = record_of(service, facts, principal), before = {0};
    enum status status = upload_sync(upload, error);
    if (status != STATUS_OK) return status;
    pthread_rwlock_rdlock(&service->clouds);
    status = clouds_get(service->queue, record.sha256, principal, &before, known, error);
    if (status == STATUS_OK) status = upload_keep(upload, error);
    if (status == STATUS_OK) status = clouds_put(service->queue, &record, error);
    pthread_rwlock_unlock(&service->clouds);
    clouds_record_done(&before);
    return cloud_kept(service, &record, status);
}

enum status service_keep_part(struct service *service, const char *id, const struct upload_facts *facts,
                              const char *principal, struct error *error) {
    struct clouds_record record = record_of(service, facts, principal);
    pthread_rwlock_rdlock(&service->clouds);
    enum status status = store_part_keep(service->store, id, record.sha256, error);
    if (status == STATUS_OK) status = clouds_put(service->queue, &record, error);
    pthread_rwlock_unlock(&service->clouds);
    return cloud_kept(service, &record, status);
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
    if (!supervised) log_line(LOG_ERROR, "the supervisor's threads neither ask for jobs nor go on with them");
    return status == STATUS_OK && supervised;
}

static void sweep_keys(struct service *service) {
    struct error error = {0};
    int64_t before_ms = job_now_ms() - service->config->idempotency_retention_ms;
    if (idempotency_forget(queue_writer(service->queue), before_ms, &error) != STATUS_OK)
        log_line(LOG_ERROR, "can't forget old keys: %s", error.text);
}

/* false: the clock was set and the ends can't be moved with it, so nothing may end by it. */
static bool follow_clock(struct service *service) {
    struct error error = {0};
    int64_t before = service->clock_ahead_ms, step_ms = wall_clock_step_ms(&service->clock_ahead_ms);
    if (!step_ms || move_ends(service, step_ms, &error) == STATUS_OK) return true;
    log_line(LOG_ERROR, "the ends can't be moved with the clock: %s", error.text);
    service->clock_ahead_ms = before;
    return false;
}

void service_sweep(struct service *service) {
    if (!follow_clock(service)) return;
    sweep_keys(service);
    sweep_jobs(service);
    sweep_clouds(service);
    uploads_sweep(service->uploads, job_now_ms());
}
