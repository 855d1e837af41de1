/* Jobs: submitted, claimed, ended, read and deleted.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/catalog/estimate.h"
#include "server/catalog/postgres/catalog_postgres.h"

/* Locks that last as long as their transaction: one submit, and one claim, at a time. */
#define LOCK_SUBMIT "SELECT pg_advisory_xact_lock(7741161)"
#define LOCK_CLAIM "SELECT pg_advisory_xact_lock(7741162)"

/* ------------------------------------------------------------------------------------------------ rows */

static enum status read_outputs(struct pq_link *link, struct job *job, struct error *error) {
    struct pq_rows *rows;
    enum status status =
        pq_select(link, "SELECT " CATALOG_OUTPUT_COLUMNS " FROM outputs WHERE job = $1 ORDER BY position",
                  VALUES(T(job->id)), &rows, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_postgres_cells(rows);
    while (job->output_count < JOB_MAX_OUTPUTS && pq_next(rows)) catalog_cells_read_output(&cells, job);
    pq_free(rows);
    return STATUS_OK;
}

enum status catalog_postgres_select_jobs(struct pq_link *link, const char *text, const struct pq_value *values,
                                         size_t value_count, struct job *jobs, size_t max, size_t *count,
                                         struct error *error) {
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_select(link, text, values, value_count, &rows, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_postgres_cells(rows);
    while (*count < max && pq_next(rows)) catalog_cells_read_job(&cells, &jobs[(*count)++]);
    pq_free(rows);
    for (size_t i = 0; status == STATUS_OK && i < *count; i++)
        if (job_ended(jobs[i].state)) status = read_outputs(link, &jobs[i], error);
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) job_done(&jobs[i]);
    *count = 0;
    return status;
}

/* ------------------------------------------------------------------------------------------------ order */

/* fair_share.h as a query: each principal's jobs in the order of their times are its first, second, ... round; rounds
 * come one after the other, and within one whoever was served longest ago.  Of those who were never served the one with
 * the older first job is first, in that round and so in all that follow. */
#define TURNS                                                                                                          \
    "SELECT id, row_number() OVER (ORDER BY round, served, first) - 1 AS ahead FROM (SELECT jobs.id, "                 \
    "coalesce(usage.served, 0) AS served, row_number() OVER own AS round, first_value(jobs.id) OVER own AS first "     \
    "FROM jobs LEFT JOIN usage ON usage.principal = jobs.principal WHERE jobs.state = 0 "                              \
    "WINDOW own AS (PARTITION BY jobs.principal ORDER BY jobs.due, jobs.id)) AS rounds"

/* The first job of a principal. */
#define FIRST_OF(who) "(SELECT id FROM jobs WHERE state = 0 AND principal = " who " ORDER BY due, id LIMIT 1)"

/* How many of these come before one job, whose round is `behind` + 1: of each principal as many as have an earlier
 * round, and one of the same round where its turn is first.  Counts no jobs but the principal's own, for usage has the
 * others'. */
#define AHEAD                                                                                                          \
    "WITH own AS MATERIALIZED (SELECT id, principal, (SELECT count(*) FROM jobs AS o WHERE o.state = 0 AND "           \
    "o.principal = j.principal AND (o.due, o.id) < (j.due, j.id)) AS behind, coalesce((SELECT served FROM usage "      \
    "WHERE usage.principal = j.principal), 0) AS served, " FIRST_OF(                                                   \
        "j.principal") " AS first FROM jobs AS j "                                                                     \
                       "WHERE id = $1 AND state = 0) SELECT (own.behind + coalesce(sum(least(u.waiting, own.behind) "  \
                       "+ "                                                                                            \
                       "(u.waiting > own.behind AND (u.served < own.served OR (u.served = own.served AND " FIRST_OF(   \
                           "u.principal") " < own.first)))::INT), 0))::BIGINT, own.behind FROM own LEFT JOIN usage "   \
                                          "AS u ON u.waiting > 0 "                                                     \
                                          "AND u.principal <> own.principal GROUP BY own.id, own.behind"

/* *behind: how many of them are its principal's own. */
static enum status read_ahead(struct pq_link *link, const char *id, int64_t *ahead, int64_t *behind,
                              struct error *error) {
    struct pq_rows *rows;
    *ahead = *behind = 0;
    enum status status = pq_select(link, AHEAD, VALUES(T(id)), &rows, error);
    if (status != STATUS_OK) return status;
    if (pq_next(rows)) {
        *ahead = pq_integer(rows, 0);
        *behind = pq_integer(rows, 1);
    }
    pq_free(rows);
    return STATUS_OK;
}

static enum status fill_ahead(struct pq_link *link, struct job *job, struct error *error) {
    int64_t ahead = 0, behind;
    if (job->state != JOB_ACCEPTED) return STATUS_OK;
    enum status status = read_ahead(link, job->id, &ahead, &behind, error);
    job->ahead = (uint64_t)ahead;
    return status;
}

/* The same for a page of jobs, newest first: the order is made once. */
static enum status fill_all_ahead(struct pq_link *link, struct job *jobs, size_t count, struct error *error) {
    struct pq_rows *rows;
    bool any = false;
    for (size_t i = 0; i < count; i++) any = any || jobs[i].state == JOB_ACCEPTED;
    if (!any) return STATUS_OK;
    enum status status =
        pq_select(link, "SELECT id, ahead FROM (" TURNS ") AS turns WHERE id BETWEEN $1 AND $2 ORDER BY id DESC",
                  VALUES(T(jobs[count - 1].id), T(jobs[0].id)), &rows, error);
    if (status != STATUS_OK) return status;
    for (size_t i = 0; pq_next(rows);) {
        while (i < count && strcmp(jobs[i].id, pq_text(rows, 0)) > 0) i++;
        if (i < count && strcmp(jobs[i].id, pq_text(rows, 0)) == 0) jobs[i].ahead = (uint64_t)pq_integer(rows, 1);
    }
    pq_free(rows);
    return STATUS_OK;
}

/* The first of all, by one look into the index for each principal that has a job. */
#define FIRST                                                                                                          \
    "SELECT first.id FROM usage CROSS JOIN LATERAL (SELECT id FROM jobs WHERE state = 0 AND "                          \
    "principal = usage.principal ORDER BY due, id LIMIT 1) AS first WHERE usage.waiting > 0 "                          \
    "ORDER BY usage.served, first.id LIMIT 1"

struct outlook {
    void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms);
    void *ctx;
};

