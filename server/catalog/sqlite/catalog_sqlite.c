/* The catalog in SQLite: opening it, what is in memory of it, and its table of functions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "server/catalog/fair_share.h"
#include "server/catalog/sqlite/schema.h"

enum { BLOCKED_MS = 500 };

/* ------------------------------------------------------------------------------------------------ memory */

void catalog_sqlite_refresh_usage(struct catalog_sqlite *sqlite, const char *principal) {
    struct error error = {0};
    enum status status = usage_refresh(sqlite->usage, sqlite->writer, principal, &error);
    (void)status; /* the older figures stand; the next change brings them up to date */
}

static enum status read_version(struct catalog_sqlite *sqlite, int64_t *version, struct error *error) {
    return sql_number(sqlite->writer, "PRAGMA data_version", NULL, 0, version, error);
}

/* The version comes first: what is written meanwhile is read once more, rather than missed. */
enum status catalog_sqlite_load(struct catalog_sqlite *sqlite, struct error *error) {
    int64_t version = 0;
    enum status status = read_version(sqlite, &version, error);
    if (status == STATUS_OK) status = catalog_sqlite_load_order(sqlite, error);
    if (status == STATUS_OK) status = usage_refresh(sqlite->usage, sqlite->writer, NULL, error);
    if (status == STATUS_OK) sqlite->version = version;
    return status;
}

struct sql *catalog_sqlite_enter(struct catalog_sqlite *sqlite) {
    struct error error = {0};
    sql_lock(sqlite->writer);
    int64_t version = sqlite->version;
    enum status status = read_version(sqlite, &version, &error);
    if (status == STATUS_OK && version != sqlite->version) status = catalog_sqlite_load(sqlite, &error);
    (void)status; /* the next one tries again */
    return sqlite->writer;
}

/* ------------------------------------------------------------------------------------------------ open */

static bool is_valid(const char *path) { return path[0] != 0; }

static bool exists(const char *path) {
    struct stat facts;
    return stat(path, &facts) == 0 && facts.st_size > 0;
}

static enum status open_connections(struct catalog_sqlite *sqlite, const char *path, struct error *error) {
    enum status status = sql_open(path, &sqlite->writer, error);
    if (status == STATUS_OK) status = schema_migrate(sqlite->writer, error);
    if (status == STATUS_OK) status = sql_open(path, &sqlite->reader, error);
    if (status == STATUS_OK) status = sql_open(path, &sqlite->prober, error);
    if (status == STATUS_OK) sql_set_patience(sqlite->prober, 0);
    return status == STATUS_OK ? catalog_sqlite_load(sqlite, error) : status;
}

static enum status open_path(const char *path, bool as_is, struct catalog **catalog, struct error *error) {
    struct catalog_sqlite *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "catalog", "no memory");
    opened->catalog.backend = &catalog_sqlite;
    pthread_mutex_init(&opened->order, NULL);
    pthread_mutex_init(&opened->keys.lock, NULL);
    opened->fair_share = fair_share_new(JOB_PRIORITY_AGING_MS);
    opened->usage = usage_new();
    enum status status =
        opened->fair_share && opened->usage ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "catalog", "no memory");
    if (status == STATUS_OK)
        status = as_is ? sql_open(path, &opened->reader, error) : open_connections(opened, path, error);
    if (status == STATUS_OK)
        *catalog = &opened->catalog;
    else
        catalog_sqlite_close(&opened->catalog);
    return status;
}

static enum status migrate(const char *path, struct error *error) {
    struct catalog *catalog = NULL;
    enum status status = open_path(path, false, &catalog, error);
    catalog_close(catalog);
    return status;
}

void catalog_sqlite_close(struct catalog *catalog) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    sql_close(sqlite->prober);
    sql_close(sqlite->reader);
    sql_close(sqlite->writer);
    fair_share_free(sqlite->fair_share);
    usage_free(sqlite->usage);
    pthread_mutex_destroy(&sqlite->keys.lock);
    pthread_mutex_destroy(&sqlite->order);
    free(sqlite);
}

/* ------------------------------------------------------------------------------------------------ identity */

/* A database of an older version has no table for it. */
static enum status read_identity(struct sql *db, char id[CATALOG_IDENTITY_BYTES], struct error *error) {
    struct sql_rows *row;
    int64_t tables = 0;
    enum status status =
        sql_number(db, "SELECT count(*) FROM sqlite_master WHERE name = 'identity'", NULL, 0, &tables, error);
    if (status != STATUS_OK || !tables) return status;
    status = sql_select(db, "SELECT id FROM identity", NULL, 0, &row, error);
    if (status != STATUS_OK) return status;
    if (sql_next(row)) sql_copy_text(row, 0, id, CATALOG_IDENTITY_BYTES);
    return sql_finish(row, error);
}

enum status catalog_sqlite_identity(struct catalog *catalog, char id[CATALOG_IDENTITY_BYTES], struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    id[0] = 0;
    sql_lock(reader);
    enum status status = read_identity(reader, id, error);
    sql_unlock(reader);
    return status;
}

/* What runs is the folder's own, under whatever name it has. */
static enum status write_identity(struct sql *db, const char *id, struct error *error) {
    enum status status = sql_begin(db, error);
    if (status != STATUS_OK) return status;
    status = sql_run(db, "UPDATE jobs SET owner = ?1 WHERE owner <> ''", VALUES(T(id)), error);
    if (status == STATUS_OK)
        status = sql_run(db, "INSERT OR REPLACE INTO identity (one, id) VALUES (1, ?1)", VALUES(T(id)), error);
    return sql_end(db, status, error);
}

enum status catalog_sqlite_set_identity(struct catalog *catalog, const char *id, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = write_identity(writer, id, error);
    sql_unlock(writer);
    return status;
}

/* Changes by others, our own writer among them, are a sign that the database takes some: only who holds it for long
 * without one is in the way. */
enum status catalog_sqlite_takes_changes(struct catalog *catalog, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct error unread = {0};
    int64_t version = 0;
    int64_t now_ms = clock_ms();
    sql_lock(sqlite->prober);
    enum status status = sql_begin(sqlite->prober, error);
    if (status == STATUS_OK) {
        enum status undone = sql_end(sqlite->prober, STATUS_CANCELLED, NULL);
        (void)undone;
        sqlite->blocked_ms = 0;
    } else {
        bool known = sql_number(sqlite->prober, "PRAGMA data_version", NULL, 0, &version, &unread) == STATUS_OK;
        if (!sqlite->blocked_ms || (known && version != sqlite->blocked_version)) {
            sqlite->blocked_ms = now_ms;
            sqlite->blocked_version = version;
        }
        if (now_ms - sqlite->blocked_ms < BLOCKED_MS) status = STATUS_OK;
    }
    sql_unlock(sqlite->prober);
    return status;
}

enum status catalog_sqlite_now(struct catalog *catalog, int64_t *now_ms, struct error *error) {
    (void)catalog, (void)error;
    *now_ms = job_now_ms();
    return STATUS_OK;
}

enum status catalog_sqlite_secret(struct catalog *catalog, const char *name, const char *brought,
                                  char secret[CATALOG_SECRET_BYTES], struct error *error) {
    (void)catalog, (void)name, (void)error;
    memcpy(secret, brought, strnlen(brought, CATALOG_SECRET_BYTES - 1) + 1);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the table */

const struct catalog_backend catalog_sqlite = {
    .scheme = "sqlite:",
    .is_valid = is_valid,
    .exists = exists,
    .open = open_path,
    .migrate = migrate,
#define OPERATION(name) .name = catalog_sqlite_##name,
#include "server/catalog/catalog_operations.def"
};
