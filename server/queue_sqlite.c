/* The queue in an SQLite database (WAL), the backend for one host.
 *
 * Two connections: one that writes, under a lock, and one that reads, under another, so that a reader never waits for
 * an fsync.  Commits of submit, claim, finish and delete are durable (synchronous=FULL); progress is written
 * casually (sql.h), which costs no fsync: after a power cut the last progress may be missing, nothing else.
 *
 * Invariant: `waiting` and `running` are the numbers of rows in these states, `turns` holds the rows that wait and
 * `runs` those that run; they change under the writer's lock, after the commit.  `order` guards the last two, is taken
 * after a connection's lock, and is held for no longer than a look at them takes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/queue.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "server/estimate.h"
#include "server/idempotency.h"
#include "server/job_rows.h"
#include "server/outbox.h"
#include "server/schema.h"
#include "server/sql.h"
#include "server/turns.h"
#include "server/usage.h"

enum { MAX_RUNS = 256 };
static const int64_t PRIORITY_AGING_MS = 10 * 60 * 1000; /* what a step of priority is worth in waiting */

struct queue {
    struct sql *writer, *reader;
    _Atomic uint64_t waiting, running;
    pthread_mutex_t order;
    struct turns *turns;
    struct usage *usage;
    size_t run_count;
    struct run {
        char id[JOB_ID_BYTES];
        struct job_cost cost;
        int64_t started_ms;
    } runs[MAX_RUNS]; /* more are not remembered */
};

/* ------------------------------------------------------------------------------------------------ turns */

/* A job has come to wait.  Where memory runs out it is not in the order, and claimed when nothing else is. */
static void put_in_order(struct queue *queue, const struct job *job) {
    struct turn turn = {.priority = job->priority, .created_ms = job->created_ms, .cost = estimate_cost(job)};
    memcpy(turn.id, job->id, sizeof turn.id);
    memcpy(turn.principal, job->principal, sizeof turn.principal);
    pthread_mutex_lock(&queue->order);
    bool kept = turns_add(queue->turns, &turn);
    (void)kept;
    pthread_mutex_unlock(&queue->order);
}

/* A waiting job runs from now on. */
static void put_in_run(struct queue *queue, const struct job *job) {
    pthread_mutex_lock(&queue->order);
    turns_take(queue->turns, job->id);
    if (queue->run_count < MAX_RUNS) {
        struct run *run = &queue->runs[queue->run_count++];
        *run = (struct run){.cost = estimate_cost(job), .started_ms = job->started_ms};
        memcpy(run->id, job->id, sizeof run->id);
    }
    pthread_mutex_unlock(&queue->order);
}

/* A job neither waits nor runs any more. */
static void take_out(struct queue *queue, const char *id) {
    pthread_mutex_lock(&queue->order);
    turns_remove(queue->turns, id);
    for (size_t i = 0; i < queue->run_count; i++)
        if (strcmp(queue->runs[i].id, id) == 0) queue->runs[i--] = queue->runs[--queue->run_count];
    pthread_mutex_unlock(&queue->order);
}

static uint64_t ahead_of(struct queue *queue, const struct job *job) {
    if (job->state != JOB_ACCEPTED) return 0;
    pthread_mutex_lock(&queue->order);
    uint64_t ahead = turns_ahead(queue->turns, job->id, NULL, NULL);
    pthread_mutex_unlock(&queue->order);
    return ahead;
}

struct outlook {
    void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms);
    void *ctx;
};

static void look_at(void *ctx, const struct turn *turn) {
    const struct outlook *outlook = ctx;
    outlook->visit(outlook->ctx, &turn->cost, 0);
}

void queue_outlook(struct queue *queue, const char *id,
                   void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx) {
    struct outlook outlook = {visit, ctx};
    pthread_mutex_lock(&queue->order);
    for (size_t i = 0; i < queue->run_count; i++) visit(ctx, &queue->runs[i].cost, queue->runs[i].started_ms);
    turns_ahead(queue->turns, id, look_at, &outlook);
    pthread_mutex_unlock(&queue->order);
}

/* ------------------------------------------------------------------------------------------------ usage */

void queue_refresh_usage(struct queue *queue, const char *principal) {
    struct error error = {0};
    enum status status = usage_refresh(queue->usage, queue->writer, principal, &error);
    (void)status; /* the older figures stand; the next change brings them up to date */
}

struct usage_figures queue_usage(struct queue *queue, const char *principal) {
    return usage_of(queue->usage, principal);
}

