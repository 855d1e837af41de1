/* What is put right: at the start what an earlier process left; and, then or later, a job whose host has gone.
 *
 * Invariant: a job's row is committed after its cloud is durable, and removed before its files are.  So a crash leaves
 * files without rows, never rows without files.  So does an older database, so the start removes only what is known to
 * be over, and moves the rest to lost+found.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "api/problem.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/jobs/service_internal.h"

/* ------------------------------------------------------------------------------------------------ files */

/* What is known to be over goes: uploads that have become clouds, jobs that were deleted.  What isn't known at all may
 * be known to a later state of the database, and is kept aside.  On a doubt everything stays. */
static enum store_fate fate_of(void *ctx, enum store_thing thing, const char *name) {
    struct service *service = ctx;
    struct error error = {0};
    struct catalog_upload upload;
    if (service->is_shared && thing != STORE_PART) return STORE_KEEP; /* it may be another host's, of this moment */
    if (thing == STORE_PART) {
        bool found;
        if (service->is_shared) return STORE_REMOVE; /* a copy of pieces that are among the blobs */
        if (uploads_find(service->uploads, name, &upload, &found, &error) != STATUS_OK) return STORE_KEEP;
        if (!found) return STORE_SET_ASIDE;
        return upload.cloud[0] ? STORE_REMOVE : STORE_KEEP;
    }
    if (thing == STORE_CLOUD) {
        uint64_t uses = 1;
        enum status status = catalog_cloud_uses(service->catalog, name, &uses, &error);
        return status != STATUS_OK || uses ? STORE_KEEP : STORE_SET_ASIDE;
    }
    static const enum store_fate fates[] = {
        [CATALOG_ABSENT] = STORE_SET_ASIDE, [CATALOG_PRESENT] = STORE_KEEP, [CATALOG_GONE] = STORE_REMOVE};
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    enum status status = catalog_get(service->catalog, name, &job, &presence, &tombstone, &error);
    job_done(&job);
    return status == STATUS_OK ? fates[presence] : STORE_KEEP;
}

/* ------------------------------------------------------------------------------------------------ rows */

/* What the start did. */
struct recovery {
    size_t requeued, failed, inputs_lost, outputs_lost, clouds_lost;
    struct store_cleaned files;
    int64_t latest_ms; /* when a job has changed last */
};

/* On one host outputs are deleted before the job is queued again, so that a crash between both leaves none behind.
 * Where a database is asked over a network, the end that a host wrote as it died may come to pass just now: then the
 * job has succeeded, and its outputs are wanted.  So there they are deleted afterwards, and only if it was queued. */
enum status service_recover_job(struct service *service, struct job *job, bool *failed, bool *changed,
                                struct error *error) {
    const int attempt = job->attempt; /* whose end was never recorded */
    *changed = false;
    if (!service->is_shared) store_outputs_delete(service->store, job->id, attempt);
    *failed = ++job->interruptions >= JOB_MAX_INTERRUPTIONS && !job->is_cancelled;
    job->expires_ms = job_now_ms() + service->config->retention_ms;
    if (*failed) {
        struct problem problem;
        problem_set(&problem, PROBLEM_WORKER_CRASHED,
                    "the service ended %d times while the job ran, of late while nothing else did", job->interruptions);
        problem_add_text(&problem, "stage", job->stage);
        free(job->problem);
        job->problem = problem_encode(&problem);
    }
    enum status status = catalog_finish(service->catalog, *failed ? JOB_FAIL : JOB_REQUEUE, job, changed, error);
    if (status == STATUS_OK && *changed && *failed)
        log_line(LOG_ERROR, "job=%s failed: the service ended %d times while it ran", job->id, job->interruptions);
    if (status == STATUS_OK && *changed && !*failed)
        log_line(LOG_WARNING, "job=%s was running when its host ended: %s", job->id,
                 job->is_cancelled ? "dismissed" : "queued again");
    if (status == STATUS_OK && *changed && *failed && job->tiles) store_tiles_delete(service->store, job->id);
    if (service->is_shared && status == STATUS_OK && *changed) store_outputs_delete(service->store, job->id, attempt);
    return status;
}

/* A job that is running, by its row: of this host when it ended, or of one that is gone; else another host has it. */
static enum status recover_running(struct service *service, struct job *job, struct recovery *recovery,
                                   struct error *error) {
    bool is_own = strcmp(job->owner, service->host) == 0, failed = false, changed = false;
    if (!is_own && job->lease_end_ms > job_now_ms()) return STATUS_OK;
    enum status status = service_recover_job(service, job, &failed, &changed, error);
    if (status == STATUS_OK && changed && failed) recovery->failed++;
    if (status == STATUS_OK && changed && !failed) recovery->requeued++;
    return status;
}

static enum status recover_job(struct service *service, struct job *job, struct recovery *recovery,
                               struct error *error) {
    bool changed;
    if (job->updated_ms > recovery->latest_ms) recovery->latest_ms = job->updated_ms;
    if (job->state == JOB_RUNNING) return recover_running(service, job, recovery, error);
    struct job_cost cost = estimate_cost(job);
    if (job_ended(job->state) && job->tiles) store_tiles_delete(service->store, job->id);
    if (job->state == JOB_SUCCESSFUL && !job->tiles)
        estimate_learn(service->estimate, &cost, job->wall_s, job->finished_ms);
    if (job->state == JOB_ACCEPTED && !store_cloud_exists(service->store, job->cloud)) {
        log_line(LOG_ERROR, "job=%s has lost its input %s: it will fail", job->id, job->cloud);
        recovery->inputs_lost++;
    }
    if (job->state != JOB_SUCCESSFUL || store_outputs_exist(service->store, job->id, job->attempt)) return STATUS_OK;
    log_line(LOG_ERROR, "job=%s has lost its outputs: deleted", job->id);
    recovery->outputs_lost++;
    return catalog_delete(service->catalog, job->id, "lost", &changed, error);
}

