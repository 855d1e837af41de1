/* The catalog in PostgreSQL: the backend for any number of hosts.  For this folder alone.
 *
 * Nothing is decided by what is in memory: turns, limits, keys and reservations are rows, and times are the database's.
 * A change is one short transaction; no transaction is open while a job runs.
 *
 * Sessions.  What a process holds (keys of requests under way, reserved bytes) names its session, whose lease its
 * catalog renews; it ends with the session, whoever ends it.
 *
 * Changes.  A change that somebody waits for (a job waits, is to end, has ended, was deleted) is notified with the
 * commit, its writer's session in front, so that who made it isn't told twice.  Beneath that, each host asks once a
 * second which jobs others have changed: so progress comes through, and so does what was notified while a connection
 * was broken.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_POSTGRES_CATALOG_POSTGRES_H
#define WHITTLE_SERVER_CATALOG_POSTGRES_CATALOG_POSTGRES_H

#include <pthread.h>

#include "server/catalog/catalog_backend.h"
#include "server/catalog/cells.h"
#include "server/catalog/postgres/pq.h"

enum { SESSION_BYTES = 33, SESSION_LEASE_MS = 60000 };

/* What could not be given back when it was to be: a key, or bytes where key is "". */
struct later {
    struct later *next;
    char principal[JOB_PRINCIPAL_BYTES], key[CATALOG_KEY_BYTES];
    uint64_t bytes;
};

struct catalog_postgres {
    struct catalog catalog; /* first */
    struct pq *pq;
    char session[SESSION_BYTES];
    pthread_t listener;
    bool listens;
    _Atomic bool ends, is_watched; /* is_watched: catalog.tell is set, and the listener may call it */
    int64_t seen_ms;               /* the listener's: changes before that were told */
    pthread_mutex_t later_lock;
    struct later *later; /* which the listener gives back */
};

/* What a link has just found not to be there isn't there, or this fails: a primary that was deposed and doesn't know it
 * has old answers, but its commits hang.  A small commit, so no transaction may be open. */
enum status catalog_postgres_confirm(struct pq_link *link, struct error *error) MUST_CHECK;

/* The row that these are at. */
struct catalog_cells catalog_postgres_cells(struct pq_rows *row);

static inline struct catalog_postgres *catalog_postgres_of(struct catalog *catalog) {
    return (struct catalog_postgres *)(void *)catalog;
}

/* ---- changes.c: what others change ---- */

/* Starts to listen, and to renew the session.  catalog_postgres_deafen ends that. */
enum status catalog_postgres_listen(struct catalog_postgres *postgres, struct error *error) MUST_CHECK;
void catalog_postgres_deafen(struct catalog_postgres *postgres);

/* The listener gives back what the database did not take back: a key of a principal (NULL: the bytes).  Never blocks.
 */
void catalog_postgres_release_later(struct catalog_postgres *postgres, const char *principal, const char *key,
                                    uint64_t bytes);

/* How long what nobody names any more stays: longer than any request to a blob store takes. */
#define GRACE_MS "600000"

/* A statement that marks a name until a time, both expressions. */
#define MARK(name, until)                                                                                              \
    "INSERT INTO marks (name, until) VALUES (" name ", " until ") ON CONFLICT (name) "                                 \
    "DO UPDATE SET until = excluded.until"

/* A key, or bytes, in the caller's transaction, which they end. */
enum status catalog_postgres_give_up_key(struct catalog_postgres *postgres, struct pq_link *link, const char *principal,
                                         const char *key, struct error *error) MUST_CHECK;
enum status catalog_postgres_give_back(struct catalog_postgres *postgres, struct pq_link *link, const char *principal,
                                       uint64_t bytes, struct error *error) MUST_CHECK;

/* In the transaction of the change: others are told when it commits. */
enum status catalog_postgres_notify(struct catalog_postgres *postgres, struct pq_link *link, enum catalog_change change,
                                    const char *id, struct error *error) MUST_CHECK;

/* ---- in the caller's transaction ---- */

/* Whether a principal may have so many bytes more; its row of usage is locked until the end of the transaction. */
enum status catalog_postgres_check_bytes(struct pq_link *link, const char *principal, uint64_t bytes, uint64_t limit,
                                         struct error *error) MUST_CHECK;

/* Submitting, one at a time: takes the lock that lasts as long as the transaction; whether so many jobs more may wait,
 * and be this principal's; adds a job, the key that it was submitted under, and who is told of its end. */
enum status catalog_postgres_lock_submit(struct pq_link *link, struct error *error) MUST_CHECK;
enum status catalog_postgres_check_counts(struct pq_link *link, const char *principal, uint64_t more,
                                          const struct catalog_limits *limits, struct error *error) MUST_CHECK;
enum status catalog_postgres_insert(struct catalog_postgres *postgres, struct pq_link *link, const struct job *job,
                                    struct error *error) MUST_CHECK;

/* A commit without an answer: the job's id, which nobody else makes, tells whether it was done. */
enum status catalog_postgres_look_up_submit(struct catalog_postgres *postgres, const char *id,
                                            struct error *error) MUST_CHECK;

enum status catalog_postgres_add_key(struct pq_link *link, const char *principal, const struct job_key *key,
                                     const char *made, int64_t now_ms, struct error *error) MUST_CHECK;
enum status catalog_postgres_add_webhook(struct pq_link *link, const char *job, const char *url,
                                         struct error *error) MUST_CHECK;

/* The jobs of a SELECT CATALOG_JOB_COLUMNS; outputs too, which those alone have that have ended.  *count is 0 on
 * failure. */
enum status catalog_postgres_select_jobs(struct pq_link *link, const char *text, const struct pq_value *values,
                                         size_t value_count, struct job *jobs, size_t max, size_t *count,
                                         struct error *error) MUST_CHECK;

/* A job's end with what is due then, and that it waits again. */
enum status catalog_postgres_write_end(struct catalog_postgres *postgres, struct pq_link *link, const struct job *job,
                                       enum job_state next, struct error *error) MUST_CHECK;
enum status catalog_postgres_write_requeue(struct catalog_postgres *postgres, struct pq_link *link,
                                           const struct job *job, struct error *error) MUST_CHECK;

/* ---- tasks.c: jobs in tiles, as in sqlite/catalog_sqlite.h ---- */

enum status catalog_postgres_take_task(struct pq_link *link, const struct catalog_claim *by, struct job *job,
                                       size_t *count, struct error *error) MUST_CHECK;
enum status catalog_postgres_list_lost_tasks(struct pq_link *link, const char *owner, struct job *jobs, size_t max,
                                             size_t *count, struct error *error) MUST_CHECK;
enum status catalog_postgres_finish_tiles(struct catalog_postgres *postgres, enum job_event event,
                                          const struct job *job, bool *changed, struct error *error) MUST_CHECK;

/* ---- the operations ---- */

#define OPERATION(name) __typeof__(catalog_##name) catalog_postgres_##name;
#include "server/catalog/catalog_operations.def"
#define OPERATION(name) __typeof__(catalog_##name) catalog_postgres_##name;
#include "server/catalog/catalog_shared_operations.def"

#endif
