/* Batches: jobs that came together.  Their end and their going are triggers' (schema.c).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/job_rows.h"

/* ------------------------------------------------------------------------------------------------ submit */

/* How many of its jobs wait, and the bytes of all that comes with it. */
static size_t batch_waits(const struct catalog_batch *batch, const struct job *jobs, uint64_t *bytes) {
    size_t waits = 0;
    *bytes = 0;
    for (size_t i = 0; i < batch->size; i++) {
        waits += jobs[i].state == JOB_ACCEPTED;
        *bytes += jobs[i].input_bytes;
        for (size_t k = 0; k < jobs[i].output_count; k++) *bytes += jobs[i].output[k].bytes;
    }
    return waits;
}

/* The rows of all of it; in a transaction.  Jobs end when all are there, for the last end makes the webhook due. */
static enum status insert_batch(struct sql *db, const struct catalog_batch *batch, const struct job *jobs,
                                struct error *error) {
    enum status status = sql_run(
        db, "INSERT INTO batches (" CATALOG_BATCH_COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5)",
        VALUES(T(batch->id), T(batch->principal), T(batch->label), I(batch->created_ms), I(batch->size)), error);
    if (status == STATUS_OK && batch->key)
        status = catalog_sqlite_add_key(db, batch->principal, batch->key, batch->id, batch->created_ms, error);
    if (status == STATUS_OK && batch->webhook)
        status = catalog_sqlite_add_webhook(db, batch->id, batch->webhook, error);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++) status = job_rows_insert(db, &jobs[i], error);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        if (jobs[i].state == JOB_SUCCESSFUL) status = catalog_sqlite_write_end(db, &jobs[i], JOB_SUCCESSFUL, error);
    return status;
}

enum status catalog_sqlite_submit_batch(struct catalog *catalog, const struct catalog_batch *batch,
                                        const struct job *jobs, const struct catalog_limits *limits,
                                        struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    uint64_t bytes, waits = batch_waits(batch, jobs, &bytes);
    catalog_sqlite_enter(sqlite);
    enum status status = catalog_sqlite_check_limits(sqlite, batch->principal, waits, limits, error);
    if (status == STATUS_OK) status = catalog_reserve(catalog, batch->principal, bytes, limits->principal_bytes, error);
    if (status == STATUS_OK) {
        status = sql_begin(sqlite->writer, error);
        if (status == STATUS_OK)
            status = sql_end(sqlite->writer, insert_batch(sqlite->writer, batch, jobs, error), error);
        if (status == STATUS_OK) catalog_sqlite_refresh_usage(sqlite, batch->principal);
        catalog_release(catalog, batch->principal, bytes);
    }
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        if (jobs[i].state == JOB_ACCEPTED) {
            sqlite->waiting++;
            catalog_sqlite_put_in_order(sqlite, &jobs[i]);
        }
    sql_unlock(sqlite->writer);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        catalog_tell(catalog, jobs[i].state == JOB_ACCEPTED ? CATALOG_WAITS : CATALOG_CHANGED, jobs[i].id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

/* The batches of a SELECT CATALOG_BATCH_COLUMNS, with their jobs.  *count is 0 on failure. */
static enum status read_batches(struct sql *db, struct sql_rows *row, struct catalog_batch *batches, size_t max,
                                size_t *count, struct error *error) {
    struct catalog_cells cells = catalog_sqlite_cells(row);
    bool ok = true;
    *count = 0;
    while (ok && *count < max && sql_next(row)) ok = catalog_cells_read_batch(&cells, &batches[(*count)++]);
    enum status status = sql_finish(row, error);
    if (status == STATUS_OK && !ok) status = error_set(error, STATUS_NO_MEMORY, "batch", "no memory");
    for (size_t i = 0; status == STATUS_OK && i < *count; i++) {
        status = sql_select(
            db, "SELECT " CATALOG_BATCH_JOB_COLUMNS " FROM jobs WHERE batch = ?1 AND batch <> '' ORDER BY id",
            VALUES(T(batches[i].id)), &row, error);
        if (status != STATUS_OK) break;
        cells = catalog_sqlite_cells(row);
        while (sql_next(row) && catalog_cells_read_batch_job(&cells, &batches[i])) continue;
        status = sql_finish(row, error);
    }
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) catalog_batch_done(&batches[i]);
    *count = 0;
    return status;
}

enum status catalog_sqlite_get_batch(struct catalog *catalog, const char *id, struct catalog_batch *batch, bool *found,
                                     struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *row;
    size_t count = 0;
    *batch = (struct catalog_batch){0};
    sql_lock(reader);
    enum status status =
        sql_select(reader, "SELECT " CATALOG_BATCH_COLUMNS " FROM batches WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status == STATUS_OK) status = read_batches(reader, row, batch, 1, &count, error);
    sql_unlock(reader);
    *found = count == 1;
    return status;
}

enum status catalog_sqlite_list_batches(struct catalog *catalog, const char *principal, const char *after,
                                        struct catalog_batch *batches, size_t max, size_t *count, struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *row;
    *count = 0;
    sql_lock(reader);
    enum status status = sql_select(reader,
                                    "SELECT " CATALOG_BATCH_COLUMNS " FROM batches WHERE (?1 IS NULL OR principal = ?1)"
                                    " AND (?2 IS NULL OR id < ?2) ORDER BY id DESC LIMIT ?3",
                                    VALUES(T(principal), T(after), I(max)), &row, error);
    if (status == STATUS_OK) status = read_batches(reader, row, batches, max, count, error);
    sql_unlock(reader);
    return status;
}
