/* Marks: what a store that is asked over a network may have of a process that died.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

static enum status change(struct catalog *catalog, const char *text, const struct sql_value *values, size_t count,
                          struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->writer;
    catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run(db, text, values, count, error);
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_mark(struct catalog *catalog, const char *name, int64_t until_ms, struct error *error) {
    return change(catalog, "INSERT OR REPLACE INTO marks (name, until) VALUES (?1, ?2)", VALUES(T(name), I(until_ms)),
                  error);
}

enum status catalog_sqlite_unmark(struct catalog *catalog, const char *name, struct error *error) {
    return change(catalog, "DELETE FROM marks WHERE name = ?1", VALUES(T(name)), error);
}

/* There hardly ever is one: who looks for it takes no lock that a change takes. */
static enum status is_due(struct sql *reader, int64_t now_ms, int64_t *due, struct error *error) {
    *due = 0;
    sql_lock(reader);
    enum status status =
        sql_number(reader, "SELECT count(*) FROM marks WHERE until <= ?1", VALUES(I(now_ms)), due, error);
    sql_unlock(reader);
    return status;
}

enum status catalog_sqlite_claim_marks(struct catalog *catalog, int64_t now_ms, char (*names)[CATALOG_MARK_BYTES],
                                       size_t max, size_t *count, struct error *error) {
    enum { AGAIN_MS = 60 * 1000 };
    struct sql *db = catalog_sqlite_of(catalog)->writer;
    struct sql_rows *row;
    int64_t due;
    *count = 0;
    enum status status = is_due(catalog_sqlite_of(catalog)->reader, now_ms, &due, error);
    if (status != STATUS_OK || !due) return status;
    catalog_sqlite_enter(catalog_sqlite_of(catalog));
    status = sql_select(db,
                        "UPDATE marks SET until = ?1 WHERE name IN (SELECT name FROM marks WHERE until <= ?2 "
                        "ORDER BY until LIMIT ?3) RETURNING name",
                        VALUES(I(job_now_ms() + AGAIN_MS), I(now_ms), I(max)), &row, error);
    if (status == STATUS_OK) {
        while (*count < max && sql_next(row)) sql_copy_text(row, 0, names[(*count)++], CATALOG_MARK_BYTES);
        status = sql_finish(row, error);
    }
    sql_unlock(db);
    return status;
}
