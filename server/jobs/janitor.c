/* What goes: deleted jobs and clouds, what has expired, and jobs whose host is silent.
 *
 * A row is removed before its files are.  The sweeps are for one thread alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/clock.h"
#include "core/base/fault.h"
#include "server/base/log.h"
#include "server/base/wall_clock.h"
#include "server/jobs/service_internal.h"

enum { TOMBSTONE_MS = 7 * 24 * 3600 * 1000 };

/* ------------------------------------------------------------------------------------------------ deleting */

/* The bytes of a cloud, which were to go at that time. */
struct deletion {
    struct service *service;
    struct blobs_removal removal;
};

static bool delete_bytes(void *ctx, const char *cloud) {
    struct deletion *deletion = ctx;
    if (store_cloud_delete(deletion->service->store, cloud, &deletion->removal) && deletion->removal.is_settled)
        return true;
    log_line_seldom(LOG_WARNING, "cloud=%s the store doesn't say that it is removed", cloud);
    return false;
}

static enum status remove_cloud(struct service *service, const char *cloud, struct error *error) {
    struct deletion deletion = {.service = service, .removal.begun_ms = clock_ms()};
    const struct catalog_removal removal = {.now_ms = job_now_ms(),
                                            .may_be_late = store_is_remote(service->store),
                                            .remove = delete_bytes,
                                            .ctx = &deletion};
    bool removed;
    return catalog_remove_cloud(service->catalog, cloud, &removal, &removed, error);
}

/* One process keeps others from a cloud that is being removed by a lock; hosts that share a catalog by its row. */
static void lock_clouds(struct service *service) {
    if (!service->is_shared) pthread_rwlock_wrlock(&service->clouds);
}

static void unlock_clouds(struct service *service) {
    if (!service->is_shared) pthread_rwlock_unlock(&service->clouds);
}

void service_forget_cloud(struct service *service, const char *cloud) {
    struct error error = {0};
    lock_clouds(service);
    if (remove_cloud(service, cloud, &error) != STATUS_OK)
        log_line(LOG_ERROR, "cloud=%s can't be removed: %s", cloud, error.text);
    unlock_clouds(service);
}

/* Of hosts that have gone while they kept a cloud, or removed one. */
static void sweep_unused_clouds(struct service *service) {
    char names[SERVICE_PAGE][JOB_HASH_BYTES];
    struct error error = {0};
    size_t count = 0;
    if (catalog_list_unused_clouds(service->catalog, job_now_ms(), names, SERVICE_PAGE, &count, &error) != STATUS_OK)
        log_line(LOG_ERROR, "can't look for clouds that nobody uses: %s", error.text);
    for (size_t i = 0; i < count; i++) service_forget_cloud(service, names[i]);
}

/* What a store that is away keeps goes when its mark is due.  Hosts that share a catalog have marked it with the row's
 * end. */
static void delete_files(struct service *service, const char *id) {
    enum { AGAIN_MS = 60 * 1000 };
    char name[JOB_ID_BYTES + sizeof "jobs/"];
    struct error error = {0};
    if (store_job_delete(service->store, id) || service->is_shared) return;
    snprintf(name, sizeof name, "jobs/%s", id);
    if (catalog_mark(service->catalog, name, job_now_ms() + AGAIN_MS, &error) != STATUS_OK)
        log_line(LOG_ERROR, "job=%s its files can't be removed, nor marked: %s", id, error.text);
}

enum status service_delete(struct service *service, const struct job *job, const char *reason, bool *changed,
                           struct error *error) {
    enum status status = catalog_delete(service->catalog, job->id, reason, changed, error);
    if (status != STATUS_OK || !*changed) return status;
    fault_at("delete-committed");
    delete_files(service, job->id);
    service_forget_cloud(service, job->cloud);
    log_line(LOG_INFO, "job=%s %s", job->id, reason);
    return STATUS_OK;
}

enum status service_delete_cloud(struct service *service, const char *sha256, const char *principal, uint64_t *jobs,
                                 struct error *error) {
    struct catalog_cloud record;
    bool found;
    lock_clouds(service);
    enum status status = catalog_get_cloud(service->catalog, sha256, principal, &record, &found, error);
    *jobs = record.jobs;
    if (status == STATUS_OK && !*jobs) status = catalog_delete_cloud(service->catalog, sha256, principal, error);
    if (status == STATUS_OK && !*jobs) status = remove_cloud(service, sha256, error);
    unlock_clouds(service);
    catalog_cloud_done(&record);
    if (status == STATUS_OK && !*jobs) log_line(LOG_INFO, "cloud=%s deleted", sha256);
    return status;
}

