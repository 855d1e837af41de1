/* Clouds: what a principal sees is the union of its rows here and of the inputs of its jobs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

static enum status select_clouds(struct catalog *catalog, const char *text, const struct pq_value *values,
                                 size_t value_count, struct catalog_cloud *records, size_t max, size_t *count,
                                 struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, text, values, value_count, &rows, error);
    if (status == STATUS_OK) {
        struct catalog_cells cells = catalog_postgres_cells(rows);
        while (*count < max && pq_next(rows)) catalog_cells_read_cloud(&cells, &records[(*count)++]);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

static enum status put(struct pq_link *link, const struct catalog_cloud *record, uint64_t principal_bytes,
                       struct error *error) {
    int64_t known = 0;
    /* The row before what the principal has (usage): in the order in which the end of clouds takes them. */
    enum status status = pq_run(link, "SELECT 1 FROM clouds WHERE sha256 = $1 AND principal = $2 FOR UPDATE",
                                VALUES(T(record->sha256), T(record->principal)), NULL, error);
    if (status == STATUS_OK)
        status = catalog_postgres_check_bytes(link, record->principal, 0, 0, error); /* locks what it has */
    if (status == STATUS_OK)
        status = pq_number(link, "SELECT count(*) FROM clouds WHERE sha256 = $1 AND principal = $2",
                           VALUES(T(record->sha256), T(record->principal)), &known, error);
    if (status == STATUS_OK && !known)
        status = catalog_postgres_check_bytes(link, record->principal, record->bytes, principal_bytes, error);
    if (status != STATUS_OK) return status;
    return pq_run(link,
                  "INSERT INTO clouds (sha256, principal, created, expires, bytes, points, format) "
                  "VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (sha256, principal) "
                  "DO UPDATE SET expires = greatest(clouds.expires, excluded.expires)",
                  VALUES(T(record->sha256), T(record->principal), I(record->created_ms), I(record->expires_ms),
                         I(record->bytes), I(record->points), T(record->format)),
                  NULL, error);
}

enum status catalog_postgres_put_cloud(struct catalog *catalog, const struct catalog_cloud *record,
                                       uint64_t principal_bytes, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    return status == STATUS_OK ? pq_end(link, put(link, record, principal_bytes, error), NULL, error) : status;
}

enum status catalog_postgres_get_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                       struct catalog_cloud *record, bool *found, struct error *error) {
    size_t count;
    memset(record, 0, sizeof *record);
    enum status status = select_clouds(catalog,
                                       CATALOG_SELECT_CLOUDS("sha256 = $1 AND ($2 IS NULL OR principal = $2)",
                                                             "cloud = $1 AND ($2 IS NULL OR principal = $2)"),
                                       VALUES(T(sha256), T(principal)), record, 1, &count, error);
    *found = count == 1;
    return status;
}

enum status catalog_postgres_list_clouds(struct catalog *catalog, const char *principal, const char *after,
                                         struct catalog_cloud *records, size_t max, size_t *count,
                                         struct error *error) {
    return select_clouds(
        catalog,
        CATALOG_SELECT_CLOUDS("$1 IS NULL OR principal = $1",
                              "$1 IS NULL OR principal = $1") "WHERE $2 IS NULL OR (created, sha256) < (SELECT "
                                                              "created, sha256 FROM seen WHERE sha256 = $2) "
                                                              "ORDER BY created DESC, sha256 DESC LIMIT $3",
        VALUES(T(principal), T(after), I(max)), records, max, count, error);
}

enum status catalog_postgres_delete_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                          struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "DELETE FROM clouds WHERE sha256 = $1 AND ($2 IS NULL OR principal = $2)",
                    VALUES(T(sha256), T(principal)), NULL, error);
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_expire_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                           size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    /* Whoever waits for a row sees what it has become in the outer condition alone. */
    status = pq_select(link,
                       "DELETE FROM clouds WHERE expires <= $1 AND (sha256, principal) IN (SELECT sha256, principal "
                       "FROM clouds AS old "
                       "WHERE expires <= $1 AND NOT EXISTS (SELECT 1 FROM jobs WHERE cloud = old.sha256 "
                       "AND principal = old.principal) ORDER BY expires LIMIT $2) RETURNING sha256",
                       VALUES(I(now_ms), I(max)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) pq_copy_text(rows, 0, names[(*count)++], JOB_HASH_BYTES);
        pq_free(rows);
    }
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_next_cloud(struct catalog *catalog, const char *after, char name[JOB_HASH_BYTES],
                                        bool *found, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, "SELECT sha256 FROM clouds WHERE sha256 > $1 ORDER BY sha256 LIMIT 1", VALUES(T(after)),
                       &rows, error);
    if (status == STATUS_OK) {
        *found = pq_next(rows);
        if (*found) pq_copy_text(rows, 0, name, JOB_HASH_BYTES);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

enum status catalog_postgres_cloud_uses(struct catalog *catalog, const char *cloud, uint64_t *uses,
                                        struct error *error) {
    struct pq_link *link;
    int64_t number = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_number(
        link, "SELECT (SELECT count(*) FROM jobs WHERE cloud = $1) + (SELECT count(*) FROM clouds WHERE sha256 = $1)",
        VALUES(T(cloud)), &number, error);
    pq_done(link);
    if (status == STATUS_OK) *uses = (uint64_t)number;
    return status;
}

/* ------------------------------------------------------------------------------------------------ garbage */

/* The row of a cloud in `expected`, locked until the end of the transaction; with the time until which it is. */
#define EXPECT                                                                                                         \
    "INSERT INTO expected (cloud, until) VALUES ($1, $2) ON CONFLICT (cloud) "                                         \
    "DO UPDATE SET until = greatest(expected.until, excluded.until) RETURNING until"

enum status catalog_postgres_expect_cloud(struct catalog *catalog, const char *cloud, int64_t until_ms,
                                          struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, EXPECT, VALUES(T(cloud), I(until_ms)), NULL, error), NULL, error);
}

static enum status count_uses(struct pq_link *link, const char *cloud, int64_t *uses, struct error *error) {
    return pq_number(
        link, "SELECT (SELECT count(*) FROM jobs WHERE cloud = $1) + (SELECT count(*) FROM clouds WHERE sha256 = $1)",
        VALUES(T(cloud)), uses, error);
}

enum status catalog_postgres_remove_cloud(struct catalog *catalog, const char *cloud, int64_t now_ms,
                                          void (*remove)(void *ctx, const char *cloud), void *ctx, bool *removed,
                                          struct error *error) {
    struct pq_link *link;
    int64_t until_ms = INT64_MAX, uses = 1;
    *removed = false;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    /* The store is asked with the row locked, and takes its time. */
    status = pq_run(link, "SET LOCAL idle_in_transaction_session_timeout = 0", NULL, 0, NULL, error);
    if (status == STATUS_OK) status = pq_number(link, EXPECT, VALUES(T(cloud), I(now_ms)), &until_ms, error);
    if (status == STATUS_OK && until_ms <= now_ms) status = count_uses(link, cloud, &uses, error);
    if (status == STATUS_OK && !uses) remove(ctx, cloud);
    if (status == STATUS_OK && until_ms <= now_ms)
        status = pq_run(link, "DELETE FROM expected WHERE cloud = $1", VALUES(T(cloud)), NULL, error);
    *removed = status == STATUS_OK && !uses;
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_list_unused_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                                size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, "SELECT cloud FROM expected WHERE until <= $1 ORDER BY until LIMIT $2",
                       VALUES(I(now_ms), I(max)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) pq_copy_text(rows, 0, names[(*count)++], JOB_HASH_BYTES);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}