static void visit_jobs(const struct outlook *outlook, struct pq_rows *rows) {
    while (pq_next(rows)) {
        struct job job = {.input_points = (uint64_t)pq_integer(rows, 1), .input_bytes = (uint64_t)pq_integer(rows, 2)};
        job.is_strange = !job_params_read(pq_text(rows, 0), &job.params);
        pq_copy_text(rows, 3, job.input_format, sizeof job.input_format);
        struct job_cost cost = estimate_cost(&job);
        outlook->visit(outlook->ctx, &cost, pq_integer(rows, 4));
    }
    pq_free(rows);
}

void catalog_postgres_outlook(struct catalog *catalog, const char *id,
                              void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx) {
    enum { LOOK_AHEAD = 256 };
    struct outlook outlook = {visit, ctx};
    int64_t ahead, behind;
    struct pq_link *link;
    struct pq_rows *rows;
    struct error ignored;
    if (pq_take_soon(catalog_postgres_of(catalog)->pq, &link, &ignored) != STATUS_OK) return;
    if (pq_select(link,
                  "SELECT params, input_points, input_bytes, input_format, started FROM jobs WHERE state = 1 LIMIT 256",
                  NULL, 0, &rows, &ignored) == STATUS_OK)
        visit_jobs(&outlook, rows);
    enum status status = read_ahead(link, id, &ahead, &behind, &ignored);
    if (status == STATUS_OK && ahead > LOOK_AHEAD)
        visit(ctx, &(struct job_cost){0}, 0); /* of no kind that is known, so nothing is claimed */
    else if (status == STATUS_OK && ahead &&
             pq_select(link,
                       "SELECT params, input_points, input_bytes, input_format, 0 FROM usage CROSS JOIN LATERAL "
                       "(SELECT id, params, input_points, input_bytes, input_format, row_number() OVER (ORDER BY due, "
                       "id) AS round, first_value(id) OVER (ORDER BY due, id) AS first FROM jobs WHERE state = 0 "
                       "AND principal = usage.principal ORDER BY due, id LIMIT $1) AS turn WHERE usage.waiting > 0 "
                       "ORDER BY round, usage.served, turn.first LIMIT $2",
                       VALUES(I(behind + 1), I(ahead)), &rows, &ignored) == STATUS_OK)
        visit_jobs(&outlook, rows);
    pq_done(link);
}

