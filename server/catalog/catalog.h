/* The catalog: the durable state of the service.  What was accepted is never lost.
 *
 * Jobs, clouds, resumable uploads, Idempotency-Keys, webhooks and what each principal has are one transaction domain:
 * each function here is one use, done in one transaction or not at all.  Every change of a job checks the state that it
 * starts from against the transition table of job.h, so two callers can't both make the same transition.
 *
 * A backend is a folder below this one that implements these functions (catalog_backend.h); a URL picks it when the
 * service starts.  Nothing above knows what a database is.
 *
 * All functions may be called from any thread.  They block on the disk or the network, but for those that say so, and
 * what they write is durable when they return, but for progress and replies.
 *
 * Statuses: STATUS_IO with a text when the backend refuses (base/away.h: it isn't there, and may be later),
 * STATUS_NO_SPACE, STATUS_NO_MEMORY; others as said.  What doesn't block for long gives up after a second.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_CATALOG_H
#define WHITTLE_SERVER_CATALOG_CATALOG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "server/catalog/job.h"
#include "server/catalog/rows.h"

struct catalog;

/* ------------------------------------------------------------------------------------------------ open */

enum { CATALOG_URL_BYTES = 4200, CATALOG_IDENTITY_BYTES = 33 };

/* Whether a setting may be the URL of a catalog: sqlite:PATH, or postgresql://HOST/DATABASE as libpq knows it. */
bool catalog_url_valid(const char *url);

/* The URL that a setting stands for: "" is the database in the data folder. */
void catalog_url(const char *setting, const char *folder, char url[CATALOG_URL_BYTES]);

/* Whether there is one that holds anything; opening would make an empty one. */
bool catalog_exists(const char *url);

/* Whether any number of hosts may open it: then none of them may take what it doesn't know for its own, nor decide by a
 * clock of its own. */
bool catalog_is_shared(const char *url);

/* Makes its tables, or brings them up to date.  STATUS_UNSUPPORTED when they are newer than this program. */
enum status catalog_migrate(const char *url, struct error *error) MUST_CHECK;

/* Opens it; one that isn't shared is made where it is missing, and brought up to date.  STATUS_UNSUPPORTED when it is
 * newer than this program, or when it is shared and older.  catalog_close accepts NULL. */
enum status catalog_open(const char *url, struct catalog **catalog, struct error *error) MUST_CHECK;
void catalog_close(struct catalog *catalog);

/* The identity that the catalog shares with the data folder (jobs/identity.h): read, "" where it has none; and set. */
enum status catalog_identity(struct catalog *catalog, char id[CATALOG_IDENTITY_BYTES], struct error *error) MUST_CHECK;
enum status catalog_set_identity(struct catalog *catalog, const char *id, struct error *error) MUST_CHECK;

/* Whether it takes changes: not when somebody else has held it for half a second, between two of these questions,
 * without making any.  Waits for nobody. */
enum status catalog_takes_changes(struct catalog *catalog, struct error *error) MUST_CHECK;

/* The time by which leases and ends go, in milliseconds since 1970: the database's where several hosts share the
 * catalog, whose clocks may be off; else the service's own. */
enum status catalog_now(struct catalog *catalog, int64_t *now_ms, struct error *error) MUST_CHECK;

/* The secret of this name, in hexadecimal, which all hosts that share the catalog have: the first that brings one has
 * made it.  Where one process serves the catalog it is the one that is brought. */
