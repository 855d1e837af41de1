/* The table of clouds.
 *
 * What a principal sees is the union of its rows here and of the inputs of its jobs, so that a job's upload costs no
 * second row.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

#include <stdlib.h>
#include <string.h>

#include "server/base/away.h"

/* Reads and ends; *count is 0 on failure. */
static enum status read_records(struct sql_rows *row, struct catalog_cloud *records, size_t max, size_t *count,
                                struct error *error) {
    *count = 0;
    struct catalog_cells cells = catalog_sqlite_cells(row);
    while (*count < max && sql_next(row)) catalog_cells_read_cloud(&cells, &records[(*count)++]);
    enum status status = sql_finish(row, error);
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) catalog_cloud_done(&records[i]);
    *count = 0;
    return status;
}

static enum status put_cloud(struct sql *db, const struct catalog_cloud *record, struct error *error) {
    return sql_run(db,
                   "INSERT INTO clouds (sha256, principal, created, expires, bytes, points, format) "
                   "VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7) "
                   "ON CONFLICT DO UPDATE SET expires = max(expires, excluded.expires)",
                   VALUES(T(record->sha256), T(record->principal), I(record->created_ms), I(record->expires_ms),
                          I(record->bytes), I(record->points), T(record->format)),
                   error);
}

enum status catalog_sqlite_put_cloud(struct catalog *catalog, const struct catalog_cloud *record,
                                     uint64_t principal_bytes, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->writer;
    int64_t known = 0;
    catalog_sqlite_enter(sqlite);
    enum status status = sql_number(db, "SELECT count(*) FROM clouds WHERE sha256 = ?1 AND principal = ?2",
                                    VALUES(T(record->sha256), T(record->principal)), &known, error);
    uint64_t bytes = known ? 0 : record->bytes, limit = known ? 0 : principal_bytes;
    if (status == STATUS_OK) status = catalog_reserve(catalog, record->principal, bytes, limit, error);
    if (status == STATUS_OK) {
        status = put_cloud(db, record, error);
        catalog_sqlite_refresh_usage(sqlite, record->principal);
        catalog_release(catalog, record->principal, bytes);
    }
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_get_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                     struct catalog_cloud *record, bool *found, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->reader;
    struct sql_rows *row;
    size_t count = 0;
    memset(record, 0, sizeof *record);
    sql_lock(db);
    enum status status = sql_select(db,
                                    CATALOG_SELECT_CLOUDS("sha256 = ?1 AND (?2 IS NULL OR principal = ?2)",
                                                          "cloud = ?1 AND (?2 IS NULL OR principal = ?2)"),
                                    VALUES(T(sha256), T(principal)), &row, error);
    if (status == STATUS_OK) status = read_records(row, record, 1, &count, error);
    sql_unlock(db);
    *found = count == 1;
    return status;
}

enum status catalog_sqlite_list_clouds(struct catalog *catalog, const char *principal, const char *after,
                                       struct catalog_cloud *records, size_t max, size_t *count, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->reader;
    struct sql_rows *row;
    *count = 0;
    sql_lock(db);
    enum status status = sql_select(
        db,
        CATALOG_SELECT_CLOUDS("?1 IS NULL OR principal = ?1",
                              "?1 IS NULL OR principal = ?1") "WHERE ?2 IS NULL OR (created, sha256) < (SELECT "
                                                              "created, sha256 FROM seen WHERE sha256 = ?2) "
                                                              "ORDER BY created DESC, sha256 DESC LIMIT ?3",
        VALUES(T(principal), T(after), I(max)), &row, error);
    if (status == STATUS_OK) status = read_records(row, records, max, count, error);
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_delete_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                        struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->writer;
    catalog_sqlite_enter(sqlite);
    enum status status = sql_run(db, "DELETE FROM clouds WHERE sha256 = ?1 AND (?2 IS NULL OR principal = ?2)",
                                 VALUES(T(sha256), T(principal)), error);
    catalog_sqlite_refresh_usage(sqlite, NULL);
    sql_unlock(db);
    return status;
}

/* Over, and without a job of its principal. */
static enum status expire(struct sql *db, int64_t now_ms, char (*names)[JOB_HASH_BYTES], size_t max, size_t *count,
                          struct error *error) {
    struct sql_rows *row;
    enum status status =
        sql_select(db,
                   "DELETE FROM clouds WHERE (sha256, principal) IN (SELECT sha256, principal FROM clouds AS old "
                   "WHERE expires <= ?1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE cloud = old.sha256 "
                   "AND principal = old.principal) ORDER BY expires LIMIT ?2) RETURNING sha256",
                   VALUES(I(now_ms), I(max)), &row, error);
    if (status != STATUS_OK) return status;
    while (*count < max && sql_next(row)) sql_copy_text(row, 0, names[(*count)++], JOB_HASH_BYTES);
    return sql_finish(row, error);
}

