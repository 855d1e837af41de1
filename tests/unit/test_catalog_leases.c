/* The contract of catalogs: leases and fences, cancelling, who is told of changes, and other processes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/unit/catalog_fixture.h"

enum { LONG_MS = 3600 * 1000 };

static bool claim_by(struct catalog_fixture *f, const char *owner, int64_t lease_ms, struct job *job) {
    struct catalog_claim by = {owner, lease_ms, INT64_MAX};
    bool found;
    assert_int_equal(catalog_claim(f->catalog, &by, job, &found, &f->error), STATUS_OK);
    return found;
}

static bool progress(struct catalog_fixture *f, const struct job *job) {
    bool held;
    assert_int_equal(catalog_progress(f->catalog, job, &held, &f->error), STATUS_OK);
    return held;
}

static size_t lost(struct catalog_fixture *f, const char *owner, struct job *jobs, size_t max) {
    size_t count;
    assert_int_equal(catalog_list_lost(f->catalog, owner, jobs, max, &count, &f->error), STATUS_OK);
    return count;
}

static size_t renew(struct catalog_fixture *f, const char *owner, struct catalog_lease *leases, size_t max) {
    size_t count;
    assert_int_equal(catalog_renew(f->catalog, owner, LONG_MS, leases, max, &count, &f->error), STATUS_OK);
    return count;
}

/* ------------------------------------------------------------------------------------------------ leases */

static void a_lease_that_is_held_is_not_lost(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, found[2];
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_string_equal(job.owner, "a");
    assert_int_equal(job.attempt, 1);
    assert_true(job.lease_end_ms >= job.started_ms + LONG_MS);
    assert_int_equal(lost(f, NULL, found, 2), 0);
    assert_int_equal(lost(f, "b", found, 2), 0);
    job_done(&job);
}

static void a_lease_that_is_over_is_lost_until_it_is_renewed(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_lease lease[2];
    struct job job, found[2];
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", 0, &job));
    assert_int_equal(lost(f, NULL, found, 2), 1);
    assert_string_equal(found[0].id, job.id);
    assert_int_equal(renew(f, "b", lease, 2), 0); /* it is nobody else's to renew */
    assert_int_equal(lost(f, NULL, found, 2), 1);
    assert_int_equal(renew(f, "a", lease, 2), 1);
    assert_string_equal(lease[0].job, job.id);
    assert_int_equal(lease[0].attempt, 1);
    assert_int_equal(lost(f, NULL, found, 2), 0);
    job_done(&job);
}

static void a_host_that_begins_finds_what_it_ran_before(void **state) {
    struct catalog_fixture *f = *state;
    struct job mine, yours, found[4];
    for (int n = 1; n <= 3; n++) catalog_fixture_submit(f, n);
    assert_true(claim_by(f, "a", LONG_MS, &mine));
    assert_true(claim_by(f, "b", LONG_MS, &yours));
    catalog_fixture_reopen(f);
    assert_int_equal(lost(f, "a", found, 4), 1);
    assert_string_equal(found[0].id, mine.id);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &found[0]));
    assert_int_equal(lost(f, "a", found, 4), 0);
    assert_true(progress(f, &yours)); /* nothing has happened to the other one's */
    job_done(&mine);
    job_done(&yours);
}

/* ------------------------------------------------------------------------------------------------ fences */

/* Takes the job from the host that has it, as a sweep does, and gives it to another one. */
static void take_over(struct catalog_fixture *f, const char *owner, struct job *job) {
    struct job found[1];
    assert_int_equal(lost(f, NULL, found, 1), 1);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &found[0]));
    assert_true(claim_by(f, owner, LONG_MS, job));
    job_done(&found[0]);
}

