/* The queue: order, transitions, limits, and what survives closing, killing and locking.
 *
 * Each test has a folder of its own.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/queue.h"

#include <dirent.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

struct fixture {
    char folder[64], path[96];
    struct queue *queue;
    struct error error;
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    snprintf(f->folder, sizeof f->folder, "/tmp/test_queue.XXXXXX");
    if (!f || !mkdtemp(f->folder)) return -1;
    snprintf(f->path, sizeof f->path, "%s/queue.db", f->folder);
    *state = f;
    return queue_open(f->path, &f->queue, &f->error) == STATUS_OK ? 0 : -1;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    queue_close(f->queue);
    DIR *folder = opendir(f->folder);
    for (struct dirent *entry; folder && (entry = readdir(folder));) unlinkat(dirfd(folder), entry->d_name, 0);
    if (folder) closedir(folder);
    int rc = rmdir(f->folder);
    free(f);
    return rc;
}

static void reopen(struct fixture *f) {
    queue_close(f->queue);
    assert_int_equal(queue_open(f->path, &f->queue, &f->error), STATUS_OK);
}

/* Ids in the order of n. */
static const char *id_of(int n, char id[JOB_ID_BYTES]) {
    snprintf(id, JOB_ID_BYTES, "%08d-0000-7000-8000-000000000000", n);
    return id;
}

static enum status submit_limited(struct fixture *f, int n, uint64_t max) {
    struct job job = {.created_ms = 1000 + n, .input_bytes = 12, .input_format = "xyz"};
    id_of(n, job.id);
    snprintf(job.cloud, sizeof job.cloud, "cloud%d", n % 2);
    snprintf(job.label, sizeof job.label, "%s", n % 2 ? "odd" : "even");
    snprintf(job.principal, sizeof job.principal, "%s", n % 3 ? "" : "third");
    params_defaults(&job.params);
    job.params.ratio = 0.25;
    return queue_submit(f->queue, &job, &(struct queue_limits){.waiting = max}, &f->error);
}

static void submit(struct fixture *f, int n) { assert_int_equal(submit_limited(f, n, 1000), STATUS_OK); }

static bool claim(struct fixture *f, struct job *job) {
    bool found;
    assert_int_equal(queue_claim(f->queue, INT64_MAX, job, &found, &f->error), STATUS_OK);
    return found;
}

static bool finish(struct fixture *f, enum job_event event, const struct job *job) {
    bool changed;
    assert_int_equal(queue_finish(f->queue, event, job, &changed, &f->error), STATUS_OK);
    return changed;
}

static enum queue_presence get(struct fixture *f, int n, struct job *job) {
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(queue_get(f->queue, id_of(n, id), job, &presence, &tombstone, &f->error), STATUS_OK);
    return presence;
}

static void assert_depth(struct fixture *f, uint64_t waiting, uint64_t running) {
    uint64_t w, r;
    queue_depth(f->queue, &w, &r);
    assert_int_equal(w, waiting);
    assert_int_equal(r, running);
}

/* ------------------------------------------------------------------------------------------------ order */

/* 3 and 6 are of another principal than 1, 2 and 4. */
static void principals_take_turns_the_oldest_first(void **state) {
    static const int order[] = {1, 3, 2, 6, 4};
    struct fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    submit(f, 6), submit(f, 4), submit(f, 3), submit(f, 2), submit(f, 1);
    reopen(f);
    for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
        get(f, order[i], &job);
        assert_int_equal(job.ahead, 0);
        job_done(&job);
        get(f, 4, &job);
        assert_int_equal(job.ahead, 4 - i);
        job_done(&job);
        assert_true(claim(f, &job));
        assert_string_equal(job.id, id_of(order[i], id));
        assert_int_equal(job.state, JOB_RUNNING);
        assert_int_equal(job.attempt, 1);
        assert_float_equal(job.params.ratio, 0.25, 0);
        job_done(&job);
    }
    assert_false(claim(f, &job));
    assert_depth(f, 0, 5);
}

static void count_costs(void *ctx, const struct job_cost *cost, int64_t started_ms) {
    int *counts = ctx;
    assert_int_equal(cost->size, 12);
    counts[started_ms > 0]++;
}

