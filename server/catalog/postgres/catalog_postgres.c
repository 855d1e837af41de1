/* The catalog in PostgreSQL: opening it, identity, health, limits, and its table of functions.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/postgres/catalog_postgres.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "server/base/random.h"
#include "server/catalog/postgres/tables.h"

/* ------------------------------------------------------------------------------------------------ open */

/* libpq needs the whole URL; the catalog's table has taken its scheme off. */
static void make_url(const char *where, char url[CATALOG_URL_BYTES]) {
    snprintf(url, CATALOG_URL_BYTES, "postgresql://%.4100s", where);
}

static bool is_valid(const char *where) {
    char url[CATALOG_URL_BYTES];
    make_url(where, url);
    return pq_valid(url);
}

/* A server always holds something: whether it is a catalog is seen when it is opened. */
static bool exists(const char *where) { return is_valid(where); }

static enum status check_schema(struct catalog_postgres *postgres, struct error *error) {
    struct pq_link *link;
    enum status status = pq_take(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = tables_check(link, error);
    pq_done(link);
    return status;
}

static enum status open_server(const char *where, bool as_is, struct catalog **catalog, struct error *error) {
    char url[CATALOG_URL_BYTES];
    struct catalog_postgres *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "catalog", "no memory");
    opened->catalog.backend = &catalog_postgres;
    pthread_mutex_init(&opened->later_lock, NULL);
    random_name(opened->session);
    make_url(where, url);
    enum status status = pq_open(url, &opened->pq, error);
    if (status == STATUS_OK && !as_is) status = check_schema(opened, error);
    if (status == STATUS_OK && !as_is) status = catalog_postgres_listen(opened, error);
    if (status == STATUS_OK)
        *catalog = &opened->catalog;
    else
        catalog_postgres_close(&opened->catalog);
    return status;
}

static enum status migrate(const char *where, struct error *error) {
    char url[CATALOG_URL_BYTES];
    struct pq *pq = NULL;
    make_url(where, url);
    enum status status = pq_open(url, &pq, error);
    if (status == STATUS_OK) status = tables_migrate(pq, error);
    pq_close(pq);
    return status;
}

void catalog_postgres_close(struct catalog *catalog) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    if (postgres->pq) catalog_postgres_deafen(postgres);
    while (postgres->later) {
        struct later *next = postgres->later->next;
        free(postgres->later);
        postgres->later = next;
    }
    pthread_mutex_destroy(&postgres->later_lock);
    pq_close(postgres->pq);
    free(postgres);
}

static void watch(struct catalog *catalog) { catalog_postgres_of(catalog)->is_watched = true; }

/* ------------------------------------------------------------------------------------------------ identity, health */

enum status catalog_postgres_identity(struct catalog *catalog, char id[CATALOG_IDENTITY_BYTES], struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    id[0] = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, "SELECT id FROM identity", NULL, 0, &rows, error);
    if (status == STATUS_OK) {
        if (pq_next(rows)) pq_copy_text(rows, 0, id, CATALOG_IDENTITY_BYTES);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

enum status catalog_postgres_set_identity(struct catalog *catalog, const char *id, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "INSERT INTO identity VALUES (1, $1) ON CONFLICT (one) DO UPDATE SET id = excluded.id",
                    VALUES(T(id)), NULL, error);
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_now(struct catalog *catalog, int64_t *now_ms, struct error *error) {
    struct pq_link *link;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_number(link, "SELECT whittle_now()", NULL, 0, now_ms, error);
    pq_done(link);
    return status;
}

enum status catalog_postgres_secret(struct catalog *catalog, const char *name, const char *brought,
                                    char secret[CATALOG_SECRET_BYTES], struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "INSERT INTO secrets (name, value) VALUES ($1, $2) ON CONFLICT (name) DO NOTHING",
                    VALUES(T(name), T(brought)), NULL, error);
    if (status == STATUS_OK)
        status = pq_select(link, "SELECT value FROM secrets WHERE name = $1", VALUES(T(name)), &rows, error);
    if (status == STATUS_OK) {
        if (pq_next(rows)) pq_copy_text(rows, 0, secret, CATALOG_SECRET_BYTES);
        pq_free(rows);
    }
    return pq_end(link, status, NULL, error);
}

/* A standby, and a server that is stopped, take none. */
enum status catalog_postgres_takes_changes(struct catalog *catalog, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_execute(link, "SELECT pg_current_xact_id()", error);
    return pq_end(link, status, NULL, error);
}

/* A transaction waits for its standby where it has written something: here a message that nobody reads. */
enum status catalog_postgres_confirm(struct pq_link *link, struct error *error) {
    return pq_execute(link, "SELECT pg_logical_emit_message(true, 'whittle', '')", error);
}

/* ------------------------------------------------------------------------------------------------ what principals have
 */