static void a_late_writer_changes_nothing(void **state) {
    static const enum job_event events[] = {JOB_DONE, JOB_FAIL, JOB_DISMISS, JOB_REQUEUE};
    struct catalog_fixture *f = *state;
    struct job late, now, before, after;
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", 0, &late));
    take_over(f, "b", &now);
    assert_int_equal(now.attempt, 2);
    catalog_fixture_get(f, 1, &before);
    late.output_count = 1;
    late.output[0] = (struct job_output){"cloud.ply", 10, "aa"};
    assert_false(progress(f, &late));
    for (size_t i = 0; i < sizeof events / sizeof *events; i++)
        assert_false(catalog_fixture_finish(f, events[i], &late));
    catalog_fixture_get(f, 1, &after);
    assert_int_equal(after.state, JOB_RUNNING);
    assert_int_equal(after.sequence, before.sequence);
    assert_int_equal(after.output_count, 0);
    catalog_fixture_assert_depth(f, 0, 1);
    assert_true(catalog_fixture_finish(f, JOB_DONE, &now));
    assert_false(catalog_fixture_finish(f, JOB_DISMISS, &late)); /* nor when it is over */
    job_done(&late), job_done(&now), job_done(&before), job_done(&after);
}

/* The same host may have it again: then the attempt tells. */
static void an_earlier_attempt_of_the_same_host_is_late_too(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_lease lease[2];
    struct job late, now;
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", 0, &late));
    take_over(f, "a", &now);
    assert_false(progress(f, &late));
    assert_false(catalog_fixture_finish(f, JOB_DONE, &late));
    assert_int_equal(renew(f, "a", lease, 2), 1);
    assert_int_equal(lease[0].attempt, 2);
    assert_true(catalog_fixture_finish(f, JOB_DONE, &now));
    job_done(&late), job_done(&now);
}

/* ------------------------------------------------------------------------------------------------ cancelling */

static void what_is_cancelled_is_told_and_not_run_again(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_lease lease[1];
    struct job job, back;
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(renew(f, "a", lease, 1), 1);
    assert_false(lease[0].is_cancelled);
    assert_int_equal(catalog_cancel(f->catalog, job.id, &f->error), STATUS_OK);
    assert_int_equal(catalog_cancel(f->catalog, job.id, &f->error), STATUS_OK);
    catalog_fixture_reopen(f);
    assert_int_equal(renew(f, "a", lease, 1), 1);
    assert_true(lease[0].is_cancelled);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job)); /* its host ends: what was asked for holds */
    catalog_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_DISMISSED);
    assert_false(claim_by(f, "a", LONG_MS, &job));
    job_done(&back);
}

static void what_does_not_run_is_not_cancelled(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, back;
    char id[JOB_ID_BYTES];
    catalog_fixture_submit(f, 1);
    assert_int_equal(catalog_cancel(f->catalog, catalog_fixture_id(1, id), &f->error), STATUS_OK);
    assert_int_equal(catalog_cancel(f->catalog, catalog_fixture_id(2, id), &f->error), STATUS_OK);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_false(job.is_cancelled);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job));
    catalog_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_ACCEPTED);
    job_done(&job), job_done(&back);
}

/* ------------------------------------------------------------------------------------------------ changes */

static void note(void *ctx, enum catalog_change change, const char *id) {
    static const char letters[] = {
        [CATALOG_CHANGED] = 'c', [CATALOG_WAITS] = 'w', [CATALOG_CANCELLED] = 'x', [CATALOG_DELETED] = 'd'};
    char *notes = ctx, wanted[JOB_ID_BYTES];
    assert_string_equal(id, catalog_fixture_id(1, wanted));
    notes[strlen(notes)] = letters[change];
}

static void every_change_of_a_job_is_told(void **state) {
    struct catalog_fixture *f = *state;
    char notes[32] = "";
    bool changed;
    struct job job;
    catalog_watch(f->catalog, note, notes);
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", 0, &job));
    assert_true(progress(f, &job));
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job));
    assert_string_equal(notes, "wccw");
    assert_false(progress(f, &job)); /* what changes nothing isn't */
    assert_false(catalog_fixture_finish(f, JOB_DONE, &job));
    assert_string_equal(notes, "wccw");
    job_done(&job);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(catalog_cancel(f->catalog, job.id, &f->error), STATUS_OK);
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_string_equal(notes, "wccwcxcd");
    job_done(&job);
}

/* Whoever is told may ask: no lock is held. */
static void ask(void *ctx, enum catalog_change change, const char *id) {
    struct catalog_fixture *f = ctx;
    struct job job;
    (void)change;
    (void)id;
    assert_int_equal(catalog_fixture_get(f, 1, &job), CATALOG_PRESENT);
    job_done(&job);
}

