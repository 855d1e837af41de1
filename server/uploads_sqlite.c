/* The rows of resumable uploads, in the queue's database.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "server/sql.h"
#include "server/uploads.h"

enum status uploads_row_put(struct queue *queue, const struct uploads_row *row, struct error *error) {
    const struct uploads_info *info = &row->info;
    struct sql *db = queue_writer(queue);
    sql_lock(db);
    enum status status =
        sql_run(db,
                "INSERT OR REPLACE INTO uploads (id, principal, metadata, cloud, created, expires, position, length, "
                "boot) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)",
                VALUES(T(info->id), T(info->principal), T(info->metadata), T(info->cloud), I(info->created_ms),
                       I(info->expires_ms), I(info->offset), I(info->length), T(row->boot)),
                error);
    sql_unlock(db);
    return status;
}

enum status uploads_row_delete(struct queue *queue, const char *id, struct error *error) {
    struct sql *db = queue_writer(queue);
    sql_lock(db);
    enum status status = sql_run(db, "DELETE FROM uploads WHERE id = ?1", VALUES(T(id)), error);
    sql_unlock(db);
    return status;
}

static void read_row(struct sql_rows *from, struct uploads_row *row) {
    struct uploads_info *info = &row->info;
    memset(row, 0, sizeof *row);
    sql_copy_text(from, 0, info->id, sizeof info->id);
    sql_copy_text(from, 1, info->principal, sizeof info->principal);
    sql_copy_text(from, 2, info->metadata, sizeof info->metadata);
    sql_copy_text(from, 3, info->cloud, sizeof info->cloud);
    info->created_ms = sql_integer(from, 4);
    info->expires_ms = sql_integer(from, 5);
    info->offset = (uint64_t)sql_integer(from, 6);
    info->length = (uint64_t)sql_integer(from, 7); /* -1 is UINT64_MAX */
    sql_copy_text(from, 8, row->boot, sizeof row->boot);
}

enum status uploads_row_next(struct queue *queue, const char *after, struct uploads_row *row, bool *found,
                             struct error *error) {
    struct sql *db = queue_reader(queue);
    struct sql_rows *rows;
    char behind[JOB_ID_BYTES];
    memcpy(behind, after, strnlen(after, JOB_ID_BYTES - 1) + 1); /* after may be row's own */
    *found = false;
    sql_lock(db);
    enum status status = sql_select(db,
                                    "SELECT id, principal, metadata, cloud, created, expires, position, length, boot "
                                    "FROM uploads WHERE id > ?1 ORDER BY id LIMIT 1",
                                    VALUES(T(behind)), &rows, error);
    if (status == STATUS_OK) {
        *found = sql_next(rows);
        if (*found) read_row(rows, row);
        status = sql_finish(rows, error);
    }
    sql_unlock(db);
    return status;
}
