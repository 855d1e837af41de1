/* The table of webhooks, `outbox`.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

#include <string.h>

enum status catalog_sqlite_add_webhook(struct sql *writer, const char *job, const char *url, struct error *error) {
    return sql_run(writer, "INSERT INTO outbox (job, url) VALUES (?1, ?2)", VALUES(T(job), T(url)), error);
}

enum status catalog_sqlite_make_webhook_due(struct sql *writer, const char *job, int64_t now_ms, struct error *error) {
    return sql_run(writer, "UPDATE outbox SET due = ?2 WHERE job = ?1", VALUES(T(job), I(now_ms)), error);
}

enum status catalog_sqlite_remove_webhook(struct sql *writer, const char *job, struct error *error) {
    return sql_run(writer, "DELETE FROM outbox WHERE job = ?1", VALUES(T(job)), error);
}

enum status catalog_sqlite_each_webhook_due(struct catalog *catalog, int64_t now_ms,
                                            bool (*look)(void *ctx, const struct catalog_webhook *row), void *ctx,
                                            struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *rows;
    struct catalog_webhook row;
    sql_lock(reader);
    enum status status =
        sql_select(reader,
                   "SELECT outbox.job, outbox.url, outbox.attempts, coalesce(jobs.principal, batches.principal, ''), "
                   "outbox.due FROM outbox LEFT JOIN jobs ON jobs.id = outbox.job "
                   "LEFT JOIN batches ON batches.id = outbox.job WHERE outbox.due > 0 AND outbox.due <= ?1 "
                   "ORDER BY outbox.due",
                   VALUES(I(now_ms)), &rows, error);
    if (status == STATUS_OK) {
        for (bool more = true; more && sql_next(rows);) {
            sql_copy_text(rows, 0, row.job, sizeof row.job);
            sql_copy_text(rows, 1, row.url, sizeof row.url);
            row.attempts = (int)sql_integer(rows, 2);
            sql_copy_text(rows, 3, row.principal, sizeof row.principal);
            row.due_ms = sql_integer(rows, 4);
            more = look(ctx, &row);
        }
        status = sql_finish(rows, error);
    }
    sql_unlock(reader);
    return status;
}

enum status catalog_sqlite_claim_webhook(struct catalog *catalog, const struct catalog_webhook *webhook,
                                         const char *owner, int64_t until_ms, bool *claimed, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run_nosync(writer, "UPDATE outbox SET owner = ?2, due = ?3 WHERE job = ?1 AND due = ?4",
                                        VALUES(T(webhook->job), T(owner), I(until_ms), I(webhook->due_ms)), error);
    *claimed = status == STATUS_OK && sql_changes(writer) > 0;
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_return_webhooks(struct catalog *catalog, const char *owner, const char *job, int64_t due_ms,
                                           struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status =
        sql_run_nosync(writer, "UPDATE outbox SET owner = '', due = ?3 WHERE owner = ?1 AND (?2 IS NULL OR job = ?2)",
                       VALUES(T(owner), T(job), I(due_ms)), error);
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_postpone_webhook(struct catalog *catalog, const char *job, int64_t due_ms,
                                            struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status =
        sql_run(writer, "UPDATE outbox SET attempts = attempts + 1, due = ?2, owner = '' WHERE job = ?1",
                VALUES(T(job), I(due_ms)), error);
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_end_webhook(struct catalog *catalog, const char *job, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = catalog_sqlite_remove_webhook(writer, job, error);
    sql_unlock(writer);
    return status;
}
