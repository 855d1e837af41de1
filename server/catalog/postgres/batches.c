/* Batches: jobs that came together.  Their end and their going are triggers' (tables.c).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/postgres/catalog_postgres.h"

/* ------------------------------------------------------------------------------------------------ submit */

/* Whether all that comes with it is within the limits. */
static enum status check_batch(struct pq_link *link, const struct catalog_batch *batch, const struct job *jobs,
                               const struct catalog_limits *limits, struct error *error) {
    uint64_t waits = 0, bytes = 0;
    for (size_t i = 0; i < batch->size; i++) {
        waits += jobs[i].state == JOB_ACCEPTED;
        bytes += jobs[i].input_bytes;
        for (size_t k = 0; k < jobs[i].output_count; k++) bytes += jobs[i].output[k].bytes;
    }
    enum status status = catalog_postgres_check_counts(link, batch->principal, waits, limits, error);
    if (status != STATUS_OK) return status;
    return catalog_postgres_check_bytes(link, batch->principal, bytes, limits->principal_bytes, error);
}

/* The rows of all of it; in a transaction.  Jobs end when all are there, for the last end makes the webhook due. */
static enum status insert_batch(struct catalog_postgres *postgres, struct pq_link *link,
                                const struct catalog_batch *batch, const struct job *jobs, struct error *error) {
    enum status status = pq_run(
        link, "INSERT INTO batches (" CATALOG_BATCH_COLUMNS ") VALUES ($1, $2, $3, $4, $5)",
        VALUES(T(batch->id), T(batch->principal), T(batch->label), I(batch->created_ms), I(batch->size)), NULL, error);
    if (status == STATUS_OK && batch->key)
        status = catalog_postgres_add_key(link, batch->principal, batch->key, batch->id, batch->created_ms, error);
    if (status == STATUS_OK && batch->webhook)
        status = catalog_postgres_add_webhook(link, batch->id, batch->webhook, error);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        status = catalog_postgres_insert(postgres, link, &jobs[i], error);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++) {
        bool waits = jobs[i].state == JOB_ACCEPTED;
        if (!waits) status = catalog_postgres_write_end(postgres, link, &jobs[i], JOB_SUCCESSFUL, error);
        if (status == STATUS_OK)
            status =
                catalog_postgres_notify(postgres, link, waits ? CATALOG_WAITS : CATALOG_CHANGED, jobs[i].id, error);
    }
    return status;
}

enum status catalog_postgres_submit_batch(struct catalog *catalog, const struct catalog_batch *batch,
                                          const struct job *jobs, const struct catalog_limits *limits,
                                          struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    bool unknown = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = catalog_postgres_lock_submit(link, error);
    if (status == STATUS_OK) status = check_batch(link, batch, jobs, limits, error);
    if (status == STATUS_OK) status = insert_batch(postgres, link, batch, jobs, error);
    status = pq_end(link, status, &unknown, error);
    if (unknown) status = catalog_postgres_look_up_submit(postgres, jobs[0].id, error);
    for (size_t i = 0; status == STATUS_OK && i < batch->size; i++)
        catalog_tell(catalog, jobs[i].state == JOB_ACCEPTED ? CATALOG_WAITS : CATALOG_CHANGED, jobs[i].id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

static enum status read_batch_jobs(struct pq_link *link, struct catalog_batch *batch, struct error *error) {
    struct pq_rows *rows;
    enum status status =
        pq_select(link, "SELECT " CATALOG_BATCH_JOB_COLUMNS " FROM jobs WHERE batch = $1 AND batch <> '' ORDER BY id",
                  VALUES(T(batch->id)), &rows, error);
    if (status != STATUS_OK) return status;
    struct catalog_cells cells = catalog_postgres_cells(rows);
    while (pq_next(rows) && catalog_cells_read_batch_job(&cells, batch)) continue;
    pq_free(rows);
    return STATUS_OK;
}

/* The batches of a SELECT CATALOG_BATCH_COLUMNS, with their jobs.  *count is 0 on failure. */
/* sure: that there is none is confirmed. */
static enum status select_batches(struct catalog *catalog, bool sure, const char *text, const struct pq_value *values,
                                  size_t value_count, struct catalog_batch *batches, size_t max, size_t *count,
                                  struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    bool ok = true;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, text, values, value_count, &rows, error);
    if (status == STATUS_OK) {
        struct catalog_cells cells = catalog_postgres_cells(rows);
        while (ok && *count < max && pq_next(rows)) ok = catalog_cells_read_batch(&cells, &batches[(*count)++]);
        pq_free(rows);
    }
    if (status == STATUS_OK && !ok) status = error_set(error, STATUS_NO_MEMORY, "batch", "no memory");
    for (size_t i = 0; status == STATUS_OK && i < *count; i++) status = read_batch_jobs(link, &batches[i], error);
    if (status == STATUS_OK && sure && *count == 0) status = catalog_postgres_confirm(link, error);
    pq_done(link);
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) catalog_batch_done(&batches[i]);
    *count = 0;
    return status;
}

enum status catalog_postgres_get_batch(struct catalog *catalog, const char *id, struct catalog_batch *batch,
                                       bool *found, struct error *error) {
    size_t count = 0;
    *batch = (struct catalog_batch){0};
    enum status status = select_batches(catalog, true, "SELECT " CATALOG_BATCH_COLUMNS " FROM batches WHERE id = $1",
                                        VALUES(T(id)), batch, 1, &count, error);
    *found = count == 1;
    return status;
}

enum status catalog_postgres_list_batches(struct catalog *catalog, const char *principal, const char *after,
                                          struct catalog_batch *batches, size_t max, size_t *count,
                                          struct error *error) {
    return select_batches(catalog, false,
                          "SELECT " CATALOG_BATCH_COLUMNS " FROM batches WHERE ($1 IS NULL OR principal = $1) "
                          "AND ($2 IS NULL OR id < $2) ORDER BY id DESC LIMIT $3",
                          VALUES(T(principal), T(after), I(max)), batches, max, count, error);
}