static void whoever_is_told_may_ask(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    catalog_watch(f->catalog, ask, f);
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ side by side */

enum { WORKERS = 3, JOBS = 60 };

struct worker {
    struct catalog *catalog;
    char owner[JOB_OWNER_BYTES];
    int done; /* -1: something failed */
};

/* Claims and ends jobs until none waits: side by side with others. */
static void *work(void *ctx) {
    struct worker *worker = ctx;
    struct catalog_claim by = {worker->owner, LONG_MS, INT64_MAX};
    struct error error;
    struct job job;
    bool found = true, changed;
    while (worker->done >= 0 && found) {
        bool ok = catalog_claim(worker->catalog, &by, &job, &found, &error) == STATUS_OK;
        if (ok && found) {
            ok = catalog_finish(worker->catalog, JOB_DONE, &job, &changed, &error) == STATUS_OK && changed;
            job_done(&job);
            worker->done++;
        }
        if (!ok) worker->done = -1;
    }
    return NULL;
}

static void each_job_is_one_threads(void **state) {
    struct catalog_fixture *f = *state;
    struct worker worker[WORKERS] = {0};
    pthread_t thread[WORKERS];
    int done = 0;
    for (int n = 0; n < JOBS; n++) catalog_fixture_submit(f, n);
    for (int i = 0; i < WORKERS; i++) {
        worker[i].catalog = f->catalog;
        snprintf(worker[i].owner, sizeof worker[i].owner, "host%d", i);
        assert_int_equal(pthread_create(&thread[i], NULL, work, &worker[i]), 0);
    }
    for (int i = 0; i < WORKERS; i++) {
        pthread_join(thread[i], NULL);
        assert_true(worker[i].done >= 0);
        done += worker[i].done;
    }
    assert_int_equal(done, JOBS);
    catalog_fixture_assert_depth(f, 0, 0);
}

/* For a child: opens the catalog by its URL, does what is to be done; the result is its exit status. */
static int in_this_process(const struct catalog_fixture *f, int (*run)(struct catalog_fixture *f)) {
    struct catalog_fixture own = {.catalog = NULL};
    memcpy(own.url, f->url, sizeof own.url);
    if (catalog_open(own.url, &own.catalog, &own.error) != STATUS_OK) return 255;
    int result = run(&own);
    catalog_close(own.catalog);
    return result;
}

static int result_of(pid_t child) {
    int status;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

static int work_alone(struct catalog_fixture *f) {
    struct worker worker = {.catalog = f->catalog};
    snprintf(worker.owner, sizeof worker.owner, "%d", (int)getpid());
    work(&worker);
    return worker.done < 0 ? 255 : worker.done;
}

static void each_job_is_one_processes(void **state) {
    struct catalog_fixture *f = *state;
    pid_t child[2];
    int done = 0;
    for (int n = 0; n < JOBS; n++) catalog_fixture_submit(f, n);
    catalog_close(f->catalog); /* a connection doesn't survive a fork */
    f->catalog = NULL;
    for (int i = 0; i < 2; i++) {
        child[i] = fork();
        if (child[i] == 0) _exit(in_this_process(f, work_alone));
    }
    for (int i = 0; i < 2; i++) {
        int result = result_of(child[i]);
        assert_true(result <= JOBS);
        done += result;
    }
    assert_int_equal(done, JOBS);
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_OK);
    catalog_fixture_assert_depth(f, 0, 0);
}

static int gate[2]; /* a pipe: closed by the test when the child may go on */

static int wait_and_take_over(struct catalog_fixture *f) {
    struct job found[1], job;
    size_t count;
    bool changed;
    if (catalog_list_lost(f->catalog, NULL, found, 1, &count, &f->error) != STATUS_OK || count != 1) return 1;
    if (catalog_finish(f->catalog, JOB_REQUEUE, &found[0], &changed, &f->error) != STATUS_OK || !changed) return 2;
    return claim_by(f, "child", LONG_MS, &job) && job.attempt == 2 ? 0 : 3;
}

/* The child is forked before anything is open, and opens the catalog when the job runs here. */
static void a_job_that_another_process_has_taken_is_fenced_here(void **state) {
    struct catalog_fixture *f = *state;
    struct job late, back;
    char byte;
    catalog_close(f->catalog);
    assert_int_equal(pipe(gate), 0);
    pid_t child = fork();
    if (child == 0) {
        close(gate[1]);
        if (read(gate[0], &byte, 1) != 0) _exit(254);
        _exit(in_this_process(f, wait_and_take_over));
    }
    close(gate[0]);
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_OK);
    catalog_fixture_submit(f, 1);
    assert_true(claim_by(f, "a", 0, &late));
    close(gate[1]);
    assert_int_equal(result_of(child), 0);
    assert_false(progress(f, &late));
    assert_false(catalog_fixture_finish(f, JOB_DONE, &late));
    catalog_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_RUNNING);
    assert_string_equal(back.owner, "child");
    job_done(&late), job_done(&back);
}

