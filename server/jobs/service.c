/* Opening and closing the service, who is told of changes, and how long jobs will take.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/codecs/batch_json.h"
#include "server/base/log.h"
#include "server/catalog/catalog.h"
#include "server/jobs/identity.h"
#include "server/jobs/metrics.h"
#include "server/jobs/service_internal.h"

/* ------------------------------------------------------------------------------------------------ open */

/* The catalog tells of a change, of this host or another one. */
static void hear_of_change(void *ctx, enum catalog_change change, const char *id) {
    struct service *service = ctx;
    if (change == CATALOG_DELETED) job_cache_forget(service->job_cache, id);
    if (change == CATALOG_WAITS || change == CATALOG_CANCELLED) { /* other changes are made under the runner's locks */
        pthread_rwlock_rdlock(&service->told_lock);
        if (change == CATALOG_WAITS && service->told) service->runner->notify(service->told);
        if (change == CATALOG_CANCELLED && service->told) service->runner->cancel(service->told, id);
        pthread_rwlock_unlock(&service->told_lock);
    }
    if (change != CATALOG_CANCELLED) change_feed_publish(service->feed, id);
}

void service_tell(struct service *service, struct supervisor *supervisor) {
    pthread_rwlock_wrlock(&service->told_lock);
    service->told = supervisor;
    pthread_rwlock_unlock(&service->told_lock);
}

/* Opens the database, if it is the folder's own. */
static enum status open_catalog(struct service *service, struct error *error) {
    char url[CATALOG_URL_BYTES];
    catalog_url(service->config->catalog, service->config->data, url);
    service->is_shared = catalog_is_shared(url);
    if (service->is_shared && !service->config->blobs[0])
        return error_set(error, STATUS_BAD_PARAMETER, "blobs",
                         "hosts that share a catalog share the bytes, too: --blobs names where they are");
    enum status status = service->is_shared ? STATUS_OK : identity_expect_database(service->store, url, error);
    if (status == STATUS_OK) status = catalog_open(url, &service->catalog, error);
    bool is_elsewhere = service->config->catalog[0] != 0;
    if (status == STATUS_OK)
        status = service->is_shared ? identity_of_host(service->store, error)
                                    : identity_check(service->store, service->catalog, url, is_elsewhere, error);
    if (status == STATUS_OK) status = scratch_identity(store_scratch(service->store), service->host, error);
    if (status == STATUS_OK && service->is_shared) status = service_follow_catalog(service, error);
    if (status == STATUS_OK) catalog_watch(service->catalog, hear_of_change, service);
    return status;
}

/* A link that one host has made opens at any: their key is the one that the first of them has brought. */
static enum status share_signing_key(struct service *service, struct error *error) {
    char own[SIGNATURE_HEX_BYTES], shared[CATALOG_SECRET_BYTES] = "";
    signature_key_text(&service->signing_key, own);
    enum status status = catalog_secret(service->catalog, "signing.key", own, shared, error);
    if (status == STATUS_OK && !signature_key_read(shared, &service->signing_key))
        status = error_set(error, STATUS_MALFORMED, "catalog", "its signing.key is no key");
    explicit_bzero(own, sizeof own);
    explicit_bzero(shared, sizeof shared);
    return status;
}

/* As many threads as can hash at once. */
static enum status open_hashing(struct thread_pool **threads, struct error *error) {
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    unsigned count = processors > 0 ? (unsigned)processors : 1;
    enum status status = thread_pool_open(count, threads);
    return status == STATUS_OK ? STATUS_OK : error_set(error, status, "service", "can't start threads");
}

enum status service_open(struct service *service, const struct config *config, struct error *error) {
    char path[SCRATCH_PATH_BYTES];
    memset(service, 0, sizeof *service);
    service->config = config;
    pthread_rwlock_init(&service->clouds, NULL);
    pthread_rwlock_init(&service->told_lock, NULL);
    service->estimate = estimate_new();
    service->job_cache = job_cache_new();
    enum status status = service->estimate && service->job_cache
                             ? STATUS_OK
                             : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK) status = change_feed_open(&service->feed, error);
    if (status == STATUS_OK) status = store_open(config->data, config->blobs, &service->store, error);
    if (status == STATUS_OK) status = open_hashing(&service->hashing, error);
    if (status == STATUS_OK) {
        scratch_keep_free(store_scratch(service->store), (uint64_t)config->min_free_bytes);
        status = open_catalog(service, error);
    }
    if (status == STATUS_OK) service_watch_unfinished(service);
    if (status == STATUS_OK) {
        scratch_key_path(store_scratch(service->store), path);
        status = signature_open(path, &service->signing_key, error);
        if (status == STATUS_OK && service->is_shared) status = share_signing_key(service, error);
    }
    service->metrics = metrics_new();
    if (status == STATUS_OK && !service->metrics) status = error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK)
        status = uploads_open(service->catalog, service->store, service->is_shared, &service->uploads, error);
    if (status == STATUS_OK) status = service_recover(service, error);
    if (status != STATUS_OK) service_close(service);
    return status;
}