enum { CATALOG_SECRET_BYTES = 65 };
enum status catalog_secret(struct catalog *catalog, const char *name, const char *brought,
                           char secret[CATALOG_SECRET_BYTES], struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ changes */

/* What has become of a job: it changed; it waits to be claimed, newly or again; it runs and is to end; it was deleted.
 */
enum catalog_change { CATALOG_CHANGED, CATALOG_WAITS, CATALOG_CANCELLED, CATALOG_DELETED };

/* From now on tell is called after each change, whichever process has made it; it must not block.  To be called before
 * the first change.  Changes may be told twice, and of several that follow each other the last alone. */
void catalog_watch(struct catalog *catalog, void (*tell)(void *ctx, enum catalog_change change, const char *id),
                   void *ctx);

/* ------------------------------------------------------------------------------------------------ jobs */

/* A job that runs is held by a lease: its owner, which is a host, and its attempt, which no two claims share.  The
 * owner renews it; where it doesn't, the lease ends, and any host may take the job and queue it again.  Until one has,
 * the job is its owner's still; whoever has held it before is fenced: what it writes of the job changes nothing.
 * Leases end by the catalog's clock. */

/* How many jobs may wait, and what each principal may have; the latter 0 = no limit. */
struct catalog_limits {
    uint64_t waiting, principal_jobs, principal_bytes;
};

/* Adds a job in state accepted.  STATUS_LIMIT when a limit is reached, error->where says which: "queue",
 * "principal_jobs" or "principal_bytes". */
enum status catalog_submit(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                           struct error *error) MUST_CHECK;

/* Adds a job that an earlier one's outputs serve: successful, with the outputs and the report that it holds.
 * STATUS_LIMIT as in catalog_submit, by principal_bytes alone. */
enum status catalog_submit_ended(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                                 struct error *error) MUST_CHECK;

/* The latest successful job of this principal with this result; *found false: there is none.  The job is the caller's,
 * to job_done. */
enum status catalog_find_result(struct catalog *catalog, const char *result, const char *principal, struct job *job,
                                bool *found, struct error *error) MUST_CHECK;

/* Who claims, for how long at first, and how much memory the job may be predicted to take. */
struct catalog_claim {
    const char *owner; /* up to JOB_OWNER_BYTES with its end */
    int64_t lease_ms, memory_bytes;
};

/* Makes the accepted job whose turn it is (fair_share.h) running and hands it over (the caller's, to job_done); of one
 * with tiles its first task that waits, and the job keeps its place while more of them do.
 * *found false: none waits, or that one is predicted to take more memory, or it or the one that runs was
 * interrupted so often that it runs alone (job.h). */
enum status catalog_claim(struct catalog *catalog, const struct catalog_claim *claim, struct job *job, bool *found,
                          struct error *error) MUST_CHECK;

/* Keeps a running job's stage, message and fraction.  *held false: it isn't the caller's to run any more, nothing was
 * done.  Not durable. */
enum status catalog_progress(struct catalog *catalog, const struct job *job, bool *held,
                             struct error *error) MUST_CHECK;

/* One of a host's leases. */
struct catalog_lease {
    char job[JOB_ID_BYTES];
    int attempt;
    bool is_cancelled;
};

/* The host lives: its leases end lease_ms from now, even those that are over and that nobody has taken.  Gives the
 * first max of them; what it runs and isn't among them is lost to it.  Not durable. */
enum status catalog_renew(struct catalog *catalog, const char *owner, int64_t lease_ms, struct catalog_lease *leases,
                          size_t max, size_t *count, struct error *error) MUST_CHECK;

/* Up to max running jobs whose lease is over, and those of this owner (NULL = of none), which has just begun and so
 * can't hold any; each the caller's, to job_done. */
enum status catalog_list_lost(struct catalog *catalog, const char *owner, struct job *jobs, size_t max, size_t *count,
                              struct error *error) MUST_CHECK;

/* A running job is to end: its owner is told, now and when it renews; should it be lost, it is dismissed instead of
 * being queued again. */
enum status catalog_cancel(struct catalog *catalog, const char *id, struct error *error) MUST_CHECK;

/* Makes the transition that the event stands for (any but JOB_CLAIM), and keeps what *job says of resources, report,
 * problem, outputs and expiry; for JOB_REQUEUE only what it says of failures, interruptions and predicted memory, and a
 * job that is cancelled is dismissed instead.  *changed false: nothing was done, as the job's state doesn't allow it,
 * or it runs and isn't held by job->owner and job->attempt.
 *
 * Of a job with tiles job->task says what the event is of.  A task's is what job_step_of says, and needs that task's
 * owner and attempt.  JOB_TASK_NONE is the whole job, whoever has its tasks; that may be withdrawn while it runs. */
enum status catalog_finish(struct catalog *catalog, enum job_event event, const struct job *job, bool *changed,
                           struct error *error) MUST_CHECK;

enum catalog_presence { CATALOG_ABSENT, CATALOG_PRESENT, CATALOG_GONE };

/* What remains of a deleted job. */
struct catalog_tombstone {
    char reason[16]; /* "deleted" or "expired" */
    int64_t at_ms;
    char principal[JOB_PRINCIPAL_BYTES]; /* whose job it was */
};

/* Reads one job into *job (the caller's, to job_done; zeroed when it isn't present) or its tombstone. */
enum status catalog_get(struct catalog *catalog, const char *id, struct job *job, enum catalog_presence *presence,
                        struct catalog_tombstone *tombstone, struct error *error) MUST_CHECK;

struct catalog_filter {
    bool by_state;
    enum job_state state;
    const char *label;     /* NULL = any */
    const char *principal; /* only jobs of this one, "" = anonymous; NULL = of all */
    const char *after;     /* only ids before (older than) this one; NULL = from the newest */
    const char *batch;     /* only jobs of this one; NULL = any */
};

/* Reads up to max jobs, newest first; each the caller's, to job_done. */
enum status catalog_list(struct catalog *catalog, const struct catalog_filter *filter, struct job *jobs, size_t max,
                         size_t *count, struct error *error) MUST_CHECK;

/* Deletes an ended job and leaves a tombstone.  *changed false: there is no such job, or it has not ended. */
enum status catalog_delete(struct catalog *catalog, const char *id, const char *reason, bool *changed,
                           struct error *error) MUST_CHECK;

/* The ids of ended jobs whose expiry is past, up to max; forgets tombstones older than tombstones_before_ms. */
enum status catalog_expired(struct catalog *catalog, int64_t now_ms, int64_t tombstones_before_ms,
                            char (*ids)[JOB_ID_BYTES], size_t max, size_t *count, struct error *error) MUST_CHECK;

/* Moves what is kept for a time: the ends of jobs, clouds and uploads, the ages of keys and tombstones, when webhooks
 * are due, and how long jobs have waited.  For a clock that was set by step_ms; no job was updated after now then. */
enum status catalog_move_times(struct catalog *catalog, int64_t step_ms, struct error *error) MUST_CHECK;

/* What has to be done before a waiting job's turn comes: first the running jobs (started_ms > 0), then those whose turn
 * comes before (started_ms = 0), in order.  From memory; visit is called under a lock, and must not call back. */
void catalog_outlook(struct catalog *catalog, const char *id,
                     void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx);

/* Jobs waiting and running; from memory, never blocks for long. */
void catalog_depth(struct catalog *catalog, uint64_t *waiting, uint64_t *running);

/* ------------------------------------------------------------------------------------------------ batches */

/* A batch: jobs that came together, one for each of several clouds, with one webhook, which is due when the last of
 * them has ended.  Each is a job as any other.  A batch is there as long as one of its jobs is. */
enum { CATALOG_MAX_BATCH = 256 };

struct catalog_batch {
    char id[JOB_ID_BYTES];               /* UUIDv7, as a job's */
    char principal[JOB_PRINCIPAL_BYTES]; /* who submitted it; "" = anonymous */
    char label[JOB_LABEL_BYTES];
    int64_t created_ms;
    size_t size; /* how many jobs it was made of: 1 to CATALOG_MAX_BATCH */

    const struct job_key *key; /* borrowed, and kept with it when it is submitted; NULL = none */
    const char *webhook;       /* the same: where to tell of its end */

    size_t job_count; /* that are there still */
    struct catalog_batch_job {
        char id[JOB_ID_BYTES], cloud[JOB_HASH_BYTES];
        enum job_state state; /* as it is seen */
        uint64_t sequence;
        double fraction;
        int64_t finished_ms;
    } * job; /* owned; in the order in which their clouds were named; NULL before it is read */
};

/* How far its jobs are: 1 for each that runs, 2 for each that has ended, or is there no more; so 0 to 2 * size.  It
 * grows where one begins or ends, and is less where one that ran waits again. */
int catalog_batch_state(const struct catalog_batch *batch);

/* Frees what the batch owns.  Accepts a zeroed one. */
void catalog_batch_done(struct catalog_batch *batch);

/* Adds a batch with its jobs (as many as its size), all or none; those in state JOB_SUCCESSFUL are served by an earlier
 * one's outputs, as in catalog_submit_ended, the others wait.  STATUS_LIMIT as in catalog_submit. */
enum status catalog_submit_batch(struct catalog *catalog, const struct catalog_batch *batch, const struct job *jobs,
                                 const struct catalog_limits *limits, struct error *error) MUST_CHECK;

/* Reads a batch; *found false: there is none (any more).  It is the caller's, to catalog_batch_done, either way. */
enum status catalog_get_batch(struct catalog *catalog, const char *id, struct catalog_batch *batch, bool *found,
                              struct error *error) MUST_CHECK;

/* Up to max of them, newest first, of this principal (NULL = of all), before (older than) the one with the id `after`
 * (NULL = from the newest); each the caller's, to catalog_batch_done. */
enum status catalog_list_batches(struct catalog *catalog, const char *principal, const char *after,
                                 struct catalog_batch *batches, size_t max, size_t *count,
                                 struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ principals */

/* What a principal has. */
struct catalog_usage {
    uint64_t active; /* jobs accepted or running */
    uint64_t bytes;  /* of the inputs and outputs of all its jobs, and of its clouds; what is shared counts for each */
    uint64_t reserved; /* bytes that are about to come: of uploads that aren't whole, of rows that are being written */
};

/* Never blocks for long. */
struct catalog_usage catalog_usage(struct catalog *catalog, const char *principal);

/* Reserves bytes for a principal, in one step with looking whether it may have them: STATUS_LIMIT, with error->where
 * "principal_bytes", where it would have more than the limit then (0 = none).  catalog_release gives them back, or says
 * that they are among `bytes` by now.  Neither blocks for long. */
enum status catalog_reserve(struct catalog *catalog, const char *principal, uint64_t bytes, uint64_t limit,
                            struct error *error) MUST_CHECK;
void catalog_release(struct catalog *catalog, const char *principal, uint64_t bytes);

/* ------------------------------------------------------------------------------------------------ clouds */

/* A cloud is content, named by its sha256; its bytes are the blob store's.  A principal sees it when it has uploaded
 * it: on its own, which expires, or with a job, which it lives as long as. */
struct catalog_cloud {
    char sha256[JOB_HASH_BYTES];
    char principal[JOB_PRINCIPAL_BYTES]; /* for catalog_put_cloud */
    int64_t created_ms, expires_ms;      /* expires 0: when its last job is deleted */
    uint64_t bytes, points;              /* points: as the header says, 0 = not known */
    char format[JOB_FORMAT_BYTES];
    uint64_t jobs; /* that refer to it, of those who may be seen */
    char *report;  /* of the newest job that has read it; owned; NULL = none */
};

/* Frees what the cloud owns.  Accepts a zeroed one. */
void catalog_cloud_done(struct catalog_cloud *cloud);

/* Whether text has the form of a cloud's id. */
bool catalog_cloud_id_valid(const char *text);

/* Makes the cloud one of its principal's; where it is already, it expires at the later of both times.  STATUS_LIMIT:
 * its principal would have more than so many bytes then (0 = no limit). */
enum status catalog_put_cloud(struct catalog *catalog, const struct catalog_cloud *cloud, uint64_t principal_bytes,
                              struct error *error) MUST_CHECK;

/* What this principal sees of a cloud (NULL: what all do).  *found false: nothing.  The cloud is the caller's. */
enum status catalog_get_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                              struct catalog_cloud *cloud, bool *found, struct error *error) MUST_CHECK;

/* Up to max clouds that this principal sees (NULL: anybody), newest first, those behind the cloud `after` (NULL: from
 * the newest). */
enum status catalog_list_clouds(struct catalog *catalog, const char *principal, const char *after,
                                struct catalog_cloud *clouds, size_t max, size_t *count,
                                struct error *error) MUST_CHECK;

/* The cloud is none of this principal's (NULL: of nobody's) own any more. */
enum status catalog_delete_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                 struct error *error) MUST_CHECK;

