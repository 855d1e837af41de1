/* The queue: order, transitions, limits, lists.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tests/unit/queue_fixture.h"

/* ------------------------------------------------------------------------------------------------ order */

/* 3 and 6 are of another principal than 1, 2 and 4. */
static void principals_take_turns_the_oldest_first(void **state) {
    static const int order[] = {1, 3, 2, 6, 4};
    struct queue_fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    queue_fixture_submit(f, 6), queue_fixture_submit(f, 4), queue_fixture_submit(f, 3), queue_fixture_submit(f, 2),
        queue_fixture_submit(f, 1);
    queue_fixture_reopen(f);
    for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
        queue_fixture_get(f, order[i], &job);
        assert_int_equal(job.ahead, 0);
        job_done(&job);
        queue_fixture_get(f, 4, &job);
        assert_int_equal(job.ahead, 4 - i);
        job_done(&job);
        assert_true(queue_fixture_claim(f, &job));
        assert_string_equal(job.id, queue_fixture_id(order[i], id));
        assert_int_equal(job.state, JOB_RUNNING);
        assert_int_equal(job.attempt, 1);
        assert_float_equal(job.params.ratio, 0.25, 0);
        job_done(&job);
    }
    assert_false(queue_fixture_claim(f, &job));
    queue_fixture_assert_depth(f, 0, 5);
}

static void count_costs(void *ctx, const struct job_cost *cost, int64_t started_ms) {
    int *counts = ctx;
    assert_int_equal(cost->size, 12);
    counts[started_ms > 0]++;
}

static void the_outlook_has_what_runs_and_what_comes_before(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    int counts[2] = {0};
    for (int n = 1; n <= 5; n++) queue_fixture_submit(f, n);
    assert_true(queue_fixture_claim(f, &job));
    queue_outlook(f->queue, queue_fixture_id(5, id), count_costs, counts);
    assert_int_equal(counts[0], 3);
    assert_int_equal(counts[1], 1);
    assert_true(queue_fixture_finish(f, JOB_DONE, &job));
    job_done(&job);
    queue_outlook(f->queue, queue_fixture_id(5, id), count_costs, counts);
    assert_int_equal(counts[0], 6);
    assert_int_equal(counts[1], 1);
}

static void a_result_is_found_by_its_principal_while_it_is_there(void **state) {
    struct queue_fixture *f = *state;
    struct job job = {.priority = 3, .created_ms = 50, .started_ms = 50, .result = "same", .principal = "me"};
    struct job found;
    bool is_found, changed;
    params_defaults(&job.params);
    queue_fixture_id(7, job.id);
    job.report = strdup("{}");
    job.output_count = 1;
    snprintf(job.output[0].name, sizeof job.output[0].name, "cloud.ply");
    assert_int_equal(queue_submit_ended(f->queue, &job, &f->error), STATUS_OK);
    queue_fixture_assert_depth(f, 0, 0);
    queue_fixture_reopen(f);
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
    struct queue_fixture *f = *state;
    struct job job;
    for (int n = 1; n < 5; n++) queue_fixture_submit(f, n);
    assert_true(queue_fixture_claim(f, &job));
    job_done(&job);
    queue_fixture_get(f, 4, &job);
    assert_int_equal(job.ahead, 2);
    job_done(&job);
    queue_fixture_get(f, 1, &job);
    assert_int_equal(job.ahead, 0);
    job_done(&job);
}

static void a_full_queue_refuses(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    assert_int_equal(queue_fixture_submit_limited(f, 1, 2), STATUS_OK);
    assert_int_equal(queue_fixture_submit_limited(f, 2, 2), STATUS_OK);
    assert_int_equal(queue_fixture_submit_limited(f, 3, 2), STATUS_LIMIT);
    assert_int_equal(queue_fixture_get(f, 3, &job), QUEUE_ABSENT);
    assert_true(queue_fixture_claim(f, &job));
    job_done(&job);
    assert_int_equal(queue_fixture_submit_limited(f, 3, 2), STATUS_OK); /* those that run don't wait */
}

static void an_id_comes_once(void **state) {
    struct queue_fixture *f = *state;
    queue_fixture_submit(f, 1);
    assert_int_equal(queue_fixture_submit_limited(f, 1, 1000), STATUS_IO);
    queue_fixture_assert_depth(f, 1, 0);
}

/* ------------------------------------------------------------------------------------------------ transitions */

static void done_keeps_everything(void **state) {
    struct queue_fixture *f = *state;
    struct job job, back;
    queue_fixture_submit(f, 1);
    assert_true(queue_fixture_claim(f, &job));
    job.report = strdup("{\"points_out\":5}");
    job.cpu_s = 1.5;
    job.wall_s = 2.5;
    job.peak_rss_bytes = 12345;
    job.expires_ms = 99;
    job.output_count = 2;
    job.output[0] = (struct job_output){"cloud.ply", 10, "aa"};
    job.output[1] = (struct job_output){"mesh.ply", 20, "bb"};
    assert_true(queue_fixture_finish(f, JOB_DONE, &job));
    queue_fixture_reopen(f);
    assert_int_equal(queue_fixture_get(f, 1, &back), QUEUE_PRESENT);
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
    queue_fixture_assert_depth(f, 0, 0);
    job_done(&job);
    job_done(&back);
}