static void sweep_clouds(struct service *service) {
    char names[SERVICE_PAGE][JOB_HASH_BYTES];
    struct error error = {0};
    size_t count = SERVICE_PAGE;
    while (count == SERVICE_PAGE) {
        if (catalog_expire_clouds(service->catalog, job_now_ms(), names, SERVICE_PAGE, &count, &error) != STATUS_OK) {
            log_line(LOG_ERROR, "can't look for expired clouds: %s", error.text);
            return;
        }
        for (size_t i = 0; i < count; i++) {
            log_line(LOG_INFO, "cloud=%s expired", names[i]);
            service_forget_cloud(service, names[i]);
        }
    }
}

static void expire(struct service *service, const char *id) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    struct error error = {0};
    bool changed;
    enum status status = catalog_get(service->catalog, id, &job, &presence, &tombstone, &error);
    if (status == STATUS_OK && presence == CATALOG_PRESENT)
        status = service_delete(service, &job, "expired", &changed, &error);
    if (status != STATUS_OK) log_line(LOG_ERROR, "job=%s can't expire: %s", id, error.text);
    job_done(&job);
}

static void sweep_jobs(struct service *service) {
    char ids[SERVICE_PAGE][JOB_ID_BYTES];
    struct error error = {0};
    size_t count = SERVICE_PAGE;
    while (count == SERVICE_PAGE) {
        int64_t now = job_now_ms();
        if (catalog_expired(service->catalog, now, now - TOMBSTONE_MS, ids, SERVICE_PAGE, &count, &error) !=
            STATUS_OK) {
            log_line(LOG_ERROR, "can't look for expired jobs: %s", error.text);
            return;
        }
        for (size_t i = 0; i < count; i++) expire(service, ids[i]);
    }
}

/* ------------------------------------------------------------------------------------------------ sweeps */

enum status service_move_ends(struct service *service, int64_t step_ms, struct error *error) {
    log_line(LOG_WARNING, "the clock was set by %lld s: what is kept for a time is kept for the same time",
             (long long)(step_ms / 1000));
    wall_clock_stop();
    enum status status = catalog_move_times(service->catalog, step_ms, error);
    if (status == STATUS_OK) {
        uploads_move_ends(service->uploads, step_ms);
        wall_clock_follow(step_ms);
    }
    wall_clock_go_on();
    job_cache_forget(service->job_cache, NULL);
    return status;
}

static void sweep_keys(struct service *service) {
    struct error error = {0};
    int64_t before_ms = job_now_ms() - service->config->idempotency_retention_ms;
    if (catalog_forget_keys(service->catalog, before_ms, &error) != STATUS_OK)
        log_line(LOG_ERROR, "can't forget old keys: %s", error.text);
}

enum status service_follow_catalog(struct service *service, struct error *error) {
    int64_t now_ms = 0;
    enum status status = catalog_now(service->catalog, &now_ms, error);
    if (status == STATUS_OK) wall_clock_follow(now_ms - job_now_ms());
    return status;
}

/* false: the clock was set and the ends can't be moved with it, so nothing may end by it. */
static bool follow_clock(struct service *service) {
    struct error error = {0};
    if (service->is_shared) {
        if (service_follow_catalog(service, &error) == STATUS_OK) return true;
        log_line(LOG_ERROR, "the catalog doesn't tell the time: %s", error.text);
        return false;
    }
    int64_t step_ms = wall_clock_step_ms();
    if (!step_ms || service_move_ends(service, step_ms, &error) == STATUS_OK) return true;
    log_line(LOG_ERROR, "the ends can't be moved with the clock: %s", error.text);
    return false;
}

