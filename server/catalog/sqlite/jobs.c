/* Jobs: submitted, claimed, ended, read and deleted; and what principals have of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/job_rows.h"

/* ------------------------------------------------------------------------------------------------ limits */

struct catalog_usage catalog_sqlite_usage(struct catalog *catalog, const char *principal) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    return usage_of(sqlite->usage, principal);
}

enum status catalog_sqlite_reserve(struct catalog *catalog, const char *principal, uint64_t bytes, uint64_t limit,
                                   struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    return usage_reserve(sqlite->usage, principal, bytes, limit, error);
}

void catalog_sqlite_release(struct catalog *catalog, const char *principal, uint64_t bytes) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    usage_release(sqlite->usage, principal, bytes);
}

enum status catalog_sqlite_check_limits(const struct catalog_sqlite *sqlite, const char *principal, uint64_t more,
                                        const struct catalog_limits *limits, struct error *error) {
    struct catalog_usage has = usage_of(sqlite->usage, principal);
    if (sqlite->waiting + more > limits->waiting)
        return error_set(error, STATUS_LIMIT, "queue", "%llu jobs are waiting", (unsigned long long)sqlite->waiting);
    if (limits->principal_jobs && has.active + more > limits->principal_jobs)
        return error_set(error, STATUS_LIMIT, "principal_jobs", "you have %llu jobs waiting or running",
                         (unsigned long long)has.active);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ submit, claim */

/* The job, the key that it was submitted under, and who is told of its end; in a transaction. */
static enum status insert(struct sql *db, const struct job *job, struct error *error) {
    enum status status = job_rows_insert(db, job, error);
    if (status == STATUS_OK && job->key)
        status = catalog_sqlite_add_key(db, job->principal, job->key, job->id, job->created_ms, error);
    if (status == STATUS_OK && job->webhook) status = catalog_sqlite_add_webhook(db, job->id, job->webhook, error);
    return status;
}

static enum status insert_alone(struct sql *db, const struct job *job, struct error *error) {
    enum status status = sql_begin(db, error);
    return status == STATUS_OK ? sql_end(db, insert(db, job, error), error) : status;
}

enum status catalog_sqlite_submit(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                                  struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    catalog_sqlite_enter(sqlite);
    enum status status = catalog_sqlite_check_limits(sqlite, job->principal, 1, limits, error);
    if (status == STATUS_OK)
        status = catalog_reserve(catalog, job->principal, job->input_bytes, limits->principal_bytes, error);
    if (status == STATUS_OK) {
        status = insert_alone(sqlite->writer, job, error);
        if (status == STATUS_OK) catalog_sqlite_refresh_usage(sqlite, job->principal);
        catalog_release(catalog, job->principal, job->input_bytes);
    }
    if (status == STATUS_OK) {
        sqlite->waiting++;
        catalog_sqlite_put_in_order(sqlite, job);
    }
    sql_unlock(sqlite->writer);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_WAITS, job->id);
    return status;
}

/* In a transaction, so that nothing is claimed that can't be handed over. */
static enum status claim(struct catalog_sqlite *sqlite, const struct catalog_claim *by, struct job *job, size_t *count,
                         struct error *error) {
    struct sql *db = sqlite->writer;
    struct sql_rows *row;
    int64_t now = job_now_ms();
    char id[JOB_ID_BYTES];
    catalog_sqlite_first_in_order(sqlite, id);
    enum status status =
        sql_select(db,
                   "UPDATE jobs SET state = ?1, attempt = attempt + 1, updated = ?2, "
                   "started = CASE WHEN tiles <> 0 AND started > 0 THEN started ELSE ?2 END, "
                   "sequence = max(sequence + 1, ?2), stage = CASE tiles WHEN 0 THEN '' ELSE stage END, "
                   "message = CASE tiles WHEN 0 THEN '' ELSE message END, "
                   "fraction = CASE tiles WHEN 0 THEN 0 ELSE fraction END, "
                   "owner = CASE tiles WHEN 0 THEN ?8 ELSE '' END, lease = CASE tiles WHEN 0 THEN ?9 ELSE ?10 END "
                   "WHERE id = (SELECT id FROM jobs WHERE state = ?3 ORDER BY id <> ?4, id LIMIT 1) "
                   "AND memory <= ?5 AND (interruptions < ?6 OR ?7 = 0) "
                   "RETURNING " CATALOG_JOB_COLUMNS,
                   VALUES(I(JOB_RUNNING), I(now), I(JOB_ACCEPTED), T(id), I(by->memory_bytes), I(JOB_ALONE_AFTER),
                          I(sqlite->running), T(by->owner), I(now + by->lease_ms), I(JOB_LEASE_NEVER)),
                   &row, error);
    if (status == STATUS_OK) status = job_rows_read(db, row, job, 1, count, error);
    if (status == STATUS_OK && *count && job->tiles) {
        status = catalog_sqlite_take_task(db, by, job, now, count, error);
        if (status != STATUS_OK || !*count) job_done(job);
    }
    return status;
}

