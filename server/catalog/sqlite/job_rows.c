/* Jobs as rows of the database: the job's own, and one for each of its outputs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/job_rows.h"

#include <stdlib.h>
#include <string.h>

static enum status read_outputs(struct sql *db, struct job *job, struct error *error) {
    struct sql_rows *row;
    enum status status =
        sql_select(db, "SELECT " CATALOG_OUTPUT_COLUMNS " FROM outputs WHERE job = ?1 ORDER BY position",
                   VALUES(T(job->id)), &row, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_sqlite_cells(row);
    while (job->output_count < JOB_MAX_OUTPUTS && sql_next(row)) catalog_cells_read_output(&cells, job);
    return sql_finish(row, error);
}

enum status job_rows_read(struct sql *db, struct sql_rows *row, struct job *jobs, size_t max, size_t *count,
                          struct error *error) {
    struct catalog_cells cells = catalog_sqlite_cells(row);
    *count = 0;
    while (*count < max && sql_next(row)) catalog_cells_read_job(&cells, &jobs[(*count)++]);
    enum status status = sql_finish(row, error);
    for (size_t i = 0; status == STATUS_OK && i < *count; i++) status = read_outputs(db, &jobs[i], error);
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) job_done(&jobs[i]);
    *count = 0;
    return status;
}

enum status job_rows_find(struct sql *db, const char *id, struct job *job, bool *found, struct error *error) {
    struct sql_rows *row;
    size_t count = 0;
    enum status status =
        sql_select(db, "SELECT " CATALOG_JOB_COLUMNS " FROM jobs WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status == STATUS_OK) status = job_rows_read(db, row, job, 1, &count, error);
    *found = count == 1;
    return status;
}

enum status job_rows_insert(struct sql *db, const struct job *job, struct error *error) {
    char *params = job_params_stored(&job->params);
    if (!params) return error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    enum status status =
        sql_run(db,
                "INSERT INTO jobs (id, state, sequence, attempt, created, started, finished, updated, expires, label, "
                "cloud, input_bytes, input_points, input_format, params, principal, priority, result, memory, "
                "tiles, batch) "
                "VALUES (?1, ?2, ?3, 0, ?4, ?14, 0, ?4, 0, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?15, ?16, ?17)",
                VALUES(T(job->id), I(JOB_ACCEPTED), I(job->created_ms), I(job->created_ms), T(job->label),
                       T(job->cloud), I(job->input_bytes), I(job->input_points), T(job->input_format), T(params),
                       T(job->principal), I(job->priority), T(job->result), I(job->started_ms), I(job->memory_bytes),
                       I(job->tiles), T(job->batch)),
                error);
    free(params);
    return status;
}

enum status job_rows_end(struct sql *db, const struct job *job, enum job_state next, struct error *error) {
    enum status status = sql_run(db,
                                 "UPDATE jobs SET state = ?2, owner = '', lease = 0, cancelled = 0, finished = ?3, "
                                 "updated = ?3, sequence = max(sequence + 1, ?3), expires = ?4, "
                                 "fraction = CASE ?2 WHEN 2 THEN 1.0 ELSE fraction END, message = '', "
                                 "cpu = ?5, wall = ?6, rss = ?7, report = ?8, problem = ?9 WHERE id = ?1",
                                 VALUES(T(job->id), I(next), I(job_now_ms()), I(job->expires_ms), R(job->cpu_s),
                                        R(job->wall_s), I(job->peak_rss_bytes), T(job->report), T(job->problem)),
                                 error);
    for (size_t i = 0; status == STATUS_OK && i < job->output_count; i++)
        status = sql_run(
            db, "INSERT INTO outputs (job, position, name, bytes, sha256) VALUES (?1, ?2, ?3, ?4, ?5)",
            VALUES(T(job->id), I(i), T(job->output[i].name), I(job->output[i].bytes), T(job->output[i].sha256)), error);
    return status;
}

enum status job_rows_requeue(struct sql *db, const struct job *job, struct error *error) {
    return sql_run(db,
                   "UPDATE jobs SET state = ?2, owner = '', lease = 0, cancelled = 0, updated = ?3, sequence = "
                   "max(sequence + 1, ?3), stage = '', message = '', "
                   "fraction = 0, failures = ?4, interruptions = ?5, memory = ?6 WHERE id = ?1",
                   VALUES(T(job->id), I(JOB_ACCEPTED), I(job_now_ms()), I(job->failures), I(job->interruptions),
                          I(job->memory_bytes)),
                   error);
}
