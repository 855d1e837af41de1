/* Clouds: what a principal sees is the union of its rows here and of the inputs of its jobs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>
#include <time.h>

#include "server/base/away.h"
#include "server/catalog/postgres/catalog_postgres.h"

/* sure: that there is none is confirmed. */
static enum status select_clouds(struct catalog *catalog, bool sure, const char *text, const struct pq_value *values,
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
    if (status == STATUS_OK && sure && *count == 0) status = catalog_postgres_confirm(link, error);
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
    enum status status = select_clouds(catalog, true,
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
        catalog, false,
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

/* The row of a cloud in `expected` says until when somebody is about to refer to it; or, with `removal`, when the
 * removal of its bytes was begun, which is `removed` once it is certain that they are gone and that no request to
 * remove them is on its way.  What is removed is kept in mind for a time: who was about to refer to it and was stopped
 * for longer than it had is told so by a trigger (tables.c).  At the end of that time it is removed once more, since
 * storing may have ended after the removal, by a host that ended with it. */
enum { KNOWN_AS_REMOVED_MS = 24 * 3600 * 1000 };

static enum status try_to_expect(struct catalog_postgres *postgres, const char *cloud, int64_t until_ms,
                                 int64_t *expected, struct error *error) {
    struct pq_link *link;
    *expected = 0;
    enum status status = pq_take(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_number(link,
                       "INSERT INTO expected (cloud, until) VALUES ($1, $2) ON CONFLICT (cloud) "
                       "DO UPDATE SET until = greatest(expected.until, excluded.until), removal = 0, removed = 0 "
                       "WHERE expected.removal = 0 OR expected.removed = 1 RETURNING 1",
                       VALUES(T(cloud), I(until_ms)), expected, error);
    pq_done(link);
    return status;
}

/* A removal takes as long as an answer of the store. */
enum status catalog_postgres_expect_cloud(struct catalog *catalog, const char *cloud, int64_t until_ms,
                                          struct error *error) {
    enum { TRIES = 20, PAUSE_MS = 50 };
    static const struct timespec pause = {.tv_nsec = PAUSE_MS * 1000 * 1000};
    int64_t expected = 0;
    for (int i = 0; i < TRIES; i++) {
        enum status status = try_to_expect(catalog_postgres_of(catalog), cloud, until_ms, &expected, error);
        if (status != STATUS_OK || expected) return status;
        nanosleep(&pause, NULL);
    }
    return error_set(error, STATUS_IO, AWAY, "the cloud %.64s is being removed", cloud);
}

struct expectation {
    int64_t until_ms, removal_ms, is_removed;
};

/* The row, which is locked until the end of the transaction, and made where there is none. */
static enum status lock_expected(struct pq_link *link, const char *cloud, int64_t now_ms,
                                 struct expectation *expectation, struct error *error) {
    struct pq_rows *rows;
    enum status status = pq_run(link, "INSERT INTO expected (cloud, until) VALUES ($1, $2) ON CONFLICT DO NOTHING",
                                VALUES(T(cloud), I(now_ms)), NULL, error);
    if (status == STATUS_OK)
        status = pq_select(link, "SELECT until, removal, removed FROM expected WHERE cloud = $1 FOR UPDATE",
                           VALUES(T(cloud)), &rows, error);
    if (status != STATUS_OK) return status;
    *expectation = (struct expectation){.until_ms = INT64_MAX};
    if (pq_next(rows))
        *expectation = (struct expectation){pq_integer(rows, 0), pq_integer(rows, 1), pq_integer(rows, 2)};
    pq_free(rows);
    return STATUS_OK;
}

static enum status count_uses(struct pq_link *link, const char *cloud, int64_t *uses, struct error *error) {
    return pq_number(
        link, "SELECT (SELECT count(*) FROM jobs WHERE cloud = $1) + (SELECT count(*) FROM clouds WHERE sha256 = $1)",
        VALUES(T(cloud)), uses, error);
}

/* *begun: the bytes are to be removed, and nobody else does so; *again: they were before, and this is the last time.  A
 * removal that somebody has begun before, and that isn't over, is left to them for as long as what they asked for may
 * still be on its way. */
static enum status begin_removal(struct pq_link *link, const char *cloud, int64_t now_ms, bool *begun, bool *again,
                                 struct error *error) {
    struct expectation known;
    int64_t uses = 1;
    *begun = *again = false;
    enum status status = lock_expected(link, cloud, now_ms, &known, error);
    if (status != STATUS_OK || known.until_ms > now_ms) return status;
    bool is_old = known.removal_ms <= now_ms - (known.is_removed ? KNOWN_AS_REMOVED_MS : CATALOG_REMOVAL_GRACE_MS);
    if (known.removal_ms && !is_old) return STATUS_OK;
    status = count_uses(link, cloud, &uses, error);
    *begun = status == STATUS_OK && !uses;
    *again = *begun && known.is_removed;
    if (status != STATUS_OK) return status;
    return pq_run(link,
                  *begun ? "UPDATE expected SET removal = $2, removed = 0 WHERE cloud = $1"
                         : "DELETE FROM expected WHERE cloud = $1 AND until <= $2",
                  VALUES(T(cloud), I(now_ms)), NULL, error);
}

/* Where it isn't noted it is tried again. */
static void end_removal(struct catalog_postgres *postgres, const char *cloud, int64_t begun_ms, bool again) {
    struct pq_link *link;
    struct error ignored;
    if (pq_take(postgres->pq, &link, &ignored) != STATUS_OK) return;
    enum status ended = pq_run(link,
                               again ? "DELETE FROM expected WHERE cloud = $1 AND removal = $2"
                                     : "UPDATE expected SET removed = 1 WHERE cloud = $1 AND removal = $2",
                               VALUES(T(cloud), I(begun_ms)), NULL, &ignored);
    (void)ended;
    pq_done(link);
}

/* That it is begun is committed before the store is asked: where its answer is lost, or who asked is, nobody puts what
 * a request that comes late would remove. */
enum status catalog_postgres_remove_cloud(struct catalog *catalog, const char *cloud,
                                          const struct catalog_removal *removal, bool *removed, struct error *error) {
    struct pq_link *link;
    bool begun = false, again = false;
    *removed = false;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_end(link, begin_removal(link, cloud, removal->now_ms, &begun, &again, error), NULL, error);
    *removed = status == STATUS_OK && begun;
    if (*removed && removal->remove(removal->ctx, cloud))
        end_removal(catalog_postgres_of(catalog), cloud, removal->now_ms, again);
    return status;
}

enum status catalog_postgres_list_unused_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                                size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link,
                       "SELECT cloud FROM expected WHERE until <= $1 AND (removal = 0 OR "
                       "removal <= $1 - CASE removed WHEN 0 THEN $3 ELSE $4 END) ORDER BY until LIMIT $2",
                       VALUES(I(now_ms), I(max), I(CATALOG_REMOVAL_GRACE_MS), I(KNOWN_AS_REMOVED_MS)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) pq_copy_text(rows, 0, names[(*count)++], JOB_HASH_BYTES);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}