void catalog_postgres_depth(struct catalog *catalog, uint64_t *waiting, uint64_t *running) {
    struct pq_link *link;
    struct pq_rows *rows;
    struct error ignored;
    *waiting = *running = 0;
    if (pq_take_soon(catalog_postgres_of(catalog)->pq, &link, &ignored) != STATUS_OK) return;
    if (pq_select(
            link,
            "SELECT coalesce((SELECT sum(waiting) FROM usage WHERE waiting > 0), 0)::BIGINT, "
            "(SELECT count(*) FROM jobs WHERE state = 1 AND tiles = 0) + (SELECT count(*) FROM tasks WHERE state = 1)",
            NULL, 0, &rows, &ignored) == STATUS_OK) {
        if (pq_next(rows)) {
            *waiting = (uint64_t)pq_integer(rows, 0);
            *running = (uint64_t)pq_integer(rows, 1);
        }
        pq_free(rows);
    }
    pq_done(link);
}

/* ------------------------------------------------------------------------------------------------ submit */

/* The job, the key that it was submitted under, and who is told of its end; in a transaction. */
enum status catalog_postgres_insert(struct catalog_postgres *postgres, struct pq_link *link, const struct job *job,
                                    struct error *error) {
    char *params = job_params_stored(&job->params);
    if (!params) return error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    enum status status = pq_run(
        link,
        "INSERT INTO jobs (id, state, sequence, attempt, created, started, finished, updated, expires, label, cloud, "
        "input_bytes, input_points, input_format, params, principal, priority, result, memory, due, writer, tiles, "
        "batch) "
        "VALUES ($1, $2, $3, 0, $3, $4, 0, whittle_now(), 0, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, "
        "$17, $18)",
        VALUES(T(job->id), I(JOB_ACCEPTED), I(job->created_ms), I(job->started_ms), T(job->label), T(job->cloud),
               I(job->input_bytes), I(job->input_points), T(job->input_format), T(params), T(job->principal),
               I(job->priority), T(job->result), I(job->memory_bytes),
               I(job->created_ms - (int64_t)job->priority * JOB_PRIORITY_AGING_MS), T(postgres->session), I(job->tiles),
               T(job->batch)),
        NULL, error);
    free(params);
    if (status == STATUS_OK && job->key)
        status = catalog_postgres_add_key(link, job->principal, job->key, job->id, job->created_ms, error);
    if (status == STATUS_OK && job->webhook) status = catalog_postgres_add_webhook(link, job->id, job->webhook, error);
    return status;
}

enum status catalog_postgres_check_counts(struct pq_link *link, const char *principal, uint64_t more,
                                          const struct catalog_limits *limits, struct error *error) {
    int64_t waiting = 0, active = 0;
    struct pq_rows *rows;
    uint64_t most = limits->waiting < INT64_MAX ? limits->waiting : INT64_MAX;
    enum status status = pq_select(link,
                                   "SELECT coalesce((SELECT sum(waiting) FROM usage WHERE waiting > 0), 0)::BIGINT, "
                                   "coalesce((SELECT active FROM usage WHERE principal = $1), 0)",
                                   VALUES(T(principal)), &rows, error);
    if (status != STATUS_OK) return status;
    if (pq_next(rows)) {
        waiting = pq_integer(rows, 0);
        active = pq_integer(rows, 1);
    }
    pq_free(rows);
    if ((uint64_t)waiting + more > most)
        return error_set(error, STATUS_LIMIT, "queue", "%lld jobs are waiting", (long long)waiting);
    if (limits->principal_jobs && (uint64_t)active + more > limits->principal_jobs)
        return error_set(error, STATUS_LIMIT, "principal_jobs", "you have %lld jobs waiting or running",
                         (long long)active);
    return STATUS_OK;
}

enum status catalog_postgres_look_up_submit(struct catalog_postgres *postgres, const char *id, struct error *error) {
    struct pq_link *link;
    struct error other;
    int64_t known = 0;
    if (pq_take(postgres->pq, &link, &other) != STATUS_OK) return STATUS_IO;
    enum status status = pq_number(link, "SELECT count(*) FROM jobs WHERE id = $1", VALUES(T(id)), &known, &other);
    pq_done(link);
    if (status == STATUS_OK && known) return STATUS_OK;
    return error->code ? error->code : STATUS_IO;
}

enum status catalog_postgres_lock_submit(struct pq_link *link, struct error *error) {
    return pq_run(link, LOCK_SUBMIT, NULL, 0, NULL, error);
}

