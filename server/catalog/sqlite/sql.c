/* SQL, shorter, on SQLite: the only file that knows it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/sql.h"

#include <pthread.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/catalog/sqlite/sql_faults.h"

enum { BUSY_MS = 10000 };

struct sql {
    sqlite3 *db;
    pthread_mutex_t lock;
    bool begun;  /* between sql_begin and sql_end */
    bool casual; /* commits aren't durable: the last casual statement could not undo that */
};

struct sql_rows {
    struct sql *sql;
    sqlite3_stmt *statement;
    bool lost; /* a text for which there was no memory */
};

/* What the database's last code means. */
static enum status status_of(sqlite3 *db) {
    switch (db ? sqlite3_errcode(db) : SQLITE_NOMEM) {
    case SQLITE_NOMEM: return STATUS_NO_MEMORY;
    case SQLITE_FULL: return STATUS_NO_SPACE;
    case SQLITE_IOERR:
    case SQLITE_CANTOPEN: return status_from_errno(sqlite3_system_errno(db));
    default: return STATUS_IO;
    }
}

static enum status refused(struct sql *sql, struct error *error) {
    return error_set(error, status_of(sql->db), "database", "the database says: %s",
                     sql->db ? sqlite3_errmsg(sql->db) : "no memory");
}

/* ------------------------------------------------------------------------------------------------ open */

enum status sql_open(const char *path, struct sql **sql, struct error *error) {
    int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX;
    struct sql *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    pthread_mutex_init(&opened->lock, NULL);
    enum status status = STATUS_OK;
    const char *vfs = fault_point ? sql_faults_vfs() : NULL;
    if (sqlite3_open_v2(path, &opened->db, flags, vfs) != SQLITE_OK) status = refused(opened, error);
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

void sql_set_patience(struct sql *sql, int ms) { sqlite3_busy_timeout(sql->db, ms); }

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

/* Undoes what the last ones could not undo themselves, because memory had run out: a transaction that was not ended,
 * commits that aren't durable. */
static enum status settle(struct sql *sql, struct error *error) {
    enum status status = STATUS_OK;
    if (!sql->begun && !sqlite3_get_autocommit(sql->db)) status = sql_execute(sql, "ROLLBACK", error);
    if (status == STATUS_OK && sql->casual) status = sql_execute(sql, "PRAGMA synchronous = FULL", error);
    if (status == STATUS_OK) sql->casual = false;
    return status;
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

static enum status run(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                       struct error *error) {
    sqlite3_stmt *statement;
    enum status status = prepare(sql, text, values, count, &statement, error);
    if (status != STATUS_OK) return status;
    if (sqlite3_step(statement) != SQLITE_DONE) status = refused(sql, error);
    sqlite3_finalize(statement);
    return status;
}

enum status sql_run(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                    struct error *error) {
    enum status status = settle(sql, error);
    return status == STATUS_OK ? run(sql, text, values, count, error) : status;
}

enum status sql_run_nosync(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                           struct error *error) {
    enum status status = settle(sql, error);
    if (status == STATUS_OK) status = sql_execute(sql, "PRAGMA synchronous = NORMAL", error);
    sql->casual = true;
    if (status == STATUS_OK) status = run(sql, text, values, count, error);
    enum status settled = settle(sql, NULL); /* else the next statement tries again */
    (void)settled;
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

enum status sql_begin(struct sql *sql, struct error *error) {
    enum status status = settle(sql, error);
    if (status == STATUS_OK) status = sql_execute(sql, "BEGIN IMMEDIATE", error);
    sql->begun = status == STATUS_OK;
    return status;
}

enum status sql_end(struct sql *sql, enum status status, struct error *error) {
    if (status == STATUS_OK && fault_at("commit"))
        status = error_set(error, STATUS_IO, "database", "a fault was armed");
    if (status == STATUS_OK) status = sql_execute(sql, "COMMIT", error);
    if (status != STATUS_OK) sqlite3_exec(sql->db, "ROLLBACK", NULL, NULL, NULL);
    sql->begun = false;
    return status;
}

/* ------------------------------------------------------------------------------------------------ rows */

enum status sql_select(struct sql *sql, const char *text, const struct sql_value *values, size_t count,
                       struct sql_rows **rows, struct error *error) {
    struct sql_rows *made = alloc_zeroed(1, sizeof *made);
    if (!made) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    made->sql = sql;
    enum status status = settle(sql, error);
    if (status == STATUS_OK) status = prepare(sql, text, values, count, &made->statement, error);
    if (status == STATUS_OK)
        *rows = made;
    else
        free(made);
    return status;
}

bool sql_next(struct sql_rows *rows) { return sqlite3_step(rows->statement) == SQLITE_ROW; }

/* A statement that changes something commits here at the latest, so this may be where the database refuses. */
enum status sql_finish(struct sql_rows *rows, struct error *error) {
    enum status status = rows->lost ? error_set(error, STATUS_NO_MEMORY, "database", "no memory") : STATUS_OK;
    if (sqlite3_finalize(rows->statement) != SQLITE_OK) status = refused(rows->sql, error);
    free(rows);
    return status;
}

int64_t sql_integer(struct sql_rows *rows, int column) { return sqlite3_column_int64(rows->statement, column); }

double sql_real(struct sql_rows *rows, int column) { return sqlite3_column_double(rows->statement, column); }

/* NULL for null. */
static const char *text_of(struct sql_rows *rows, int column) {
    bool is_null = sqlite3_column_type(rows->statement, column) == SQLITE_NULL;
    const unsigned char *text = is_null ? NULL : sqlite3_column_text(rows->statement, column);
    if (!text && !is_null) rows->lost = true;
    return (const char *)text;
}

const char *sql_text(struct sql_rows *rows, int column) {
    const char *text = text_of(rows, column);
    return text ? text : "";
}

void sql_copy_text(struct sql_rows *rows, int column, char *to, size_t bytes) {
    snprintf(to, bytes, "%s", sql_text(rows, column));
}

char *sql_new_text(struct sql_rows *rows, int column) {
    const char *text = text_of(rows, column);
    size_t bytes = text ? strlen(text) + 1 : 0;
    char *copy = text ? alloc_array(bytes, 1) : NULL;
    if (copy) memcpy(copy, text, bytes);
    if (text && !copy) rows->lost = true;
    return copy;
}
