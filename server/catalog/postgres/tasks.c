/* Jobs in tiles: their tasks, claimed, ended and lost.
 *
 * The job's row waits (state 0) while one of its tasks does, so its turn comes as any job's; it runs without an owner
 * while all that are left run.  Whoever changes a task holds the lock of the job's row, and looks at the tasks by a
 * statement of its own after that: one that waits for a row's lock sees other tables as they were before.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

/* ------------------------------------------------------------------------------------------------ claim */

/* One that has no tasks begins with its plan. */
static enum status begin_tasks(struct pq_link *link, struct job *job, struct error *error) {
    int64_t begun = 0;
    enum status status = pq_run(
        link, "INSERT INTO tasks (job, number) SELECT $1, $2 WHERE NOT EXISTS (SELECT 1 FROM tasks WHERE job = $1)",
        VALUES(T(job->id), I(JOB_TASK_PLAN)), &begun, error);
    if (status != STATUS_OK || !begun) return status;
    job->tiles = JOB_TILES_UNPLANNED;
    job->tiles_done = 0;
    return pq_run(link,
                  "UPDATE jobs SET tiles = $2, tiles_done = 0, stage = '', message = '', fraction = 0 WHERE id = $1",
                  VALUES(T(job->id), I(JOB_TILES_UNPLANNED)), NULL, error);
}

enum status catalog_postgres_take_task(struct pq_link *link, const struct catalog_claim *by, struct job *job,
                                       size_t *count, struct error *error) {
    struct pq_rows *rows;
    *count = 0;
    enum status status = begin_tasks(link, job, error);
    if (status == STATUS_OK)
        status = pq_select(
            link,
            "UPDATE tasks SET state = $2, attempt = $3, owner = $4, lease = whittle_now() + $5 "
            "WHERE job = $1 AND number = (SELECT min(number) FROM tasks WHERE job = $1 AND state = $6) "
            "RETURNING number, failures, interruptions, lease",
            VALUES(T(job->id), I(JOB_RUNNING), I(job->attempt), T(by->owner), I(by->lease_ms), I(JOB_ACCEPTED)), &rows,
            error);
    if (status != STATUS_OK) return status;
    if (pq_next(rows)) {
        job->task = pq_integer(rows, 0);
        job->failures = (int)pq_integer(rows, 1);
        job->interruptions = (int)pq_integer(rows, 2);
        job->lease_end_ms = pq_integer(rows, 3);
        snprintf(job->owner, sizeof job->owner, "%s", by->owner);
        *count = 1;
    }
    pq_free(rows);
    return pq_run(link,
                  "UPDATE jobs SET state = $2 WHERE id = $1 AND EXISTS (SELECT 1 FROM tasks WHERE job = $1 "
                  "AND tasks.state = $2)",
                  VALUES(T(job->id), I(JOB_ACCEPTED)), NULL, error);
}

/* ------------------------------------------------------------------------------------------------ lost */

