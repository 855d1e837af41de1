/* What the handlers, the supervisor and main share, and the few things that need more than one of catalog, store and
 * events: submitting (submit.c), recovering after a crash (recovery.c), deleting and letting old jobs go (janitor.c).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_SERVICE_H
#define WHITTLE_SERVER_JOBS_SERVICE_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "api/codecs/job_json.h"
#include "server/base/signature.h"
#include "server/catalog/catalog.h"
#include "server/catalog/estimate.h"
#include "server/jobs/change_feed.h"
#include "server/jobs/config.h"
#include "server/jobs/job_cache.h"
#include "server/storage/admission.h"
#include "server/storage/store.h"
#include "server/storage/upload.h"
#include "server/storage/uploads.h"

struct metrics;
struct readiness;
struct supervisor;
struct tls;
struct tokens;

/* Something that confines jobs: 0 = it doesn't hold. */
struct service_measure {
    const char *name;
    int64_t value;
};

enum { SERVICE_MEASURES = 8 };

/* What the service asks of who runs its jobs (runner/supervisor.h). */
struct service_runner {
    void (*notify)(struct supervisor *supervisor);                 /* a job waits */
    bool (*cancel)(struct supervisor *supervisor, const char *id); /* a running one is to end */
    bool (*answers)(struct supervisor *supervisor);
};

struct service {
    const struct config *_Atomic config; /* borrowed; each one lives as long as the service */
    struct tokens *tokens;               /* NULL = requests need none */
    struct signature_key signing_key;
    struct tls *tls; /* NULL = plain HTTP */
    struct store *store;
    bool is_shared;              /* the catalog and the blobs are other hosts', too */
    char host[JOB_OWNER_BYTES];  /* this one, as the owner of leases: the identity of its folder */
    struct thread_pool *hashing; /* threads that hash uploads on their way in */
    struct catalog *catalog;
    struct change_feed *feed;
    struct uploads *uploads;
    struct metrics *metrics;
    struct estimate *estimate;     /* how long jobs took */
    struct job_cache *job_cache;   /* documents of ended jobs, in memory */
    struct supervisor *supervisor; /* set by main, before the first request */
    pthread_rwlock_t told_lock;
    struct supervisor *told;             /* of changes of the catalog, by any thread; NULL = nobody */
    const struct service_runner *runner; /* what it does; set when it is opened */
    struct readiness *readiness;
    struct service_measure confinement[SERVICE_MEASURES]; /* set with the supervisor; those without a name are none */
    pthread_rwlock_t clouds; /* held shared while a cloud is kept and its job submitted, alone while clouds that
                                no job refers to are removed */
    _Atomic bool draining;   /* no new work is taken */
};

/* Opens the store and the catalog, and recovers what an earlier process left (logged): running jobs are queued again,
 * or failed where the service has ended in too many of them; half-written files are removed; clouds, outputs and
 * uploads that the database doesn't know go to lost+found; jobs whose outputs are gone are deleted. STATUS_UNSUPPORTED:
 * folder and database don't belong together (jobs/identity.h). */
enum status service_open(struct service *service, const struct config *config, struct error *error) MUST_CHECK;
void service_close(struct service *service);

/* Makes an upload that has passed upload_end, and its job, durable; fills in job's id, cloud, times.  upload NULL: the
 * facts are of a cloud that is here already.  Where an earlier job of the same principal has computed the same (and
 * fresh is not set, and the settings allow it), its outputs become this job's too, which then is successful at once:
 * job->state says so.  STATUS_LIMIT: the queue is full; STATUS_BAD_PARAMETER: that cloud is gone. */
enum status service_submit(struct service *service, struct upload *upload, const struct upload_facts *facts,
                           struct job *job, bool fresh, struct error *error) MUST_CHECK;

/* The same for a batch of clouds that are here: makes it and its jobs durable, all or none; fills in ids and times of
 * both.  Each job has its cloud, input and parameters already. */
enum status service_submit_batch(struct service *service, struct catalog_batch *batch, struct job *jobs, bool fresh,
                                 struct error *error) MUST_CHECK;

/* The batch's document as text; returns new, NULL when memory runs out.  with_jobs: each of its jobs is named. */
char *service_batch_text(const struct catalog_batch *batch, bool with_jobs);

/* Whether the store is other hosts', too, or is asked over a network: what it doesn't take now it may take later, and
 * what was asked of it may be done when nobody waits for that any more. */
static inline bool service_store_is_apart(const struct service *service) {
    return service->is_shared || store_is_remote(service->store);
}

/* How many seconds it will be until the job has ended, waiting included; NAN = not known, or it has ended. */
double service_time_left(struct service *service, const struct job *job);

/* How many threads a job with these parameters runs with. */
uint64_t service_threads(const struct service *service, const struct params *params);

/* A view of the job as its document; borrows the job. */
struct job_document service_document(struct service *service, const struct job *job);

/* The limits of a cloud and, where params is given, of a job on it. */
struct admission service_admission(const struct config *config, const struct params *params);

/* Makes an upload that has passed upload_end, durably, a cloud of this principal, to be kept for the retention time.
 * *known: it was one already.  STATUS_LIMIT: it would have too many bytes. */
enum status service_keep_cloud(struct service *service, struct upload *upload, const struct upload_facts *facts,
                               const char *principal, bool *known, struct error *error) MUST_CHECK;

/* The same for a resumable upload that is whole; the upload stays. */
enum status service_keep_part(struct service *service, const char *id, const struct upload_facts *facts,
                              const char *principal, struct error *error) MUST_CHECK;

/* Deletes what this principal (NULL: anybody) has of a cloud, and the file when nothing refers to it any more; nothing
 * is done while *jobs, the number of this principal's jobs that refer to it, isn't 0. */
enum status service_delete_cloud(struct service *service, const char *sha256, const char *principal, uint64_t *jobs,
                                 struct error *error) MUST_CHECK;

/* Deletes an ended job with its files; reason as in catalog_delete. */
enum status service_delete(struct service *service, const struct job *job, const char *reason, bool *changed,
                           struct error *error) MUST_CHECK;

/* What is done from time to time: queues jobs again whose host is gone, follows the clock, deletes the jobs, clouds,
 * uploads and keys whose time is over, and the blobs that marks name.  By one thread alone. */
void service_sweep(struct service *service);

/* From now on the supervisor (NULL = nobody) is told which jobs wait and which are to end.  Whoever was before isn't
 * being told any more when this returns. */
void service_tell(struct service *service, struct supervisor *supervisor);

/* Whether the catalog and the supervisor answer; logs what does not.  Blocks for as long as they do. */
bool service_answers(struct service *service);

#endif
