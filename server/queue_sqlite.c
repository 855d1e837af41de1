/* The queue in an SQLite database (WAL), the backend for one host.
 *
 * Two connections: one that writes, under a lock, and one that reads, under another, so that a reader never waits for
 * an fsync.  Commits of submit, claim, finish and delete are durable (synchronous=FULL); progress is written with
 * synchronous=NORMAL, which costs no fsync: after a power cut the last progress may be missing, nothing else.
 *
 * The schema's version is `user_version`, the number of its steps.  To change it: append a step to `schema`, never edit
 * one; each step runs once, in order.
 *
 * Invariant: `waiting` and `running` are the numbers of rows in these states; they change under the writer's lock,
 * after the commit.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/queue.h"

#include <pthread.h>
#include <sqlite3.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BUSY_MS = 10000 };

static const char *const schema[] = {
    "CREATE TABLE jobs (id TEXT PRIMARY KEY, state INTEGER NOT NULL, sequence INTEGER NOT NULL, "
    "attempt INTEGER NOT NULL, created INTEGER NOT NULL, started INTEGER NOT NULL, finished INTEGER NOT NULL, "
    "updated INTEGER NOT NULL, expires INTEGER NOT NULL, label TEXT NOT NULL, cloud TEXT NOT NULL, "
    "input_bytes INTEGER NOT NULL, input_points INTEGER NOT NULL, input_format TEXT NOT NULL, params TEXT NOT NULL, "
    "stage TEXT NOT NULL DEFAULT '', message TEXT NOT NULL DEFAULT '', fraction REAL NOT NULL DEFAULT 0, "
    "cpu REAL NOT NULL DEFAULT 0, wall REAL NOT NULL DEFAULT 0, rss INTEGER NOT NULL DEFAULT 0, report TEXT, "
    "problem TEXT) STRICT;"
    "CREATE INDEX jobs_by_state ON jobs (state, id);"
    "CREATE INDEX jobs_by_label ON jobs (label, id);"
    "CREATE INDEX jobs_by_cloud ON jobs (cloud);"
    "CREATE INDEX jobs_by_expiry ON jobs (expires);"
    "CREATE TABLE outputs (job TEXT NOT NULL, position INTEGER NOT NULL, name TEXT NOT NULL, bytes INTEGER NOT NULL, "
    "sha256 TEXT NOT NULL, PRIMARY KEY (job, position)) STRICT, WITHOUT ROWID;"
    "CREATE TABLE tombstones (id TEXT PRIMARY KEY, reason TEXT NOT NULL, at INTEGER NOT NULL) STRICT;",
    "ALTER TABLE jobs ADD COLUMN principal TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE tombstones ADD COLUMN principal TEXT NOT NULL DEFAULT '';"
    "CREATE INDEX jobs_by_principal ON jobs (principal, id);",
};
enum { SCHEMA_VERSION = sizeof schema / sizeof schema[0] };

/* In the order in which read_job takes them. */
#define JOB_COLUMNS                                                                                                    \
    "id, state, sequence, attempt, created, started, finished, updated, expires, label, cloud, input_bytes, "          \
    "input_points, input_format, params, stage, message, fraction, cpu, wall, rss, report, problem, principal, "       \
    "CASE state WHEN 0 THEN (SELECT count(*) FROM jobs AS other WHERE other.state = 0 AND other.id < jobs.id) "        \
    "ELSE 0 END"

struct connection {
    sqlite3 *db;
    pthread_mutex_t lock;
};

struct queue {
    struct connection writer, reader;
    _Atomic uint64_t waiting, running;
};

/* ------------------------------------------------------------------------------------------------ SQL, shorter */

static enum status refused(sqlite3 *db, struct error *error) {
    return error_set(error, STATUS_IO, "queue", "the database says: %s", db ? sqlite3_errmsg(db) : "no memory");
}

static enum status execute(sqlite3 *db, const char *sql, struct error *error) {
    return sqlite3_exec(db, sql, NULL, NULL, NULL) == SQLITE_OK ? STATUS_OK : refused(db, error);
}

/* One value to bind. */
struct value {
    enum { INTEGER, REAL, TEXT } type;
    int64_t integer;
    double real;
    const char *text; /* NULL = null */
};
#define I(x) ((struct value){.type = INTEGER, .integer = (int64_t)(x)})
#define R(x) ((struct value){.type = REAL, .real = (x)})
#define T(x) ((struct value){.type = TEXT, .text = (x)})
#define VALUES(...)                                                                                                    \
    (const struct value[]){__VA_ARGS__}, sizeof((const struct value[]){__VA_ARGS__}) / sizeof(struct value)