static enum status check_limits(const struct queue *queue, const struct job *job, const struct queue_limits *limits,
                                struct error *error) {
    struct usage_figures has = usage_of(queue->usage, job->principal);
    if (queue->waiting >= limits->waiting)
        return error_set(error, STATUS_LIMIT, "queue", "%llu jobs are waiting", (unsigned long long)queue->waiting);
    if (limits->principal_jobs && has.active >= limits->principal_jobs)
        return error_set(error, STATUS_LIMIT, "principal_jobs", "%llu of your jobs wait or run",
                         (unsigned long long)has.active);
    if (limits->principal_bytes && has.bytes + job->input_bytes > limits->principal_bytes)
        return error_set(error, STATUS_LIMIT, "principal_bytes", "%llu bytes are kept for you",
                         (unsigned long long)has.bytes);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ open */

static enum status count_states(struct queue *queue, struct error *error) {
    int64_t waiting = 0, running = 0;
    const char *sql = "SELECT count(*) FROM jobs WHERE state = ?1";
    enum status status = sql_number(queue->reader, sql, VALUES(I(JOB_ACCEPTED)), &waiting, error);
    if (status == STATUS_OK) status = sql_number(queue->reader, sql, VALUES(I(JOB_RUNNING)), &running, error);
    queue->waiting = (uint64_t)waiting;
    queue->running = (uint64_t)running;
    return status;
}

/* Those that waited when the process before this one ended. */
static enum status order_waiting(struct queue *queue, struct error *error) {
    struct sql_rows *row;
    enum status status = sql_select(queue->reader, "SELECT " JOB_ROWS_COLUMNS " FROM jobs WHERE state = ?1 ORDER BY id",
                                    VALUES(I(JOB_ACCEPTED)), &row, error);
    if (status != STATUS_OK) return status;
    struct job job;
    while (sql_next(row)) {
        job_rows_read_one(row, &job);
        put_in_order(queue, &job);
        job_done(&job);
    }
    return sql_finish(row, error);
}

enum status queue_open(const char *path, struct queue **queue, struct error *error) {
    struct queue *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    pthread_mutex_init(&opened->order, NULL);
    opened->turns = turns_new(PRIORITY_AGING_MS);
    opened->usage = usage_new();
    enum status status =
        opened->turns && opened->usage ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    if (status == STATUS_OK) status = sql_open(path, &opened->writer, error);
    if (status == STATUS_OK) status = schema_migrate(opened->writer, error);
    if (status == STATUS_OK) status = sql_open(path, &opened->reader, error);
    if (status == STATUS_OK) status = count_states(opened, error);
    if (status == STATUS_OK) status = order_waiting(opened, error);
    if (status == STATUS_OK) status = usage_refresh(opened->usage, opened->writer, NULL, error);
    if (status == STATUS_OK)
        *queue = opened;
    else
        queue_close(opened);
    return status;
}

void queue_close(struct queue *queue) {
    if (!queue) return;
    sql_close(queue->reader);
    sql_close(queue->writer);
    turns_free(queue->turns);
    usage_free(queue->usage);
    pthread_mutex_destroy(&queue->order);
    free(queue);
}

struct sql *queue_writer(struct queue *queue) {
    return queue->writer;
}

struct sql *queue_reader(struct queue *queue) {
    return queue->reader;
}

void queue_depth(struct queue *queue, uint64_t *waiting, uint64_t *running) {
    *waiting = atomic_load(&queue->waiting);
    *running = atomic_load(&queue->running);
}

/* ------------------------------------------------------------------------------------------------ submit, claim */

/* The job, the key that it was submitted under, and who is told of its end; in a transaction. */
static enum status insert(struct sql *db, const struct job *job, struct error *error) {
    enum status status = job_rows_insert(db, job, error);
    if (status == STATUS_OK && job->key)
        status = idempotency_add(db, job->principal, job->key, job->id, job->created_ms, error);
    if (status == STATUS_OK && job->webhook) status = outbox_add(db, job->id, job->webhook, error);
    return status;
}

static enum status insert_alone(struct sql *db, const struct job *job, struct error *error) {
    enum status status = sql_begin(db, error);
    return status == STATUS_OK ? sql_end(db, insert(db, job, error), error) : status;
}

enum status queue_submit(struct queue *queue, const struct job *job, const struct queue_limits *limits,
                         struct error *error) {
    sql_lock(queue->writer);
    enum status status = check_limits(queue, job, limits, error);
    if (status == STATUS_OK) status = insert_alone(queue->writer, job, error);
    if (status == STATUS_OK) {
        queue_refresh_usage(queue, job->principal);
        queue->waiting++;
        put_in_order(queue, job);
    }
    sql_unlock(queue->writer);
    return status;
}

/* Whose turn it is; "" where the order knows of nobody. */
static void first_in_order(struct queue *queue, char id[JOB_ID_BYTES]) {
    pthread_mutex_lock(&queue->order);
    const struct turn *turn = turns_first(queue->turns);
    snprintf(id, JOB_ID_BYTES, "%s", turn ? turn->id : "");
    pthread_mutex_unlock(&queue->order);
}

/* In a transaction, so that nothing is claimed that can't be handed over. */
static enum status claim(struct queue *queue, int64_t memory_bytes, struct job *job, size_t *count,
                         struct error *error) {
    struct sql *db = queue->writer;
    struct sql_rows *row;
    int64_t now = job_now_ms();
    char id[JOB_ID_BYTES];
    first_in_order(queue, id);
    enum status status =
        sql_select(db,
                   "UPDATE jobs SET state = ?1, attempt = attempt + 1, started = ?2, updated = ?2, "
                   "sequence = max(sequence + 1, ?2), stage = '', message = '', fraction = 0 "
                   "WHERE id = (SELECT id FROM jobs WHERE state = ?3 ORDER BY id <> ?4, id LIMIT 1) "
                   "AND memory <= ?5 "
                   "RETURNING " JOB_ROWS_COLUMNS,
                   VALUES(I(JOB_RUNNING), I(now), I(JOB_ACCEPTED), T(id), I(memory_bytes)), &row, error);
    return status == STATUS_OK ? job_rows_read(db, row, job, 1, count, error) : status;
}

static enum status claim_alone(struct queue *queue, int64_t memory_bytes, struct job *job, bool *found,
                               struct error *error) {
    size_t count = 0;
    enum status status = sql_begin(queue->writer, error);
    if (status != STATUS_OK) return status;
    status = claim(queue, memory_bytes, job, &count, error);
    status = sql_end(queue->writer, status, error);
    *found = status == STATUS_OK && count == 1;
    if (count == 1 && !*found) job_done(job);
    return status;
}

enum status queue_claim(struct queue *queue, int64_t memory_bytes, struct job *job, bool *found, struct error *error) {
    *found = false;
    sql_lock(queue->writer);
    enum status status = STATUS_OK;
    if (queue->waiting) status = claim_alone(queue, memory_bytes, job, found, error);
    if (*found) {
        queue->waiting--;
        queue->running++;
        put_in_run(queue, job);
    }
    sql_unlock(queue->writer);
    return status;
}

enum status queue_progress(struct queue *queue, const char *id, const char *stage, const char *message, double fraction,
                           struct error *error) {
    sql_lock(queue->writer);
    enum status status =
        sql_run_casually(queue->writer,
                         "UPDATE jobs SET stage = ?2, message = ?3, fraction = ?4, updated = ?5, "
                         "sequence = max(sequence + 1, ?5) WHERE id = ?1 AND state = ?6",
                         VALUES(T(id), T(stage), T(message), R(fraction), I(job_now_ms()), I(JOB_RUNNING)), error);
    sql_unlock(queue->writer);
    return status;
}

/* ------------------------------------------------------------------------------------------------ finish */

static enum status write_end(struct sql *db, const struct job *job, enum job_state next, struct error *error) {
    enum status status = job_rows_end(db, job, next, error);
    return status == STATUS_OK ? outbox_make_due(db, job->id, job_now_ms(), error) : status;
}

/* One transaction; *from and *next are set when *changed is. */
static enum status finish(struct sql *db, enum job_event event, const struct job *job, enum job_state *from,
                          enum job_state *next, struct error *error) {
    int64_t state = -1;
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    status = sql_number(db, "SELECT state FROM jobs WHERE id = ?1", VALUES(T(job->id)), &state, error);
    *from = *next = (enum job_state)(state < 0 ? JOB_DISMISSED : state);
    if (status == STATUS_OK && job_transition(*from, event, next))
        status = event == JOB_REQUEUE ? job_rows_requeue(db, job->id, error) : write_end(db, job, *next, error);
    return sql_end(db, status, error);
}

enum status queue_finish(struct queue *queue, enum job_event event, const struct job *job, bool *changed,
                         struct error *error) {
    enum job_state from = JOB_ACCEPTED, next = JOB_ACCEPTED;
    sql_lock(queue->writer);
    enum status status = finish(queue->writer, event, job, &from, &next, error);
    *changed = status == STATUS_OK && from != next;
    if (*changed && from == JOB_ACCEPTED) queue->waiting--;
    if (*changed && from == JOB_RUNNING) queue->running--;
    if (*changed) take_out(queue, job->id);
    if (*changed) queue_refresh_usage(queue, job->principal);
    if (*changed && next == JOB_ACCEPTED) {
        queue->waiting++;
        put_in_order(queue, job);
    }
    sql_unlock(queue->writer);
    return status;
}

/* ------------------------------------------------------------------------------------------------ reuse */

enum status queue_submit_ended(struct queue *queue, const struct job *job, struct error *error) {
    enum job_state next;
    sql_lock(queue->writer);
    enum status status = sql_begin(queue->writer, error);
    if (status == STATUS_OK) {
        status = insert(queue->writer, job, error);
        if (status == STATUS_OK && job_transition(JOB_ACCEPTED, JOB_REUSE, &next))
            status = write_end(queue->writer, job, next, error);
        status = sql_end(queue->writer, status, error);
    }
    if (status == STATUS_OK) queue_refresh_usage(queue, job->principal);
    sql_unlock(queue->writer);
    return status;
}

enum status queue_find_result(struct queue *queue, const char *result, const char *principal, struct job *job,
                              bool *found, struct error *error) {
    struct sql_rows *row;
    size_t count = 0;
    sql_lock(queue->reader);
    enum status status = sql_select(queue->reader,
                                    "SELECT " JOB_ROWS_COLUMNS " FROM jobs WHERE result = ?1 AND result <> '' "
                                    "AND principal = ?2 AND state = ?3 ORDER BY id DESC LIMIT 1",
                                    VALUES(T(result), T(principal), I(JOB_SUCCESSFUL)), &row, error);
    if (status == STATUS_OK) status = job_rows_read(queue->reader, row, job, 1, &count, error);
    sql_unlock(queue->reader);
    *found = status == STATUS_OK && count == 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

static enum status find_tombstone(struct sql *db, const char *id, struct queue_tombstone *tombstone, bool *found,
                                  struct error *error) {
    struct sql_rows *row;
    enum status status =
        sql_select(db, "SELECT reason, at, principal FROM tombstones WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status != STATUS_OK) return status;
    *found = sql_next(row);
    if (*found) {
        sql_copy_text(row, 0, tombstone->reason, sizeof tombstone->reason);
        tombstone->at_ms = sql_integer(row, 1);
        sql_copy_text(row, 2, tombstone->principal, sizeof tombstone->principal);
    }
    return sql_finish(row, error);
}

enum status queue_get(struct queue *queue, const char *id, struct job *job, enum queue_presence *presence,
                      struct queue_tombstone *tombstone, struct error *error) {
    bool found = false, gone = false;
    memset(job, 0, sizeof *job);
    sql_lock(queue->reader);
    enum status status = job_rows_find(queue->reader, id, job, &found, error);
    if (status == STATUS_OK && !found) status = find_tombstone(queue->reader, id, tombstone, &gone, error);
    sql_unlock(queue->reader);
    if (found) job->ahead = ahead_of(queue, job);
    *presence = found ? QUEUE_PRESENT : gone ? QUEUE_GONE : QUEUE_ABSENT;
    return status;
}

enum status queue_list(struct queue *queue, const struct queue_filter *filter, struct job *jobs, size_t max,
                       size_t *count, struct error *error) {
    struct sql_rows *row;
    *count = 0;
    sql_lock(queue->reader);
    enum status status = sql_select(queue->reader,
                                    "SELECT " JOB_ROWS_COLUMNS " FROM jobs WHERE (?1 < 0 OR state = ?1) "
                                    "AND (?2 IS NULL OR label = ?2) AND (?3 IS NULL OR id < ?3) "
                                    "AND (?4 IS NULL OR principal = ?4) ORDER BY id DESC LIMIT ?5",
                                    VALUES(I(filter->by_state ? (int)filter->state : -1), T(filter->label),
                                           T(filter->after), T(filter->principal), I(max)),
                                    &row, error);
    if (status == STATUS_OK) status = job_rows_read(queue->reader, row, jobs, max, count, error);
    sql_unlock(queue->reader);
    for (size_t i = 0; i < *count; i++) jobs[i].ahead = ahead_of(queue, &jobs[i]);
    return status;
}

enum status queue_cloud_uses(struct queue *queue, const char *cloud, uint64_t *uses, struct error *error) {
    int64_t number = 0;
    sql_lock(queue->reader);
    enum status status = sql_number(
        queue->reader,
        "SELECT (SELECT count(*) FROM jobs WHERE cloud = ?1) + (SELECT count(*) FROM clouds WHERE sha256 = ?1)",
        VALUES(T(cloud)), &number, error);
    sql_unlock(queue->reader);
    if (status == STATUS_OK) *uses = (uint64_t)number;
    return status;
}

/* ------------------------------------------------------------------------------------------------ delete, expire */

static enum status delete_rows(struct sql *db, const char *id, const char *reason, int64_t *deleted,
                               struct error *error) {
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    status = sql_run(db,
                     "INSERT OR REPLACE INTO tombstones (id, reason, at, principal) "
                     "SELECT id, ?2, ?3, principal FROM jobs WHERE id = ?1 AND state NOT IN (?4, ?5)",
                     VALUES(T(id), T(reason), I(job_now_ms()), I(JOB_ACCEPTED), I(JOB_RUNNING)), error);
    *deleted = status == STATUS_OK ? sql_changes(db) : 0;
    if (*deleted) {
        status = sql_run(db, "DELETE FROM outputs WHERE job = ?1", VALUES(T(id)), error);
        if (status == STATUS_OK) status = sql_run(db, "DELETE FROM jobs WHERE id = ?1", VALUES(T(id)), error);
        if (status == STATUS_OK) status = outbox_remove(db, id, error);
    }
    return sql_end(db, status, error);
}

enum status queue_delete(struct queue *queue, const char *id, const char *reason, bool *changed, struct error *error) {
    int64_t deleted = 0;
    sql_lock(queue->writer);
    enum status status = delete_rows(queue->writer, id, reason, &deleted, error);
    if (deleted) queue_refresh_usage(queue, NULL);
    sql_unlock(queue->writer);
    *changed = status == STATUS_OK && deleted;
    return status;
}

enum status queue_expired(struct queue *queue, int64_t now_ms, int64_t tombstones_before_ms, char (*ids)[JOB_ID_BYTES],
                          size_t max, size_t *count, struct error *error) {
    struct sql_rows *row;
    *count = 0;
    sql_lock(queue->writer);
    struct sql *db = queue->writer;
    enum status status = sql_run(db, "DELETE FROM tombstones WHERE at < ?1", VALUES(I(tombstones_before_ms)), error);
    if (status == STATUS_OK)
        status = sql_select(db, "SELECT id FROM jobs WHERE expires > 0 AND expires <= ?1 ORDER BY expires LIMIT ?2",
                            VALUES(I(now_ms), I(max)), &row, error);
    if (status == STATUS_OK) {
        while (*count < max && sql_next(row)) sql_copy_text(row, 0, ids[(*count)++], JOB_ID_BYTES);
        status = sql_finish(row, error);
    }
    sql_unlock(queue->writer);
    return status;
}

static enum status move_times(struct sql *db, int64_t step_ms, struct error *error) {
    static const char *const changes[] = {
        "UPDATE jobs SET expires = expires + ?1, sequence = sequence + 1 WHERE expires > 0",
        "UPDATE clouds SET expires = expires + ?1 WHERE expires > 0",
        "UPDATE uploads SET expires = expires + ?1",
        "UPDATE replies SET at = at + ?1",
        "UPDATE tombstones SET at = at + ?1",
        "UPDATE outbox SET due = due + ?1 WHERE due > 0"};
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    for (size_t i = 0; status == STATUS_OK && i < sizeof changes / sizeof *changes; i++)
        status = sql_run(db, changes[i], VALUES(I(step_ms)), error);
    if (status == STATUS_OK)
        status = sql_run(db, "UPDATE jobs SET updated = ?1 WHERE updated > ?1", VALUES(I(job_now_ms())), error);
    return sql_end(db, status, error);
}

enum status queue_move_times(struct queue *queue, int64_t step_ms, struct error *error) {
    sql_lock(queue->writer);
    enum status status = move_times(queue->writer, step_ms, error);
    sql_unlock(queue->writer);
    if (status != STATUS_OK) return status;
    pthread_mutex_lock(&queue->order);
    turns_move_times(queue->turns, step_ms);
    for (size_t i = 0; i < queue->run_count; i++) queue->runs[i].started_ms += step_ms;
    pthread_mutex_unlock(&queue->order);
    return STATUS_OK;
}