/* Deletes up to max rows whose time is over and whose principal has no job that refers to them; their clouds' names. */
enum status catalog_expire_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES], size_t max,
                                  size_t *count, struct error *error) MUST_CHECK;

/* The first cloud behind `after` ("" = from the beginning) that a principal has on its own; *found false: none. */
enum status catalog_next_cloud(struct catalog *catalog, const char *after, char name[JOB_HASH_BYTES], bool *found,
                               struct error *error) MUST_CHECK;

/* How many jobs and principals refer to a cloud. */
enum status catalog_cloud_uses(struct catalog *catalog, const char *cloud, uint64_t *uses,
                               struct error *error) MUST_CHECK;

/* Somebody is about to store a cloud and to refer to it: nobody may remove its bytes before then.  While they are being
 * removed, or may still be because the store didn't answer, it waits a little, then STATUS_IO (base/away.h).  Where one
 * process serves the catalog it keeps them itself, by a lock that it holds, and alone the latter is looked at. */
enum status catalog_expect_cloud(struct catalog *catalog, const char *cloud, int64_t until_ms,
                                 struct error *error) MUST_CHECK;

/* How the bytes of a cloud are removed. */
struct catalog_removal {
    int64_t now_ms;
    bool may_be_late; /* what remove asks for may come to pass when it has returned, or its process has ended; where
                       * several hosts share the catalog it always may, for a host may stand still */
    bool (*remove)(void *ctx, const char *cloud); /* false: they may go later, or not at all */
    void *ctx;
};