/* What this host ran itself, and what hosts ran that are silent: jobs, and tasks of jobs in tiles. */
static enum status recover_lost(struct service *service, struct recovery *recovery, struct error *error) {
    struct job *jobs = calloc(SERVICE_PAGE, sizeof *jobs);
    size_t count = SERVICE_PAGE;
    enum status status = jobs ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    while (status == STATUS_OK && count == SERVICE_PAGE) {
        status = catalog_list_lost(service->catalog, service->host, jobs, SERVICE_PAGE, &count, error);
        for (size_t i = 0; i < count; i++) {
            if (status == STATUS_OK) status = recover_running(service, &jobs[i], recovery, error);
            job_done(&jobs[i]);
        }
    }
    free(jobs);
    return status;
}

/* Of many hosts each recovers what was lost, and learns from the latest jobs how long they take. */
static enum status recover_own(struct service *service, struct recovery *recovery, struct error *error) {
    struct job *jobs = calloc(SERVICE_PAGE, sizeof *jobs);
    struct catalog_filter latest = {.by_state = true, .state = JOB_SUCCESSFUL};
    size_t count = SERVICE_PAGE;
    enum status status = jobs ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    if (status == STATUS_OK) status = recover_lost(service, recovery, error);
    if (status == STATUS_OK) status = catalog_list(service->catalog, &latest, jobs, SERVICE_PAGE, &count, error);
    for (size_t i = 0; status == STATUS_OK && i < count; i++) {
        struct job_cost cost = estimate_cost(&jobs[i]);
        if (!jobs[i].tiles) estimate_learn(service->estimate, &cost, jobs[i].wall_s, jobs[i].finished_ms);
        job_done(&jobs[i]);
    }
    free(jobs);
    return status;
}

/* Goes through all jobs, newest first. */
static enum status recover_jobs(struct service *service, struct recovery *recovery, struct error *error) {
    char after[JOB_ID_BYTES] = "";
    struct job *jobs = calloc(SERVICE_PAGE, sizeof *jobs);
    size_t count = SERVICE_PAGE;
    enum status status = jobs ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "service", "no memory");
    while (status == STATUS_OK && count == SERVICE_PAGE) {
        struct catalog_filter filter = {.after = after[0] ? after : NULL};
        status = catalog_list(service->catalog, &filter, jobs, SERVICE_PAGE, &count, error);
        for (size_t i = 0; status == STATUS_OK && i < count; i++)
            status = recover_job(service, &jobs[i], recovery, error);
        if (status == STATUS_OK && count) memcpy(after, jobs[count - 1].id, sizeof after);
        for (size_t i = 0; i < count; i++) job_done(&jobs[i]);
    }
    free(jobs);
    return status;
}

/* Forgets the clouds whose files are gone. */
static enum status recover_clouds(struct service *service, struct recovery *recovery, struct error *error) {
    char name[JOB_HASH_BYTES] = "";
    bool found = true;
    enum status status = STATUS_OK;
    while (status == STATUS_OK && found) {
        status = catalog_next_cloud(service->catalog, name, name, &found, error);
        if (status != STATUS_OK || !found || store_cloud_exists(service->store, name)) continue;
        log_line(LOG_ERROR, "cloud=%s has lost its file: forgotten", name);
        recovery->clouds_lost++;
        status = catalog_delete_cloud(service->catalog, name, NULL, error);
    }
    return status;
}

/* A job that changed in the future: the clock was set back while there was no service, whose own goes on from there. */
static enum status recover_clock(struct service *service, const struct recovery *recovery, struct error *error) {
    int64_t step_ms = job_now_ms() - recovery->latest_ms;
    if (step_ms > -WALL_CLOCK_STEP_MS) return STATUS_OK;
    wall_clock_follow(-step_ms);
    return service_move_ends(service, step_ms, error);
}

static void tell_of_lost_files(const struct service *service, const struct store_cleaned *files) {
    if (files->set_aside)
        log_line(LOG_WARNING, "%zu clouds, jobs and uploads that the database doesn't know were moved to %s/%s",
                 files->set_aside, service->config->data, files->place);
    if (files->left)
        log_line(LOG_ERROR, "%zu clouds, jobs and uploads that the database doesn't know can't be moved to lost+found",
                 files->left);
}

enum status service_recover(struct service *service, struct error *error) {
    struct recovery found = {0};
    enum status status =
        service->is_shared ? recover_own(service, &found, error) : recover_jobs(service, &found, error);
    if (status == STATUS_OK && !service->is_shared) status = recover_lost(service, &found, error);
    if (status == STATUS_OK && !service->is_shared) status = recover_clock(service, &found, error);
    if (status == STATUS_OK && !service->is_shared) status = recover_clouds(service, &found, error);
    if (status == STATUS_OK) status = store_clean(service->store, fate_of, service, &found.files, error);
    bool anything = found.requeued || found.failed || found.inputs_lost || found.outputs_lost || found.clouds_lost ||
                    found.files.removed || found.files.set_aside;
    log_line(anything ? LOG_WARNING : LOG_INFO,
             "recovered requeued=%zu failed=%zu inputs_lost=%zu outputs_lost=%zu clouds_lost=%zu files_removed=%zu "
             "files_set_aside=%zu",
             found.requeued, found.failed, found.inputs_lost, found.outputs_lost, found.clouds_lost,
             found.files.removed, found.files.set_aside);
    tell_of_lost_files(service, &found.files);
    return status;
}
