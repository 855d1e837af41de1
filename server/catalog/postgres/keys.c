/* Keys: those under way are held by a session, those done are in a table of their own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

/* A key whose session has ended is anybody's.  Where the database doesn't answer nobody gets one, and what may have
 * come of the attempt is taken back: whoever asks comes again. */
enum status catalog_postgres_hold_key(struct catalog *catalog, const char *principal, const char *key,
                                      struct catalog_key_hold *hold, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    int64_t taken = 0;
    enum status status = pq_begin_soon(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "SET LOCAL synchronous_commit = off", NULL, 0, NULL, error);
    if (status == STATUS_OK)
        status = pq_run(link,
                        "INSERT INTO holds (principal, key, session) VALUES ($1, $2, $3) "
                        "ON CONFLICT (principal, key) DO UPDATE SET session = excluded.session WHERE NOT EXISTS "
                        "(SELECT 1 FROM sessions WHERE id = holds.session AND lease > whittle_now())",
                        VALUES(T(principal), T(key), T(postgres->session)), &taken, error);
    status = pq_end(link, status, NULL, error);
    if (status != STATUS_OK) catalog_postgres_release_later(postgres, principal, key, 0);
    if (status == STATUS_OK && taken)
        *hold = (struct catalog_key_hold){.principal = principal, .key = key, .held = true};
    return status;
}

/* Durable: a failover that undid it would leave the key held for as long as this process lives. */
enum status catalog_postgres_give_up_key(struct catalog_postgres *postgres, struct pq_link *link, const char *principal,
                                         const char *key, struct error *error) {
    enum status status = pq_run(link, "DELETE FROM holds WHERE principal = $1 AND key = $2 AND session = $3",
                                VALUES(T(principal), T(key), T(postgres->session)), NULL, error);
    return pq_end(link, status, NULL, error);
}

void catalog_postgres_release_key(struct catalog *catalog, struct catalog_key_hold *hold) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    struct error ignored;
    if (!hold->held) return;
    if (pq_begin_soon(postgres->pq, &link, &ignored) != STATUS_OK ||
        catalog_postgres_give_up_key(postgres, link, hold->principal, hold->key, &ignored) != STATUS_OK)
        catalog_postgres_release_later(postgres, hold->principal, hold->key, 0);
    *hold = (struct catalog_key_hold){.held = false};
}

enum status catalog_postgres_find_reply(struct catalog *catalog, const char *principal, const char *key,
                                        struct catalog_reply *record, bool *found, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    memset(record, 0, sizeof *record);
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status =
        pq_select(link, "SELECT fingerprint, made, etag, status, reply FROM replies WHERE principal = $1 AND key = $2",
                  VALUES(T(principal), T(key)), &rows, error);
    if (status == STATUS_OK) {
        *found = pq_next(rows);
        if (*found) {
            pq_copy_text(rows, 0, record->fingerprint, sizeof record->fingerprint);
            pq_copy_text(rows, 1, record->made, sizeof record->made);
            pq_copy_text(rows, 2, record->etag, sizeof record->etag);
            record->status = (int)pq_integer(rows, 3);
            record->reply = pq_new_text(rows, 4);
        }
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

enum status catalog_postgres_add_key(struct pq_link *link, const char *principal, const struct job_key *key,
                                     const char *made, int64_t now_ms, struct error *error) {
    return pq_run(link, "INSERT INTO replies (principal, key, fingerprint, made, at) VALUES ($1, $2, $3, $4, $5)",
                  VALUES(T(principal), T(key->key), T(key->fingerprint), T(made), I(now_ms)), NULL, error);
}

enum status catalog_postgres_put_key(struct catalog *catalog, const char *principal, const struct job_key *key,
                                     const char *made, int64_t now_ms, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, catalog_postgres_add_key(link, principal, key, made, now_ms, error), NULL, error);
}

enum status catalog_postgres_keep_reply(struct catalog *catalog, const char *principal, const char *key,
                                        int status_code, const char *etag, const char *reply, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "SET LOCAL synchronous_commit = off", NULL, 0, NULL, error);
    if (status == STATUS_OK)
        status = pq_run(link, "UPDATE replies SET status = $3, etag = $4, reply = $5 WHERE principal = $1 AND key = $2",
                        VALUES(T(principal), T(key), I(status_code), T(etag), T(reply)), NULL, error);
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_forget_keys(struct catalog *catalog, int64_t before_ms, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, "DELETE FROM replies WHERE at < $1", VALUES(I(before_ms)), NULL, error), NULL,
                  error);
}