enum status catalog_postgres_submit(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                                    struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    bool unknown = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_lock_submit(link, error);
    if (status == STATUS_OK) status = catalog_postgres_check_counts(link, job->principal, 1, limits, error);
    if (status == STATUS_OK)
        status = catalog_postgres_check_bytes(link, job->principal, job->input_bytes, limits->principal_bytes, error);
    if (status == STATUS_OK) status = catalog_postgres_insert(postgres, link, job, error);
    if (status == STATUS_OK) status = catalog_postgres_notify(postgres, link, CATALOG_WAITS, job->id, error);
    status = pq_end(link, status, &unknown, error);
    if (unknown) status = catalog_postgres_look_up_submit(postgres, job->id, error);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_WAITS, job->id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ claim */

/* The job whose turn it is, if it fits: it and its principal's turn in one statement.  One that was interrupted often
 * runs while its host runs nothing else. */
static enum status claim(struct catalog_postgres *postgres, struct pq_link *link, const struct catalog_claim *by,
                         struct job *job, size_t *count, struct error *error) {
    enum status status = pq_run(link, LOCK_CLAIM, NULL, 0, NULL, error);
    if (status == STATUS_OK)
        status = catalog_postgres_select_jobs(
            link,
            "UPDATE jobs SET state = $1, attempt = attempt + 1, claims = claims + 1, updated = whittle_now(), "
            "started = CASE WHEN tiles <> 0 AND started > 0 THEN started ELSE whittle_now() END, "
            "sequence = greatest(sequence + 1, whittle_now()), stage = CASE tiles WHEN 0 THEN '' ELSE stage END, "
            "message = CASE tiles WHEN 0 THEN '' ELSE message END, "
            "fraction = CASE tiles WHEN 0 THEN 0 ELSE fraction END, owner = CASE tiles WHEN 0 THEN $2 ELSE '' END, "
            "lease = CASE tiles WHEN 0 THEN whittle_now() + $3 ELSE $7 END, writer = $6 WHERE id = (" FIRST
            ") AND state = 0 AND memory <= $4 "
            "AND (interruptions < $5 OR NOT EXISTS (SELECT 1 FROM jobs WHERE state = 1 AND owner = $2 "
            "UNION ALL SELECT 1 FROM tasks WHERE state = 1 AND owner = $2)) "
            "AND NOT EXISTS (SELECT 1 FROM jobs WHERE state = 1 AND owner = $2 AND interruptions >= $5) "
            "RETURNING " CATALOG_JOB_COLUMNS,
            VALUES(I(JOB_RUNNING), T(by->owner), I(by->lease_ms), I(by->memory_bytes), I(JOB_ALONE_AFTER),
                   T(postgres->session), I(JOB_LEASE_NEVER)),
            job, 1, count, error);
    if (status == STATUS_OK && *count && job->is_strange) return STATUS_OK; /* and isn't claimed */
    if (status == STATUS_OK && *count && job->tiles) {
        status = catalog_postgres_take_task(link, by, job, count, error);
        if (status != STATUS_OK || !*count) job_done(job);
    }
    if (status == STATUS_OK && *count)
        status = pq_run(link, "UPDATE usage SET served = nextval('turns') WHERE principal = $1",
                        VALUES(T(job->principal)), NULL, error);
    return status;
}

/* A commit without an answer isn't looked up: a job that is claimed and that nobody runs is lost with its lease. */
static enum status claim_one(struct catalog_postgres *postgres, const struct catalog_claim *by, struct job *job,
                             size_t *count, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = claim(postgres, link, by, job, count, error);
    if (status != STATUS_OK || !*count || !job->is_strange) return pq_end(link, status, NULL, error);
    pq_undo(link);
    return STATUS_OK;
}

/* A job that another host has to run goes behind all that wait of its principal, who comes after the others. */
static enum status pass_over(struct catalog_postgres *postgres, const char *id, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, "SELECT whittle_pass_over($1)", VALUES(T(id)), NULL, error), NULL, error);
}

