/* The contract of catalogs: jobs in tiles, whose tasks are claimed, ended and lost one by one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/unit/catalog_fixture.h"

enum { LONG_MS = 3600 * 1000, TILES = 3 };

static void submit_in_tiles(struct catalog_fixture *f, int n) {
    struct job job = {.state = JOB_ACCEPTED, .created_ms = 1000 + n, .sequence = 1, .tiles = JOB_TILES_UNPLANNED};
    const struct catalog_limits limits = {.waiting = 100};
    catalog_fixture_id(n, job.id);
    params_defaults(&job.params);
    job.memory_bytes = 7;
    assert_int_equal(catalog_submit(f->catalog, &job, &limits, &f->error), STATUS_OK);
}

static bool claim_by(struct catalog_fixture *f, const char *owner, int64_t lease_ms, struct job *job) {
    struct catalog_claim by = {owner, lease_ms, INT64_MAX};
    bool found;
    assert_int_equal(catalog_claim(f->catalog, &by, job, &found, &f->error), STATUS_OK);
    return found;
}

/* Claims the task of this number and ends it so. */
static void do_task(struct catalog_fixture *f, int64_t number, enum job_event event) {
    struct job job;
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(job.task, number);
    if (number == JOB_TASK_PLAN) job.tiles = TILES;
    job.task_cpu_s = 1;
    assert_true(catalog_fixture_finish(f, event, &job));
    job_done(&job);
}

static size_t lost(struct catalog_fixture *f, const char *owner, struct job *jobs, size_t max) {
    size_t count;
    assert_int_equal(catalog_list_lost(f->catalog, owner, jobs, max, &count, &f->error), STATUS_OK);
    return count;
}

static enum job_state state_of(struct catalog_fixture *f, int n, int64_t *tiles_done) {
    struct job job;
    assert_int_equal(catalog_fixture_get(f, n, &job), CATALOG_PRESENT);
    enum job_state state = job.state;
    if (tiles_done) *tiles_done = job.tiles_done;
    job_done(&job);
    return state;
}

static void tasks_follow_each_other_to_the_end(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    int64_t done;
    submit_in_tiles(f, 1);
    assert_int_equal(state_of(f, 1, NULL), JOB_ACCEPTED);
    catalog_fixture_assert_depth(f, 1, 0);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    for (int64_t t = 1; t <= TILES; t++) {
        assert_int_equal(state_of(f, 1, &done), JOB_RUNNING);
        assert_int_equal(done, t - 1);
        do_task(f, t, JOB_DONE);
    }
    do_task(f, TILES + 1, JOB_DONE);
    catalog_fixture_assert_depth(f, 0, 0);
    assert_int_equal(catalog_fixture_get(f, 1, &job), CATALOG_PRESENT);
    assert_int_equal(job.state, JOB_SUCCESSFUL);
    assert_int_equal(job.tiles, TILES);
    assert_int_equal(job.tiles_done, TILES);
    assert_int_equal(job.attempt, TILES + 2);
    job_done(&job);
    assert_false(claim_by(f, "a", LONG_MS, &job));
}

static void tiles_run_beside_each_other_and_the_merge_after_them(void **state) {
    struct catalog_fixture *f = *state;
    struct job job[TILES], other;
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    for (int t = 0; t < TILES; t++) {
        assert_true(claim_by(f, t % 2 ? "a" : "b", LONG_MS, &job[t]));
        assert_int_equal(job[t].task, t + 1);
        assert_string_equal(job[t].owner, t % 2 ? "a" : "b");
    }
    catalog_fixture_assert_depth(f, 0, TILES);
    assert_false(claim_by(f, "a", LONG_MS, &other));
    assert_int_equal(state_of(f, 1, NULL), JOB_RUNNING);
    for (int t = TILES; t--;) {
        assert_true(job[t].attempt != job[(t + 1) % TILES].attempt);
        assert_false(t > 0 && claim_by(f, "a", LONG_MS, &other));
        assert_true(catalog_fixture_finish(f, JOB_DONE, &job[t]));
        assert_false(catalog_fixture_finish(f, JOB_DONE, &job[t])); /* it is done */
        job_done(&job[t]);
    }
    do_task(f, TILES + 1, JOB_DONE);
    assert_int_equal(state_of(f, 1, NULL), JOB_SUCCESSFUL);
}