/* Calls remove where nobody refers to a cloud and nobody is about to; nobody can begin to meanwhile, by
 * catalog_expect_cloud, and no row that refers to it is added.  *removed: whether it was so.  After a removal that may
 * be late, and whose remove said false or didn't return, nobody can begin to until that was tried again, after
 * CATALOG_REMOVAL_GRACE_MS, and true. */
enum { CATALOG_REMOVAL_GRACE_MS = 180 * 1000 }; /* BLOBS_REMOVAL_S, and what clocks are apart */
enum status catalog_remove_cloud(struct catalog *catalog, const char *cloud, const struct catalog_removal *removal,
                                 bool *removed, struct error *error) MUST_CHECK;

/* Up to max clouds that somebody was about to refer to, at a time that is over: whoever it was has done so, or has
 * gone.  And those whose removal is to be tried again. */
enum status catalog_list_unused_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                       size_t max, size_t *count, struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ uploads */

enum { CATALOG_METADATA_BYTES = 601, CATALOG_BOOT_BYTES = 64 };

enum { CATALOG_MAX_PARTS = 16, CATALOG_CONCAT_BYTES = CATALOG_MAX_PARTS * JOB_ID_BYTES + sizeof "final" };

/* A resumable upload (storage/uploads.h). */
struct catalog_upload {
    char id[JOB_ID_BYTES]; /* UUIDv7 */
    char principal[JOB_PRINCIPAL_BYTES];
    char metadata[CATALOG_METADATA_BYTES]; /* as the client sent it */
    char cloud[JOB_HASH_BYTES];            /* what it has become; "" = it isn't whole */
    int64_t created_ms, expires_ms;
    uint64_t offset, length;           /* length UINT64_MAX = not known yet */
    char boot[CATALOG_BOOT_BYTES];     /* of the kernel that has written the file */
    char concat[CATALOG_CONCAT_BYTES]; /* "" = on its own; "partial": a part of another one, and no cloud; "final ID
                                          ...": made of these, of which there are up to CATALOG_MAX_PARTS */
};