/* Those that this program doesn't know are passed over until the first of them is first again. */
enum status catalog_postgres_claim(struct catalog *catalog, const struct catalog_claim *by, struct job *job,
                                   bool *found, struct error *error) {
    enum { MOST_STRANGE = 16 };
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    char first[JOB_ID_BYTES] = "";
    *found = false;
    for (int i = 0; i < MOST_STRANGE; i++) {
        size_t count = 0;
        enum status status = claim_one(postgres, by, job, &count, error);
        *found = status == STATUS_OK && count == 1 && !job->is_strange;
        if (*found) catalog_tell(catalog, CATALOG_CHANGED, job->id);
        if (*found || !count) return status;
        char id[JOB_ID_BYTES];
        memcpy(id, job->id, sizeof id);
        job_done(job);
        if (status == STATUS_OK && strcmp(id, first) != 0) status = pass_over(postgres, id, error);
        if (status != STATUS_OK || strcmp(id, first) == 0) return status;
        if (!first[0]) memcpy(first, id, sizeof first);
    }
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ leases */

enum status catalog_postgres_progress(struct catalog *catalog, const struct job *job, bool *held, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    int64_t changed = 0;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "SET LOCAL synchronous_commit = off", NULL, 0, NULL, error);
    if (status == STATUS_OK)
        status = pq_run(link,
                        job->tiles
                            ? "UPDATE jobs SET stage = $2, message = $3, fraction = greatest(fraction, $4), "
                              "updated = whittle_now(), sequence = greatest(sequence + 1, whittle_now()), writer = $8 "
                              "WHERE id = $1 AND EXISTS (SELECT 1 FROM tasks WHERE job = $1 AND state = $5 "
                              "AND attempt = $6 AND owner = $7 AND number = $9)"
                            : "UPDATE jobs SET stage = $2, message = $3, fraction = $4, updated = whittle_now(), "
                              "sequence = greatest(sequence + 1, whittle_now()), writer = $8 "
                              "WHERE id = $1 AND state = $5 AND attempt = $6 AND owner = $7 AND $9 <= 0",
                        VALUES(T(job->id), T(job->stage), T(job->message), R(job->fraction), I(JOB_RUNNING),
                               I(job->attempt), T(job->owner), T(postgres->session), I(job->task)),
                        &changed, error);
    status = pq_end(link, status, NULL, error);
    if (status == STATUS_OK) *held = changed > 0;
    if (status == STATUS_OK && changed) catalog_tell(catalog, CATALOG_CHANGED, job->id);
    return status;
}

enum status catalog_postgres_renew(struct catalog *catalog, const char *owner, int64_t lease_ms,
                                   struct catalog_lease *leases, size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "SET LOCAL synchronous_commit = off", NULL, 0, NULL, error);
    if (status == STATUS_OK)
        status = pq_select(link,
                           "WITH own AS (UPDATE jobs SET lease = whittle_now() + $3 WHERE state = $1 AND owner = $2 "
                           "RETURNING id, attempt, cancelled), parts AS (UPDATE tasks SET lease = whittle_now() + $3 "
                           "WHERE state = $1 AND owner = $2 RETURNING job, attempt) "
                           "SELECT * FROM own UNION ALL SELECT job, attempt, 0 FROM parts",
                           VALUES(I(JOB_RUNNING), T(owner), I(lease_ms)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) {
            struct catalog_lease *lease = &leases[(*count)++];
            pq_copy_text(rows, 0, lease->job, sizeof lease->job);
            lease->attempt = (int)pq_integer(rows, 1);
            lease->is_cancelled = pq_integer(rows, 2) != 0;
        }
        pq_free(rows);
    }
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_list_lost(struct catalog *catalog, const char *owner, struct job *jobs, size_t max,
                                       size_t *count, struct error *error) {
    struct pq_link *link;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_select_jobs(link,
                                          "SELECT " CATALOG_JOB_COLUMNS
                                          " FROM jobs WHERE state = $1 AND (lease <= whittle_now() OR owner = $2) "
                                          "ORDER BY id LIMIT $3",
                                          VALUES(I(JOB_RUNNING), T(owner), I(max)), jobs, max, count, error);
    if (status == STATUS_OK) status = catalog_postgres_list_lost_tasks(link, owner, jobs, max, count, error);
    pq_done(link);
    return status;
}

enum status catalog_postgres_cancel(struct catalog *catalog, const char *id, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link,
                    "UPDATE jobs SET cancelled = 1, updated = whittle_now(), writer = $3 "
                    "WHERE id = $1 AND state = $2 AND cancelled = 0",
                    VALUES(T(id), I(JOB_RUNNING), T(postgres->session)), NULL, error);
    if (status == STATUS_OK) status = catalog_postgres_notify(postgres, link, CATALOG_CANCELLED, id, error);
    status = pq_end(link, status, NULL, error);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_CANCELLED, id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ finish */

