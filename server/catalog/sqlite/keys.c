/* Keys: those under way in a list, those done in a table.
 *
 * The list is short, a few entries for each connection at most, so it is gone through from its start.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/catalog_sqlite.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

/* ------------------------------------------------------------------------------------------------ under way */

static bool is_same(const struct catalog_key_hold *hold, const char *principal, const char *key) {
    return strcmp(hold->key, key) == 0 && strcmp(hold->principal, principal) == 0;
}

enum status catalog_sqlite_hold_key(struct catalog *catalog, const char *principal, const char *key,
                                    struct catalog_key_hold *hold, struct error *error) {
    (void)error;
    struct key_holds *keys = &catalog_sqlite_of(catalog)->keys;
    pthread_mutex_lock(&keys->lock);
    const struct catalog_key_hold *other = keys->first;
    while (other && !is_same(other, principal, key)) other = other->next;
    if (!other) {
        *hold = (struct catalog_key_hold){principal, key, true, NULL, keys->first};
        if (hold->next) hold->next->previous = hold;
        keys->first = hold;
    }
    pthread_mutex_unlock(&keys->lock);
    return STATUS_OK;
}

void catalog_sqlite_release_key(struct catalog *catalog, struct catalog_key_hold *hold) {
    struct key_holds *keys = &catalog_sqlite_of(catalog)->keys;
    if (!hold->held) return;
    pthread_mutex_lock(&keys->lock);
    if (hold->previous) hold->previous->next = hold->next;
    if (hold->next) hold->next->previous = hold->previous;
    if (keys->first == hold) keys->first = hold->next;
    pthread_mutex_unlock(&keys->lock);
    *hold = (struct catalog_key_hold){.held = false};
}

/* ------------------------------------------------------------------------------------------------ done */

enum status catalog_sqlite_find_reply(struct catalog *catalog, const char *principal, const char *key,
                                      struct catalog_reply *record, bool *found, struct error *error) {
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *row;
    memset(record, 0, sizeof *record);
    *found = false;
    sql_lock(reader);
    enum status status = sql_select(reader,
                                    "SELECT fingerprint, made, etag, status, reply FROM replies "
                                    "WHERE principal = ?1 AND key = ?2",
                                    VALUES(T(principal), T(key)), &row, error);
    if (status == STATUS_OK) {
        *found = sql_next(row);
        if (*found) {
            sql_copy_text(row, 0, record->fingerprint, sizeof record->fingerprint);
            sql_copy_text(row, 1, record->made, sizeof record->made);
            sql_copy_text(row, 2, record->etag, sizeof record->etag);
            record->status = (int)sql_integer(row, 3);
            record->reply = sql_new_text(row, 4);
        }
        status = sql_finish(row, error);
    }
    sql_unlock(reader);
    return status;
}

enum status catalog_sqlite_add_key(struct sql *writer, const char *principal, const struct job_key *key,
                                   const char *made, int64_t now_ms, struct error *error) {
    return sql_run(writer, "INSERT INTO replies (principal, key, fingerprint, made, at) VALUES (?1, ?2, ?3, ?4, ?5)",
                   VALUES(T(principal), T(key->key), T(key->fingerprint), T(made), I(now_ms)), error);
}

enum status catalog_sqlite_put_key(struct catalog *catalog, const char *principal, const struct job_key *key,
                                   const char *made, int64_t now_ms, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = catalog_sqlite_add_key(writer, principal, key, made, now_ms, error);
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_keep_reply(struct catalog *catalog, const char *principal, const char *key, int status_code,
                                      const char *etag, const char *reply, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run_nosync(
        writer, "UPDATE replies SET status = ?3, etag = ?4, reply = ?5 WHERE principal = ?1 AND key = ?2",
        VALUES(T(principal), T(key), I(status_code), T(etag), T(reply)), error);
    sql_unlock(writer);
    return status;
}

enum status catalog_sqlite_forget_keys(struct catalog *catalog, int64_t before_ms, struct error *error) {
    struct sql *writer = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    enum status status = sql_run(writer, "DELETE FROM replies WHERE at < ?1", VALUES(I(before_ms)), error);
    sql_unlock(writer);
    return status;
}