static int bind(sqlite3_stmt *statement, int i, const struct value *value) {
    switch (value->type) {
    case INTEGER: return sqlite3_bind_int64(statement, i, value->integer);
    case REAL: return sqlite3_bind_double(statement, i, value->real);
    case TEXT: break;
    }
    return sqlite3_bind_text(statement, i, value->text, -1, SQLITE_STATIC);
}

/* Prepares a statement and binds ?1, ?2, ...  The values' texts are borrowed until it is finalised. */
static enum status prepare(sqlite3 *db, const char *sql, const struct value *values, size_t count,
                           sqlite3_stmt **statement, struct error *error) {
    if (sqlite3_prepare_v2(db, sql, -1, statement, NULL) != SQLITE_OK) return refused(db, error);
    for (size_t i = 0; i < count; i++) {
        if (bind(*statement, (int)i + 1, &values[i]) == SQLITE_OK) continue;
        sqlite3_finalize(*statement);
        return refused(db, error);
    }
    return STATUS_OK;
}

/* Runs a statement that returns no rows. */
static enum status run(sqlite3 *db, const char *sql, const struct value *values, size_t count, struct error *error) {
    sqlite3_stmt *statement;
    enum status status = prepare(db, sql, values, count, &statement, error);
    if (status != STATUS_OK) return status;
    if (sqlite3_step(statement) != SQLITE_DONE) status = refused(db, error);
    sqlite3_finalize(statement);
    return status;
}

/* Runs a statement that returns one number; untouched where it returns no row. */
static enum status number_of(sqlite3 *db, const char *sql, const struct value *values, size_t count, int64_t *number,
                             struct error *error) {
    sqlite3_stmt *statement;
    enum status status = prepare(db, sql, values, count, &statement, error);
    if (status != STATUS_OK) return status;
    int step = sqlite3_step(statement);
    if (step == SQLITE_ROW)
        *number = sqlite3_column_int64(statement, 0);
    else if (step != SQLITE_DONE)
        status = refused(db, error);
    sqlite3_finalize(statement);
    return status;
}

/* Ends a transaction: commits when status is OK and undoes it otherwise. */
static enum status end(sqlite3 *db, enum status status, struct error *error) {
    if (status == STATUS_OK) status = execute(db, "COMMIT", error);
    if (status != STATUS_OK) sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
    return status;
}

static enum status begin(sqlite3 *db, struct error *error) { return execute(db, "BEGIN IMMEDIATE", error); }

/* ------------------------------------------------------------------------------------------------ open */

static enum status migrate(sqlite3 *db, struct error *error) {
    int64_t version = 0;
    enum status status = begin(db, error);
    if (status != STATUS_OK) return status;
    status = number_of(db, "PRAGMA user_version", NULL, 0, &version, error);
    if (status == STATUS_OK && version > SCHEMA_VERSION)
        status = error_set(error, STATUS_UNSUPPORTED, "queue", "the database has schema %lld, this program knows %d",
                           (long long)version, SCHEMA_VERSION);
    for (int64_t i = version; status == STATUS_OK && i < SCHEMA_VERSION; i++) status = execute(db, schema[i], error);
    char sql[64];
    snprintf(sql, sizeof sql, "PRAGMA user_version = %d", SCHEMA_VERSION);
    if (status == STATUS_OK) status = execute(db, sql, error);
    return end(db, status, error);
}

static enum status connect_to(const char *path, struct connection *connection, struct error *error) {
    int flags = SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX;
    if (sqlite3_open_v2(path, &connection->db, flags, NULL) != SQLITE_OK) return refused(connection->db, error);
    sqlite3_busy_timeout(connection->db, BUSY_MS);
    return execute(connection->db, "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA temp_store = MEMORY",
                   error);
}

static enum status count_states(struct queue *queue, struct error *error) {
    int64_t waiting = 0, running = 0;
    const char *sql = "SELECT count(*) FROM jobs WHERE state = ?1";
    enum status status = number_of(queue->reader.db, sql, VALUES(I(JOB_ACCEPTED)), &waiting, error);
    if (status == STATUS_OK) status = number_of(queue->reader.db, sql, VALUES(I(JOB_RUNNING)), &running, error);
    queue->waiting = (uint64_t)waiting;
    queue->running = (uint64_t)running;
    return status;
}

