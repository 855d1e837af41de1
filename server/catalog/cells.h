/* Rows of a backend's database, read without knowing whose: a backend says how its driver gives a column, and what a
 * record is made of is said once, for all of them.
 *
 * To keep something more of a job: README.md has the list of places.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_CELLS_H
#define WHITTLE_SERVER_CATALOG_CELLS_H

#include <stdbool.h>
#include <stdint.h>

#include "server/catalog/catalog.h"

/* The row that a SELECT is at.  Columns count from 0. */
struct catalog_cells {
    void *row; /* the driver's; what the functions take; borrowed */
    int64_t (*integer)(void *row, int column);
    double (*real)(void *row, int column);
    const char *(*text)(void *row, int column); /* borrowed until the next call; null is "" */
    char *(*new_text)(void *row, int column);   /* returns new; NULL for null, or where there is no memory */
};

/* In the order in which they are read. */
#define CATALOG_JOB_COLUMNS                                                                                            \
    "id, state, sequence, attempt, created, started, finished, updated, expires, label, cloud, input_bytes, "          \
    "input_points, input_format, params, stage, message, fraction, cpu, wall, rss, report, problem, principal, "       \
    "priority, result, memory, failures, interruptions, owner, lease, cancelled, "                                     \
    "tiles, tiles_done, batch"

/* The state that a job is seen in: one whose tasks wait runs since the first was claimed. */
#define CATALOG_JOB_SEEN "CASE WHEN state = 0 AND tiles <> 0 AND started > 0 THEN 1 ELSE state END"
#define CATALOG_OUTPUT_COLUMNS "name, bytes, sha256"
#define CATALOG_TASK_COLUMNS "job, number, attempt, owner, lease, failures, interruptions"
#define CATALOG_UPLOAD_COLUMNS "id, principal, metadata, cloud, created, expires, position, length, boot, concat"

/* What is known of clouds, by themselves and by jobs: the two sources as one, each row narrowed down by a condition
 * over sha256 and principal (jobs have cloud for sha256).  The whole is a SELECT from `seen`, to which WHERE may be
 * added. */
#define CATALOG_SELECT_CLOUDS(clouds_where, jobs_where)                                                                \
    "WITH source AS (SELECT sha256, created, expires, bytes, points, format, 0 AS job FROM clouds WHERE " clouds_where \
    " UNION ALL SELECT cloud, created, 0, input_bytes, input_points, input_format, 1 FROM jobs WHERE " jobs_where      \
    "), seen AS (SELECT sha256, min(created) AS created, max(expires) AS expires, max(bytes) AS bytes, "               \
    "max(points) AS points, max(format) AS format, sum(job) AS jobs FROM source GROUP BY sha256) "                     \
    "SELECT sha256, created, expires, bytes, points, format, jobs, (SELECT report FROM jobs WHERE "                    \
    "cloud = seen.sha256 AND report IS NOT NULL ORDER BY id DESC LIMIT 1) FROM seen "
#define CATALOG_BATCH_COLUMNS "id, principal, label, created, size"
#define CATALOG_BATCH_JOB_COLUMNS "id, " CATALOG_JOB_SEEN ", sequence, fraction, finished, cloud"

/* A row of CATALOG_JOB_COLUMNS, without the job's outputs; *job is the caller's, for job_done. */
void catalog_cells_read_job(const struct catalog_cells *cells, struct job *job);

/* Adds a row of CATALOG_OUTPUT_COLUMNS to the job, which has fewer than JOB_MAX_OUTPUTS. */
void catalog_cells_read_output(const struct catalog_cells *cells, struct job *job);

/* A row of CATALOG_TASK_COLUMNS, in the members that a task has of its own. */
void catalog_cells_read_task(const struct catalog_cells *cells, struct job *task);

/* A row of CATALOG_UPLOAD_COLUMNS. */
void catalog_cells_read_upload(const struct catalog_cells *cells, struct catalog_upload *upload);

/* A row of CATALOG_SELECT_CLOUDS; *cloud is the caller's, for catalog_cloud_done. */
void catalog_cells_read_cloud(const struct catalog_cells *cells, struct catalog_cloud *cloud);

/* A row of CATALOG_BATCH_COLUMNS, with room for its jobs; false: there is no memory for that.  Either way *batch is the
 * caller's, for catalog_batch_done. */
bool catalog_cells_read_batch(const struct catalog_cells *cells, struct catalog_batch *batch);

/* Adds a row of CATALOG_BATCH_JOB_COLUMNS to the batch; false: it has all that it was made of. */
bool catalog_cells_read_batch_job(const struct catalog_cells *cells, struct catalog_batch *batch);

/* A row of catalog_rows_list_columns; *row is the caller's, for catalog_row_done. */
void catalog_cells_read_row(const struct catalog_cells *cells, enum catalog_table_name table, struct catalog_row *row);

#endif
