/* The outbox's statements.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/outbox.h"

#include <string.h>

#include "server/sql.h"

enum status outbox_add(struct sql *writer, const char *job, const char *url, struct error *error) {
    return sql_run(writer, "INSERT INTO outbox (job, url) VALUES (?1, ?2)", VALUES(T(job), T(url)), error);
}

enum status outbox_make_due(struct sql *writer, const char *job, int64_t now_ms, struct error *error) {
    return sql_run(writer, "UPDATE outbox SET due = ?2 WHERE job = ?1", VALUES(T(job), I(now_ms)), error);
}

enum status outbox_remove(struct sql *writer, const char *job, struct error *error) {
    return sql_run(writer, "DELETE FROM outbox WHERE job = ?1", VALUES(T(job)), error);
}

enum status outbox_next(struct sql *reader, int64_t now_ms, struct outbox_row *row, bool *found, int64_t *next_ms,
                        struct error *error) {
    struct sql_rows *rows;
    *found = false;
    *next_ms = INT64_MAX;
    sql_lock(reader);
    enum status status = sql_select(
        reader, "SELECT job, url, attempts, due FROM outbox WHERE due > 0 ORDER BY due LIMIT 1", NULL, 0, &rows, error);
    if (status == STATUS_OK) {
        if (sql_next(rows)) {
            sql_copy_text(rows, 0, row->job, sizeof row->job);
            sql_copy_text(rows, 1, row->url, sizeof row->url);
            row->attempts = (int)sql_integer(rows, 2);
            *next_ms = sql_integer(rows, 3);
            *found = *next_ms <= now_ms;
        }
        status = sql_finish(rows, error);
    }
    sql_unlock(reader);
    return status;
}

enum status outbox_postpone(struct sql *writer, const char *job, int64_t due_ms, struct error *error) {
    sql_lock(writer);
    enum status status = sql_run(writer, "UPDATE outbox SET attempts = attempts + 1, due = ?2 WHERE job = ?1",
                                 VALUES(T(job), I(due_ms)), error);
    sql_unlock(writer);
    return status;
}

enum status outbox_end(struct sql *writer, const char *job, struct error *error) {
    sql_lock(writer);
    enum status status = outbox_remove(writer, job, error);
    sql_unlock(writer);
    return status;
}