/* Adds it, or takes the place of what is there. */
enum status catalog_put_upload(struct catalog *catalog, const struct catalog_upload *upload,
                               struct error *error) MUST_CHECK;

/* Removes it and its pieces; with by_ms only if it has expired by then, which somebody may just have put off
 * (INT64_MAX: whatever it says).  *deleted: it isn't there any more, or never was. */
enum status catalog_delete_upload(struct catalog *catalog, const char *id, int64_t by_ms, bool *deleted,
                                  struct error *error) MUST_CHECK;

/* The first one behind the id `after` ("" = from the beginning), which may be upload->id. */
enum status catalog_next_upload(struct catalog *catalog, const char *after, struct catalog_upload *upload, bool *found,
                                struct error *error) MUST_CHECK;

/* ---- of hosts that share the catalog, any of which goes on with an upload (catalog_is_shared, else never called) ----
 *
 * The bytes are pieces, each a blob, in the order of their offsets; the row's offset is where the last one ends.  Who
 * writes is named by a token, the newest one: whoever had it before adds no piece any more. */
enum { CATALOG_TOKEN_BYTES = 33, CATALOG_PIECE_BYTES = 64 };

/* How many uploads there may be, of all and of one principal, and how many bytes it may have (0 = no limit). */
struct catalog_upload_limits {
    uint64_t all, of_principal, principal_bytes;
};

