/* What others change: a thread that listens, asks, and keeps the session alive.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/base/alloc.h"
#include "server/catalog/postgres/catalog_postgres.h"

enum { LOOK_MS = 1000, SLICE_MS = 100, PAGE = 256, OVERLAP_MS = 5000, NOTE_BYTES = 128 };

enum status catalog_postgres_notify(struct catalog_postgres *postgres, struct pq_link *link, enum catalog_change change,
                                    const char *id, struct error *error) {
    return pq_run(link, "SELECT pg_notify('whittle', $1 || ' ' || $2 || ' ' || $3)",
                  VALUES(T(postgres->session), I(change), T(id)), NULL, error);
}

static void tell(struct catalog_postgres *postgres, enum catalog_change change, const char *id) {
    if (postgres->is_watched) catalog_tell(&postgres->catalog, change, id);
}

/* "SESSION CHANGE ID": our own were told when they were made. */
static void hear(struct catalog_postgres *postgres, const char *note) {
    size_t length = strlen(postgres->session);
    if (strncmp(note, postgres->session, length) == 0) return;
    const char *number = strchr(note, ' '), *id = number ? strchr(number + 1, ' ') : NULL;
    long change = number ? strtol(number + 1, NULL, 10) : -1;
    if (id && change >= CATALOG_CHANGED && change <= CATALOG_DELETED)
        tell(postgres, (enum catalog_change)change, id + 1);
}

/* A page of the jobs that others have changed between two times, both included, behind the one at *from_ms with the id
 * last; these two become the last one's. */
static enum status look_at_page(struct catalog_postgres *postgres, struct pq_link *link, int64_t *from_ms,
                                char last[JOB_ID_BYTES], int64_t until_ms, bool *is_full, struct error *error) {
    struct pq_rows *rows;
    enum status status =
        pq_select(link,
                  "SELECT id, state, cancelled, updated FROM jobs WHERE (updated, id) > ($1, $2) AND updated <= $3 "
                  "AND writer <> $4 ORDER BY updated, id LIMIT $5",
                  VALUES(I(*from_ms), T(last), I(until_ms), T(postgres->session), I(PAGE)), &rows, error);
    if (status != STATUS_OK) return status;
    int found = 0;
    for (; pq_next(rows); found++) {
        bool waits = pq_integer(rows, 1) == JOB_ACCEPTED,
             ends = pq_integer(rows, 1) == JOB_RUNNING && pq_integer(rows, 2);
        if (ends) tell(postgres, CATALOG_CANCELLED, pq_text(rows, 0));
        tell(postgres, waits ? CATALOG_WAITS : CATALOG_CHANGED, pq_text(rows, 0));
        *from_ms = pq_integer(rows, 3);
        snprintf(last, JOB_ID_BYTES, "%s", pq_text(rows, 0));
    }
    pq_free(rows);
    *is_full = found == PAGE;
    return STATUS_OK;
}

/* Jobs that others have changed since the last time; by the database's clock, a little overlapping, for transactions
 * don't end in the order in which they read it.  Where that clock was set back, from what it says now. */
static enum status look(struct catalog_postgres *postgres, struct pq_link *link, struct error *error) {
    char last[JOB_ID_BYTES] = "";
    bool is_full = true;
    int64_t now_ms = 0;
    enum status status = pq_number(link, "SELECT whittle_now()", NULL, 0, &now_ms, error);
    if (status != STATUS_OK) return status;
    int64_t from_ms = (now_ms < postgres->seen_ms ? now_ms : postgres->seen_ms) - OVERLAP_MS;
    while (status == STATUS_OK && is_full && !postgres->ends)
        status = look_at_page(postgres, link, &from_ms, last, now_ms, &is_full, error);
    if (status == STATUS_OK) postgres->seen_ms = now_ms;
    return status;
}

/* What a process that is gone has held goes with its session. */
static enum status renew_session(struct catalog_postgres *postgres, struct pq_link *link, struct error *error) {
    enum status status = pq_run(link,
                                "INSERT INTO sessions (id, lease) VALUES ($1, whittle_now() + $2) "
                                "ON CONFLICT (id) DO UPDATE SET lease = excluded.lease",
                                VALUES(T(postgres->session), I(SESSION_LEASE_MS)), NULL, error);
    if (status == STATUS_OK)
        status = pq_execute(link,
                            "WITH gone AS (DELETE FROM sessions WHERE lease < whittle_now() - 60000 RETURNING id), "
                            "held AS (DELETE FROM holds WHERE session IN (SELECT id FROM gone)) "
                            "DELETE FROM reservations WHERE session IN (SELECT id FROM gone)",
                            error);
    return status;
}