static void the_outlook_has_what_runs_and_what_comes_before(void **state) {
    struct fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    int counts[2] = {0};
    for (int n = 1; n <= 5; n++) submit(f, n);
    assert_true(claim(f, &job));
    queue_outlook(f->queue, id_of(5, id), count_costs, counts);
    assert_int_equal(counts[0], 3);
    assert_int_equal(counts[1], 1);
    assert_true(finish(f, JOB_DONE, &job));
    job_done(&job);
    queue_outlook(f->queue, id_of(5, id), count_costs, counts);
    assert_int_equal(counts[0], 6);
    assert_int_equal(counts[1], 1);
}

static void a_result_is_found_by_its_principal_while_it_is_there(void **state) {
    struct fixture *f = *state;
    struct job job = {.priority = 3, .created_ms = 50, .started_ms = 50, .result = "same", .principal = "me"};
    struct job found;
    bool is_found, changed;
    params_defaults(&job.params);
    id_of(7, job.id);
    job.report = strdup("{}");
    job.output_count = 1;
    snprintf(job.output[0].name, sizeof job.output[0].name, "cloud.ply");
    assert_int_equal(queue_submit_ended(f->queue, &job, &f->error), STATUS_OK);
    assert_depth(f, 0, 0);
    reopen(f);
    assert_int_equal(queue_find_result(f->queue, "same", "you", &found, &is_found, &f->error), STATUS_OK);
    assert_false(is_found);
    assert_int_equal(queue_find_result(f->queue, "same", "me", &found, &is_found, &f->error), STATUS_OK);
    assert_true(is_found);
    assert_string_equal(found.id, job.id);
    assert_string_equal(found.report, "{}");
    assert_string_equal(found.output[0].name, "cloud.ply");
    assert_int_equal(found.priority, 3);
    assert_int_equal(found.started_ms, 50);
    assert_int_equal(found.state, JOB_SUCCESSFUL);
    job_done(&found);
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_int_equal(queue_find_result(f->queue, "same", "me", &found, &is_found, &f->error), STATUS_OK);
    assert_false(is_found);
    job_done(&job);
}

static void how_many_are_ahead(void **state) {
    struct fixture *f = *state;
    struct job job;
    for (int n = 1; n < 5; n++) submit(f, n);
    assert_true(claim(f, &job));
    job_done(&job);
    get(f, 4, &job);
    assert_int_equal(job.ahead, 2);
    job_done(&job);
    get(f, 1, &job);
    assert_int_equal(job.ahead, 0);
    job_done(&job);
}

static void a_full_queue_refuses(void **state) {
    struct fixture *f = *state;
    struct job job;
    assert_int_equal(submit_limited(f, 1, 2), STATUS_OK);
    assert_int_equal(submit_limited(f, 2, 2), STATUS_OK);
    assert_int_equal(submit_limited(f, 3, 2), STATUS_LIMIT);
    assert_int_equal(get(f, 3, &job), QUEUE_ABSENT);
    assert_true(claim(f, &job));
    job_done(&job);
    assert_int_equal(submit_limited(f, 3, 2), STATUS_OK); /* those that run don't wait */
}

static void an_id_comes_once(void **state) {
    struct fixture *f = *state;
    submit(f, 1);
    assert_int_equal(submit_limited(f, 1, 1000), STATUS_IO);
    assert_depth(f, 1, 0);
}

/* ------------------------------------------------------------------------------------------------ transitions */