/* Adds a new one, and its writer.  Its bytes are reserved with it: as many as it will have, or as have come.
 * STATUS_LIMIT: error->where is "max_uploads", "principal_uploads" or "principal_bytes". */
enum status catalog_open_upload(struct catalog *catalog, const struct catalog_upload *upload, const char *token,
                                const struct catalog_upload_limits *limits, struct error *error) MUST_CHECK;

/* Doesn't block for long, like the next one. */
enum status catalog_find_upload(struct catalog *catalog, const char *id, struct catalog_upload *upload, bool *found,
                                struct error *error) MUST_CHECK;

/* The principal's upload with this concat, if it is whole; the oldest of several. */
enum status catalog_find_final(struct catalog *catalog, const char *principal, const char *concat,
                               struct catalog_upload *upload, bool *found, struct error *error) MUST_CHECK;

/* Makes token the one who writes, at this offset (UINT64_MAX = wherever it is), and sets a length that wasn't known
 * (UINT64_MAX = leaves it).  *upload is the row as it is then; *seized false: its offset or its length is another one,
 * it is a cloud already, or it isn't there (upload->id ""), and nothing was done.  STATUS_LIMIT as above. */
enum status catalog_seize_upload(struct catalog *catalog, const char *id, const char *token, uint64_t offset,
                                 uint64_t length, uint64_t principal_bytes, struct catalog_upload *upload, bool *seized,
                                 struct error *error) MUST_CHECK;

struct catalog_piece {
    uint64_t offset, bytes;
    uint64_t reserved;              /* for its principal by catalog_reserve, and given back with its row */
    char name[CATALOG_PIECE_BYTES]; /* of its blob, in the upload's folder */
};

/* The piece is the upload's next; *held false: token doesn't write any more, and nothing was done. */
enum status catalog_add_piece(struct catalog *catalog, const char *id, const char *token,
                              const struct catalog_piece *piece, int64_t expires_ms, bool *held,
                              struct error *error) MUST_CHECK;