static enum status claim_in_transaction(struct catalog_sqlite *sqlite, const struct catalog_claim *by, struct job *job,
                                        bool *found, struct error *error) {
    size_t count = 0;
    enum status status = sql_begin(sqlite->writer, error);
    if (status != STATUS_OK) return status;
    status = claim(sqlite, by, job, &count, error);
    status = sql_end(sqlite->writer, status, error);
    *found = status == STATUS_OK && count == 1;
    if (count == 1 && !*found) job_done(job);
    return status;
}

enum status catalog_sqlite_claim(struct catalog *catalog, const struct catalog_claim *by, struct job *job, bool *found,
                                 struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    *found = false;
    catalog_sqlite_enter(sqlite);
    enum status status = STATUS_OK;
    if (sqlite->waiting && !sqlite->alone) status = claim_in_transaction(sqlite, by, job, found, error);
    if (*found) {
        sqlite->alone = !job->tiles && job->interruptions >= JOB_ALONE_AFTER;
        sqlite->running++;
        catalog_sqlite_put_in_run(sqlite, job);
    }
    if (*found && job->tiles)
        catalog_sqlite_settle_task(sqlite, job);
    else if (*found)
        sqlite->waiting--;
    sql_unlock(sqlite->writer);
    if (*found) catalog_tell(catalog, CATALOG_CHANGED, job->id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ leases */

enum status catalog_sqlite_progress(struct catalog *catalog, const struct job *job, bool *held, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run_nosync(
        writer,
        job->tiles
            ? "UPDATE jobs SET stage = ?2, message = ?3, fraction = max(fraction, ?4), updated = ?5, "
              "sequence = max(sequence + 1, ?5) WHERE id = ?1 AND EXISTS (SELECT 1 FROM tasks WHERE job = ?1 "
              "AND number = ?9 AND state = ?6 AND attempt = ?7 AND owner = ?8)"
            : "UPDATE jobs SET stage = ?2, message = ?3, fraction = ?4, updated = ?5, sequence = max(sequence + 1, ?5) "
              "WHERE id = ?1 AND state = ?6 AND attempt = ?7 AND owner = ?8 AND ?9 <= 0",
        VALUES(T(job->id), T(job->stage), T(job->message), R(job->fraction), I(job_now_ms()), I(JOB_RUNNING),
               I(job->attempt), T(job->owner), I(job->task)),
        error);
    bool changed = status == STATUS_OK && sql_changes(writer) > 0;
    sql_unlock(writer);
    if (status == STATUS_OK) *held = changed;
    if (changed) catalog_tell(catalog, CATALOG_CHANGED, job->id);
    return status;
}

static enum status list_leases(struct sql *db, const char *owner, struct catalog_lease *leases, size_t max,
                               size_t *count, struct error *error) {
    struct sql_rows *row;
    enum status status =
        sql_select(db,
                   "SELECT id, attempt, cancelled FROM jobs WHERE state = ?1 AND owner = ?2 "
                   "UNION ALL SELECT job, attempt, 0 FROM tasks WHERE state = ?1 AND owner = ?2 LIMIT ?3",
                   VALUES(I(JOB_RUNNING), T(owner), I(max)), &row, error);
    if (status != STATUS_OK) return status;
    while (*count < max && sql_next(row)) {
        struct catalog_lease *lease = &leases[(*count)++];
        sql_copy_text(row, 0, lease->job, sizeof lease->job);
        lease->attempt = (int)sql_integer(row, 1);
        lease->is_cancelled = sql_integer(row, 2) != 0;
    }
    return sql_finish(row, error);
}

enum status catalog_sqlite_renew(struct catalog *catalog, const char *owner, int64_t lease_ms,
                                 struct catalog_lease *leases, size_t max, size_t *count, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    *count = 0;
    enum status status = sql_run_nosync(writer, "UPDATE jobs SET lease = ?3 WHERE state = ?1 AND owner = ?2",
                                        VALUES(I(JOB_RUNNING), T(owner), I(job_now_ms() + lease_ms)), error);
    if (status == STATUS_OK)
        status = sql_run_nosync(writer, "UPDATE tasks SET lease = ?3 WHERE state = ?1 AND owner = ?2",
                                VALUES(I(JOB_RUNNING), T(owner), I(job_now_ms() + lease_ms)), error);
    if (status == STATUS_OK) status = list_leases(writer, owner, leases, max, count, error);
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_list_lost(struct catalog *catalog, const char *owner, struct job *jobs, size_t max,
                                     size_t *count, struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *row;
    *count = 0;
    sql_lock(reader);
    enum status status = sql_select(reader,
                                    "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE state = ?1 "
                                    "AND (lease <= ?2 OR owner = ?3) ORDER BY id LIMIT ?4",
                                    VALUES(I(JOB_RUNNING), I(job_now_ms()), T(owner), I(max)), &row, error);
    if (status == STATUS_OK) status = job_rows_read(reader, row, jobs, max, count, error);
    if (status == STATUS_OK) status = catalog_sqlite_list_lost_tasks(reader, owner, jobs, max, count, error);
    sql_unlock(reader);
    return status;
}

enum status catalog_sqlite_cancel(struct catalog *catalog, const char *id, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run(writer, "UPDATE jobs SET cancelled = 1 WHERE id = ?1 AND state = ?2 AND cancelled = 0",
                                 VALUES(T(id), I(JOB_RUNNING)), error);
    sql_unlock(writer);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_CANCELLED, id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ finish */

enum status catalog_sqlite_write_end(struct sql *db, const struct job *job, enum job_state next, struct error *error) {
    enum status status = job_rows_end(db, job, next, error);
    return status == STATUS_OK ? catalog_sqlite_make_webhook_due(db, job->id, job_now_ms(), error) : status;
}

/* What the end of a job starts from. */
struct held_row {
    int64_t state, attempt, is_cancelled;
    char owner[JOB_OWNER_BYTES];
};

/* state -1: there is no such job. */
static enum status read_held(struct sql *db, const char *id, struct held_row *held, struct error *error) {
    struct sql_rows *row;
    *held = (struct held_row){.state = -1};
    enum status status =
        sql_select(db, "SELECT state, attempt, cancelled, owner FROM jobs WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status != STATUS_OK) return status;
    if (sql_next(row)) {
        held->state = sql_integer(row, 0);
        held->attempt = sql_integer(row, 1);
        held->is_cancelled = sql_integer(row, 2);
        sql_copy_text(row, 3, held->owner, sizeof held->owner);
    }
    return sql_finish(row, error);
}

/* Whether the job as the caller knows it may have ended: what runs is fenced by owner and attempt. */
static bool may_finish(const struct held_row *held, const struct job *job) {
    if (held->state != JOB_RUNNING) return held->state >= 0;
    return held->attempt == job->attempt && strcmp(held->owner, job->owner) == 0;
}

/* One transaction; *from and *next differ where it was done. */
static enum status finish(struct sql *db, enum job_event event, const struct job *job, enum job_state *from,
                          enum job_state *next, struct error *error) {
    struct held_row held;
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    status = read_held(db, job->id, &held, error);
    *from = *next = (enum job_state)(held.state < 0 ? JOB_DISMISSED : held.state);
    if (event == JOB_REQUEUE && held.is_cancelled) event = JOB_DISMISS;
    if (status == STATUS_OK && may_finish(&held, job) && job_transition(*from, event, next))
        status =
            event == JOB_REQUEUE ? job_rows_requeue(db, job, error) : catalog_sqlite_write_end(db, job, *next, error);
    return sql_end(db, status, error);
}

enum status catalog_sqlite_finish(struct catalog *catalog, enum job_event event, const struct job *job, bool *changed,
                                  struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    enum job_state from = JOB_ACCEPTED, next = JOB_ACCEPTED;
    if (job->tiles) return catalog_sqlite_finish_tiles(sqlite, event, job, changed, error);
    catalog_sqlite_enter(sqlite);
    enum status status = finish(sqlite->writer, event, job, &from, &next, error);
    *changed = status == STATUS_OK && from != next;
    if (*changed && from == JOB_ACCEPTED) sqlite->waiting--;
    if (*changed && from == JOB_RUNNING) {
        sqlite->running--;
        sqlite->alone = false; /* it was this one, if any */
    }
    if (*changed) catalog_sqlite_take_out(sqlite, job->id);
    if (*changed) catalog_sqlite_refresh_usage(sqlite, job->principal);
    if (*changed && next == JOB_ACCEPTED) {
        sqlite->waiting++;
        catalog_sqlite_put_in_order(sqlite, job);
    }
    sql_unlock(sqlite->writer);
    if (*changed) catalog_tell(catalog, next == JOB_ACCEPTED ? CATALOG_WAITS : CATALOG_CHANGED, job->id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ reuse */

static enum status insert_ended(struct sql *db, const struct job *job, struct error *error) {
    enum job_state next;
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    status = insert(db, job, error);
    if (status == STATUS_OK && job_transition(JOB_ACCEPTED, JOB_REUSE, &next))
        status = catalog_sqlite_write_end(db, job, next, error);
    return sql_end(db, status, error);
}

enum status catalog_sqlite_submit_ended(struct catalog *catalog, const struct job *job,
                                        const struct catalog_limits *limits, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    uint64_t bytes = job->input_bytes;
    for (size_t i = 0; i < job->output_count; i++) bytes += job->output[i].bytes;
    catalog_sqlite_enter(sqlite);
    enum status status = catalog_reserve(catalog, job->principal, bytes, limits->principal_bytes, error);
    if (status == STATUS_OK) {
        status = insert_ended(sqlite->writer, job, error);
        if (status == STATUS_OK) catalog_sqlite_refresh_usage(sqlite, job->principal);
        catalog_release(catalog, job->principal, bytes);
    }
    sql_unlock(sqlite->writer);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_CHANGED, job->id);
    return status;
}

enum status catalog_sqlite_find_result(struct catalog *catalog, const char *result, const char *principal,
                                       struct job *job, bool *found, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql_rows *row;
    size_t count = 0;
    sql_lock(sqlite->reader);
    enum status status = sql_select(sqlite->reader,
                                    "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE result = ?1 AND result <> '' "
                                    "AND principal = ?2 AND state = ?3 ORDER BY id DESC LIMIT 1",
                                    VALUES(T(result), T(principal), I(JOB_SUCCESSFUL)), &row, error);
    if (status == STATUS_OK) status = job_rows_read(sqlite->reader, row, job, 1, &count, error);
    sql_unlock(sqlite->reader);
    *found = status == STATUS_OK && count == 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

static enum status find_tombstone(struct sql *db, const char *id, struct catalog_tombstone *tombstone, bool *found,
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

enum status catalog_sqlite_get(struct catalog *catalog, const char *id, struct job *job,
                               enum catalog_presence *presence, struct catalog_tombstone *tombstone,
                               struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    bool found = false, gone = false;
    memset(job, 0, sizeof *job);
    sql_lock(sqlite->reader);
    enum status status = job_rows_find(sqlite->reader, id, job, &found, error);
    if (status == STATUS_OK && !found) status = find_tombstone(sqlite->reader, id, tombstone, &gone, error);
    sql_unlock(sqlite->reader);
    if (found) job->ahead = catalog_sqlite_ahead_of(sqlite, job);
    *presence = found ? CATALOG_PRESENT : gone ? CATALOG_GONE : CATALOG_ABSENT;
    return status;
}

enum status catalog_sqlite_list(struct catalog *catalog, const struct catalog_filter *filter, struct job *jobs,
                                size_t max, size_t *count, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql_rows *row;
    *count = 0;
    sql_lock(sqlite->reader);
    enum status status =
        sql_select(sqlite->reader,
                   "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE (?1 < 0 OR " CATALOG_JOB_SEEN " = ?1) "
                   "AND (?2 IS NULL OR label = ?2) AND (?3 IS NULL OR id < ?3) "
                   "AND (?4 IS NULL OR principal = ?4) AND (?6 IS NULL OR batch = ?6) ORDER BY id DESC LIMIT ?5",
                   VALUES(I(filter->by_state ? (int)filter->state : -1), T(filter->label), T(filter->after),
                          T(filter->principal), I(max), T(filter->batch)),
                   &row, error);
    if (status == STATUS_OK) status = job_rows_read(sqlite->reader, row, jobs, max, count, error);
    sql_unlock(sqlite->reader);
    for (size_t i = 0; i < *count; i++) jobs[i].ahead = catalog_sqlite_ahead_of(sqlite, &jobs[i]);
    return status;
}

enum status catalog_sqlite_cloud_uses(struct catalog *catalog, const char *cloud, uint64_t *uses, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    int64_t number = 0;
    sql_lock(sqlite->reader);
    enum status status = sql_number(
        sqlite->reader,
        "SELECT (SELECT count(*) FROM jobs WHERE cloud = ?1) + (SELECT count(*) FROM clouds WHERE sha256 = ?1)",
        VALUES(T(cloud)), &number, error);
    sql_unlock(sqlite->reader);
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
        if (status == STATUS_OK) status = catalog_sqlite_remove_webhook(db, id, error);
    }
    return sql_end(db, status, error);
}

enum status catalog_sqlite_delete(struct catalog *catalog, const char *id, const char *reason, bool *changed,
                                  struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    int64_t deleted = 0;
    catalog_sqlite_enter(sqlite);
    enum status status = delete_rows(sqlite->writer, id, reason, &deleted, error);
    if (deleted) catalog_sqlite_refresh_usage(sqlite, NULL);
    sql_unlock(sqlite->writer);
    *changed = status == STATUS_OK && deleted;
    if (*changed) catalog_tell(catalog, CATALOG_DELETED, id);
    return status;
}

enum status catalog_sqlite_expired(struct catalog *catalog, int64_t now_ms, int64_t tombstones_before_ms,
                                   char (*ids)[JOB_ID_BYTES], size_t max, size_t *count, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql_rows *row;
    *count = 0;
    catalog_sqlite_enter(sqlite);
    struct sql *db = sqlite->writer;
    enum status status = sql_run(db, "DELETE FROM tombstones WHERE at < ?1", VALUES(I(tombstones_before_ms)), error);
    if (status == STATUS_OK)
        status = sql_select(db, "SELECT id FROM jobs WHERE expires > 0 AND expires <= ?1 ORDER BY expires LIMIT ?2",
                            VALUES(I(now_ms), I(max)), &row, error);
    if (status == STATUS_OK) {
        while (*count < max && sql_next(row)) sql_copy_text(row, 0, ids[(*count)++], JOB_ID_BYTES);
        status = sql_finish(row, error);
    }
    sql_unlock(sqlite->writer);
    return status;
}

static enum status move_times(struct sql *db, int64_t step_ms, struct error *error) {
    static const char *const changes[] = {
        "UPDATE jobs SET expires = expires + ?1, sequence = sequence + 1 WHERE expires > 0",
        "UPDATE jobs SET lease = lease + ?1 WHERE lease > 0",
        "UPDATE tasks SET lease = lease + ?1 WHERE lease > 0",
        "UPDATE clouds SET expires = expires + ?1 WHERE expires > 0",
        "UPDATE uploads SET expires = expires + ?1",
        "UPDATE removals SET begun = begun + ?1",
        "UPDATE marks SET until = until + ?1",
        "UPDATE replies SET at = at + ?1",
        "UPDATE tombstones SET at = at + ?1",
        "UPDATE outbox SET due = due + ?1 WHERE due > 0"};
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    for (size_t i = 0; status == STATUS_OK && i < sizeof changes / sizeof *changes; i++)
        status = sql_run(db, changes[i], VALUES(I(step_ms)), error);
    if (status == STATUS_OK)
        status =
            sql_run(db, "UPDATE jobs SET updated = ?1 WHERE updated > ?1", VALUES(I(job_now_ms() + step_ms)), error);
    return sql_end(db, status, error);
}

enum status catalog_sqlite_move_times(struct catalog *catalog, int64_t step_ms, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    catalog_sqlite_enter(sqlite);
    enum status status = move_times(sqlite->writer, step_ms, error);
    sql_unlock(sqlite->writer);
    if (status == STATUS_OK) catalog_sqlite_move_order(sqlite, step_ms);
    return status;
}