static void only_legal_transitions_change_anything(void **state) {
    struct queue_fixture *f = *state;
    struct job job, back;
    queue_fixture_submit(f, 1);
    queue_fixture_get(f, 1, &job);
    assert_false(queue_fixture_finish(f, JOB_DONE, &job));
    assert_false(queue_fixture_finish(f, JOB_FAIL, &job));
    assert_false(queue_fixture_finish(f, JOB_REQUEUE, &job));
    assert_false(queue_fixture_finish(f, JOB_DISMISS, &job)); /* there is no process that it would end */
    assert_true(queue_fixture_finish(f, JOB_WITHDRAW, &job));
    for (int event = JOB_DONE; event < JOB_EVENT_COUNT; event++)
        assert_false(queue_fixture_finish(f, (enum job_event)event, &job));
    queue_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_DISMISSED);
    assert_false(queue_fixture_claim(f, &job));
    queue_fixture_assert_depth(f, 0, 0);
    struct job none = {.id = "none"};
    assert_false(queue_fixture_finish(f, JOB_DISMISS, &none));
    job_done(&back);
}

static void requeue_counts_attempts(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    queue_fixture_submit(f, 1);
    for (int attempt = 1; attempt <= 3; attempt++) {
        assert_true(queue_fixture_claim(f, &job));
        assert_int_equal(job.attempt, attempt);
        assert_true(queue_fixture_finish(f, JOB_REQUEUE, &job));
        queue_fixture_assert_depth(f, 1, 0);
        job_done(&job);
    }
}

static void sequences_only_grow(void **state) {
    struct queue_fixture *f = *state;
    struct job job, now;
    uint64_t last = 0;
    queue_fixture_submit(f, 1);
    assert_true(queue_fixture_claim(f, &job));
    for (int i = 0; i < 50; i++) {
        assert_int_equal(queue_progress(f->queue, job.id, "contract", "some", i / 50.0, &f->error), STATUS_OK);
        queue_fixture_get(f, 1, &now);
        assert_true(now.sequence > last);
        assert_string_equal(now.stage, "contract");
        last = now.sequence;
        job_done(&now);
    }
    job_done(&job);
}

static void progress_of_an_ended_job_changes_nothing(void **state) {
    struct queue_fixture *f = *state;
    struct job job, before, after;
    queue_fixture_submit(f, 1);
    assert_true(queue_fixture_claim(f, &job));
    assert_true(queue_fixture_finish(f, JOB_DISMISS, &job));
    queue_fixture_get(f, 1, &before);
    assert_int_equal(queue_progress(f->queue, job.id, "late", "", 0.5, &f->error), STATUS_OK);
    queue_fixture_get(f, 1, &after);
    assert_int_equal(before.sequence, after.sequence);
    assert_string_equal(after.stage, "");
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ lists, deletion */

static size_t list(struct queue_fixture *f, struct queue_filter filter, struct job *jobs, size_t max) {
    size_t count;
    assert_int_equal(queue_list(f->queue, &filter, jobs, max, &count, &f->error), STATUS_OK);
    return count;
}

static void lists_are_newest_first_and_filtered(void **state) {
    struct queue_fixture *f = *state;
    struct job jobs[10], job;
    char id[JOB_ID_BYTES];
    for (int n = 0; n < 6; n++) queue_fixture_submit(f, n);
    assert_true(queue_fixture_claim(f, &job));
    job_done(&job);
    assert_int_equal(list(f, (struct queue_filter){0}, jobs, 10), 6);
    assert_string_equal(jobs[0].id, queue_fixture_id(5, id));
    assert_int_equal(list(f, (struct queue_filter){0}, jobs, 4), 4);
    assert_int_equal(list(f, (struct queue_filter){.after = queue_fixture_id(2, id)}, jobs, 10), 2);
    assert_int_equal(list(f, (struct queue_filter){.label = "odd"}, jobs, 10), 3);
    assert_int_equal(list(f, (struct queue_filter){.label = "' OR 1=1 --"}, jobs, 10), 0);
    assert_int_equal(list(f, (struct queue_filter){.principal = ""}, jobs, 10), 4);
    assert_int_equal(list(f, (struct queue_filter){.principal = "third"}, jobs, 10), 2);
    assert_string_equal(jobs[0].principal, "third");
    assert_int_equal(list(f, (struct queue_filter){.by_state = true, .state = JOB_RUNNING}, jobs, 10), 1);
    assert_int_equal(list(f, (struct queue_filter){.by_state = true, .state = JOB_FAILED}, jobs, 10), 0);
}

static void usage_follows_every_change(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    bool changed;
    for (int n = 0; n < 4; n++) queue_fixture_submit(f, n); /* 0 and 3 are "third"'s, 12 bytes each */
    assert_int_equal(queue_usage(f->queue, "third").active, 2);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 24);
    assert_true(queue_fixture_claim(f, &job)); /* 0 */
    assert_int_equal(queue_usage(f->queue, "third").active, 2);
    job.output_count = 1;
    job.output[0] = (struct job_output){.name = "cloud.ply", .bytes = 100};
    assert_true(queue_fixture_finish(f, JOB_DONE, &job));
    assert_int_equal(queue_usage(f->queue, "third").active, 1);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 124);
    queue_fixture_reopen(f);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 124);
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_int_equal(queue_usage(f->queue, "third").bytes, 12);
    assert_int_equal(queue_usage(f->queue, "").active, 2);
    assert_int_equal(queue_usage(f->queue, "nobody").active, 0);
    job_done(&job);
}