enum status catalog_postgres_write_end(struct catalog_postgres *postgres, struct pq_link *link, const struct job *job,
                                       enum job_state next, struct error *error) {
    enum status status =
        pq_run(link,
               "UPDATE jobs SET state = $2, owner = '', lease = 0, cancelled = 0, finished = whittle_now(), "
               "updated = whittle_now(), sequence = greatest(sequence + 1, whittle_now()), expires = $3, "
               "fraction = CASE $2 WHEN 2 THEN 1.0 ELSE fraction END, message = '', cpu = $4, wall = $5, rss = $6, "
               "report = $7, problem = $8, writer = $9 WHERE id = $1",
               VALUES(T(job->id), I(next), I(job->expires_ms), R(job->cpu_s), R(job->wall_s), I(job->peak_rss_bytes),
                      T(job->report), T(job->problem), T(postgres->session)),
               NULL, error);
    for (size_t i = 0; status == STATUS_OK && i < job->output_count; i++)
        status =
            pq_run(link, "INSERT INTO outputs (job, position, name, bytes, sha256) VALUES ($1, $2, $3, $4, $5)",
                   VALUES(T(job->id), I(i), T(job->output[i].name), I(job->output[i].bytes), T(job->output[i].sha256)),
                   NULL, error);
    if (status == STATUS_OK)
        status = pq_run(link, "UPDATE outbox SET due = whittle_now() WHERE job = $1", VALUES(T(job->id)), NULL, error);
    return status;
}

enum status catalog_postgres_write_requeue(struct catalog_postgres *postgres, struct pq_link *link,
                                           const struct job *job, struct error *error) {
    return pq_run(link,
                  "UPDATE jobs SET state = $2, owner = '', lease = 0, cancelled = 0, updated = whittle_now(), "
                  "sequence = greatest(sequence + 1, whittle_now()), stage = '', message = '', fraction = 0, "
                  "failures = $3, interruptions = $4, memory = $5, writer = $6 WHERE id = $1",
                  VALUES(T(job->id), I(JOB_ACCEPTED), I(job->failures), I(job->interruptions), I(job->memory_bytes),
                         T(postgres->session)),
                  NULL, error);
}

/* What the end of a job starts from; state -1: there is no such job. */
struct held_row {
    int64_t state, attempt, is_cancelled;
    char owner[JOB_OWNER_BYTES];
};

static enum status read_held(struct pq_link *link, const char *text, const char *id, struct held_row *held,
                             struct error *error) {
    struct pq_rows *rows;
    *held = (struct held_row){.state = -1};
    enum status status = pq_select(link, text, VALUES(T(id)), &rows, error);
    if (status != STATUS_OK) return status;
    if (pq_next(rows)) {
        held->state = pq_integer(rows, 0);
        held->attempt = pq_integer(rows, 1);
        held->is_cancelled = pq_integer(rows, 2);
        pq_copy_text(rows, 3, held->owner, sizeof held->owner);
    }
    pq_free(rows);
    return STATUS_OK;
}

/* Whether the job as the caller knows it may have ended: what runs is fenced by owner and attempt. */
static bool may_finish(const struct held_row *held, const struct job *job) {
    if (held->state != JOB_RUNNING) return held->state >= 0;
    return held->attempt == job->attempt && strcmp(held->owner, job->owner) == 0;
}

/* In a transaction; *from and *next differ where it was done. */
static enum status finish(struct catalog_postgres *postgres, struct pq_link *link, enum job_event event,
                          const struct job *job, enum job_state *from, enum job_state *next, struct error *error) {
    struct held_row held;
    enum status status = read_held(link, "SELECT state, attempt, cancelled, owner FROM jobs WHERE id = $1 FOR UPDATE",
                                   job->id, &held, error);
    *from = *next = (enum job_state)(held.state < 0 ? JOB_DISMISSED : held.state);
    if (event == JOB_REQUEUE && held.is_cancelled) event = JOB_DISMISS;
    if (status != STATUS_OK || !may_finish(&held, job) || !job_transition(*from, event, next)) return status;
    status = event == JOB_REQUEUE ? catalog_postgres_write_requeue(postgres, link, job, error)
                                  : catalog_postgres_write_end(postgres, link, job, *next, error);
    enum catalog_change change = *next == JOB_ACCEPTED ? CATALOG_WAITS : CATALOG_CHANGED;
    return status == STATUS_OK ? catalog_postgres_notify(postgres, link, change, job->id, error) : status;
}

