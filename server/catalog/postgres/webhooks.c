/* The table of webhooks, `outbox`: a row that is claimed is due again when the claim ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

enum status catalog_postgres_add_webhook(struct pq_link *link, const char *job, const char *url, struct error *error) {
    return pq_run(link, "INSERT INTO outbox (job, url) VALUES ($1, $2)", VALUES(T(job), T(url)), NULL, error);
}

enum status catalog_postgres_each_webhook_due(struct catalog *catalog, int64_t now_ms,
                                              bool (*look)(void *ctx, const struct catalog_webhook *row), void *ctx,
                                              struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    struct catalog_webhook row;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status =
        pq_select(link,
                  "SELECT outbox.job, outbox.url, outbox.attempts, coalesce(jobs.principal, batches.principal, ''), "
                  "outbox.due FROM outbox LEFT JOIN jobs ON jobs.id = outbox.job "
                  "LEFT JOIN batches ON batches.id = outbox.job WHERE outbox.due > 0 AND outbox.due <= $1 "
                  "ORDER BY outbox.due",
                  VALUES(I(now_ms)), &rows, error);
    if (status == STATUS_OK) {
        for (bool more = true; more && pq_next(rows);) {
            pq_copy_text(rows, 0, row.job, sizeof row.job);
            pq_copy_text(rows, 1, row.url, sizeof row.url);
            row.attempts = (int)pq_integer(rows, 2);
            pq_copy_text(rows, 3, row.principal, sizeof row.principal);
            row.due_ms = pq_integer(rows, 4);
            more = look(ctx, &row);
        }
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

/* Changes a row of the table; for those that don't ask whether there was one. */
static enum status change(struct catalog *catalog, const char *text, const struct pq_value *values, size_t count,
                          int64_t *changed, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, text, values, count, changed, error), NULL, error);
}

enum status catalog_postgres_claim_webhook(struct catalog *catalog, const struct catalog_webhook *webhook,
                                           const char *owner, int64_t until_ms, bool *claimed, struct error *error) {
    int64_t changed = 0;
    enum status status =
        change(catalog, "UPDATE outbox SET owner = $2, due = $3, claims = claims + 1 WHERE job = $1 AND due = $4",
               VALUES(T(webhook->job), T(owner), I(until_ms), I(webhook->due_ms)), &changed, error);
    *claimed = status == STATUS_OK && changed > 0;
    return status;
}

enum status catalog_postgres_return_webhooks(struct catalog *catalog, const char *owner, const char *job,
                                             int64_t due_ms, struct error *error) {
    return change(catalog, "UPDATE outbox SET owner = '', due = $3 WHERE owner = $1 AND ($2 IS NULL OR job = $2)",
                  VALUES(T(owner), T(job), I(due_ms)), NULL, error);
}

enum status catalog_postgres_postpone_webhook(struct catalog *catalog, const char *job, int64_t due_ms,
                                              struct error *error) {
    return change(catalog, "UPDATE outbox SET attempts = attempts + 1, due = $2, owner = '' WHERE job = $1",
                  VALUES(T(job), I(due_ms)), NULL, error);
}

enum status catalog_postgres_end_webhook(struct catalog *catalog, const char *job, struct error *error) {
    return change(catalog, "DELETE FROM outbox WHERE job = $1", VALUES(T(job)), NULL, error);
}
