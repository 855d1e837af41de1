/* Rows of a catalog as they are, for moving them to another one (daemon/transfer.c): tables and columns that every
 * backend has under the same names.
 *
 * What a host or a process holds isn't moved: leases, keys of requests under way, reservations; resumable uploads
 * aren't either.  A job that was running has no lease then, so it is queued again; one of tiles begins anew.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_ROWS_H
#define WHITTLE_SERVER_CATALOG_ROWS_H

#include <stddef.h>
#include <stdint.h>

enum catalog_table_name {
    CATALOG_TABLE_CLOUDS,
    CATALOG_TABLE_BATCHES,
    CATALOG_TABLE_JOBS,
    CATALOG_TABLE_OUTPUTS,
    CATALOG_TABLE_WEBHOOKS,
    CATALOG_TABLE_REPLIES,
    CATALOG_TABLE_TOMBSTONES,
    CATALOG_TABLE_COUNT
};

/* Columns of jobs that others look at, by their places. */
enum { CATALOG_JOB_ID, CATALOG_JOB_STATE, CATALOG_JOB_ATTEMPT, CATALOG_JOB_CLOUD };

enum { CATALOG_MAX_COLUMNS = 36, CATALOG_COLUMNS_BYTES = 600, CATALOG_STATEMENT_BYTES = 1600 };

struct catalog_table {
    const char *name, *order; /* order: its key, the first of which tells whose a row is */
    struct {
        const char *name; /* NULL = there are no more */
        enum catalog_cell_type { CATALOG_INTEGER, CATALOG_REAL, CATALOG_TEXT } type;
    } column[CATALOG_MAX_COLUMNS];
};

extern const struct catalog_table catalog_tables[CATALOG_TABLE_COUNT];

size_t catalog_table_columns(const struct catalog_table *table);

/* A row: a cell for each column, of which its type says what counts. */
struct catalog_row {
    enum catalog_table_name table;
    struct {
        int64_t integer;
        double real;
        char *text; /* owned; NULL = null */
    } cell[CATALOG_MAX_COLUMNS];
};

/* Frees what the row owns.  Accepts a zeroed one. */
void catalog_row_done(struct catalog_row *row);

/* "a, b, c": the columns of a table, for backends. */
void catalog_rows_list_columns(const struct catalog_table *table, char text[CATALOG_COLUMNS_BYTES]);

#endif
