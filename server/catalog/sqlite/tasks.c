/* Jobs in tiles: their tasks, claimed, ended and lost.
 *
 * The job's row waits (state 0) while one of its tasks does, so its turn comes as any job's; it runs without an owner
 * while all that are left run.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/job_rows.h"

/* ------------------------------------------------------------------------------------------------ claim */

/* One that has no tasks begins with its plan. */
static enum status begin_tasks(struct sql *db, struct job *job, struct error *error) {
    enum status status = sql_run(
        db, "INSERT INTO tasks (job, number) SELECT ?1, ?2 WHERE NOT EXISTS (SELECT 1 FROM tasks WHERE job = ?1)",
        VALUES(T(job->id), I(JOB_TASK_PLAN)), error);
    if (status != STATUS_OK || !sql_changes(db)) return status;
    job->tiles = JOB_TILES_UNPLANNED;
    job->tiles_done = 0;
    return sql_run(db,
                   "UPDATE jobs SET tiles = ?2, tiles_done = 0, stage = '', message = '', fraction = 0 WHERE id = ?1",
                   VALUES(T(job->id), I(JOB_TILES_UNPLANNED)), error);
}

enum status catalog_sqlite_take_task(struct sql *db, const struct catalog_claim *by, struct job *job, int64_t now,
                                     size_t *count, struct error *error) {
    struct sql_rows *row;
    *count = 0;
    enum status status = begin_tasks(db, job, error);
    if (status == STATUS_OK)
        status = sql_select(
            db,
            "UPDATE tasks SET state = ?2, attempt = ?3, owner = ?4, lease = ?5 WHERE job = ?1 AND "
            "number = (SELECT min(number) FROM tasks WHERE job = ?1 AND state = ?6) "
            "RETURNING number, failures, interruptions",
            VALUES(T(job->id), I(JOB_RUNNING), I(job->attempt), T(by->owner), I(now + by->lease_ms), I(JOB_ACCEPTED)),
            &row, error);
    if (status != STATUS_OK) return status;
    if (sql_next(row)) {
        job->task = sql_integer(row, 0);
        job->failures = (int)sql_integer(row, 1);
        job->interruptions = (int)sql_integer(row, 2);
        job->lease_end_ms = now + by->lease_ms;
        snprintf(job->owner, sizeof job->owner, "%s", by->owner);
        *count = 1;
    }
    status = sql_finish(row, error);
    if (status != STATUS_OK) return status;
    return sql_run(db,
                   "UPDATE jobs SET state = ?2 WHERE id = ?1 AND EXISTS (SELECT 1 FROM tasks WHERE job = ?1 "
                   "AND state = ?2)",
                   VALUES(T(job->id), I(JOB_ACCEPTED)), error);
}

/* ------------------------------------------------------------------------------------------------ lost */