/* Jobs whose host is silent.  This one's own are held, whatever their leases say; without a shared catalog all are. */
static void sweep_leases(struct service *service) {
    struct error error = {0};
    size_t count = 0;
    struct job *jobs = calloc(SERVICE_PAGE, sizeof *jobs);
    enum status status = jobs ? catalog_list_lost(service->catalog, NULL, jobs, SERVICE_PAGE, &count, &error)
                              : error_set(&error, STATUS_NO_MEMORY, "service", "no memory");
    for (size_t i = 0; i < count; i++) {
        bool failed, changed, is_own = strcmp(jobs[i].owner, service->host) == 0;
        if (status == STATUS_OK && !is_own) status = service_recover_job(service, &jobs[i], &failed, &changed, &error);
        job_done(&jobs[i]);
    }
    if (status != STATUS_OK) log_line(LOG_ERROR, "can't look for lost jobs: %s", error.text);
    free(jobs);
}

/* What a store keeps of a put that didn't end. */
static const char unfinished_mark[] = "unfinished ";

static bool mark_unfinished(void *ctx, const char *what) {
    enum { PUT_MS = 3600 * 1000 }; /* no put takes longer */
    struct service *service = ctx;
    char name[CATALOG_MARK_BYTES];
    struct error error = {0};
    snprintf(name, sizeof name, "%s%s", unfinished_mark, what);
    enum status status = catalog_mark(service->catalog, name, job_now_ms() + PUT_MS, &error);
    if (status != STATUS_OK) log_line(LOG_ERROR, "%s can't be marked: %s", name, error.text);
    return status == STATUS_OK;
}

static void unmark_unfinished(void *ctx, const char *what) {
    struct service *service = ctx;
    char name[CATALOG_MARK_BYTES];
    struct error error = {0};
    snprintf(name, sizeof name, "%s%s", unfinished_mark, what);
    if (catalog_unmark(service->catalog, name, &error) != STATUS_OK)
        log_line(LOG_WARNING, "%s stays marked: %s", name, error.text); /* and is given up, which does nothing then */
}

void service_watch_unfinished(struct service *service) {
    const struct blobs_unfinished unfinished = {mark_unfinished, unmark_unfinished, service};
    store_watch_unfinished(service->store, &unfinished);
}

/* What a mark names goes, unless a row names it by now: a job's folder of blobs, an upload's, a cloud.  The mark stays
 * where that fails, and is due again. */
static enum status sweep_mark(struct service *service, const char *name, struct error *error) {
    static const struct {
        const char *folder;
        enum catalog_thing thing;
    } kinds[] = {{"jobs/", CATALOG_JOB}, {"uploads/", CATALOG_UPLOAD}};
    bool known = false;
    enum status status = STATUS_OK;
    if (strncmp(name, unfinished_mark, strlen(unfinished_mark)) == 0)
        return store_give_up(service->store, name + strlen(unfinished_mark))
                   ? catalog_unmark(service->catalog, name, error)
                   : STATUS_OK;
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++) {
        size_t length = strlen(kinds[i].folder);
        if (strncmp(name, kinds[i].folder, length) != 0) continue;
        status = catalog_knows(service->catalog, kinds[i].thing, name + length, &known, error);
        if (status == STATUS_OK && !known && !store_marked_delete(service->store, name)) return STATUS_OK;
    }
    /* It waits for who stores the cloud just now; who ends at that moment leaves it marked. */
    if (status == STATUS_OK && strncmp(name, "clouds/", 7) == 0) service_forget_cloud(service, name + 7);
    if (status == STATUS_OK) status = catalog_unmark(service->catalog, name, error);
    return status;
}

static void sweep_marks(struct service *service) {
    struct error error = {0};
    size_t count = 0;
    char(*names)[CATALOG_MARK_BYTES] = calloc(SERVICE_PAGE, sizeof *names);
    if (!names) return;
    enum status status = catalog_claim_marks(service->catalog, job_now_ms(), names, SERVICE_PAGE, &count, &error);
    for (size_t i = 0; status == STATUS_OK && i < count; i++) status = sweep_mark(service, names[i], &error);
    if (status != STATUS_OK) log_line(LOG_ERROR, "can't look for what nobody names: %s", error.text);
    free(names);
}

void service_sweep(struct service *service) {
    if (!follow_clock(service)) return;
    sweep_keys(service);
    sweep_leases(service);
    sweep_jobs(service);
    sweep_clouds(service);
    sweep_unused_clouds(service);
    uploads_sweep(service->uploads, job_now_ms());
    sweep_marks(service);
}
