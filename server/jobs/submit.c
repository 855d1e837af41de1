/* What comes in: jobs, and clouds to keep.
 *
 * A row is committed after its bytes are durable, and both while `clouds` is held shared, so that nobody removes the
 * cloud in between.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/clock.h"
#include "core/base/fault.h"
#include "core/base/version.h"
#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/jobs/metrics.h"
#include "server/jobs/service_internal.h"

/* How long a cloud may take from being stored to being referred to; hosts that share the catalog leave it until then.
 */
enum { EXPECTED_MS = 10 * 60 * 1000 };

/* What is put before there is a row, and stays where a process dies in between: at the start nobody looks for it in a
 * store that isn't this machine's. */
static enum status mark(struct service *service, const char *folder, const char *id, struct error *error) {
    char name[CATALOG_MARK_BYTES];
    if (!service_store_is_apart(service)) return STATUS_OK;
    snprintf(name, sizeof name, "%s/%s", folder, id);
    return catalog_mark(service->catalog, name, job_now_ms() + EXPECTED_MS, error);
}

/* Of hosts that share the catalog this is a mark, too. */
static enum status expect_cloud(struct service *service, const char *cloud, struct error *error) {
    return catalog_expect_cloud(service->catalog, cloud, job_now_ms() + EXPECTED_MS, error);
}

/* The same for who is about to store it, and not only to refer to it. */
static enum status expect_to_store(struct service *service, const char *cloud, struct error *error) {
    enum status status = expect_cloud(service, cloud, error);
    return status == STATUS_OK && !service->is_shared ? mark(service, "clouds", cloud, error) : status;
}

/* Once it is stored.  Storing what is large may take longer than that, and then somebody may have removed it: so
 * whoever took a while expects it anew, and looks. */
static enum status still_expect_cloud(struct service *service, const char *cloud, int64_t begun_ms,
                                      struct error *error) {
    enum { A_WHILE_MS = 1000 };
    if (!service->is_shared || clock_ms() - begun_ms < A_WHILE_MS) return STATUS_OK;
    enum status status = expect_cloud(service, cloud, error);
    if (status == STATUS_OK && !store_cloud_exists(service->store, cloud))
        status = error_set(error, STATUS_IO, AWAY, "the cloud %.64s was removed while it was stored", cloud);
    return status;
}

/* ------------------------------------------------------------------------------------------------ jobs */

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

/* What was copied of an earlier job is whole where its row is there still: the row goes before what it names. */
static enum status share_outputs(struct service *service, const struct job *earlier, const struct job *job,
                                 struct error *error) {
    bool known = false;
    enum status status = store_outputs_share(service->store, earlier->id, earlier->attempt, job->id, error);
    if (status == STATUS_OK) status = catalog_knows(service->catalog, CATALOG_JOB, earlier->id, &known, error);
    if (status != STATUS_OK || known) return status;
    store_outputs_delete(service->store, job->id, 0);
    return error_set(error, STATUS_IO, "store", "job %s was deleted meanwhile", earlier->id);
}

/* Takes over from an earlier job with the same result what it made.  false: there is none, or its files are gone; in a
 * store apart the job has another id then, for what was asked of the old one's names may still be on its way. */
static bool borrow(struct service *service, struct job *job) {
    struct error error = {0};
    struct job earlier;
    bool found = false;
    enum status status = catalog_find_result(service->catalog, job->result, job->principal, &earlier, &found, &error);
    if (status == STATUS_OK && found) status = mark(service, "jobs", job->id, &error);
    if (status == STATUS_OK && found) status = share_outputs(service, &earlier, job, &error);
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
    if (status != STATUS_OK && service_store_is_apart(service)) job_another_id(job->id);
    return status == STATUS_OK;
}

static struct catalog_limits limits_of(const struct config *config) {
    return (struct catalog_limits){(uint64_t)config->max_queue, (uint64_t)config->principal_jobs,
                                   (uint64_t)config->principal_bytes};
}