/* A commit without an answer: it was done where the row says what it would say.  Else whoever asked asks again. */
static bool was_finished(struct catalog_postgres *postgres, const struct job *job, enum job_state next) {
    struct held_row held;
    struct pq_link *link;
    struct error ignored;
    if (pq_take(postgres->pq, &link, &ignored) != STATUS_OK) return false;
    enum status status =
        read_held(link, "SELECT state, attempt, cancelled, owner FROM jobs WHERE id = $1", job->id, &held, &ignored);
    pq_done(link);
    return status == STATUS_OK && held.state == (int64_t)next && held.attempt == job->attempt;
}

enum status catalog_postgres_finish(struct catalog *catalog, enum job_event event, const struct job *job, bool *changed,
                                    struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    enum job_state from = JOB_ACCEPTED, next = JOB_ACCEPTED;
    struct pq_link *link;
    bool unknown = false;
    *changed = false;
    if (job->tiles) return catalog_postgres_finish_tiles(postgres, event, job, changed, error);
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = finish(postgres, link, event, job, &from, &next, error);
    status = pq_end(link, status, &unknown, error);
    if (unknown && from != next && was_finished(postgres, job, next)) status = STATUS_OK;
    *changed = status == STATUS_OK && from != next;
    if (*changed) catalog_tell(catalog, next == JOB_ACCEPTED ? CATALOG_WAITS : CATALOG_CHANGED, job->id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ reuse */

enum status catalog_postgres_submit_ended(struct catalog *catalog, const struct job *job,
                                          const struct catalog_limits *limits, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    enum job_state next;
    bool unknown = false;
    uint64_t bytes = job->input_bytes;
    for (size_t i = 0; i < job->output_count; i++) bytes += job->output[i].bytes;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_check_bytes(link, job->principal, bytes, limits->principal_bytes, error);
    if (status == STATUS_OK) status = catalog_postgres_insert(postgres, link, job, error);
    if (status == STATUS_OK && job_transition(JOB_ACCEPTED, JOB_REUSE, &next))
        status = catalog_postgres_write_end(postgres, link, job, next, error);
    if (status == STATUS_OK) status = catalog_postgres_notify(postgres, link, CATALOG_CHANGED, job->id, error);
    status = pq_end(link, status, &unknown, error);
    if (unknown) status = catalog_postgres_look_up_submit(postgres, job->id, error);
    if (status == STATUS_OK) catalog_tell(catalog, CATALOG_CHANGED, job->id);
    return status;
}

enum status catalog_postgres_find_result(struct catalog *catalog, const char *result, const char *principal,
                                         struct job *job, bool *found, struct error *error) {
    struct pq_link *link;
    size_t count = 0;
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_select_jobs(link,
                                          "SELECT " CATALOG_JOB_COLUMNS
                                          " FROM jobs WHERE result = $1 AND result <> '' AND principal = $2 "
                                          "AND state = $3 ORDER BY id DESC LIMIT 1",
                                          VALUES(T(result), T(principal), I(JOB_SUCCESSFUL)), job, 1, &count, error);
    pq_done(link);
    *found = status == STATUS_OK && count == 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

static enum status find_tombstone(struct pq_link *link, const char *id, struct catalog_tombstone *tombstone,
                                  bool *found, struct error *error) {
    struct pq_rows *rows;
    enum status status =
        pq_select(link, "SELECT reason, at, principal FROM tombstones WHERE id = $1", VALUES(T(id)), &rows, error);
    if (status != STATUS_OK) return status;
    *found = pq_next(rows);
    if (*found) {
        pq_copy_text(rows, 0, tombstone->reason, sizeof tombstone->reason);
        tombstone->at_ms = pq_integer(rows, 1);
        pq_copy_text(rows, 2, tombstone->principal, sizeof tombstone->principal);
    }
    pq_free(rows);
    return STATUS_OK;
}

enum status catalog_postgres_get(struct catalog *catalog, const char *id, struct job *job,
                                 enum catalog_presence *presence, struct catalog_tombstone *tombstone,
                                 struct error *error) {
    struct pq_link *link;
    size_t count = 0;
    bool gone = false;
    memset(job, 0, sizeof *job);
    *presence = CATALOG_ABSENT;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_select_jobs(link, "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE id = $1", VALUES(T(id)),
                                          job, 1, &count, error);
    if (status == STATUS_OK && count) status = fill_ahead(link, job, error);
    if (status == STATUS_OK && !count) status = find_tombstone(link, id, tombstone, &gone, error);
    if (status == STATUS_OK && !count && !gone) status = catalog_postgres_confirm(link, error);
    pq_done(link);
    if (status != STATUS_OK && count) job_done(job);
    if (status == STATUS_OK) *presence = count ? CATALOG_PRESENT : gone ? CATALOG_GONE : CATALOG_ABSENT;
    return status;
}

enum status catalog_postgres_list(struct catalog *catalog, const struct catalog_filter *filter, struct job *jobs,
                                  size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_select_jobs(
        link,
        "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE ($1 < 0 OR " CATALOG_JOB_SEEN
        " = $1) AND ($2 IS NULL OR label = $2) "
        "AND ($3 IS NULL OR id < $3) AND ($4 IS NULL OR principal = $4) AND ($6 IS NULL OR batch = $6) "
        "ORDER BY id DESC LIMIT $5",
        VALUES(I(filter->by_state ? (int)filter->state : -1), T(filter->label), T(filter->after), T(filter->principal),
               I(max), T(filter->batch)),
        jobs, max, count, error);
    if (status == STATUS_OK) status = fill_all_ahead(link, jobs, *count, error);
    pq_done(link);
    for (size_t i = 0; status != STATUS_OK && i < *count; i++) job_done(&jobs[i]);
    if (status != STATUS_OK) *count = 0;
    return status;
}

/* ------------------------------------------------------------------------------------------------ delete, expire */

static enum status delete_rows(struct catalog_postgres *postgres, struct pq_link *link, const char *id,
                               const char *reason, int64_t *deleted, struct error *error) {
    enum status status = pq_run(link,
                                "WITH old AS (SELECT principal FROM jobs WHERE id = $1 AND state > 1 FOR UPDATE) "
                                "INSERT INTO tombstones (id, reason, at, principal) "
                                "SELECT $1, $2, whittle_now(), principal FROM old ON CONFLICT (id) DO UPDATE SET "
                                "reason = excluded.reason, at = excluded.at, principal = excluded.principal",
                                VALUES(T(id), T(reason)), deleted, error);
    if (status != STATUS_OK || !*deleted) return status;
    /* Its batch before what its principal has (usage): in the order in which the end of another of its jobs takes them.
     */
    status = pq_run(link, "SELECT 1 FROM batches WHERE id = (SELECT batch FROM jobs WHERE id = $1) FOR UPDATE",
                    VALUES(T(id)), NULL, error);
    if (status == STATUS_OK) status = pq_run(link, "DELETE FROM outputs WHERE job = $1", VALUES(T(id)), NULL, error);
    if (status == STATUS_OK) status = pq_run(link, "DELETE FROM jobs WHERE id = $1", VALUES(T(id)), deleted, error);
    if (status == STATUS_OK) status = pq_run(link, "DELETE FROM outbox WHERE job = $1", VALUES(T(id)), NULL, error);
    if (status == STATUS_OK) /* what an attempt that was lost puts until then */
        status = pq_run(link, MARK("'jobs/' || $1", "whittle_now() + " GRACE_MS), VALUES(T(id)), NULL, error);
    return status == STATUS_OK ? catalog_postgres_notify(postgres, link, CATALOG_DELETED, id, error) : status;
}

enum status catalog_postgres_delete(struct catalog *catalog, const char *id, const char *reason, bool *changed,
                                    struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    int64_t deleted = 0;
    *changed = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = delete_rows(postgres, link, id, reason, &deleted, error);
    status = pq_end(link, status, NULL, error);
    *changed = status == STATUS_OK && deleted;
    if (*changed) catalog_tell(catalog, CATALOG_DELETED, id);
    return status;
}

enum status catalog_postgres_expired(struct catalog *catalog, int64_t now_ms, int64_t tombstones_before_ms,
                                     char (*ids)[JOB_ID_BYTES], size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "DELETE FROM tombstones WHERE at < $1", VALUES(I(tombstones_before_ms)), NULL, error);
    if (status == STATUS_OK)
        status = pq_select(link, "SELECT id FROM jobs WHERE expires > 0 AND expires <= $1 ORDER BY expires LIMIT $2",
                           VALUES(I(now_ms), I(max)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) pq_copy_text(rows, 0, ids[(*count)++], JOB_ID_BYTES);
        pq_free(rows);
    }
    return pq_end(link, status, NULL, error);
}

/* Nobody sets the database's clock with those of the hosts. */
enum status catalog_postgres_move_times(struct catalog *catalog, int64_t step_ms, struct error *error) {
    (void)catalog;
    (void)step_ms;
    (void)error;
    return STATUS_OK;
}
