/* Whose turn it is and what runs, in memory.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/estimate.h"
#include "server/catalog/fair_share.h"
#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/job_rows.h"

/* Where memory runs out the job is not in the order, and claimed when nothing else is. */
void catalog_sqlite_put_in_order(struct catalog_sqlite *sqlite, const struct job *job) {
    struct turn turn = {.priority = job->priority, .created_ms = job->created_ms, .cost = estimate_cost(job)};
    memcpy(turn.id, job->id, sizeof turn.id);
    memcpy(turn.principal, job->principal, sizeof turn.principal);
    pthread_mutex_lock(&sqlite->order);
    bool kept = fair_share_add(sqlite->fair_share, &turn);
    (void)kept;
    pthread_mutex_unlock(&sqlite->order);
}

void catalog_sqlite_put_in_run(struct catalog_sqlite *sqlite, const struct job *job) {
    pthread_mutex_lock(&sqlite->order);
    fair_share_take(sqlite->fair_share, job->id);
    if (sqlite->run_count < CATALOG_SQLITE_MAX_RUNS) {
        struct run *run = &sqlite->runs[sqlite->run_count++];
        *run = (struct run){.cost = estimate_cost(job), .started_ms = job->started_ms};
        memcpy(run->id, job->id, sizeof run->id);
    }
    pthread_mutex_unlock(&sqlite->order);
}

void catalog_sqlite_take_out(struct catalog_sqlite *sqlite, const char *id) {
    pthread_mutex_lock(&sqlite->order);
    fair_share_remove(sqlite->fair_share, id);
    for (size_t i = 0; i < sqlite->run_count; i++)
        if (strcmp(sqlite->runs[i].id, id) == 0) sqlite->runs[i--] = sqlite->runs[--sqlite->run_count];
    pthread_mutex_unlock(&sqlite->order);
}

void catalog_sqlite_first_in_order(struct catalog_sqlite *sqlite, char id[JOB_ID_BYTES]) {
    pthread_mutex_lock(&sqlite->order);
    const struct turn *turn = fair_share_first(sqlite->fair_share);
    snprintf(id, JOB_ID_BYTES, "%s", turn ? turn->id : "");
    pthread_mutex_unlock(&sqlite->order);
}

uint64_t catalog_sqlite_ahead_of(struct catalog_sqlite *sqlite, const struct job *job) {
    if (job->state != JOB_ACCEPTED) return 0;
    pthread_mutex_lock(&sqlite->order);
    uint64_t ahead = fair_share_ahead(sqlite->fair_share, job->id, NULL, NULL);
    pthread_mutex_unlock(&sqlite->order);
    return ahead;
}

void catalog_sqlite_move_order(struct catalog_sqlite *sqlite, int64_t step_ms) {
    pthread_mutex_lock(&sqlite->order);
    fair_share_move_times(sqlite->fair_share, step_ms);
    for (size_t i = 0; i < sqlite->run_count; i++) sqlite->runs[i].started_ms += step_ms;
    pthread_mutex_unlock(&sqlite->order);
}

/* ------------------------------------------------------------------------------------------------ loading */

static enum status load_state(struct catalog_sqlite *sqlite, enum job_state state,
                              void (*put)(struct catalog_sqlite *sqlite, const struct job *job),
                              _Atomic uint64_t *count, struct error *error) {
    struct sql_rows *row;
    uint64_t found = 0;
    enum status status =
        sql_select(sqlite->writer, "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE state = ?1 ORDER BY id",
                   VALUES(I(state)), &row, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_sqlite_cells(row);
    struct job job;
    for (; sql_next(row); found++) {
        catalog_cells_read_job(&cells, &job);
        put(sqlite, &job);
        if (state == JOB_RUNNING && job.interruptions >= JOB_ALONE_AFTER) sqlite->alone = true;
        job_done(&job);
    }
    *count = found;
    return sql_finish(row, error);
}

/* What runs is a job in one piece, or a task. */
enum status catalog_sqlite_count(struct catalog_sqlite *sqlite, struct error *error) {
    int64_t waiting = 0, running = 0;
    enum status status = sql_number(sqlite->writer, "SELECT count(*) FROM jobs WHERE state = ?1",
                                    VALUES(I(JOB_ACCEPTED)), &waiting, error);
    if (status == STATUS_OK)
        status = sql_number(sqlite->writer,
                            "SELECT (SELECT count(*) FROM jobs WHERE state = ?1 AND tiles = 0) + "
                            "(SELECT count(*) FROM tasks WHERE state = 1)",
                            VALUES(I(JOB_RUNNING)), &running, error);
    if (status != STATUS_OK) return status;
    sqlite->waiting = (uint64_t)waiting;
    sqlite->running = (uint64_t)running;
    return STATUS_OK;
}

enum status catalog_sqlite_load_order(struct catalog_sqlite *sqlite, struct error *error) {
    pthread_mutex_lock(&sqlite->order);
    fair_share_clear(sqlite->fair_share);
    sqlite->run_count = 0;
    pthread_mutex_unlock(&sqlite->order);
    sqlite->alone = false;
    enum status status = load_state(sqlite, JOB_ACCEPTED, catalog_sqlite_put_in_order, &sqlite->waiting, error);
    if (status == STATUS_OK)
        status = load_state(sqlite, JOB_RUNNING, catalog_sqlite_put_in_run, &sqlite->running, error);
    return status == STATUS_OK ? catalog_sqlite_count(sqlite, error) : status;
}

/* ------------------------------------------------------------------------------------------------ outlook */

struct outlook {
    void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms);
    void *ctx;
};

static void look_at_turn(void *ctx, const struct turn *turn) {
    const struct outlook *outlook = ctx;
    outlook->visit(outlook->ctx, &turn->cost, 0);
}

void catalog_sqlite_outlook(struct catalog *catalog, const char *id,
                            void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct outlook outlook = {visit, ctx};
    pthread_mutex_lock(&sqlite->order);
    for (size_t i = 0; i < sqlite->run_count; i++) visit(ctx, &sqlite->runs[i].cost, sqlite->runs[i].started_ms);
    fair_share_ahead(sqlite->fair_share, id, look_at_turn, &outlook);
    pthread_mutex_unlock(&sqlite->order);
}

void catalog_sqlite_depth(struct catalog *catalog, uint64_t *waiting, uint64_t *running) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    *waiting = atomic_load(&sqlite->waiting);
    *running = atomic_load(&sqlite->running);
}