/* Adds the job's row: of one that waits, or of one whose result is there already. */
static enum status enqueue(struct service *service, struct job *job, bool fresh, struct error *error) {
    struct catalog_limits limits = limits_of(service->config);
    enum status status = name_result(job, error);
    if (status != STATUS_OK) return status;
    if (fresh || !service->config->result_cache || !borrow(service, job))
        return catalog_submit(service->catalog, job, &limits, error);
    status = catalog_submit_ended(service->catalog, job, &limits, error);
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
    memcpy(job->cloud, facts->sha256, sizeof job->cloud);
    memcpy(job->input_format, facts->format, sizeof job->input_format);
    job->input_bytes = facts->bytes;
    job->input_points = facts->points;

    pthread_rwlock_rdlock(&service->clouds);
    int64_t begun_ms = clock_ms();
    status = upload ? expect_to_store(service, job->cloud, error) : expect_cloud(service, job->cloud, error);
    if (status == STATUS_OK && upload)
        status = upload_keep(upload, error);
    else if (status == STATUS_OK && !store_cloud_exists(service->store, job->cloud))
        status = error_set(error, STATUS_BAD_PARAMETER, "input", "there is no cloud %s any more", job->cloud);
    if (status == STATUS_OK && upload) status = still_expect_cloud(service, job->cloud, begun_ms, error);
    fault_at("submit-kept");
    if (status == STATUS_OK) {
        wall_clock_hold();
        job->created_ms = job->updated_ms = job_now_ms();
        status = enqueue(service, job, fresh, error);
        wall_clock_release();
    }
    pthread_rwlock_unlock(&service->clouds);
    if (status != STATUS_OK) service_forget_cloud(service, job->cloud);
    if (status != STATUS_OK) return status;
    fault_at("submit-committed");
    metrics_submitted(service->metrics);
    log_line(LOG_INFO, "job=%s %s: %llu bytes of %s who=%s", job->id,
             job->state == JOB_SUCCESSFUL ? "successful, as an earlier one" : "accepted",
             (unsigned long long)job->input_bytes, job->input_format, job->principal[0] ? job->principal : "-");
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ batches */

/* The job's id, which is behind that of the one before, and what it takes of the batch. */
static void make_of_batch(const struct catalog_batch *batch, struct timespec *now, struct job *job) {
    now->tv_nsec += 1000; /* ids count quarters of a microsecond */
    now->tv_sec += now->tv_nsec / 1000000000;
    now->tv_nsec %= 1000000000;
    job_new_id(now, job->id);
    memcpy(job->batch, batch->id, sizeof job->batch);
    job->created_ms = job->updated_ms = batch->created_ms;
}

/* What has to hold of a job before its row is added; where an earlier one serves, it has that one's outputs then. */
static enum status prepare_of_batch(struct service *service, struct job *job, bool fresh, struct error *error) {
    enum status status = expect_cloud(service, job->cloud, error);
    if (status == STATUS_OK && !store_cloud_exists(service->store, job->cloud))
        status = error_set(error, STATUS_BAD_PARAMETER, "input", "there is no cloud %s any more", job->cloud);
    if (status == STATUS_OK) status = name_result(job, error);
    if (status == STATUS_OK && !fresh && service->config->result_cache && borrow(service, job))
        job->state = JOB_SUCCESSFUL;
    return status;
}

enum status service_submit_batch(struct service *service, struct catalog_batch *batch, struct job *jobs, bool fresh,
                                 struct error *error) {
    struct catalog_limits limits = limits_of(service->config);
    enum status status = STATUS_OK;
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    job_new_id(&now, batch->id);
    pthread_rwlock_rdlock(&service->clouds);
    wall_clock_hold();
    batch->created_ms = job_now_ms();
    for (size_t i = 0; i < batch->size; i++) make_of_batch(batch, &now, &jobs[i]);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        status = prepare_of_batch(service, &jobs[i], fresh, error);
    fault_at("batch-prepared");
    if (status == STATUS_OK) status = catalog_submit_batch(service->catalog, batch, jobs, &limits, error);
    wall_clock_release();
    pthread_rwlock_unlock(&service->clouds);
    for (size_t i = 0; status != STATUS_OK && i < batch->size; i++)
        if (jobs[i].state == JOB_SUCCESSFUL) store_job_delete(service->store, jobs[i].id);
    if (status != STATUS_OK) return status;
    fault_at("batch-committed");
    for (size_t i = 0; i < batch->size; i++) metrics_submitted(service->metrics);
    log_line(LOG_INFO, "batch=%s accepted: %zu jobs, from %s who=%s", batch->id, batch->size, jobs[0].id,
             batch->principal[0] ? batch->principal : "-");
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ clouds */

static struct catalog_cloud record_of(const struct upload_facts *facts, const char *principal) {
    struct catalog_cloud record = {.bytes = facts->bytes, .points = facts->points};
    memcpy(record.sha256, facts->sha256, sizeof record.sha256);
    memcpy(record.format, facts->format, sizeof record.format);
    snprintf(record.principal, sizeof record.principal, "%s", principal);
    return record;
}

static enum status put_cloud(struct service *service, struct catalog_cloud *record, uint64_t principal_bytes,
                             struct error *error) {
    wall_clock_hold();
    record->created_ms = job_now_ms();
    record->expires_ms = record->created_ms + service->config->retention_ms;
    enum status status = catalog_put_cloud(service->catalog, record, principal_bytes, error);
    wall_clock_release();
    return status;
}

/* The end of keeping a cloud: of a failure, no file remains. */
static enum status cloud_kept(struct service *service, const struct catalog_cloud *record, enum status status) {
    if (status != STATUS_OK) service_forget_cloud(service, record->sha256);
    if (status == STATUS_OK)
        log_line(LOG_INFO, "cloud=%s kept: %llu bytes of %s", record->sha256, (unsigned long long)record->bytes,
                 record->format);
    return status;
}

enum status service_keep_cloud(struct service *service, struct upload *upload, const struct upload_facts *facts,
                               const char *principal, bool *known, struct error *error) {
    struct catalog_cloud record = record_of(facts, principal), before = {0};
    enum status status = upload_sync(upload, error);
    if (status != STATUS_OK) return status;
    pthread_rwlock_rdlock(&service->clouds);
    int64_t begun_ms = clock_ms();
    status = catalog_get_cloud(service->catalog, record.sha256, principal, &before, known, error);
    if (status == STATUS_OK) status = expect_to_store(service, record.sha256, error);
    if (status == STATUS_OK) status = upload_keep(upload, error);
    if (status == STATUS_OK) status = still_expect_cloud(service, record.sha256, begun_ms, error);
    if (status == STATUS_OK) status = put_cloud(service, &record, (uint64_t)service->config->principal_bytes, error);
    pthread_rwlock_unlock(&service->clouds);
    catalog_cloud_done(&before);
    return cloud_kept(service, &record, status);
}

enum status service_keep_part(struct service *service, const char *id, const struct upload_facts *facts,
                              const char *principal, struct error *error) {
    struct catalog_cloud record = record_of(facts, principal);
    pthread_rwlock_rdlock(&service->clouds);
    int64_t begun_ms = clock_ms();
    enum status status = expect_to_store(service, record.sha256, error);
    if (status == STATUS_OK) status = store_part_keep(service->store, id, record.sha256, error);
    if (status == STATUS_OK) status = still_expect_cloud(service, record.sha256, begun_ms, error);
    if (status == STATUS_OK) status = put_cloud(service, &record, 0, error); /* reserved */
    pthread_rwlock_unlock(&service->clouds);
    return cloud_kept(service, &record, status);
}