static void jobs_of_others_have_turns_between_tiles(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    catalog_fixture_submit(f, 2); /* the same principal's, and later */
    do_task(f, 1, JOB_DONE);
    catalog_fixture_assert_depth(f, 2, 0);
    do_task(f, 2, JOB_DONE);
    do_task(f, 3, JOB_DONE);
    do_task(f, TILES + 1, JOB_DONE);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(job.tiles, 0);
    job_done(&job);
}

static void a_lost_tile_waits_again_alone(void **state) {
    struct catalog_fixture *f = *state;
    struct job held, gone, found[4];
    struct catalog_lease lease[4];
    size_t count;
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    assert_true(claim_by(f, "a", LONG_MS, &held));
    assert_true(claim_by(f, "b", 0, &gone));
    assert_int_equal(lost(f, NULL, found, 4), 1);
    assert_int_equal(found[0].task, gone.task);
    assert_int_equal(found[0].attempt, gone.attempt);
    assert_string_equal(found[0].owner, "b");
    found[0].interruptions++;
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &found[0]));
    job_done(&found[0]);
    assert_false(catalog_fixture_finish(f, JOB_DONE, &gone)); /* fenced */
    assert_int_equal(catalog_renew(f->catalog, "b", LONG_MS, lease, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_renew(f->catalog, "a", LONG_MS, lease, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_int_equal(lease[0].attempt, held.attempt);
    job_done(&gone);
    assert_true(claim_by(f, "a", LONG_MS, &gone));
    assert_int_equal(gone.task, 2);
    assert_int_equal(gone.interruptions, 1);
    assert_true(catalog_fixture_finish(f, JOB_DONE, &held));
    assert_true(catalog_fixture_finish(f, JOB_DONE, &gone));
    do_task(f, 3, JOB_DONE);
    job_done(&held), job_done(&gone);
}

static void a_host_that_begins_finds_its_tasks(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, found[4];
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    catalog_fixture_reopen(f);
    assert_int_equal(lost(f, "a", found, 4), 1);
    assert_int_equal(found[0].task, 1);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &found[0]));
    job_done(&found[0]), job_done(&job);
    catalog_fixture_assert_depth(f, 1, 0);
    do_task(f, 1, JOB_DONE);
}

static void progress_is_the_holders_and_never_goes_back(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, now;
    bool held;
    submit_in_tiles(f, 1);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    job.fraction = 0.25;
    snprintf(job.stage, sizeof job.stage, "count");
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    assert_true(held);
    job.fraction = 0.125;
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    assert_int_equal(catalog_fixture_get(f, 1, &now), CATALOG_PRESENT);
    assert_true(now.fraction == 0.25);
    assert_string_equal(now.stage, "count");
    job.attempt++;
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    assert_false(held);
    job_done(&job), job_done(&now);
}

static void told(void *ctx, enum catalog_change change, const char *id) {
    (void)id;
    if (change == CATALOG_CANCELLED) __atomic_add_fetch((int *)ctx, 1, __ATOMIC_SEQ_CST);
}

static void a_job_ends_whoever_has_its_tasks(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, whole;
    int cancelled = 0;
    catalog_watch(f->catalog, told, &cancelled);
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(catalog_fixture_get(f, 1, &whole), CATALOG_PRESENT);
    assert_true(catalog_fixture_finish(f, JOB_WITHDRAW, &whole));
    assert_true(cancelled > 0);
    assert_int_equal(state_of(f, 1, NULL), JOB_DISMISSED);
    assert_false(catalog_fixture_finish(f, JOB_DONE, &job));
    assert_false(catalog_fixture_finish(f, JOB_WITHDRAW, &whole));
    catalog_fixture_assert_depth(f, 0, 0);
    job_done(&job), job_done(&whole);
    assert_false(claim_by(f, "a", LONG_MS, &job));
}

static void a_task_that_fails_fails_the_job(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    do_task(f, 1, JOB_FAIL);
    assert_int_equal(state_of(f, 1, NULL), JOB_FAILED);
    assert_false(claim_by(f, "a", LONG_MS, &job));
    catalog_fixture_assert_depth(f, 0, 0);
}

static void a_job_that_begins_anew_is_planned_again(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    submit_in_tiles(f, 1);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    assert_int_equal(catalog_fixture_get(f, 1, &job), CATALOG_PRESENT);
    assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job));
    job_done(&job);
    assert_true(claim_by(f, "a", LONG_MS, &job));
    assert_int_equal(job.task, JOB_TASK_PLAN);
    assert_int_equal(job.tiles, JOB_TILES_UNPLANNED);
    job_done(&job);
}