enum status catalog_sqlite_expire_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                         size_t max, size_t *count, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->writer;
    *count = 0;
    catalog_sqlite_enter(sqlite);
    enum status status = expire(db, now_ms, names, max, count, error);
    if (*count) catalog_sqlite_refresh_usage(sqlite, NULL);
    sql_unlock(db);
    return status;
}

enum status catalog_sqlite_next_cloud(struct catalog *catalog, const char *after, char name[JOB_HASH_BYTES],
                                      bool *found, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    struct sql *db = sqlite->reader;
    struct sql_rows *row;
    *found = false;
    sql_lock(db);
    enum status status = sql_select(db, "SELECT sha256 FROM clouds WHERE sha256 > ?1 ORDER BY sha256 LIMIT 1",
                                    VALUES(T(after)), &row, error);
    if (status == STATUS_OK) {
        *found = sql_next(row);
        if (*found) sql_copy_text(row, 0, name, JOB_HASH_BYTES);
        status = sql_finish(row, error);
    }
    sql_unlock(db);
    return status;
}

/* ------------------------------------------------------------------------------------------------ garbage */

/* A row of `removals` says since when the bytes of a cloud are being removed, in a store that may do so late; it goes
 * once it is certain that nothing of that is still on its way.  That nobody refers to a cloud which is being removed is
 * for a lock of the process that serves the database, so a row is looked at where an earlier removal has left it. */
static enum status find_removal(struct sql *db, const char *cloud, int64_t *begun_ms, struct error *error) {
    *begun_ms = 0;
    return sql_number(db, "SELECT begun FROM removals WHERE cloud = ?1", VALUES(T(cloud)), begun_ms, error);
}

enum status catalog_sqlite_expect_cloud(struct catalog *catalog, const char *cloud, int64_t until_ms,
                                        struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->reader;
    int64_t begun_ms;
    (void)until_ms;
    sql_lock(db);
    enum status status = find_removal(db, cloud, &begun_ms, error);
    sql_unlock(db);
    if (status != STATUS_OK || !begun_ms) return status;
    return error_set(error, STATUS_IO, AWAY, "the cloud %.64s is being removed", cloud);
}

/* *begun: nobody refers to the cloud, and what was asked for before can't come to pass any more. */
static enum status begin_removal(struct catalog_sqlite *sqlite, const char *cloud,
                                 const struct catalog_removal *removal, bool *begun, struct error *error) {
    struct sql *db = sqlite->writer;
    int64_t begun_ms;
    catalog_sqlite_enter(sqlite);
    enum status status = find_removal(db, cloud, &begun_ms, error);
    *begun = status == STATUS_OK && (!begun_ms || begun_ms <= removal->now_ms - CATALOG_REMOVAL_GRACE_MS);
    if (*begun && removal->may_be_late)
        status = sql_run(db, "INSERT OR REPLACE INTO removals (cloud, begun) VALUES (?1, ?2)",
                         VALUES(T(cloud), I(removal->now_ms)), error);
    sql_unlock(db);
    *begun = *begun && status == STATUS_OK;
    return status;
}

/* Where it isn't noted it is tried again. */
static void end_removal(struct catalog_sqlite *sqlite, const char *cloud) {
    struct error ignored;
    catalog_sqlite_enter(sqlite);
    enum status ended =
        sql_run_nosync(sqlite->writer, "DELETE FROM removals WHERE cloud = ?1", VALUES(T(cloud)), &ignored);
    (void)ended;
    sql_unlock(sqlite->writer);
}

enum status catalog_sqlite_remove_cloud(struct catalog *catalog, const char *cloud,
                                        const struct catalog_removal *removal, bool *removed, struct error *error) {
    struct catalog_sqlite *sqlite = catalog_sqlite_of(catalog);
    uint64_t uses = 1;
    *removed = false;
    enum status status = catalog_sqlite_cloud_uses(catalog, cloud, &uses, error);
    if (status == STATUS_OK && !uses) status = begin_removal(sqlite, cloud, removal, removed, error);
    if (*removed && removal->remove(removal->ctx, cloud) && removal->may_be_late) end_removal(sqlite, cloud);
    return status;
}

enum status catalog_sqlite_list_unused_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                              size_t max, size_t *count, struct error *error) {
    struct sql *db = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *row;
    *count = 0;
    sql_lock(db);
    enum status status = sql_select(db, "SELECT cloud FROM removals WHERE begun <= ?1 ORDER BY begun LIMIT ?2",
                                    VALUES(I(now_ms - CATALOG_REMOVAL_GRACE_MS), I(max)), &row, error);
    if (status == STATUS_OK) {
        while (*count < max && sql_next(row)) sql_copy_text(row, 0, names[(*count)++], JOB_HASH_BYTES);
        status = sql_finish(row, error);
    }
    sql_unlock(db);
    return status;
}