static void a_principal_has_limits_of_its_own(void **state) {
    struct queue_fixture *f = *state;
    struct queue_limits jobs = {.waiting = 100, .principal_jobs = 1}, bytes = {.waiting = 100, .principal_bytes = 20};
    struct job job = {.created_ms = 1, .input_bytes = 12, .input_format = "xyz", .principal = "third"};
    queue_fixture_submit(f, 3);
    queue_fixture_id(10, job.id);
    params_defaults(&job.params);
    assert_int_equal(queue_submit(f->queue, &job, &jobs, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_jobs");
    assert_int_equal(queue_submit(f->queue, &job, &bytes, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    job.principal[0] = 0;
    assert_int_equal(queue_submit(f->queue, &job, &jobs, &f->error), STATUS_OK);
}

static void deleting_leaves_a_tombstone(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    bool changed;
    uint64_t uses;
    queue_fixture_submit(f, 3);
    assert_true(queue_fixture_claim(f, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_false(changed); /* it runs */
    assert_true(queue_fixture_finish(f, JOB_DISMISS, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_true(changed);
    assert_int_equal(queue_cloud_uses(f->queue, job.cloud, &uses, &f->error), STATUS_OK);
    assert_int_equal(uses, 0);
    job_done(&job);
    queue_fixture_reopen(f);
    enum queue_presence presence;
    struct queue_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(queue_get(f->queue, queue_fixture_id(3, id), &job, &presence, &tombstone, &f->error), STATUS_OK);
    assert_int_equal(presence, QUEUE_GONE);
    assert_string_equal(tombstone.principal, "third");
    assert_string_equal(tombstone.reason, "deleted");
    assert_true(tombstone.at_ms > 0);
}

static void what_is_past_its_time_is_found(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    char ids[4][JOB_ID_BYTES], id[JOB_ID_BYTES];
    size_t count;
    for (int n = 0; n < 3; n++) queue_fixture_submit(f, n);
    for (int n = 0; n < 2; n++) {
        assert_true(queue_fixture_claim(f, &job));
        job.expires_ms = 100 + n * 100;
        assert_true(queue_fixture_finish(f, JOB_DISMISS, &job));
        job_done(&job);
    }
    assert_int_equal(queue_expired(f->queue, 150, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(ids[0], queue_fixture_id(0, id));
    assert_int_equal(queue_expired(f->queue, 1000, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2); /* a job that waits never expires */
}

static void tombstones_are_forgotten(void **state) {
    struct queue_fixture *f = *state;
    struct job job;
    char ids[1][JOB_ID_BYTES];
    size_t count;
    bool changed;
    queue_fixture_submit(f, 1);
    assert_true(queue_fixture_claim(f, &job));
    assert_true(queue_fixture_finish(f, JOB_DISMISS, &job));
    assert_int_equal(queue_delete(f->queue, job.id, "expired", &changed, &f->error), STATUS_OK);
    job_done(&job);
    assert_int_equal(queue_expired(f->queue, 0, INT64_MAX, ids, 1, &count, &f->error), STATUS_OK);
    assert_int_equal(queue_fixture_get(f, 1, &job), QUEUE_ABSENT);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        QUEUE_TEST(principals_take_turns_the_oldest_first),
        QUEUE_TEST(the_outlook_has_what_runs_and_what_comes_before),
        QUEUE_TEST(a_result_is_found_by_its_principal_while_it_is_there),
        QUEUE_TEST(how_many_are_ahead),
        QUEUE_TEST(a_full_queue_refuses),
        QUEUE_TEST(an_id_comes_once),
        QUEUE_TEST(done_keeps_everything),
        QUEUE_TEST(only_legal_transitions_change_anything),
        QUEUE_TEST(requeue_counts_attempts),
        QUEUE_TEST(sequences_only_grow),
        QUEUE_TEST(progress_of_an_ended_job_changes_nothing),
        QUEUE_TEST(lists_are_newest_first_and_filtered),
        QUEUE_TEST(usage_follows_every_change),
        QUEUE_TEST(a_principal_has_limits_of_its_own),
        QUEUE_TEST(deleting_leaves_a_tombstone),
        QUEUE_TEST(what_is_past_its_time_is_found),
        QUEUE_TEST(tombstones_are_forgotten),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