enum status queue_open(const char *path, struct queue **queue, struct error *error) {
    struct queue *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    pthread_mutex_init(&opened->writer.lock, NULL);
    pthread_mutex_init(&opened->reader.lock, NULL);
    enum status status = connect_to(path, &opened->writer, error);
    if (status == STATUS_OK) status = migrate(opened->writer.db, error);
    if (status == STATUS_OK) status = connect_to(path, &opened->reader, error);
    if (status == STATUS_OK) status = count_states(opened, error);
    if (status == STATUS_OK)
        *queue = opened;
    else
        queue_close(opened);
    return status;
}

void queue_close(struct queue *queue) {
    if (!queue) return;
    sqlite3_close(queue->reader.db);
    sqlite3_close(queue->writer.db);
    pthread_mutex_destroy(&queue->reader.lock);
    pthread_mutex_destroy(&queue->writer.lock);
    free(queue);
}

void queue_depth(struct queue *queue, uint64_t *waiting, uint64_t *running) {
    *waiting = atomic_load(&queue->waiting);
    *running = atomic_load(&queue->running);
}

/* ------------------------------------------------------------------------------------------------ rows */

static void copy_text(sqlite3_stmt *row, int column, char *to, size_t bytes) {
    const unsigned char *text = sqlite3_column_text(row, column);
    snprintf(to, bytes, "%s", text ? (const char *)text : "");
}

static char *new_text(sqlite3_stmt *row, int column) {
    const unsigned char *text = sqlite3_column_text(row, column);
    return text ? strdup((const char *)text) : NULL;
}

static void read_job(sqlite3_stmt *row, struct job *job) {
    int c = 0;
    memset(job, 0, sizeof *job);
    copy_text(row, c++, job->id, sizeof job->id);
    job->state = (enum job_state)sqlite3_column_int(row, c++);
    job->sequence = (uint64_t)sqlite3_column_int64(row, c++);
    job->attempt = sqlite3_column_int(row, c++);
    int64_t *const times[] = {&job->created_ms, &job->started_ms, &job->finished_ms, &job->updated_ms,
                              &job->expires_ms};
    for (size_t i = 0; i < sizeof times / sizeof *times; i++) *times[i] = sqlite3_column_int64(row, c++);
    copy_text(row, c++, job->label, sizeof job->label);
    copy_text(row, c++, job->cloud, sizeof job->cloud);
    job->input_bytes = (uint64_t)sqlite3_column_int64(row, c++);
    job->input_points = (uint64_t)sqlite3_column_int64(row, c++);
    copy_text(row, c++, job->input_format, sizeof job->input_format);
    const unsigned char *params = sqlite3_column_text(row, c++);
    job_params_read(params ? (const char *)params : "", &job->params);
    copy_text(row, c++, job->stage, sizeof job->stage);
    copy_text(row, c++, job->message, sizeof job->message);
    job->fraction = sqlite3_column_double(row, c++);
    job->cpu_s = sqlite3_column_double(row, c++);
    job->wall_s = sqlite3_column_double(row, c++);
    job->peak_rss_bytes = (uint64_t)sqlite3_column_int64(row, c++);
    job->report = new_text(row, c++);
    job->problem = new_text(row, c++);
    copy_text(row, c++, job->principal, sizeof job->principal);
    job->ahead = (uint64_t)sqlite3_column_int64(row, c);
}

static enum status read_outputs(sqlite3 *db, struct job *job, struct error *error) {
    sqlite3_stmt *row;
    enum status status = prepare(db, "SELECT name, bytes, sha256 FROM outputs WHERE job = ?1 ORDER BY position",
                                 VALUES(T(job->id)), &row, error);
    if (status != STATUS_OK) return status;
    int step;
    while ((step = sqlite3_step(row)) == SQLITE_ROW && job->output_count < JOB_MAX_OUTPUTS) {
        struct job_output *output = &job->output[job->output_count++];
        copy_text(row, 0, output->name, sizeof output->name);
        output->bytes = (uint64_t)sqlite3_column_int64(row, 1);
        copy_text(row, 2, output->sha256, sizeof output->sha256);
    }
    if (step != SQLITE_DONE && step != SQLITE_ROW) status = refused(db, error);
    sqlite3_finalize(row);
    return status;
}