enum status catalog_sqlite_list_lost_tasks(struct sql *db, const char *owner, struct job *jobs, size_t max,
                                           size_t *count, struct error *error) {
    struct sql_rows *row;
    size_t first = *count;
    enum status status = sql_select(db,
                                    "SELECT " CATALOG_TASK_COLUMNS " FROM tasks "
                                    "WHERE state = ?1 AND (lease <= ?2 OR owner = ?3) ORDER BY job, number LIMIT ?4",
                                    VALUES(I(JOB_RUNNING), I(job_now_ms()), T(owner), I(max - first)), &row, error);
    if (status != STATUS_OK) return status;
    size_t end = first;
    struct job task;
    struct catalog_cells cells = catalog_sqlite_cells(row);
    while (end < max && sql_next(row)) catalog_cells_read_task(&cells, &jobs[end++]);
    status = sql_finish(row, error);
    for (size_t i = first; status == STATUS_OK && i < end; i++) {
        bool found;
        task = jobs[i];
        status = job_rows_find(db, task.id, &jobs[*count], &found, error);
        if (status != STATUS_OK || !found) continue;
        job_become_task(&jobs[(*count)++], &task);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ end */

/* Whether the task is the caller's, or the job may still end.  *next: DISMISSED where somebody wants it to end. */
static enum status find_held(struct sql *db, const struct job *job, bool *held, enum job_event *event,
                             struct error *error) {
    int64_t cancelled = 0, known = 0;
    enum status status = sql_number(db, "SELECT cancelled FROM jobs WHERE id = ?1 AND state IN (?2, ?3)",
                                    VALUES(T(job->id), I(JOB_ACCEPTED), I(JOB_RUNNING)), &cancelled, error);
    if (status == STATUS_OK)
        status = sql_number(
            db,
            "SELECT count(*) FROM jobs WHERE id = ?1 AND state IN (?2, ?3) AND (?4 < 0 OR EXISTS "
            "(SELECT 1 FROM tasks WHERE job = ?1 AND number = ?4 AND state = ?3 AND attempt = ?5 "
            "AND owner = ?6))",
            VALUES(T(job->id), I(JOB_ACCEPTED), I(JOB_RUNNING), I(job->task), I(job->attempt), T(job->owner)), &known,
            error);
    *held = known != 0;
    if (cancelled && (*event != JOB_DONE || job->task <= job->tiles)) *event = JOB_DISMISS;
    return status;
}

/* What a task took counts to its job. */
static enum status count_task(struct sql *db, const struct job *job, int64_t now, struct error *error) {
    return sql_run(db,
                   "UPDATE jobs SET cpu = cpu + ?2, rss = max(rss, ?3), updated = ?4, "
                   "sequence = max(sequence + 1, ?4) WHERE id = ?1",
                   VALUES(T(job->id), R(job->task_cpu_s), I(job->peak_rss_bytes), I(now)), error);
}

static enum status end_task(struct sql *db, const struct job *job, struct error *error) {
    return sql_run(db, "UPDATE tasks SET state = ?3, owner = '', lease = 0 WHERE job = ?1 AND number = ?2",
                   VALUES(T(job->id), I(job->task), I(JOB_SUCCESSFUL)), error);
}

static enum status add_tasks(struct sql *db, const struct job *job, int64_t first, int64_t last, struct error *error) {
    return sql_run(db,
                   "WITH RECURSIVE n(i) AS (SELECT ?2 UNION ALL SELECT i + 1 FROM n WHERE i < ?3) "
                   "INSERT INTO tasks (job, number) SELECT ?1, i FROM n",
                   VALUES(T(job->id), I(first), I(last)), error);
}

static enum status note_planned(struct sql *db, const struct job *job, struct error *error) {
    enum status status = end_task(db, job, error);
    if (status == STATUS_OK) status = add_tasks(db, job, 1, job->tiles, error);
    if (status != STATUS_OK) return status;
    return sql_run(db, "UPDATE jobs SET tiles = ?2, state = ?3 WHERE id = ?1",
                   VALUES(T(job->id), I(job->tiles), I(JOB_ACCEPTED)), error);
}

static enum status note_tile(struct sql *db, const struct job *job, struct error *error) {
    int64_t left = 1;
    enum status status = end_task(db, job, error);
    if (status == STATUS_OK)
        status = sql_run(db, "UPDATE jobs SET tiles_done = tiles_done + 1 WHERE id = ?1", VALUES(T(job->id)), error);
    if (status == STATUS_OK)
        status = sql_number(db, "SELECT count(*) FROM tasks WHERE job = ?1 AND state <> ?2",
                            VALUES(T(job->id), I(JOB_SUCCESSFUL)), &left, error);
    if (status != STATUS_OK || left) return status;
    status = add_tasks(db, job, job->tiles + 1, job->tiles + 1, error);
    if (status != STATUS_OK) return status;
    return sql_run(db, "UPDATE jobs SET state = ?2 WHERE id = ?1", VALUES(T(job->id), I(JOB_ACCEPTED)), error);
}

static enum status wait_again(struct sql *db, const struct job *job, struct error *error) {
    enum status status =
        sql_run(db,
                "UPDATE tasks SET state = ?3, owner = '', lease = 0, failures = ?4, "
                "interruptions = ?5 WHERE job = ?1 AND number = ?2",
                VALUES(T(job->id), I(job->task), I(JOB_ACCEPTED), I(job->failures), I(job->interruptions)), error);
    if (status != STATUS_OK) return status;
    return sql_run(db, "UPDATE jobs SET state = ?2 WHERE id = ?1", VALUES(T(job->id), I(JOB_ACCEPTED)), error);
}

static enum status drop_tasks(struct sql *db, const struct job *job, struct error *error) {
    return sql_run(db, "DELETE FROM tasks WHERE job = ?1", VALUES(T(job->id)), error);
}

static enum status finish_in_transaction(struct sql *db, enum job_event event, const struct job *job, bool *changed,
                                         bool *ended, struct error *error) {
    enum job_state next;
    enum status status = find_held(db, job, changed, &event, error);
    enum job_step step = job_step_of(job, event, &next);
    *ended = *changed && step == JOB_STEP_END;
    if (status != STATUS_OK || !*changed) return status;
    if (step == JOB_STEP_END) status = catalog_sqlite_write_end(db, job, next, error);
    if (step == JOB_STEP_RESTART) status = job_rows_requeue(db, job, error);
    if (step == JOB_STEP_END || step == JOB_STEP_RESTART)
        return status == STATUS_OK ? drop_tasks(db, job, error) : status;
    status = count_task(db, job, job_now_ms(), error);
    if (status != STATUS_OK) return status;
    if (step == JOB_STEP_PLANNED) return note_planned(db, job, error);
    return step == JOB_STEP_TILE ? note_tile(db, job, error) : wait_again(db, job, error);
}

void catalog_sqlite_settle_task(struct catalog_sqlite *sqlite, const struct job *job) {
    struct error ignored;
    int64_t waits = 0;
    enum status status = catalog_sqlite_count(sqlite, &ignored);
    if (status == STATUS_OK)
        status = sql_number(sqlite->writer, "SELECT count(*) FROM jobs WHERE id = ?1 AND state = ?2",
                            VALUES(T(job->id), I(JOB_ACCEPTED)), &waits, &ignored);
    if (status == STATUS_OK && waits) catalog_sqlite_put_in_order(sqlite, job);
}

enum status catalog_sqlite_finish_tiles(struct catalog_sqlite *sqlite, enum job_event event, const struct job *job,
                                        bool *changed, struct error *error) {
    bool ended = false;
    *changed = false;
    catalog_sqlite_enter(sqlite);
    enum status status = sql_begin(sqlite->writer, error);
    if (status == STATUS_OK)
        status =
            sql_end(sqlite->writer, finish_in_transaction(sqlite->writer, event, job, changed, &ended, error), error);
    *changed = *changed && status == STATUS_OK;
    if (*changed) {
        catalog_sqlite_take_out(sqlite, job->id);
        catalog_sqlite_refresh_usage(sqlite, job->principal);
        catalog_sqlite_settle_task(sqlite, job);
    }
    sql_unlock(sqlite->writer);
    if (*changed) catalog_tell(&sqlite->catalog, ended ? CATALOG_CHANGED : CATALOG_WAITS, job->id);
    if (*changed && ended && event != JOB_DONE) catalog_tell(&sqlite->catalog, CATALOG_CANCELLED, job->id);
    return status;
}
