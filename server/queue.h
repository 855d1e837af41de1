/* The durable queue of jobs: what was accepted is never lost.
 *
 * One backend at present, SQLite (queue_sqlite.c).  Another one (a database server shared by several hosts) implements
 * the same functions; nothing above changes.  Every change is one transaction that checks the state it starts from
 * against the transition table of job.h, so two callers can't both make the same transition.  All functions may be
 * called from any thread; they block on the disk.  What has to be durable is on disk when they return; progress isn't.
 *
 * Statuses: STATUS_IO with a text when the database refuses; others as said.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_QUEUE_H
#define WHITTLE_SERVER_QUEUE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/status.h"
#include "server/job.h"
#include "server/usage.h"

struct queue;
struct sql;

/* Opens or creates the database file; its schema is brought up to date.  STATUS_UNSUPPORTED when it is newer than this
 * program.  queue_close accepts NULL. */
enum status queue_open(const char *path, struct queue **queue, struct error *error) MUST_CHECK;
void queue_close(struct queue *queue);

/* The database's connection for writing and the one for reading, for what else is kept in it; borrowed. */
struct sql *queue_writer(struct queue *queue);
struct sql *queue_reader(struct queue *queue);

/* How many jobs may wait, and what each principal may have; the latter 0 = no limit. */
struct queue_limits {
    uint64_t waiting, principal_jobs, principal_bytes;
};

/* Adds a job in state accepted.  STATUS_LIMIT when a limit is reached, error->where says which: "queue",
 * "principal_jobs" or "principal_bytes". */
enum status queue_submit(struct queue *queue, const struct job *job, const struct queue_limits *limits,
                         struct error *error) MUST_CHECK;

/* What a principal has; from memory, never blocks for long. */
struct usage_figures queue_usage(struct queue *queue, const char *principal);

/* To be called after a change of what a principal has (NULL: of anybody) that was not made by this module, with the
 * writer locked. */
void queue_refresh_usage(struct queue *queue, const char *principal);

/* Adds a job that an earlier one's outputs serve: successful, with the outputs and the report that it holds. */
enum status queue_submit_ended(struct queue *queue, const struct job *job, struct error *error) MUST_CHECK;

/* The latest successful job of this principal with this result; *found false: there is none.  The job is the caller's,
 * to job_done. */
enum status queue_find_result(struct queue *queue, const char *result, const char *principal, struct job *job,
                              bool *found, struct error *error) MUST_CHECK;

/* Makes the accepted job whose turn it is (turns.h) running and hands it over (the caller's, to job_done).  *found
 * false: none waits, or that one is predicted to take more than memory_bytes. */
enum status queue_claim(struct queue *queue, int64_t memory_bytes, struct job *job, bool *found,
                        struct error *error) MUST_CHECK;

/* Keeps a running job's stage, message and fraction; nothing when it isn't running any more.  Not durable. */
enum status queue_progress(struct queue *queue, const char *id, const char *stage, const char *message, double fraction,
                           struct error *error) MUST_CHECK;

/* Makes the transition that event stands for (not JOB_CLAIM), and keeps what *job says of resources, report, problem,
 * outputs and expiry (not for JOB_REQUEUE).  *changed false: the job's state doesn't allow it, nothing was done. */
enum status queue_finish(struct queue *queue, enum job_event event, const struct job *job, bool *changed,
                         struct error *error) MUST_CHECK;

enum queue_presence { QUEUE_ABSENT, QUEUE_PRESENT, QUEUE_GONE };

/* What remains of a deleted job. */
struct queue_tombstone {
    char reason[16]; /* "deleted" or "expired" */
    int64_t at_ms;
    char principal[JOB_PRINCIPAL_BYTES]; /* whose job it was */
};

/* Reads one job into *job (the caller's, to job_done; zeroed when it isn't present) or its tombstone. */
enum status queue_get(struct queue *queue, const char *id, struct job *job, enum queue_presence *presence,
                      struct queue_tombstone *tombstone, struct error *error) MUST_CHECK;

struct queue_filter {
    bool by_state;
    enum job_state state;
    const char *label;     /* NULL = any */
    const char *principal; /* only jobs of this one, "" = anonymous; NULL = of all */
    const char *after;     /* only ids before (older than) this one; NULL = from the newest */
};

/* Reads up to max jobs, newest first; each the caller's, to job_done. */
enum status queue_list(struct queue *queue, const struct queue_filter *filter, struct job *jobs, size_t max,
                       size_t *count, struct error *error) MUST_CHECK;

/* Deletes an ended job and leaves a tombstone.  *changed false: there is no such job, or it has not ended. */
enum status queue_delete(struct queue *queue, const char *id, const char *reason, bool *changed,
                         struct error *error) MUST_CHECK;

/* The ids of ended jobs whose expiry is past, up to max; forgets tombstones older than tombstones_before_ms. */
enum status queue_expired(struct queue *queue, int64_t now_ms, int64_t tombstones_before_ms, char (*ids)[JOB_ID_BYTES],
                          size_t max, size_t *count, struct error *error) MUST_CHECK;

/* Moves what is kept for a time: the ends of jobs, clouds and uploads, the ages of keys and tombstones, when webhooks
 * are due, and how long jobs have waited.  For a clock that was set by step_ms; no job was updated after now then. */
enum status queue_move_times(struct queue *queue, int64_t step_ms, struct error *error) MUST_CHECK;

/* How many jobs and rows of clouds.h refer to a cloud. */
enum status queue_cloud_uses(struct queue *queue, const char *cloud, uint64_t *uses, struct error *error) MUST_CHECK;

/* What has to be done before a waiting job's turn comes: first the running jobs (started_ms > 0), then those whose turn
 * comes before (started_ms = 0), in order.  From memory; visit is called under a lock, and must not call back. */
void queue_outlook(struct queue *queue, const char *id,
                   void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx);

/* Jobs waiting and running; from memory, never blocks for long. */
void queue_depth(struct queue *queue, uint64_t *waiting, uint64_t *running);

#endif