void service_close(struct service *service) {
    uploads_close(service->uploads);
    catalog_close(service->catalog); /* which tells of changes until then */
    change_feed_free(service->feed);
    metrics_free(service->metrics);
    thread_pool_close(service->hashing);
    store_close(service->store);
    estimate_free(service->estimate);
    job_cache_free(service->job_cache);
    pthread_rwlock_destroy(&service->told_lock);
    pthread_rwlock_destroy(&service->clouds);
}

/* ------------------------------------------------------------------------------------------------ forecast */

uint64_t service_threads(const struct service *service, const struct params *params) {
    return params->threads ? params->threads : (uint64_t)service->config->threads_per_job;
}

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
    catalog_outlook(service->catalog, job->id, forecast_job, &forecast);
    double end = estimate_assign(forecast.busy_s, forecast.workers, seconds);
    return isnan(forecast.never) ? NAN : end;
}

struct job_document service_document(struct service *service, const struct job *job) {
    return (struct job_document){
        .id = job->id,
        .status = job_state_name(job->state),
        .stage = job->stage,
        .message = job->message,
        .label = job->label,
        .principal = job->principal,
        .batch = job->batch,
        .fraction = job->fraction,
        .tiles = job->tiles > 0 ? (uint64_t)job->tiles : 0,
        .tiles_done = (uint64_t)job->tiles_done,
        .created_ms = job->created_ms,
        .started_ms = job->started_ms,
        .finished_ms = job->finished_ms,
        .updated_ms = job->updated_ms,
        .expires_ms = job->expires_ms,
        .ahead = job->ahead,
        .priority = job->priority,
        .time_left_s = job_ended(job->state) || job->tiles ? NAN : service_time_left(service, job),
        .attempt = job->attempt,
        .cloud = job->cloud,
        .input_points = job->input_points,
        .input_bytes = job->input_bytes,
        .input_format = job->input_format,
        .params = &job->params,
        .threads = service_threads(service, &job->params),
        .cpu_s = job->cpu_s,
        .wall_s = job->wall_s,
        .peak_rss_bytes = job->peak_rss_bytes,
        .report = job->report,
        .problem = job->problem,
        .has_outputs = job->output_count > 0,
    };
}

char *service_batch_text(const struct catalog_batch *batch, bool with_jobs) {
    struct batch_document document = {.id = batch->id,
                                      .label = batch->label,
                                      .principal = batch->principal,
                                      .created_ms = batch->created_ms,
                                      .size = batch->size,
                                      .job_count = batch->job_count,
                                      .with_jobs = with_jobs};
    struct batch_document_job *jobs = calloc(batch->job_count + 1, sizeof *jobs);
    for (size_t i = 0; jobs && i < batch->job_count; i++) {
        const struct catalog_batch_job *job = &batch->job[i];
        jobs[i] = (struct batch_document_job){job->id, job_state_name(job->state), job->cloud, job->fraction,
                                              job->finished_ms};
    }
    document.job = jobs;
    char *text = jobs ? batch_encode(&document) : NULL;
    free(jobs);
    return text;
}

struct admission service_admission(const struct config *config, const struct params *params) {
    struct admission admission = {.max_points = (uint64_t)config->max_points,
                                  .max_memory_bytes = (uint64_t)config->job_memory_bytes,
                                  .has_params = params != NULL};
    if (params) admission.params = *params;
    return admission;
}

/* ------------------------------------------------------------------------------------------------ health */

bool service_answers(struct service *service) {
    static const char nobody[] = "00000000-0000-0000-0000-000000000000";
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    struct error error = {0};
    enum status status = catalog_get(service->catalog, nobody, &job, &presence, &tombstone, &error);
    job_done(&job);
    if (status != STATUS_OK) log_line(LOG_ERROR, "the queue doesn't answer: %s", error.text);
    bool supervised = service->runner->answers(service->supervisor);
    if (!supervised) log_line(LOG_ERROR, "the supervisor's threads neither claim jobs nor make progress");
    return status == STATUS_OK && supervised;
}