void catalog_postgres_release_later(struct catalog_postgres *postgres, const char *principal, const char *key,
                                    uint64_t bytes) {
    struct later *later = alloc_zeroed(1, sizeof *later);
    if (!later) return; /* it ends with the session */
    snprintf(later->principal, sizeof later->principal, "%s", principal);
    snprintf(later->key, sizeof later->key, "%s", key ? key : "");
    later->bytes = bytes;
    pthread_mutex_lock(&postgres->later_lock);
    later->next = postgres->later;
    postgres->later = later;
    pthread_mutex_unlock(&postgres->later_lock);
}

static enum status release_one(struct catalog_postgres *postgres, const struct later *later, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    return later->key[0] ? catalog_postgres_give_up_key(postgres, link, later->principal, later->key, error)
                         : catalog_postgres_give_back(postgres, link, later->principal, later->bytes, error);
}

/* The first is taken out for as long as it is tried; nobody else takes any out. */
static enum status release_now(struct catalog_postgres *postgres, struct error *error) {
    enum status status = STATUS_OK;
    while (status == STATUS_OK) {
        pthread_mutex_lock(&postgres->later_lock);
        struct later *later = postgres->later;
        if (later) postgres->later = later->next;
        pthread_mutex_unlock(&postgres->later_lock);
        if (!later) break;
        status = release_one(postgres, later, error);
        if (status != STATUS_OK) {
            pthread_mutex_lock(&postgres->later_lock);
            later->next = postgres->later;
            postgres->later = later;
            pthread_mutex_unlock(&postgres->later_lock);
        } else {
            free(later);
        }
    }
    return status;
}

/* Until the end, or until the connection is lost. */
static enum status attend(struct catalog_postgres *postgres, struct pq_link *link, struct error *error) {
    enum { SESSION_EVERY = 10 };
    char note[NOTE_BYTES];
    enum status status = pq_execute(link, "LISTEN whittle", error);
    for (int round = 0; status == STATUS_OK && !postgres->ends; round++) {
        if (round % SESSION_EVERY == 0) status = renew_session(postgres, link, error);
        if (status == STATUS_OK) status = look(postgres, link, error);
        if (status == STATUS_OK) status = release_now(postgres, error);
        for (int waited = 0; status == STATUS_OK && waited < LOOK_MS && !postgres->ends; waited += SLICE_MS) {
            bool notified = true;
            while (status == STATUS_OK && notified) {
                status = pq_wait(link, SLICE_MS, note, sizeof note, &notified, error);
                if (status == STATUS_OK && notified) hear(postgres, note);
            }
        }
    }
    return status;
}

static void *listen_to_others(void *ctx) {
    struct catalog_postgres *postgres = ctx;
    static const struct timespec pause = {.tv_nsec = SLICE_MS * 1000 * 1000};
    while (!postgres->ends) {
        struct error error = {0};
        struct pq_link *link;
        enum status status = pq_take(postgres->pq, &link, &error);
        if (status == STATUS_OK) {
            status = attend(postgres, link, &error);
            struct error ignored;
            enum status stopped = pq_execute(link, "UNLISTEN *", &ignored);
            (void)stopped;
            pq_done(link);
        }
        if (status != STATUS_OK) nanosleep(&pause, NULL); /* what asks the catalog says what is wrong */
    }
    return NULL;
}

enum status catalog_postgres_listen(struct catalog_postgres *postgres, struct error *error) {
    struct pq_link *link;
    enum status status = pq_take(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = renew_session(postgres, link, error);
    if (status == STATUS_OK) status = pq_number(link, "SELECT whittle_now()", NULL, 0, &postgres->seen_ms, error);
    pq_done(link);
    if (status != STATUS_OK) return status;
    postgres->listens = pthread_create(&postgres->listener, NULL, listen_to_others, postgres) == 0;
    return postgres->listens ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "catalog", "can't start a thread");
}

void catalog_postgres_deafen(struct catalog_postgres *postgres) {
    struct pq_link *link;
    struct error ignored;
    if (!postgres->listens) return;
    postgres->ends = true;
    pthread_join(postgres->listener, NULL);
    if (pq_take(postgres->pq, &link, &ignored) != STATUS_OK) return;
    enum status ended =
        pq_run(link,
               "WITH gone AS (DELETE FROM sessions WHERE id = $1), held AS (DELETE FROM holds WHERE session = $1) "
               "DELETE FROM reservations WHERE session = $1",
               VALUES(T(postgres->session)), NULL, &ignored);
    (void)ended; /* its lease ends by itself */
    pq_done(link);
}