/* What others change is known without opening the catalog again: order, depth, usage and fences. */
static void what_another_connection_does_is_seen(void **state) {
    struct catalog_fixture *f = *state, other = {.catalog = NULL};
    struct job job, late;
    char id[JOB_ID_BYTES];
    assert_int_equal(catalog_open(f->url, &other.catalog, &other.error), STATUS_OK);
    catalog_fixture_submit(&other, 1);
    assert_true(claim_by(f, "a", 0, &late));
    assert_string_equal(late.id, catalog_fixture_id(1, id));
    take_over(&other, "b", &job);
    assert_false(catalog_fixture_finish(f, JOB_DONE, &late));
    assert_true(catalog_fixture_finish(&other, JOB_DONE, &job));
    catalog_fixture_submit(f, 2);
    catalog_fixture_assert_depth(f, 1, 0);
    assert_int_equal(catalog_usage(f->catalog, "").active, 1);
    catalog_close(other.catalog);
    job_done(&job), job_done(&late);
}

/* ------------------------------------------------------------------------------------------------ limits */

static enum status submit_of(struct catalog_fixture *f, int n, uint64_t bytes, const struct catalog_limits *limits) {
    struct job job = {.created_ms = 1, .input_bytes = bytes, .input_format = "xyz", .principal = "ann"};
    catalog_fixture_id(n, job.id);
    params_defaults(&job.params);
    return catalog_submit(f->catalog, &job, limits, &f->error);
}

struct submitter {
    struct catalog_fixture *f;
    int first, accepted;
};

static void *submit_many(void *ctx) {
    struct submitter *submitter = ctx;
    struct catalog_fixture own = {.catalog = submitter->f->catalog};
    struct catalog_limits limits = {.waiting = 1000, .principal_bytes = 100};
    for (int n = 0; n < 10; n++) submitter->accepted += submit_of(&own, submitter->first + n, 10, &limits) == STATUS_OK;
    return NULL;
}

static void the_limit_is_the_limit_however_many_ask(void **state) {
    struct catalog_fixture *f = *state;
    struct submitter submitter[WORKERS] = {0};
    pthread_t thread[WORKERS];
    int accepted = 0;
    for (int i = 0; i < WORKERS; i++) {
        submitter[i] = (struct submitter){f, 100 * i, 0};
        assert_int_equal(pthread_create(&thread[i], NULL, submit_many, &submitter[i]), 0);
    }
    for (int i = 0; i < WORKERS; i++) {
        pthread_join(thread[i], NULL);
        accepted += submitter[i].accepted;
    }
    assert_int_equal(accepted, 10);
    assert_int_equal(catalog_usage(f->catalog, "ann").bytes, 100);
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(a_lease_that_is_held_is_not_lost),
        CATALOG_TEST(a_lease_that_is_over_is_lost_until_it_is_renewed),
        CATALOG_TEST(a_host_that_begins_finds_what_it_ran_before),
        CATALOG_TEST(a_late_writer_changes_nothing),
        CATALOG_TEST(an_earlier_attempt_of_the_same_host_is_late_too),
        CATALOG_TEST(what_is_cancelled_is_told_and_not_run_again),
        CATALOG_TEST(what_does_not_run_is_not_cancelled),
        CATALOG_TEST(every_change_of_a_job_is_told),
        CATALOG_TEST(whoever_is_told_may_ask),
        CATALOG_TEST(each_job_is_one_threads),
        CATALOG_TEST(each_job_is_one_processes),
        CATALOG_TEST(a_job_that_another_process_has_taken_is_fenced_here),
        CATALOG_TEST(what_another_connection_does_is_seen),
        CATALOG_TEST(the_limit_is_the_limit_however_many_ask),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