/* Its pieces from this offset on, up to max, in their order. */
enum status catalog_list_pieces(struct catalog *catalog, const char *id, uint64_t offset, struct catalog_piece *pieces,
                                size_t max, size_t *count, struct error *error) MUST_CHECK;

/* It is a cloud now, and has no pieces any more; nothing where it has become one before, or is gone. */
enum status catalog_complete_upload(struct catalog *catalog, const char *id, const char *cloud,
                                    struct error *error) MUST_CHECK;

/* The ids of up to max whose time is over. */
enum status catalog_expired_uploads(struct catalog *catalog, int64_t now_ms, char (*ids)[JOB_ID_BYTES], size_t max,
                                    size_t *count, struct error *error) MUST_CHECK;

/* Marks: names of blobs, or of folders of them, that are nobody's from a time on unless a row names them by then.  Who
 * removes a row that has blobs marks them in the same transaction; who puts blobs before there is a row marks them
 * before.  So nothing is found by listing what there is.  An earlier mark of the name is replaced. */
enum { CATALOG_MARK_BYTES = 512 };
enum status catalog_mark(struct catalog *catalog, const char *name, int64_t until_ms, struct error *error) MUST_CHECK;
enum status catalog_unmark(struct catalog *catalog, const char *name, struct error *error) MUST_CHECK;