static void done_keeps_everything(void **state) {
    struct fixture *f = *state;
    struct job job, back;
    submit(f, 1);
    assert_true(claim(f, &job));
    job.report = strdup("{\"points_out\":5}");
    job.cpu_s = 1.5;
    job.wall_s = 2.5;
    job.peak_rss_bytes = 12345;
    job.expires_ms = 99;
    job.output_count = 2;
    job.output[0] = (struct job_output){"cloud.ply", 10, "aa"};
    job.output[1] = (struct job_output){"mesh.ply", 20, "bb"};
    assert_true(finish(f, JOB_DONE, &job));
    reopen(f);
    assert_int_equal(get(f, 1, &back), QUEUE_PRESENT);
    assert_int_equal(back.state, JOB_SUCCESSFUL);
    assert_string_equal(back.report, job.report);
    assert_null(back.problem);
    assert_float_equal(back.cpu_s, 1.5, 0);
    assert_float_equal(back.fraction, 1, 0);
    assert_int_equal(back.peak_rss_bytes, 12345);
    assert_int_equal(back.output_count, 2);
    assert_string_equal(back.output[1].name, "mesh.ply");
    assert_int_equal(back.output[1].bytes, 20);
    assert_true(back.sequence > job.sequence);
    assert_depth(f, 0, 0);
    job_done(&job);
    job_done(&back);
}

static void only_legal_transitions_change_anything(void **state) {
    struct fixture *f = *state;
    struct job job, back;
    submit(f, 1);
    get(f, 1, &job);
    assert_false(finish(f, JOB_DONE, &job));
    assert_false(finish(f, JOB_FAIL, &job));
    assert_false(finish(f, JOB_REQUEUE, &job));
    assert_false(finish(f, JOB_DISMISS, &job)); /* there is no process that it would end */
    assert_true(finish(f, JOB_WITHDRAW, &job));
    for (int event = JOB_DONE; event < JOB_EVENT_COUNT; event++) assert_false(finish(f, (enum job_event)event, &job));
    get(f, 1, &back);
    assert_int_equal(back.state, JOB_DISMISSED);
    assert_false(claim(f, &job));
    assert_depth(f, 0, 0);
    struct job none = {.id = "none"};
    assert_false(finish(f, JOB_DISMISS, &none));
    job_done(&back);
}

static void requeue_counts_attempts(void **state) {
    struct fixture *f = *state;
    struct job job;
    submit(f, 1);
    for (int attempt = 1; attempt <= 3; attempt++) {
        assert_true(claim(f, &job));
        assert_int_equal(job.attempt, attempt);
        assert_true(finish(f, JOB_REQUEUE, &job));
        assert_depth(f, 1, 0);
        job_done(&job);
    }
}

static void sequences_only_grow(void **state) {
    struct fixture *f = *state;
    struct job job, now;
    uint64_t last = 0;
    submit(f, 1);
    assert_true(claim(f, &job));
    for (int i = 0; i < 50; i++) {
        assert_int_equal(queue_progress(f->queue, job.id, "contract", "some", i / 50.0, &f->error), STATUS_OK);
        get(f, 1, &now);
        assert_true(now.sequence > last);
        assert_string_equal(now.stage, "contract");
        last = now.sequence;
        job_done(&now);
    }
    job_done(&job);
}