/* Reads the rows of a SELECT JOB_COLUMNS; *count is 0 on failure. */
static enum status read_jobs(sqlite3 *db, sqlite3_stmt *row, struct job *jobs, size_t max, size_t *count,
                             struct error *error) {
    enum status status = STATUS_OK;
    int step = SQLITE_DONE;
    *count = 0;
    while (*count < max && (step = sqlite3_step(row)) == SQLITE_ROW) read_job(row, &jobs[(*count)++]);
    if (step != SQLITE_DONE && step != SQLITE_ROW) status = refused(db, error);
    sqlite3_finalize(row);
    for (size_t i = 0; status == STATUS_OK && i < *count; i++) status = read_outputs(db, &jobs[i], error);
    if (status == STATUS_OK) return STATUS_OK;
    for (size_t i = 0; i < *count; i++) job_done(&jobs[i]);
    *count = 0;
    return status;
}

static enum status find_job(sqlite3 *db, const char *id, struct job *job, bool *found, struct error *error) {
    sqlite3_stmt *row;
    size_t count = 0;
    enum status status = prepare(db, "SELECT " JOB_COLUMNS " FROM jobs WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status == STATUS_OK) status = read_jobs(db, row, job, 1, &count, error);
    *found = count == 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ submit, claim */

static enum status insert(sqlite3 *db, const struct job *job, struct error *error) {
    char *params = job_params_text(&job->params);
    if (!params) return error_set(error, STATUS_NO_MEMORY, "queue", "no memory");
    enum status status =
        run(db,
            "INSERT INTO jobs (id, state, sequence, attempt, created, started, finished, updated, expires, label, "
            "cloud, input_bytes, input_points, input_format, params, principal) "
            "VALUES (?1, ?2, ?3, 0, ?4, 0, 0, ?4, 0, ?5, ?6, ?7, ?8, ?9, ?10, ?11)",
            VALUES(T(job->id), I(JOB_ACCEPTED), I(job->created_ms), I(job->created_ms), T(job->label), T(job->cloud),
                   I(job->input_bytes), I(job->input_points), T(job->input_format), T(params), T(job->principal)),
            error);
    free(params);
    return status;
}

enum status queue_submit(struct queue *queue, const struct job *job, uint64_t max_waiting, struct error *error) {
    enum status status;
    pthread_mutex_lock(&queue->writer.lock);
    if (queue->waiting >= max_waiting)
        status = error_set(error, STATUS_LIMIT, "queue", "%llu jobs are waiting", (unsigned long long)queue->waiting);
    else
        status = insert(queue->writer.db, job, error);
    if (status == STATUS_OK) queue->waiting++;
    pthread_mutex_unlock(&queue->writer.lock);
    return status;
}

static enum status claim(sqlite3 *db, struct job *job, bool *found, struct error *error) {
    sqlite3_stmt *row;
    size_t count;
    int64_t now = job_now_ms();
    enum status status = prepare(db,
                                 "UPDATE jobs SET state = ?1, attempt = attempt + 1, started = ?2, updated = ?2, "
                                 "sequence = max(sequence + 1, ?2), stage = '', message = '', fraction = 0 "
                                 "WHERE id = (SELECT id FROM jobs WHERE state = ?3 ORDER BY id LIMIT 1) "
                                 "RETURNING " JOB_COLUMNS,
                                 VALUES(I(JOB_RUNNING), I(now), I(JOB_ACCEPTED)), &row, error);
    if (status == STATUS_OK) status = read_jobs(db, row, job, 1, &count, error);
    if (status == STATUS_OK) *found = count == 1;
    return status;
}

enum status queue_claim(struct queue *queue, struct job *job, bool *found, struct error *error) {
    *found = false;
    pthread_mutex_lock(&queue->writer.lock);
    enum status status = STATUS_OK;
    if (queue->waiting) status = claim(queue->writer.db, job, found, error);
    if (*found) {
        queue->waiting--;
        queue->running++;
    }
    pthread_mutex_unlock(&queue->writer.lock);
    return status;
}

enum status queue_progress(struct queue *queue, const char *id, const char *stage, const char *message, double fraction,
                           struct error *error) {
    pthread_mutex_lock(&queue->writer.lock);
    sqlite3 *db = queue->writer.db;
    enum status status = execute(db, "PRAGMA synchronous = NORMAL", error);
    if (status == STATUS_OK)
        status = run(db,
                     "UPDATE jobs SET stage = ?2, message = ?3, fraction = ?4, updated = ?5, "
                     "sequence = max(sequence + 1, ?5) WHERE id = ?1 AND state = ?6",
                     VALUES(T(id), T(stage), T(message), R(fraction), I(job_now_ms()), I(JOB_RUNNING)), error);
    if (sqlite3_exec(db, "PRAGMA synchronous = FULL", NULL, NULL, NULL) != SQLITE_OK) status = refused(db, error);
    pthread_mutex_unlock(&queue->writer.lock);
    return status;
}

/* ------------------------------------------------------------------------------------------------ finish */

static enum status write_end(sqlite3 *db, const struct job *job, enum job_state next, struct error *error) {
    enum status status =
        run(db,
            "UPDATE jobs SET state = ?2, finished = ?3, updated = ?3, sequence = max(sequence + 1, ?3), expires = ?4, "
            "fraction = CASE ?2 WHEN 2 THEN 1.0 ELSE fraction END, message = '', "
            "cpu = ?5, wall = ?6, rss = ?7, report = ?8, problem = ?9 WHERE id = ?1",
            VALUES(T(job->id), I(next), I(job_now_ms()), I(job->expires_ms), R(job->cpu_s), R(job->wall_s),
                   I(job->peak_rss_bytes), T(job->report), T(job->problem)),
            error);
    for (size_t i = 0; status == STATUS_OK && i < job->output_count; i++)
        status = run(
            db, "INSERT INTO outputs (job, position, name, bytes, sha256) VALUES (?1, ?2, ?3, ?4, ?5)",
            VALUES(T(job->id), I(i), T(job->output[i].name), I(job->output[i].bytes), T(job->output[i].sha256)), error);
    return status;
}

static enum status write_requeue(sqlite3 *db, const char *id, struct error *error) {
    return run(db,
               "UPDATE jobs SET state = ?2, updated = ?3, sequence = max(sequence + 1, ?3), stage = '', message = '', "
               "fraction = 0 WHERE id = ?1",
               VALUES(T(id), I(JOB_ACCEPTED), I(job_now_ms())), error);
}

/* One transaction; *from and *next are set when *changed is. */
static enum status finish(sqlite3 *db, enum job_event event, const struct job *job, enum job_state *from,
                          enum job_state *next, struct error *error) {
    int64_t state = -1;
    enum status status = begin(db, error);
    if (status != STATUS_OK) return status;
    status = number_of(db, "SELECT state FROM jobs WHERE id = ?1", VALUES(T(job->id)), &state, error);
    *from = *next = (enum job_state)(state < 0 ? JOB_DISMISSED : state);
    if (status == STATUS_OK && job_transition(*from, event, next))
        status = event == JOB_REQUEUE ? write_requeue(db, job->id, error) : write_end(db, job, *next, error);
    return end(db, status, error);
}

enum status queue_finish(struct queue *queue, enum job_event event, const struct job *job, bool *changed,
                         struct error *error) {
    enum job_state from, next;
    pthread_mutex_lock(&queue->writer.lock);
    enum status status = finish(queue->writer.db, event, job, &from, &next, error);
    *changed = status == STATUS_OK && from != next;
    if (*changed && from == JOB_ACCEPTED) queue->waiting--;
    if (*changed && from == JOB_RUNNING) queue->running--;
    if (*changed && next == JOB_ACCEPTED) queue->waiting++;
    pthread_mutex_unlock(&queue->writer.lock);
    return status;
}

/* ------------------------------------------------------------------------------------------------ read */

static enum status find_tombstone(sqlite3 *db, const char *id, struct queue_tombstone *tombstone, bool *found,
                                  struct error *error) {
    sqlite3_stmt *row;
    enum status status =
        prepare(db, "SELECT reason, at, principal FROM tombstones WHERE id = ?1", VALUES(T(id)), &row, error);
    if (status != STATUS_OK) return status;
    int step = sqlite3_step(row);
    *found = step == SQLITE_ROW;
    if (*found) {
        copy_text(row, 0, tombstone->reason, sizeof tombstone->reason);
        tombstone->at_ms = sqlite3_column_int64(row, 1);
        copy_text(row, 2, tombstone->principal, sizeof tombstone->principal);
    } else if (step != SQLITE_DONE) {
        status = refused(db, error);
    }
    sqlite3_finalize(row);
    return status;
}

enum status queue_get(struct queue *queue, const char *id, struct job *job, enum queue_presence *presence,
                      struct queue_tombstone *tombstone, struct error *error) {
    bool found = false, gone = false;
    memset(job, 0, sizeof *job);
    pthread_mutex_lock(&queue->reader.lock);
    enum status status = find_job(queue->reader.db, id, job, &found, error);
    if (status == STATUS_OK && !found) status = find_tombstone(queue->reader.db, id, tombstone, &gone, error);
    pthread_mutex_unlock(&queue->reader.lock);
    *presence = found ? QUEUE_PRESENT : gone ? QUEUE_GONE : QUEUE_ABSENT;
    return status;
}

enum status queue_list(struct queue *queue, const struct queue_filter *filter, struct job *jobs, size_t max,
                       size_t *count, struct error *error) {
    sqlite3_stmt *row;
    *count = 0;
    pthread_mutex_lock(&queue->reader.lock);
    enum status status = prepare(queue->reader.db,
                                 "SELECT " JOB_COLUMNS " FROM jobs WHERE (?1 < 0 OR state = ?1) "
                                 "AND (?2 IS NULL OR label = ?2) AND (?3 IS NULL OR id < ?3) "
                                 "AND (?4 IS NULL OR principal = ?4) ORDER BY id DESC LIMIT ?5",
                                 VALUES(I(filter->by_state ? (int)filter->state : -1), T(filter->label),
                                        T(filter->after), T(filter->principal), I(max)),
                                 &row, error);
    if (status == STATUS_OK) status = read_jobs(queue->reader.db, row, jobs, max, count, error);
    pthread_mutex_unlock(&queue->reader.lock);
    return status;
}

enum status queue_cloud_uses(struct queue *queue, const char *cloud, uint64_t *uses, struct error *error) {
    int64_t number = 0;
    pthread_mutex_lock(&queue->reader.lock);
    enum status status =
        number_of(queue->reader.db, "SELECT count(*) FROM jobs WHERE cloud = ?1", VALUES(T(cloud)), &number, error);
    pthread_mutex_unlock(&queue->reader.lock);
    if (status == STATUS_OK) *uses = (uint64_t)number;
    return status;
}

/* ------------------------------------------------------------------------------------------------ delete, expire */

static enum status delete_rows(sqlite3 *db, const char *id, const char *reason, int64_t *deleted, struct error *error) {
    enum status status = begin(db, error);
    if (status != STATUS_OK) return status;
    status = run(db,
                 "INSERT OR REPLACE INTO tombstones (id, reason, at, principal) "
                 "SELECT id, ?2, ?3, principal FROM jobs WHERE id = ?1 AND state NOT IN (?4, ?5)",
                 VALUES(T(id), T(reason), I(job_now_ms()), I(JOB_ACCEPTED), I(JOB_RUNNING)), error);
    *deleted = status == STATUS_OK ? sqlite3_changes(db) : 0;
    if (*deleted) {
        status = run(db, "DELETE FROM outputs WHERE job = ?1", VALUES(T(id)), error);
        if (status == STATUS_OK) status = run(db, "DELETE FROM jobs WHERE id = ?1", VALUES(T(id)), error);
    }
    return end(db, status, error);
}

enum status queue_delete(struct queue *queue, const char *id, const char *reason, bool *changed, struct error *error) {
    int64_t deleted = 0;
    pthread_mutex_lock(&queue->writer.lock);
    enum status status = delete_rows(queue->writer.db, id, reason, &deleted, error);
    pthread_mutex_unlock(&queue->writer.lock);
    *changed = status == STATUS_OK && deleted;
    return status;
}

enum status queue_expired(struct queue *queue, int64_t now_ms, int64_t tombstones_before_ms, char (*ids)[JOB_ID_BYTES],
                          size_t max, size_t *count, struct error *error) {
    sqlite3_stmt *row;
    *count = 0;
    pthread_mutex_lock(&queue->writer.lock);
    sqlite3 *db = queue->writer.db;
    enum status status = run(db, "DELETE FROM tombstones WHERE at < ?1", VALUES(I(tombstones_before_ms)), error);
    if (status == STATUS_OK)
        status = prepare(db, "SELECT id FROM jobs WHERE expires > 0 AND expires <= ?1 ORDER BY expires LIMIT ?2",
                         VALUES(I(now_ms), I(max)), &row, error);
    if (status == STATUS_OK) {
        while (*count < max && sqlite3_step(row) == SQLITE_ROW) copy_text(row, 0, ids[(*count)++], JOB_ID_BYTES);
        sqlite3_finalize(row);
    }
    pthread_mutex_unlock(&queue->writer.lock);
    return status;
}