/* Up to max whose time is over, and which are due again in a minute: one host at a time gets each. */
enum status catalog_claim_marks(struct catalog *catalog, int64_t now_ms, char (*names)[CATALOG_MARK_BYTES], size_t max,
                                size_t *count, struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ keys */

/* Idempotency-Key: a request that is sent again under the same key isn't done again.
 *
 * A key belongs to a principal.  While a request holds it, others with it are turned away.  When a request has made
 * something, the key, a fingerprint of the request and what it made are kept, with a job in the transaction that adds
 * the job.  A request that was refused leaves nothing, and may be sent again under the same key. */
enum { CATALOG_KEY_BYTES = 256 };

/* Whether a header's value may be a key: 1 to 255 visible ASCII characters. */
bool catalog_key_valid(const char *key);

/* A request's hold on its key; zeroed = it has none. */
struct catalog_key_hold {
    const char *principal, *key; /* borrowed while it is held */
    bool held;
    struct catalog_key_hold *previous, *next;
};

/* Takes hold of a key; hold->held false: a request with it is under way.  catalog_release_key accepts one that isn't
 * held.  Neither blocks for long. */
enum status catalog_hold_key(struct catalog *catalog, const char *principal, const char *key,
                             struct catalog_key_hold *hold, struct error *error) MUST_CHECK;
void catalog_release_key(struct catalog *catalog, struct catalog_key_hold *hold);

/* What a request under a key made. */
struct catalog_reply {
    char fingerprint[JOB_HASH_BYTES];
    char made[JOB_HASH_BYTES]; /* the job's id, the cloud's hash */
    char etag[32];             /* of the reply; "" = none */
    int status;                /* of the reply; 0 = it was never made */
    char *reply;               /* its text; owned; NULL = it was never made */
};
void catalog_reply_done(struct catalog_reply *reply);

/* Reads what was made under a key; *found false: nothing.  The reply is the caller's, to catalog_reply_done. */
enum status catalog_find_reply(struct catalog *catalog, const char *principal, const char *key,
                               struct catalog_reply *reply, bool *found, struct error *error) MUST_CHECK;

/* Keeps what a request under a key makes, without a reply as yet; catalog_submit does so by itself. */
enum status catalog_put_key(struct catalog *catalog, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) MUST_CHECK;

/* Keeps the reply to that request.  Not durable at once, and nothing is lost if it isn't. */
enum status catalog_keep_reply(struct catalog *catalog, const char *principal, const char *key, int status,
                               const char *etag, const char *text, struct error *error) MUST_CHECK;

/* Forgets what is older. */
enum status catalog_forget_keys(struct catalog *catalog, int64_t before_ms, struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ webhooks */

/* Who is told of the end of which job or batch.  A webhook is added with it, becomes due when it ends, and goes with
 * its delivery or with what it is of. */
struct catalog_webhook {
    char job[JOB_ID_BYTES], url[JOB_WEBHOOK_BYTES], principal[JOB_PRINCIPAL_BYTES]; /* the job's, or the batch's */
    int attempts;                                                                   /* that failed */
    int64_t due_ms;                                                                 /* since when it is due */
};

/* Gives look those that are due, the one that has been due longest first, until it returns false.  look is to be short
 * and must not call back. */
enum status catalog_each_webhook_due(struct catalog *catalog, int64_t now_ms,
                                     bool (*look)(void *ctx, const struct catalog_webhook *webhook), void *ctx,
                                     struct error *error) MUST_CHECK;

/* It is the owner's (a host's) to deliver until then, when it is due again.  *claimed false: somebody else has it, or
 * it is gone.  Not durable. */
enum status catalog_claim_webhook(struct catalog *catalog, const struct catalog_webhook *webhook, const char *owner,
                                  int64_t until_ms, bool *claimed, struct error *error) MUST_CHECK;

/* What the owner has claimed and not delivered (of this job; NULL = of all) is due then: it has just begun, or ends. */
enum status catalog_return_webhooks(struct catalog *catalog, const char *owner, const char *job, int64_t due_ms,
                                    struct error *error) MUST_CHECK;

/* Its delivery failed: it is due again then. */
enum status catalog_postpone_webhook(struct catalog *catalog, const char *job, int64_t due_ms,
                                     struct error *error) MUST_CHECK;

/* It is delivered, or given up. */
enum status catalog_end_webhook(struct catalog *catalog, const char *job, struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ the offline check */

/* Who is told what a catalog holds. */
struct catalog_examiner {
    void (*damaged)(void *ctx, const char *what);
    void (*unfinished)(void *ctx, const char *what); /* which the next start recovers */
    void (*job)(void *ctx, const char *id, int attempt, int64_t state, uint64_t outputs);
    void (*cloud)(void *ctx, const char *sha256);
    void (*output)(void *ctx, const char *job, int attempt, const struct job_output *output);
    void *ctx;
};

/* Opens one that nobody serves, as it is: of any version of the schema, older or newer.  catalog_identity,
 * catalog_examine, catalog_knows and catalog_close alone are allowed. */
enum status catalog_open_as_is(const char *url, struct catalog **catalog, struct error *error) MUST_CHECK;

/* Tells whether it is sound in itself, then of all jobs, clouds and outputs. */
void catalog_examine(struct catalog *catalog, const struct catalog_examiner *examiner);

/* Whether it has the job, cloud or upload of this name. */
enum catalog_thing { CATALOG_JOB, CATALOG_CLOUD, CATALOG_UPLOAD };
enum status catalog_knows(struct catalog *catalog, enum catalog_thing thing, const char *name, bool *known,
                          struct error *error) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ moving */

/* Whether a host serves it, besides this process; one that was killed counts for a minute.  What one host alone may
 * serve is never served here: its folder is locked. */
enum status catalog_is_served(struct catalog *catalog, bool *served, struct error *error) MUST_CHECK;

/* Up to max rows of a table in the order of its key, without the first `skip`; of: those alone whose first column is
 * this one (NULL = all).  Each is the caller's, to catalog_row_done.  Of a catalog that nobody changes meanwhile. */
enum status catalog_read_rows(struct catalog *catalog, enum catalog_table_name table, const char *of, uint64_t skip,
                              struct catalog_row *rows, size_t max, size_t *count, struct error *error) MUST_CHECK;

/* Adds those of the rows that aren't there, in their order, all in one transaction; *added grows by how many. */
enum status catalog_add_rows(struct catalog *catalog, const struct catalog_row *rows, size_t count, uint64_t *added,
                             struct error *error) MUST_CHECK;

#endif