static void progress_of_an_ended_job_changes_nothing(void **state) {
    struct fixture *f = *state;
    struct job job, before, after;
    submit(f, 1);
    assert_true(claim(f, &job));
    assert_true(finish(f, JOB_DISMISS, &job));
    get(f, 1, &before);
    assert_int_equal(queue_progress(f->queue, job.id, "late", "", 0.5, &f->error), STATUS_OK);
    get(f, 1, &after);
    assert_int_equal(before.sequence, after.sequence);
    assert_string_equal(after.stage, "");
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ lists, deletion */

static size_t list(struct fixture *f, struct queue_filter filter, struct job *jobs, size_t max) {
    size_t count;
    assert_int_equal(queue_list(f->queue, &filter, jobs, max, &count, &f->error), STATUS_OK);
    return count;
}

static void lists_are_newest_first_and_filtered(void **state) {
    struct fixture *f = *state;
    struct job jobs[10], job;
    char id[JOB_ID_BYTES];
    for (int n = 0; n < 6; n++) submit(f, n);
    assert_true(claim(f, &job));
    job_done(&job);
    assert_int_equal(list(f, (struct queue_filter){0}, jobs, 10), 6);
    assert_string_equal(jobs[0].id, id_of(5, id));
    assert_int_equal(list(f, (struct queue_filter){0}, jobs, 4), 4);
    assert_int_equal(list(f, (struct queue_filter){.after = id_of(2, id)}, jobs, 10), 2);
    assert_int_equal(list(f, (struct queue_filter){.label = "odd"}, jobs, 10), 3);
    assert_int_equal(list(f, (struct queue_filter){.label = "' OR 1=1 --"}, jobs, 10), 0);
    assert_int_equal(list(f, (struct queue_filter){.principal = ""}, jobs, 10), 4);
    assert_int_equal(list(f, (struct queue_filter){.principal = "third"}, jobs, 10), 2);
    assert_string_equal(jobs[0].principal, "third");
    assert_int_equal(list(f, (struct queue_filter){.by_state = true, .state = JOB_RUNNING}, jobs, 10), 1);
    assert_int_equal(list(f, (struct queue_filter){.by_state = true, .state = JOB_FAILED}, jobs, 10), 0);
}

static void usage_follows_every_change(void **state) {
    struct fixture *f = *state;
    struct job job;
    bool changed;
    for (int n = 0; n < 4; n++) submit(f, n); /* 0 and 3 are "third"'s, 12 bytes each */
    assert_int_equal(queue_usage(f->queue, "third").active, 2);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 24);
    assert_true(claim(f, &job)); /* 0 */
    assert_int_equal(queue_usage(f->queue, "third").active, 2);
    job.output_count = 1;
    job.output[0] = (struct job_output){.name = "cloud.ply", .bytes = 100};
    assert_true(finish(f, JOB_DONE, &job));
    assert_int_equal(queue_usage(f->queue, "third").active, 1);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 124);
    reopen(f);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 124);
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 12);
    assert_int_equal(queue_usage(f->queue, "").active, 2);
    assert_int_equal(queue_usage(f->queue, "nobody").active, 0);
    job_done(&job);
}

