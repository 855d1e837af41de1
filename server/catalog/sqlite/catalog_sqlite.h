/* The catalog in an SQLite database (WAL): the backend for one host.  For this folder alone.
 *
 * Two connections: one that writes, under a lock, and one that reads, under another, so that a reader never waits for
 * an fsync.  Commits are durable (synchronous=FULL), but for progress and replies (sql_run_nosync): after a power cut
 * the last of these may be missing, nothing else.
 *
 * Who may have how many jobs, bytes and turns is decided under the writer's lock, by what is in memory: `waiting` and
 * `running` are the numbers of rows in these states, `fair_share` holds the rows that wait, `runs` those that run,
 * `usage` what principals have.  They change after the commit.  Another process may write to the same file: whoever
 * takes the lock and finds that one has (PRAGMA data_version) reads them again first (catalog_sqlite_enter).  `order`
 * guards fair_share and runs, is taken after a connection's lock, and is held for no longer than a look at them takes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_SQLITE_CATALOG_SQLITE_H
#define WHITTLE_SERVER_CATALOG_SQLITE_CATALOG_SQLITE_H

#include <pthread.h>
#include <stdatomic.h>

#include "server/catalog/catalog_backend.h"
#include "server/catalog/cells.h"
#include "server/catalog/sqlite/sql.h"
#include "server/catalog/sqlite/usage.h"

enum { CATALOG_SQLITE_MAX_RUNS = 256 };

/* Requests that hold an Idempotency-Key. */
struct key_holds {
    pthread_mutex_t lock;
    struct catalog_key_hold *first;
};

struct catalog_sqlite {
    struct catalog catalog; /* first */
    struct sql *writer, *reader;
    struct sql *prober;                  /* tries whether there could be a change, and waits for nobody */
    int64_t blocked_ms, blocked_version; /* under its lock: since when there couldn't (0 = there could), and the
                                            database's version then */
    int64_t version;                     /* of the database, as the writer sees others change it; under its lock */
    _Atomic uint64_t waiting, running;
    bool alone; /* what runs was interrupted often, and nothing else may run; under the writer's lock */
    struct usage *usage;
    struct key_holds keys;
    pthread_mutex_t order;
    struct fair_share *fair_share;
    size_t run_count;
    struct run {
        char id[JOB_ID_BYTES];
        struct job_cost cost;
        int64_t started_ms;
    } runs[CATALOG_SQLITE_MAX_RUNS]; /* more are not remembered */
};

static inline struct catalog_sqlite *catalog_sqlite_of(struct catalog *catalog) {
    return (struct catalog_sqlite *)(void *)catalog;
}

/* Takes the writer's lock, with what is in memory up to date, and returns the writer; sql_unlock gives it back. */
struct sql *catalog_sqlite_enter(struct catalog_sqlite *sqlite);

/* Reads all that is in memory, under the writer's lock. */
enum status catalog_sqlite_load(struct catalog_sqlite *sqlite, struct error *error) MUST_CHECK;

/* ---- order.c: turns and runs, under the writer's lock ---- */

enum status catalog_sqlite_load_order(struct catalog_sqlite *sqlite, struct error *error) MUST_CHECK;

/* Counts again how many wait and how many run. */
enum status catalog_sqlite_count(struct catalog_sqlite *sqlite, struct error *error) MUST_CHECK;

/* A job has come to wait; a waiting one runs from now on; one neither waits nor runs any more. */
void catalog_sqlite_put_in_order(struct catalog_sqlite *sqlite, const struct job *job);
void catalog_sqlite_put_in_run(struct catalog_sqlite *sqlite, const struct job *job);
void catalog_sqlite_take_out(struct catalog_sqlite *sqlite, const char *id);

/* Whose turn it is; "" where the order knows of nobody. */
void catalog_sqlite_first_in_order(struct catalog_sqlite *sqlite, char id[JOB_ID_BYTES]);

/* How many jobs come before this one. */
uint64_t catalog_sqlite_ahead_of(struct catalog_sqlite *sqlite, const struct job *job);

void catalog_sqlite_move_order(struct catalog_sqlite *sqlite, int64_t step_ms);

/* ---- in the caller's transaction, or under the writer's lock ---- */

/* After a change of what a principal (NULL: anybody) has. */
void catalog_sqlite_refresh_usage(struct catalog_sqlite *sqlite, const char *principal);

/* Whether so many jobs more may wait, and be this principal's. */
enum status catalog_sqlite_check_limits(const struct catalog_sqlite *sqlite, const char *principal, uint64_t more,
                                        const struct catalog_limits *limits, struct error *error) MUST_CHECK;

enum status catalog_sqlite_add_key(struct sql *writer, const char *principal, const struct job_key *key,
                                   const char *made, int64_t now_ms, struct error *error) MUST_CHECK;
enum status catalog_sqlite_add_webhook(struct sql *writer, const char *job, const char *url,
                                       struct error *error) MUST_CHECK;
enum status catalog_sqlite_make_webhook_due(struct sql *writer, const char *job, int64_t now_ms,
                                            struct error *error) MUST_CHECK;
enum status catalog_sqlite_remove_webhook(struct sql *writer, const char *job, struct error *error) MUST_CHECK;

/* A job's end, with what is due then. */
enum status catalog_sqlite_write_end(struct sql *writer, const struct job *job, enum job_state next,
                                     struct error *error) MUST_CHECK;

/* ---- rows.c ---- */

/* The row that these are at. */
struct catalog_cells catalog_sqlite_cells(struct sql_rows *row);

/* ---- tasks.c: jobs in tiles ---- */

/* Makes the first task of the job that waits the claimer's: owner, attempt and what else is a task's become *job's.
 * *count 0: none waits. */
enum status catalog_sqlite_take_task(struct sql *writer, const struct catalog_claim *by, struct job *job, int64_t now,
                                     size_t *count, struct error *error) MUST_CHECK;

/* Adds those that are lost to the jobs, as catalog_list_lost. */
enum status catalog_sqlite_list_lost_tasks(struct sql *reader, const char *owner, struct job *jobs, size_t max,
                                           size_t *count, struct error *error) MUST_CHECK;

/* catalog_finish of such a job. */
enum status catalog_sqlite_finish_tiles(struct catalog_sqlite *sqlite, enum job_event event, const struct job *job,
                                        bool *changed, struct error *error) MUST_CHECK;

/* Puts what is in memory right after a change of a job's tasks, under the writer's lock: how many wait and run, and
 * whether the job has a turn. */
void catalog_sqlite_settle_task(struct catalog_sqlite *sqlite, const struct job *job);

/* ---- the operations ---- */

#define OPERATION(name) __typeof__(catalog_##name) catalog_sqlite_##name;
#include "server/catalog/catalog_operations.def"

#endif
