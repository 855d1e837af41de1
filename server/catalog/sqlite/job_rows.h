/* Jobs as rows of the database, within the catalog's transactions, under its locks.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_JOB_ROWS_H
#define WHITTLE_SERVER_CATALOG_SQLITE_JOB_ROWS_H

#include "server/catalog/sqlite/catalog_sqlite.h"

/* Reads all rows of a SELECT CATALOG_JOB_COLUMNS, outputs too, and ends it; *count is 0 on failure. */
enum status job_rows_read(struct sql *db, struct sql_rows *row, struct job *jobs, size_t max, size_t *count,
                          struct error *error) MUST_CHECK;

/* The job of this id, outputs too. */
enum status job_rows_find(struct sql *db, const char *id, struct job *job, bool *found, struct error *error) MUST_CHECK;

/* Adds one that waits. */
enum status job_rows_insert(struct sql *db, const struct job *job, struct error *error) MUST_CHECK;

/* Writes a job's end: its next state, its figures, its outputs. */
enum status job_rows_end(struct sql *db, const struct job *job, enum job_state next, struct error *error) MUST_CHECK;

/* Writes that it waits again, and how often it failed and was interrupted. */
enum status job_rows_requeue(struct sql *db, const struct job *job, struct error *error) MUST_CHECK;

#endif
