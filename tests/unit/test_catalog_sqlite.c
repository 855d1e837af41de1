/* The queue's database: what survives closing, killing and locking, and many threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
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

#include "tests/unit/catalog_fixture.h"

/* ------------------------------------------------------------------------------------------------ durability */

static void everything_is_there_after_reopening(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    for (int n = 0; n < 5; n++) catalog_fixture_submit(f, n);
    assert_true(catalog_fixture_claim(f, &job));
    job_done(&job);
    catalog_fixture_reopen(f);
    catalog_fixture_assert_depth(f, 4, 1);
    catalog_fixture_get(f, 0, &job);
    assert_int_equal(job.state, JOB_RUNNING);
    job_done(&job);
}

static void what_was_submitted_survives_a_kill(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    catalog_close(f->catalog);
    f->catalog = NULL;
    pid_t child = fork();
    if (child == 0) {
        if (catalog_open(f->url, &f->catalog, &f->error) != STATUS_OK) _exit(1);
        if (catalog_fixture_submit_limited(f, 7, 10) != STATUS_OK) _exit(2);
        kill(getpid(), SIGKILL);
    }
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_OK);
    assert_int_equal(catalog_fixture_get(f, 7, &job), CATALOG_PRESENT);
    catalog_fixture_assert_depth(f, 1, 0);
    job_done(&job);
}

static sqlite3 *other_connection(struct catalog_fixture *f, const char *sql) {
    sqlite3 *db;
    assert_int_equal(sqlite3_open(f->path, &db), SQLITE_OK);
    assert_int_equal(sqlite3_exec(db, sql, NULL, NULL, NULL), SQLITE_OK);
    return db;
}

static sqlite3 *holder;
static int waits;

/* What SQLite calls while it waits for a lock: by then whoever waits has tried, and the lock goes. */
static int release(sqlite3_vfs *vfs, int microseconds) {
    (void)vfs;
    waits++;
    assert_int_equal(sqlite3_exec(holder, "ROLLBACK", NULL, NULL, NULL), SQLITE_OK);
    return microseconds;
}

static void a_lock_held_by_somebody_else_is_waited_for(void **state) {
    struct catalog_fixture *f = *state;
    sqlite3_vfs *vfs = sqlite3_vfs_find(NULL);
    int (*sleep_before)(sqlite3_vfs *, int) = vfs->xSleep;
    holder = other_connection(f, "BEGIN IMMEDIATE");
    vfs->xSleep = release;
    catalog_fixture_submit(f, 1);
    vfs->xSleep = sleep_before;
    sqlite3_close(holder);
    assert_int_equal(waits, 1);
    catalog_fixture_assert_depth(f, 1, 0);
}

static void readers_do_not_wait_for_a_writer(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    catalog_fixture_submit(f, 1);
    sqlite3 *db = other_connection(f, "BEGIN IMMEDIATE; UPDATE jobs SET label = 'x'");
    assert_int_equal(catalog_fixture_get(f, 1, &job), CATALOG_PRESENT);
    assert_string_equal(job.label, "odd");
    job_done(&job);
    sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
    sqlite3_close(db);
}

static void a_database_that_refuses_is_an_error_and_changes_nothing(void **state) {
    struct catalog_fixture *f = *state;
    catalog_fixture_submit(f, 1);
    sqlite3 *db = other_connection(f, "DROP TABLE outputs; CREATE TRIGGER no BEFORE INSERT ON jobs BEGIN SELECT "
                                      "RAISE(ABORT, 'disk is full'); END");
    assert_int_equal(catalog_fixture_submit_limited(f, 2, 10), STATUS_IO);
    assert_non_null(strstr(f->error.text, "disk is full"));
    catalog_fixture_assert_depth(f, 1, 0);
    struct job job = {0};
    bool changed;
    assert_int_equal(sqlite3_exec(db, "UPDATE jobs SET state = 1", NULL, NULL, NULL), SQLITE_OK);
    catalog_fixture_id(1, job.id);
    job.output_count = 1;
    assert_int_equal(catalog_finish(f->catalog, JOB_DONE, &job, &changed, &f->error), STATUS_IO);
    assert_false(changed);
    sqlite3_stmt *row;
    assert_int_equal(sqlite3_prepare_v2(db, "SELECT state FROM jobs", -1, &row, NULL), SQLITE_OK);
    assert_int_equal(sqlite3_step(row), SQLITE_ROW);
    assert_int_equal(sqlite3_column_int(row, 0), JOB_RUNNING); /* the half that succeeded was undone */
    sqlite3_finalize(row);
    sqlite3_close(db);
}

static void a_file_that_is_no_database_is_refused(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *catalog = NULL;
    char path[128], url[144];
    snprintf(path, sizeof path, "%s/noise", f->folder);
    snprintf(url, sizeof url, "sqlite:%s", path);
    FILE *file = fopen(path, "w");
    for (int i = 0; i < 5000; i++) fputs("noise ", file);
    fclose(file);
    assert_int_equal(catalog_open(url, &catalog, &f->error), STATUS_IO);
    assert_int_equal(catalog_open("sqlite:/nonexistent/folder/x.db", &catalog, &f->error), STATUS_IO);
    assert_null(catalog);
}

static void a_newer_schema_is_refused(void **state) {
    struct catalog_fixture *f = *state;
    catalog_close(f->catalog);
    f->catalog = NULL;
    sqlite3_close(other_connection(f, "PRAGMA user_version = 99"));
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_UNSUPPORTED);
}

/* ------------------------------------------------------------------------------------------------ threads */

enum { THREADS = 4, EACH = 25 };

static void *claim_and_finish(void *ctx) {
    struct catalog *catalog = ctx;
    struct error error;
    intptr_t count = 0;
    struct job job;
    bool found = true, changed;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    while (catalog_claim(catalog, &by, &job, &found, &error) == STATUS_OK && found) {
        if (catalog_finish(catalog, JOB_DISMISS, &job, &changed, &error) == STATUS_OK) count += changed;
        job_done(&job);
    }
    return (void *)count;
}

static void what_runs_is_not_withdrawn(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, back;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    assert_false(catalog_fixture_finish(f, JOB_WITHDRAW, &job));
    catalog_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_RUNNING);
    job_done(&job);
    job_done(&back);
}

static void each_job_is_claimed_by_one(void **state) {
    struct catalog_fixture *f = *state;
    pthread_t thread[THREADS];
    intptr_t total = 0;
    for (int n = 0; n < THREADS * EACH; n++) catalog_fixture_submit(f, n);
    for (int i = 0; i < THREADS; i++)
        assert_int_equal(pthread_create(&thread[i], NULL, claim_and_finish, f->catalog), 0);
    for (int i = 0; i < THREADS; i++) {
        void *count;
        pthread_join(thread[i], &count);
        total += (intptr_t)count;
    }
    assert_int_equal(total, THREADS * EACH);
    catalog_fixture_assert_depth(f, 0, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        CATALOG_TEST(everything_is_there_after_reopening),
        CATALOG_TEST(what_was_submitted_survives_a_kill),
        CATALOG_TEST(a_lock_held_by_somebody_else_is_waited_for),
        CATALOG_TEST(readers_do_not_wait_for_a_writer),
        CATALOG_TEST(a_database_that_refuses_is_an_error_and_changes_nothing),
        CATALOG_TEST(a_file_that_is_no_database_is_refused),
        CATALOG_TEST(a_newer_schema_is_refused),
        CATALOG_TEST(what_runs_is_not_withdrawn),
        CATALOG_TEST(each_job_is_claimed_by_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