/* What sessions have reserved, and what uploads will have, or have, whose length isn't known. */
#define RESERVED                                                                                                       \
    "(coalesce((SELECT sum(r.bytes) FROM reservations r JOIN sessions s ON s.id = r.session "                          \
    "WHERE r.principal = $1 AND s.lease > whittle_now()), 0) + coalesce((SELECT sum(CASE WHEN length < 0 THEN "        \
    "position ELSE length END) FROM uploads WHERE principal = $1 AND cloud = ''), 0))::BIGINT"

static uint64_t count_of(const struct pq_rows *rows, int column) {
    int64_t value = pq_integer(rows, column);
    return value > 0 ? (uint64_t)value : 0;
}

struct catalog_usage catalog_postgres_usage(struct catalog *catalog, const char *principal) {
    struct catalog_usage usage = {0};
    struct error ignored;
    struct pq_link *link;
    struct pq_rows *rows;
    if (pq_take_soon(catalog_postgres_of(catalog)->pq, &link, &ignored) != STATUS_OK) return usage;
    if (pq_select(link,
                  "SELECT coalesce((SELECT active FROM usage WHERE principal = $1), 0), "
                  "coalesce((SELECT bytes FROM usage WHERE principal = $1), 0), " RESERVED,
                  VALUES(T(principal)), &rows, &ignored) == STATUS_OK) {
        if (pq_next(rows))
            usage = (struct catalog_usage){
                .active = count_of(rows, 0), .bytes = count_of(rows, 1), .reserved = count_of(rows, 2)};
        pq_free(rows);
    }
    pq_done(link);
    return usage;
}

enum status catalog_postgres_check_bytes(struct pq_link *link, const char *principal, uint64_t bytes, uint64_t limit,
                                         struct error *error) {
    int64_t has = 0;
    enum status status = pq_run(link,
                                "INSERT INTO usage (principal, active, bytes) VALUES ($1, 0, 0) "
                                "ON CONFLICT (principal) DO UPDATE SET active = usage.active",
                                VALUES(T(principal)), NULL, error);
    if (status == STATUS_OK)
        status = pq_number(link, "SELECT bytes + " RESERVED " FROM usage WHERE principal = $1", VALUES(T(principal)),
                           &has, error);
    if (status != STATUS_OK || !limit || ((uint64_t)has <= limit && bytes <= limit - (uint64_t)has)) return status;
    return error_set(error, STATUS_LIMIT, "principal_bytes", "%lld bytes are kept for you, %llu may be", (long long)has,
                     (unsigned long long)limit);
}

/* Not durable: what is reserved ends with the session anyway. */
enum status catalog_postgres_reserve(struct catalog *catalog, const char *principal, uint64_t bytes, uint64_t limit,
                                     struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    if (!bytes && !limit) return STATUS_OK;
    enum status status = pq_begin_soon(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "SET LOCAL synchronous_commit = off", NULL, 0, NULL, error);
    if (status == STATUS_OK) status = catalog_postgres_check_bytes(link, principal, bytes, limit, error);
    if (status == STATUS_OK)
        status = pq_run(link,
                        "INSERT INTO reservations AS r (session, principal, bytes) VALUES ($1, $2, $3) "
                        "ON CONFLICT (principal, session) DO UPDATE SET bytes = r.bytes + excluded.bytes",
                        VALUES(T(postgres->session), T(principal), I(bytes)), NULL, error);
    bool unknown = false;
    status = pq_end(link, status, &unknown, error);
    if (unknown) catalog_postgres_release_later(postgres, principal, NULL, bytes); /* never below 0 */
    return status;
}

enum status catalog_postgres_give_back(struct catalog_postgres *postgres, struct pq_link *link, const char *principal,
                                       uint64_t bytes, struct error *error) {
    enum status status =
        pq_run(link, "UPDATE reservations SET bytes = greatest(bytes - $3, 0) WHERE principal = $2 AND session = $1",
               VALUES(T(postgres->session), T(principal), I(bytes)), NULL, error);
    return pq_end(link, status, NULL, error);
}

void catalog_postgres_release(struct catalog *catalog, const char *principal, uint64_t bytes) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    struct error ignored;
    if (!bytes) return;
    if (pq_begin_soon(postgres->pq, &link, &ignored) != STATUS_OK ||
        catalog_postgres_give_back(postgres, link, principal, bytes, &ignored) != STATUS_OK)
        catalog_postgres_release_later(postgres, principal, NULL, bytes);
}

/* ------------------------------------------------------------------------------------------------ the table */

const struct catalog_backend catalog_postgres = {
    .scheme = "postgresql://",
    .is_shared = true,
    .is_valid = is_valid,
    .exists = exists,
    .open = open_server,
    .migrate = migrate,
    .watch = watch,
#define OPERATION(name) .name = catalog_postgres_##name,
#include "server/catalog/catalog_operations.def"
#define OPERATION(name) .name = catalog_postgres_##name,
#include "server/catalog/catalog_shared_operations.def"
};