static void it_is_listed_as_running_while_its_tasks_wait(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_filter running = {.by_state = true, .state = JOB_RUNNING};
    struct catalog_filter accepted = {.by_state = true, .state = JOB_ACCEPTED};
    struct job jobs[2];
    size_t count;
    submit_in_tiles(f, 1);
    assert_int_equal(catalog_list(f->catalog, &accepted, jobs, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    job_done(&jobs[0]);
    do_task(f, JOB_TASK_PLAN, JOB_DONE);
    assert_int_equal(catalog_list(f->catalog, &accepted, jobs, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_list(f->catalog, &running, jobs, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    job_done(&jobs[0]);
}

static void a_task_waits_for_memory(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_claim by = {"a", LONG_MS, 6};
    struct job job;
    bool found;
    submit_in_tiles(f, 1);
    assert_int_equal(catalog_claim(f->catalog, &by, &job, &found, &f->error), STATUS_OK);
    assert_false(found);
    by.memory_bytes = 7;
    assert_int_equal(catalog_claim(f->catalog, &by, &job, &found, &f->error), STATUS_OK);
    assert_true(found);
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ several threads */

enum { MANY = 40, THREADS = 4 };

struct hand {
    struct catalog *catalog;
    char owner[8];
    int merges, tiles, failures;
};

/* Does whatever there is until the merge is done, or somebody else has done it. */
static void *work_along(void *ctx) {
    struct hand *hand = ctx;
    struct catalog_claim by = {hand->owner, LONG_MS, INT64_MAX};
    struct error error;
    for (bool over = false; !over;) {
        struct job job;
        enum catalog_presence presence;
        struct catalog_tombstone tombstone;
        bool found = false, changed = false;
        if (catalog_claim(hand->catalog, &by, &job, &found, &error) != STATUS_OK) hand->failures++;
        if (found) {
            if (job.task == JOB_TASK_PLAN) job.tiles = MANY;
            hand->tiles += job.task > 0 && job.task <= MANY;
            hand->merges += job.task > MANY;
            if (catalog_finish(hand->catalog, JOB_DONE, &job, &changed, &error) != STATUS_OK || !changed)
                hand->failures++;
            job_done(&job);
            continue;
        }
        char id[JOB_ID_BYTES];
        if (catalog_get(hand->catalog, catalog_fixture_id(1, id), &job, &presence, &tombstone, &error) != STATUS_OK)
            hand->failures++;
        over = job_ended(job.state) || hand->failures;
        job_done(&job);
    }
    return NULL;
}

static void many_hands_do_each_task_once(void **state) {
    struct catalog_fixture *f = *state;
    struct hand hand[THREADS];
    pthread_t thread[THREADS];
    int merges = 0, tiles = 0;
    submit_in_tiles(f, 1);
    for (int i = 0; i < THREADS; i++) {
        hand[i] = (struct hand){.catalog = f->catalog};
        snprintf(hand[i].owner, sizeof hand[i].owner, "h%c", (char)('0' + i));
        assert_int_equal(pthread_create(&thread[i], NULL, work_along, &hand[i]), 0);
    }
    for (int i = 0; i < THREADS; i++) {
        assert_int_equal(pthread_join(thread[i], NULL), 0);
        assert_int_equal(hand[i].failures, 0);
        merges += hand[i].merges;
        tiles += hand[i].tiles;
    }
    assert_int_equal(merges, 1);
    assert_int_equal(tiles, MANY);
    assert_int_equal(state_of(f, 1, NULL), JOB_SUCCESSFUL);
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(tasks_follow_each_other_to_the_end),
        CATALOG_TEST(tiles_run_beside_each_other_and_the_merge_after_them),
        CATALOG_TEST(jobs_of_others_have_turns_between_tiles),
        CATALOG_TEST(a_lost_tile_waits_again_alone),
        CATALOG_TEST(a_host_that_begins_finds_its_tasks),
        CATALOG_TEST(progress_is_the_holders_and_never_goes_back),
        CATALOG_TEST(a_job_ends_whoever_has_its_tasks),
        CATALOG_TEST(a_task_that_fails_fails_the_job),
        CATALOG_TEST(a_job_that_begins_anew_is_planned_again),
        CATALOG_TEST(it_is_listed_as_running_while_its_tasks_wait),
        CATALOG_TEST(a_task_waits_for_memory),
        CATALOG_TEST(many_hands_do_each_task_once),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof tests[0]);
}
