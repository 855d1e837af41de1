/* Keys: those under way in a list, those done in a table.
 *
 * The list is short, a few entries for each connection at most, so it is gone through from its start.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/idempotency.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "server/sql.h"

struct idempotency {
    pthread_mutex_t lock;
    struct idempotency_claim *first;
};

struct idempotency *idempotency_new(void) {
    struct idempotency *idempotency = calloc(1, sizeof *idempotency);
    if (idempotency) pthread_mutex_init(&idempotency->lock, NULL);
    return idempotency;
}

void idempotency_free(struct idempotency *idempotency) {
    if (!idempotency) return;
    pthread_mutex_destroy(&idempotency->lock);
    free(idempotency);
}

bool idempotency_key_valid(const char *key) {
    size_t length = strlen(key);
    for (const char *c = key; *c; c++)
        if (*c <= ' ' || *c > '~') return false;
    return length > 0 && length < IDEMPOTENCY_KEY_BYTES;
}

/* ------------------------------------------------------------------------------------------------ under way */

static bool is_same(const struct idempotency_claim *claim, const char *principal, const char *key) {
    return strcmp(claim->key, key) == 0 && strcmp(claim->principal, principal) == 0;
}

bool idempotency_claim(struct idempotency *idempotency, const char *principal, const char *key,
                       struct idempotency_claim *claim) {
    pthread_mutex_lock(&idempotency->lock);
    const struct idempotency_claim *other = idempotency->first;
    while (other && !is_same(other, principal, key)) other = other->next;
    if (!other) {
        *claim = (struct idempotency_claim){principal, key, true, NULL, idempotency->first};
        if (claim->next) claim->next->previous = claim;
        idempotency->first = claim;
    }
    pthread_mutex_unlock(&idempotency->lock);
    return !other;
}

void idempotency_release(struct idempotency *idempotency, struct idempotency_claim *claim) {
    if (!claim->held) return;
    pthread_mutex_lock(&idempotency->lock);
    if (claim->previous) claim->previous->next = claim->next;
    if (claim->next) claim->next->previous = claim->previous;
    if (idempotency->first == claim) idempotency->first = claim->next;
    pthread_mutex_unlock(&idempotency->lock);
    *claim = (struct idempotency_claim){.held = false};
}

/* ------------------------------------------------------------------------------------------------ done */

enum status idempotency_find(struct sql *reader, const char *principal, const char *key,
                             struct idempotency_record *record, bool *found, struct error *error) {
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

void idempotency_record_done(struct idempotency_record *record) {
    free(record->reply);
    memset(record, 0, sizeof *record);
}

enum status idempotency_add(struct sql *writer, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) {
    return sql_run(writer, "INSERT INTO replies (principal, key, fingerprint, made, at) VALUES (?1, ?2, ?3, ?4, ?5)",
                   VALUES(T(principal), T(key->key), T(key->fingerprint), T(made), I(now_ms)), error);
}

enum status idempotency_put(struct sql *writer, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) {
    sql_lock(writer);
    enum status status = idempotency_add(writer, principal, key, made, now_ms, error);
    sql_unlock(writer);
    return status;
}

enum status idempotency_keep_reply(struct sql *writer, const char *principal, const char *key, int status_code,
                                   const char *etag, const char *reply, struct error *error) {
    sql_lock(writer);
    enum status status = sql_run_casually(
        writer, "UPDATE replies SET status = ?3, etag = ?4, reply = ?5 WHERE principal = ?1 AND key = ?2",
        VALUES(T(principal), T(key), I(status_code), T(etag), T(reply)), error);
    sql_unlock(writer);
    return status;
}

enum status idempotency_forget(struct sql *writer, int64_t before_ms, struct error *error) {
    sql_lock(writer);
    enum status status = sql_run(writer, "DELETE FROM replies WHERE at < ?1", VALUES(I(before_ms)), error);
    sql_unlock(writer);
    return status;
}
