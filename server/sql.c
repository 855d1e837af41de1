/* SQL, shorter, on SQLite: the only file that knows it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/sql.h"

#include <pthread.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/alloc.h"
#include "core/fault.h"

enum { BUSY_MS = 10000 };

struct sql {
    sqlite3 *db;
    pthread_mutex_t lock;
};

struct sql_rows {
    struct sql *sql;
    sqlite3_stmt *statement;
    int step; /* what the last step returned */
};

static enum status refused(struct sql *sql, struct error *error) {
    int code = sql->db ? sqlite3_errcode(sql->db) : SQLITE_NOMEM;
    enum status status = code == SQLITE_FULL ? STATUS_NO_SPACE : code == SQLITE_NOMEM ? STATUS_NO_MEMORY : STATUS_IO;
    return error_set(error, status, "database", "the database says: %s",
                     sql->db ? sqlite3_errmsg(sql->db) : "no memory");
}

/* ------------------------------------------------------------------------------------------------ open */

enum status sql_open(const char *path, struct sql **sql, struct error *error) {
    int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX;
    struct sql *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    pthread_mutex_init(&opened->lock, NULL);
    enum status status = STATUS_OK;
    if (sqlite3_open_v2(path, &opened->db, flags, NULL) != SQLITE_OK) status = refused(opened, error);
    if (status == STATUS_OK) {
        sqlite3_busy_timeout(opened->db, BUSY_MS);
        status = sql_execute(opened, "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA temp_store = MEMORY",
                             error);
    }
    if (status == STATUS_OK)
        *sql = opened;
    else
        sql_close(opened);
    return status;
}

void sql_close(struct sql *sql) {
    if (!sql) return;
    sqlite3_close(sql->db);
    pthread_mutex_destroy(&sql->lock);
    free(sql);
}

enum status sql_migrate(struct sql *sql, const char *const *steps, size_t count, struct error *error) {
    int64_t version = 0;
    enum status status = sql_begin(sql, error);
    if (status != STATUS_OK) return status;
    status = sql_number(sql, "PRAGMA user_version", NULL, 0, &version, error);
    if (status == STATUS_OK && version > (int64_t)count)
        status = error_set(error, STATUS_UNSUPPORTED, "database",
                           "it was written by a newer version (schema %lld, this one knows %zu); install that, or put "
                           "the backup from before the upgrade back",
                           (long long)version, count);
    for (size_t i = (size_t)version; status == STATUS_OK && i < count; i++) status = sql_execute(sql, steps[i], error);
    char text[64];
    snprintf(text, sizeof text, "PRAGMA user_version = %zu", count);
    if (status == STATUS_OK) status = sql_execute(sql, text, error);
    return sql_end(sql, status, error);
}

void sql_lock(struct sql *sql) { pthread_mutex_lock(&sql->lock); }

void sql_unlock(struct sql *sql) { pthread_mutex_unlock(&sql->lock); }

/* ------------------------------------------------------------------------------------------------ statements */

enum status sql_execute(struct sql *sql, const char *text, struct error *error) {
    return sqlite3_exec(sql->db, text, NULL, NULL, NULL) == SQLITE_OK ? STATUS_OK : refused(sql, error);
}

static int bind(sqlite3_stmt *statement, int i, const struct sql_value *value) {
    switch (value->type) {
    case SQL_VALUE_INTEGER: return sqlite3_bind_int64(statement, i, value->integer);
    case SQL_VALUE_REAL: return sqlite3_bind_double(statement, i, value->real);
    case SQL_VALUE_TEXT: break;
    }
    return sqlite3_bind_text(statement, i, value->text, -1, SQLITE_STATIC);
}

/* Prepares a statement and binds ?1, ?2, ... */
static enum status prepare(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                           sqlite3_stmt **statement, struct error *error) {
    if (sqlite3_prepare_v2(sql->db, text, -1, statement, NULL) != SQLITE_OK) return refused(sql, error);
    for (size_t i = 0; i < count; i++) {
        if (bind(*statement, (int)i + 1, &values[i]) == SQLITE_OK) continue;
        sqlite3_finalize(*statement);
        return refused(sql, error);
    }
    return STATUS_OK;
}

enum status sql_run(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                    struct error *error) {
    sqlite3_stmt *statement;
    enum status status = prepare(sql, text, values, count, &statement, error);
    if (status != STATUS_OK) return status;
    if (sqlite3_step(statement) != SQLITE_DONE) status = refused(sql, error);
    sqlite3_finalize(statement);
    return status;
}

int64_t sql_changes(const struct sql *sql) { return sqlite3_changes(sql->db); }

enum status sql_number(struct sql *sql, const char *text, const struct sql_value *values, size_t count, int64_t *number,
                       struct error *error) {
    struct sql_rows *rows;
    enum status status = sql_select(sql, text, values, count, &rows, error);
    if (status != STATUS_OK) return status;
    if (sql_next(rows)) *number = sql_integer(rows, 0);
    return sql_finish(rows, error);
}

enum status sql_begin(struct sql *sql, struct error *error) { return sql_execute(sql, "BEGIN IMMEDIATE", error); }

enum status sql_end(struct sql *sql, enum status status, struct error *error) {
    if (status == STATUS_OK && fault_at("commit"))
        status = error_set(error, STATUS_IO, "database", "a fault was armed");
    if (status == STATUS_OK) status = sql_execute(sql, "COMMIT", error);
    if (status != STATUS_OK) sqlite3_exec(sql->db, "ROLLBACK", NULL, NULL, NULL);
    return status;
}

/* ------------------------------------------------------------------------------------------------ rows */

enum status sql_select(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                       struct sql_rows **rows, struct error *error) {
    struct sql_rows *made = alloc_zeroed(1, sizeof *made);
    if (!made) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    made->sql = sql;
    made->step = SQLITE_DONE;
    enum status status = prepare(sql, text, values, count, &made->statement, error);
    if (status == STATUS_OK)
        *rows = made;
    else
        free(made);
    return status;
}

bool sql_next(struct sql_rows *rows) { return (rows->step = sqlite3_step(rows->statement)) == SQLITE_ROW; }

enum status sql_finish(struct sql_rows *rows, struct error *error) {
    bool ok = rows->step == SQLITE_ROW || rows->step == SQLITE_DONE;
    enum status status = ok ? STATUS_OK : refused(rows->sql, error);
    sqlite3_finalize(rows->statement);
    free(rows);
    return status;
}

int64_t sql_integer(struct sql_rows *rows, int column) { return sqlite3_column_int64(rows->statement, column); }

double sql_real(struct sql_rows *rows, int column) { return sqlite3_column_double(rows->statement, column); }

const char *sql_text(struct sql_rows *rows, int column) {
    const unsigned char *text = sqlite3_column_text(rows->statement, column);
    return text ? (const char *)text : "";
}

void sql_copy_text(struct sql_rows *rows, int column, char *to, size_t bytes) {
    snprintf(to, bytes, "%s", sql_text(rows, column));
}

char *sql_new_text(struct sql_rows *rows, int column) {
    const unsigned char *text = sqlite3_column_text(rows->statement, column);
    return text ? strdup((const char *)text) : NULL;
}