enum status catalog_postgres_list_lost_tasks(struct pq_link *link, const char *owner, struct job *jobs, size_t max,
                                             size_t *count, struct error *error) {
    struct pq_rows *rows;
    size_t first = *count, end = first;
    enum status status = pq_select(link,
                                   "SELECT " CATALOG_TASK_COLUMNS " FROM tasks WHERE state = $1 "
                                   "AND (lease <= whittle_now() OR owner = $2) ORDER BY job, number LIMIT $3",
                                   VALUES(I(JOB_RUNNING), T(owner), I(max - first)), &rows, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_postgres_cells(rows);
    while (end < max && pq_next(rows)) catalog_cells_read_task(&cells, &jobs[end++]);
    pq_free(rows);
    for (size_t i = first; status == STATUS_OK && i < end; i++) {
        struct job task = jobs[i];
        size_t found = 0;
        status = catalog_postgres_select_jobs(link, "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE id = $1",
                                              VALUES(T(task.id)), &jobs[*count], 1, &found, error);
        if (found) job_become_task(&jobs[(*count)++], &task);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ end */

/* Whether the task is the caller's, or the job may still end; locks the job's row. */
static enum status find_held(struct pq_link *link, const struct job *job, bool *held, enum job_event *event,
                             struct error *error) {
    int64_t cancelled = -1, own = 1;
    enum status status = pq_number(link, "SELECT cancelled FROM jobs WHERE id = $1 AND state IN ($2, $3) FOR UPDATE",
                                   VALUES(T(job->id), I(JOB_ACCEPTED), I(JOB_RUNNING)), &cancelled, error);
    if (status == STATUS_OK && job->task != JOB_TASK_NONE)
        status =
            pq_number(link,
                      "SELECT count(*) FROM tasks WHERE job = $1 AND number = $2 AND state = $3 AND attempt = $4 "
                      "AND owner = $5",
                      VALUES(T(job->id), I(job->task), I(JOB_RUNNING), I(job->attempt), T(job->owner)), &own, error);
    *held = cancelled >= 0 && own != 0;
    if (cancelled > 0 && (*event != JOB_DONE || job->task <= job->tiles)) *event = JOB_DISMISS;
    return status;
}

static enum status end_task(struct pq_link *link, const struct job *job, struct error *error) {
    return pq_run(link, "UPDATE tasks SET state = $3, owner = '', lease = 0 WHERE job = $1 AND number = $2",
                  VALUES(T(job->id), I(job->task), I(JOB_SUCCESSFUL)), NULL, error);
}

static enum status add_tasks(struct pq_link *link, const struct job *job, int64_t first, int64_t last,
                             struct error *error) {
    return pq_run(link, "INSERT INTO tasks (job, number) SELECT $1, generate_series($2::BIGINT, $3::BIGINT)",
                  VALUES(T(job->id), I(first), I(last)), NULL, error);
}

static enum status note_planned(struct pq_link *link, const struct job *job, struct error *error) {
    enum status status = end_task(link, job, error);
    if (status == STATUS_OK) status = add_tasks(link, job, 1, job->tiles, error);
    if (status != STATUS_OK) return status;
    return pq_run(link, "UPDATE jobs SET tiles = $2, state = $3 WHERE id = $1",
                  VALUES(T(job->id), I(job->tiles), I(JOB_ACCEPTED)), NULL, error);
}

static enum status note_tile(struct pq_link *link, const struct job *job, struct error *error) {
    int64_t left = 1;
    enum status status = end_task(link, job, error);
    if (status == STATUS_OK)
        status =
            pq_run(link, "UPDATE jobs SET tiles_done = tiles_done + 1 WHERE id = $1", VALUES(T(job->id)), NULL, error);
    if (status == STATUS_OK)
        status = pq_number(link, "SELECT count(*) FROM tasks WHERE job = $1 AND state <> $2",
                           VALUES(T(job->id), I(JOB_SUCCESSFUL)), &left, error);
    if (status != STATUS_OK || left) return status;
    status = add_tasks(link, job, job->tiles + 1, job->tiles + 1, error);
    if (status != STATUS_OK) return status;
    return pq_run(link, "UPDATE jobs SET state = $2 WHERE id = $1", VALUES(T(job->id), I(JOB_ACCEPTED)), NULL, error);
}

static enum status wait_again(struct pq_link *link, const struct job *job, struct error *error) {
    enum status status =
        pq_run(link,
               "UPDATE tasks SET state = $3, owner = '', lease = 0, failures = $4, "
               "interruptions = $5 WHERE job = $1 AND number = $2",
               VALUES(T(job->id), I(job->task), I(JOB_ACCEPTED), I(job->failures), I(job->interruptions)), NULL, error);
    if (status != STATUS_OK) return status;
    return pq_run(link, "UPDATE jobs SET state = $2 WHERE id = $1", VALUES(T(job->id), I(JOB_ACCEPTED)), NULL, error);
}

/* A task's end that isn't the job's; what it took counts to the job. */
static enum status note_task(struct catalog_postgres *postgres, struct pq_link *link, enum job_step step,
                             const struct job *job, struct error *error) {
    enum status status =
        pq_run(link,
               "UPDATE jobs SET cpu = cpu + $2, rss = greatest(rss, $3), updated = whittle_now(), "
               "sequence = greatest(sequence + 1, whittle_now()), writer = $4 WHERE id = $1",
               VALUES(T(job->id), R(job->task_cpu_s), I(job->peak_rss_bytes), T(postgres->session)), NULL, error);
    if (status != STATUS_OK) return status;
    if (step == JOB_STEP_PLANNED) return note_planned(link, job, error);
    return step == JOB_STEP_TILE ? note_tile(link, job, error) : wait_again(link, job, error);
}

/* What a task that is lost puts until then is marked, too. */
static enum status end_job(struct catalog_postgres *postgres, struct pq_link *link, const struct job *job,
                           enum job_state next, struct error *error) {
    enum status status = catalog_postgres_write_end(postgres, link, job, next, error);
    if (status != STATUS_OK) return status;
    status =
        pq_run(link, MARK("'jobs/' || $1 || '/tiles'", "whittle_now() + " GRACE_MS), VALUES(T(job->id)), NULL, error);
    if (status != STATUS_OK || next == JOB_SUCCESSFUL) return status;
    return catalog_postgres_notify(postgres, link, CATALOG_CANCELLED, job->id, error);
}

static enum status finish_in_transaction(struct catalog_postgres *postgres, struct pq_link *link, enum job_event event,
                                         const struct job *job, bool *changed, bool *ended, struct error *error) {
    enum job_state next;
    enum status status = find_held(link, job, changed, &event, error);
    enum job_step step = job_step_of(job, event, &next);
    *ended = *changed && step == JOB_STEP_END;
    if (status != STATUS_OK || !*changed) return status;
    if (step == JOB_STEP_END) status = end_job(postgres, link, job, next, error);
    if (step == JOB_STEP_RESTART) status = catalog_postgres_write_requeue(postgres, link, job, error);
    if (step != JOB_STEP_END && step != JOB_STEP_RESTART)
        status = note_task(postgres, link, step, job, error);
    else if (status == STATUS_OK)
        status = pq_run(link, "DELETE FROM tasks WHERE job = $1", VALUES(T(job->id)), NULL, error);
    if (status != STATUS_OK) return status;
    return catalog_postgres_notify(postgres, link, *ended ? CATALOG_CHANGED : CATALOG_WAITS, job->id, error);
}

/* A commit without an answer is asked again, and then the task isn't the caller's any more. */
enum status catalog_postgres_finish_tiles(struct catalog_postgres *postgres, enum job_event event,
                                          const struct job *job, bool *changed, struct error *error) {
    struct pq_link *link;
    bool ended = false;
    *changed = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = finish_in_transaction(postgres, link, event, job, changed, &ended, error);
    status = pq_end(link, status, NULL, error);
    *changed = *changed && status == STATUS_OK;
    if (*changed) catalog_tell(&postgres->catalog, ended ? CATALOG_CHANGED : CATALOG_WAITS, job->id);
    if (*changed && ended && event != JOB_DONE) catalog_tell(&postgres->catalog, CATALOG_CANCELLED, job->id);
    return status;
}
