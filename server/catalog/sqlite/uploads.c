/* The rows of resumable uploads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

#include <string.h>

enum status catalog_sqlite_put_upload(struct catalog *catalog, const struct catalog_upload *row, struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->writer;
    catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status =
        sql_run(db,
                "INSERT OR REPLACE INTO uploads (id, principal, metadata, cloud, created, expires, position, length, "
                "boot, concat) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
                VALUES(T(row->id), T(row->principal), T(row->metadata), T(row->cloud), I(row->created_ms),
                       I(row->expires_ms), I(row->offset), I(row->length), T(row->boot), T(row->concat)),
                error);
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_delete_upload(struct catalog *catalog, const char *id, int64_t by_ms, bool *deleted,
                                         struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->writer;
    struct sql_rows *rows;
    *deleted = false;
    catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status =
        sql_run(db, "DELETE FROM uploads WHERE id = ?1 AND expires <= ?2", VALUES(T(id), I(by_ms)), error);
    if (status == STATUS_OK)
        status = sql_select(db, "SELECT 1 FROM uploads WHERE id = ?1", VALUES(T(id)), &rows, error);
    if (status == STATUS_OK) {
        *deleted = !sql_next(rows);
        status = sql_finish(rows, error);
    }
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_next_upload(struct catalog *catalog, const char *after, struct catalog_upload *row,
                                       bool *found, struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *rows;
    char behind[JOB_ID_BYTES];
    memcpy(behind, after, strnlen(after, JOB_ID_BYTES - 1) + 1); /* after may be row's own */
    *found = false;
    sql_lock(db);
    enum status status = sql_select(db,
                                    "SELECT " CATALOG_UPLOAD_COLUMNS " "
                                    "FROM uploads WHERE id > ?1 ORDER BY id LIMIT 1",
                                    VALUES(T(behind)), &rows, error);
    if (status == STATUS_OK) {
        *found = sql_next(rows);
        struct catalog_cells cells = catalog_sqlite_cells(rows);
        if (*found) catalog_cells_read_upload(&cells, row);
        status = sql_finish(rows, error);
    }
    sql_unlock(db);
    return status;
}