static void a_principal_has_limits_of_its_own(void **state) {
    struct fixture *f = *state;
    struct queue_limits jobs = {.waiting = 100, .principal_jobs = 1}, bytes = {.waiting = 100, .principal_bytes = 20};
    struct job job = {.created_ms = 1, .input_bytes = 12, .input_format = "xyz", .principal = "third"};
    submit(f, 3);
    id_of(10, job.id);
    params_defaults(&job.params);
    assert_int_equal(queue_submit(f->queue, &job, &jobs, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_jobs");
    assert_int_equal(queue_submit(f->queue, &job, &bytes, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    job.principal[0] = 0;
    assert_int_equal(queue_submit(f->queue, &job, &jobs, &f->error), STATUS_OK);
}

static void deleting_leaves_a_tombstone(void **state) {
    struct fixture *f = *state;
    struct job job;
    bool changed;
    uint64_t uses;
    submit(f, 3);
    assert_true(claim(f, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_false(changed); /* it runs */
    assert_true(finish(f, JOB_DISMISS, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_true(changed);
    assert_int_equal(queue_cloud_uses(f->queue, job.cloud, &uses, &f->error), STATUS_OK);
    assert_int_equal(uses, 0);
    job_done(&job);
    reopen(f);
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(queue_get(f->queue, id_of(3, id), &job, &presence, &tombstone, &f->error), STATUS_OK);
    assert_int_equal(presence, QUEUE_GONE);
    assert_string_equal(tombstone.principal, "third");
    assert_string_equal(tombstone.reason, "deleted");
    assert_true(tombstone.at_ms > 0);
}

static void what_is_past_its_time_is_found(void **state) {
    struct fixture *f = *state;
    struct job job;
    char ids[4][JOB_ID_BYTES], id[JOB_ID_BYTES];
    size_t count;
    for (int n = 0; n < 3; n++) submit(f, n);
    for (int n = 0; n < 2; n++) {
        assert_true(claim(f, &job));
        job.expires_ms = 100 + n * 100;
        assert_true(finish(f, JOB_DISMISS, &job));
        job_done(&job);
    }
    assert_int_equal(queue_expired(f->queue, 150, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(ids[0], id_of(0, id));
    assert_int_equal(queue_expired(f->queue, 1000, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2); /* a job that waits never expires */
}

static void tombstones_are_forgotten(void **state) {
    struct fixture *f = *state;
    struct job job;
    char ids[1][JOB_ID_BYTES];
    size_t count;
    bool changed;
    submit(f, 1);
    assert_true(claim(f, &job));
    assert_true(finish(f, JOB_DISMISS, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "expired", &changed, &f->error), STATUS_OK);
    job_done(&job);
    assert_int_equal(queue_expired(f->queue, 0, INT64_MAX, ids, 1, &count, &f->error), STATUS_OK);
    assert_int_equal(get(f, 1, &job), QUEUE_ABSENT);
}

/* ------------------------------------------------------------------------------------------------ durability */

static void everything_is_there_after_reopening(void **state) {
    struct fixture *f = *state;
    struct job job;
    for (int n = 0; n < 5; n++) submit(f, n);
    assert_true(claim(f, &job));
    job_done(&job);
    reopen(f);
    assert_depth(f, 4, 1);
    get(f, 0, &job);
    assert_int_equal(job.state, JOB_RUNNING);
    job_done(&job);
}

static void what_was_submitted_survives_a_kill(void **state) {
    struct fixture *f = *state;
    struct job job;
    queue_close(f->queue);
    f->queue = NULL;
    pid_t child = fork();
    if (child == 0) {
        if (queue_open(f->path, &f->queue, &f->error) != STATUS_OK) _exit(1);
        if (submit_limited(f, 7, 10) != STATUS_OK) _exit(2);
        kill(getpid(), SIGKILL);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
    assert_int_equal(queue_open(f->path, &f->queue, &f->error), STATUS_OK);
    assert_int_equal(get(f, 7, &job), QUEUE_PRESENT);
    assert_depth(f, 1, 0);
    job_done(&job);
}

static sqlite3 *other_connection(struct fixture *f, const char *sql) {
    sqlite3 *db;
    assert_int_equal(sqlite3_open(f->path, &db), SQLITE_OK);
    assert_int_equal(sqlite3_exec(db, sql, NULL, NULL, NULL), SQLITE_OK);
    return db;
}

static void *release(void *ctx) {
    sqlite3 *db = ctx;
    usleep(50000);
    sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
    return NULL;
}

static void a_lock_held_by_somebody_else_is_waited_for(void **state) {
    struct fixture *f = *state;
    pthread_t thread;
    sqlite3 *db = other_connection(f, "BEGIN IMMEDIATE");
    assert_int_equal(pthread_create(&thread, NULL, release, db), 0);
    submit(f, 1);
    pthread_join(thread, NULL);
    sqlite3_close(db);
    assert_depth(f, 1, 0);
}

static void readers_do_not_wait_for_a_writer(void **state) {
    struct fixture *f = *state;
    struct job job;
    submit(f, 1);
    sqlite3 *db = other_connection(f, "BEGIN IMMEDIATE; UPDATE jobs SET label = 'x'");
    assert_int_equal(get(f, 1, &job), QUEUE_PRESENT);
    assert_string_equal(job.label, "odd");
    job_done(&job);
    sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
    sqlite3_close(db);
}

static void a_database_that_refuses_is_an_error_and_changes_nothing(void **state) {
    struct fixture *f = *state;
    submit(f, 1);
    sqlite3 *db = other_connection(f, "DROP TABLE outputs; CREATE TRIGGER no BEFORE INSERT ON jobs BEGIN SELECT "
                                      "RAISE(ABORT, 'disk is full'); END");
    assert_int_equal(submit_limited(f, 2, 10), STATUS_IO);
    assert_non_null(strstr(f->error.text, "disk is full"));
    assert_depth(f, 1, 0);
    struct job job = {0};
    bool changed;
    assert_int_equal(sqlite3_exec(db, "UPDATE jobs SET state = 1", NULL, NULL, NULL), SQLITE_OK);
    id_of(1, job.id);
    job.output_count = 1;
    assert_int_equal(queue_finish(f->queue, JOB_DONE, &job, &changed, &f->error), STATUS_IO);
    assert_false(changed);
    sqlite3_stmt *row;
    assert_int_equal(sqlite3_prepare_v2(db, "SELECT state FROM jobs", -1, &row, NULL), SQLITE_OK);
    assert_int_equal(sqlite3_step(row), SQLITE_ROW);
    assert_int_equal(sqlite3_column_int(row, 0), JOB_RUNNING); /* the half that succeeded was undone */
    sqlite3_finalize(row);
    sqlite3_close(db);
}

static void a_file_that_is_no_database_is_refused(void **state) {
    struct fixture *f = *state;
    struct queue *queue = NULL;
    char path[128];
    snprintf(path, sizeof path, "%s/noise", f->folder);
    FILE *file = fopen(path, "w");
    for (int i = 0; i < 5000; i++) fputs("noise ", file);
    fclose(file);
    assert_int_equal(queue_open(path, &queue, &f->error), STATUS_IO);
    assert_int_equal(queue_open("/nonexistent/folder/x.db", &queue, &f->error), STATUS_IO);
    assert_null(queue);
}

static void a_newer_schema_is_refused(void **state) {
    struct fixture *f = *state;
    queue_close(f->queue);
    f->queue = NULL;
    sqlite3_close(other_connection(f, "PRAGMA user_version = 99"));
    assert_int_equal(queue_open(f->path, &f->queue, &f->error), STATUS_UNSUPPORTED);
}

/* ------------------------------------------------------------------------------------------------ threads */

enum { THREADS = 4, EACH = 25 };

static void *claim_and_finish(void *ctx) {
    struct queue *queue = ctx;
    struct error error;
    intptr_t count = 0;
    struct job job;
    bool found = true, changed;
    while (queue_claim(queue, INT64_MAX, &job, &found, &error) == STATUS_OK && found) {
        if (queue_finish(queue, JOB_DISMISS, &job, &changed, &error) == STATUS_OK) count += changed;
        job_done(&job);
    }
    return (void *)count;
}

static void what_runs_is_not_withdrawn(void **state) {
    struct fixture *f = *state;
    struct job job, back;
    submit(f, 1);
    assert_true(claim(f, &job));
    assert_false(finish(f, JOB_WITHDRAW, &job));
    get(f, 1, &back);
    assert_int_equal(back.state, JOB_RUNNING);
    job_done(&job);
    job_done(&back);
}

static void each_job_is_claimed_by_one(void **state) {
    struct fixture *f = *state;
    pthread_t thread[THREADS];
    intptr_t total = 0;
    for (int n = 0; n < THREADS * EACH; n++) submit(f, n);
    for (int i = 0; i < THREADS; i++) assert_int_equal(pthread_create(&thread[i], NULL, claim_and_finish, f->queue), 0);
    for (int i = 0; i < THREADS; i++) {
        void *count;
        pthread_join(thread[i], &count);
        total += (intptr_t)count;
    }
    assert_int_equal(total, THREADS * EACH);
    assert_depth(f, 0, 0);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void) {
    const struct CMUnitTest tests[] = {
        TEST(principals_take_turns_the_oldest_first),
        TEST(the_outlook_has_what_runs_and_what_comes_before),
        TEST(a_result_is_found_by_its_principal_while_it_is_there),
        TEST(how_many_are_ahead),
        TEST(a_full_queue_refuses),
        TEST(an_id_comes_once),
        TEST(done_keeps_everything),
        TEST(only_legal_transitions_change_anything),
        TEST(requeue_counts_attempts),
        TEST(sequences_only_grow),
        TEST(progress_of_an_ended_job_changes_nothing),
        TEST(lists_are_newest_first_and_filtered),
        TEST(usage_follows_every_change),
        TEST(a_principal_has_limits_of_its_own),
        TEST(deleting_leaves_a_tombstone),
        TEST(what_is_past_its_time_is_found),
        TEST(tombstones_are_forgotten),
        TEST(everything_is_there_after_reopening),
        TEST(what_was_submitted_survives_a_kill),
        TEST(a_lock_held_by_somebody_else_is_waited_for),
        TEST(readers_do_not_wait_for_a_writer),
        TEST(a_database_that_refuses_is_an_error_and_changes_nothing),
        TEST(a_file_that_is_no_database_is_refused),
        TEST(a_newer_schema_is_refused),
        TEST(what_runs_is_not_withdrawn),
        TEST(each_job_is_claimed_by_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
