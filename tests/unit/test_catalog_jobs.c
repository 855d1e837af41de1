/* The contract of catalogs: order, transitions, limits, lists of jobs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "tests/unit/catalog_fixture.h"

/* ------------------------------------------------------------------------------------------------ order */

/* 3 and 6 are of another principal than 1, 2 and 4. */
static void principals_take_turns_the_oldest_first(void **state) {
    static const int order[] = {1, 3, 2, 6, 4};
    struct catalog_fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    catalog_fixture_submit(f, 6), catalog_fixture_submit(f, 4), catalog_fixture_submit(f, 3),
        catalog_fixture_submit(f, 2), catalog_fixture_submit(f, 1);
    catalog_fixture_reopen(f);
    for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
        catalog_fixture_get(f, order[i], &job);
        assert_int_equal(job.ahead, 0);
        job_done(&job);
        catalog_fixture_get(f, 4, &job);
        assert_int_equal(job.ahead, 4 - i);
        job_done(&job);
        assert_true(catalog_fixture_claim(f, &job));
        assert_string_equal(job.id, catalog_fixture_id(order[i], id));
        assert_int_equal(job.state, JOB_RUNNING);
        assert_int_equal(job.attempt, 1);
        assert_float_equal(job.params.ratio, 0.25, 0);
        job_done(&job);
    }
    assert_false(catalog_fixture_claim(f, &job));
    catalog_fixture_assert_depth(f, 0, 5);
}

static void count_costs(void *ctx, const struct job_cost *cost, int64_t started_ms) {
    int *counts = ctx;
    assert_int_equal(cost->size, 12);
    counts[started_ms > 0]++;
}

static void the_outlook_has_what_runs_and_what_comes_before(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    char id[JOB_ID_BYTES];
    int counts[2] = {0};
    for (int n = 1; n <= 5; n++) catalog_fixture_submit(f, n);
    assert_true(catalog_fixture_claim(f, &job));
    catalog_outlook(f->catalog, catalog_fixture_id(5, id), count_costs, counts);
    assert_int_equal(counts[0], 3);
    assert_int_equal(counts[1], 1);
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    job_done(&job);
    catalog_outlook(f->catalog, catalog_fixture_id(5, id), count_costs, counts);
    assert_int_equal(counts[0], 6);
    assert_int_equal(counts[1], 1);
}

static void a_result_is_found_by_its_principal_while_it_is_there(void **state) {
    struct catalog_fixture *f = *state;
    struct job job = {.priority = 3, .created_ms = 50, .started_ms = 50, .result = "same", .principal = "me"};
    struct job found;
    bool is_found, changed;
    params_defaults(&job.params);
    catalog_fixture_id(7, job.id);
    job.report = strdup("{}");
    job.output_count = 1;
    snprintf(job.output[0].name, sizeof job.output[0].name, "cloud.ply");
    assert_int_equal(catalog_submit_ended(f->catalog, &job, &(struct catalog_limits){0}, &f->error), STATUS_OK);
    catalog_fixture_assert_depth(f, 0, 0);
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_find_result(f->catalog, "same", "you", &found, &is_found, &f->error), STATUS_OK);
    assert_false(is_found);
    assert_int_equal(catalog_find_result(f->catalog, "same", "me", &found, &is_found, &f->error), STATUS_OK);
    assert_true(is_found);
    assert_string_equal(found.id, job.id);
    assert_string_equal(found.report, "{}");
    assert_string_equal(found.output[0].name, "cloud.ply");
    assert_int_equal(found.priority, 3);
    assert_int_equal(found.started_ms, 50);
    assert_int_equal(found.state, JOB_SUCCESSFUL);
    job_done(&found);
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_int_equal(catalog_find_result(f->catalog, "same", "me", &found, &is_found, &f->error), STATUS_OK);
    assert_false(is_found);
    job_done(&job);
}

static void how_many_are_ahead(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    for (int n = 1; n < 5; n++) catalog_fixture_submit(f, n);
    assert_true(catalog_fixture_claim(f, &job));
    job_done(&job);
    catalog_fixture_get(f, 4, &job);
    assert_int_equal(job.ahead, 2);
    job_done(&job);
    catalog_fixture_get(f, 1, &job);
    assert_int_equal(job.ahead, 0);
    job_done(&job);
}

static void a_full_queue_refuses(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    assert_int_equal(catalog_fixture_submit_limited(f, 1, 2), STATUS_OK);
    assert_int_equal(catalog_fixture_submit_limited(f, 2, 2), STATUS_OK);
    assert_int_equal(catalog_fixture_submit_limited(f, 3, 2), STATUS_LIMIT);
    assert_int_equal(catalog_fixture_get(f, 3, &job), CATALOG_ABSENT);
    assert_true(catalog_fixture_claim(f, &job));
    job_done(&job);
    assert_int_equal(catalog_fixture_submit_limited(f, 3, 2), STATUS_OK); /* those that run don't wait */
}

static void an_id_comes_once(void **state) {
    struct catalog_fixture *f = *state;
    catalog_fixture_submit(f, 1);
    assert_int_equal(catalog_fixture_submit_limited(f, 1, 1000), STATUS_IO);
    catalog_fixture_assert_depth(f, 1, 0);
}

/* ------------------------------------------------------------------------------------------------ transitions */

static void done_keeps_everything(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, back;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    job.report = strdup("{\"points_out\":5}");
    job.cpu_s = 1.5;
    job.wall_s = 2.5;
    job.peak_rss_bytes = 12345;
    job.expires_ms = 99;
    job.output_count = 2;
    job.output[0] = (struct job_output){"cloud.ply", 10, "aa"};
    job.output[1] = (struct job_output){"mesh.ply", 20, "bb"};
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_fixture_get(f, 1, &back), CATALOG_PRESENT);
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
    catalog_fixture_assert_depth(f, 0, 0);
    job_done(&job);
    job_done(&back);
}

static void only_legal_transitions_change_anything(void **state) {
    struct catalog_fixture *f = *state;
    struct job job, back;
    catalog_fixture_submit(f, 1);
    catalog_fixture_get(f, 1, &job);
    assert_false(catalog_fixture_finish(f, JOB_DONE, &job));
    assert_false(catalog_fixture_finish(f, JOB_FAIL, &job));
    assert_false(catalog_fixture_finish(f, JOB_REQUEUE, &job));
    assert_false(catalog_fixture_finish(f, JOB_DISMISS, &job)); /* there is no process that it would end */
    assert_true(catalog_fixture_finish(f, JOB_WITHDRAW, &job));
    for (int event = JOB_DONE; event < JOB_EVENT_COUNT; event++)
        assert_false(catalog_fixture_finish(f, (enum job_event)event, &job));
    catalog_fixture_get(f, 1, &back);
    assert_int_equal(back.state, JOB_DISMISSED);
    assert_false(catalog_fixture_claim(f, &job));
    catalog_fixture_assert_depth(f, 0, 0);
    struct job none = {.id = "none"};
    assert_false(catalog_fixture_finish(f, JOB_DISMISS, &none));
    job_done(&back);
}

static void requeue_counts_attempts(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    catalog_fixture_submit(f, 1);
    for (int attempt = 1; attempt <= 3; attempt++) {
        assert_true(catalog_fixture_claim(f, &job));
        assert_int_equal(job.attempt, attempt);
        assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job));
        catalog_fixture_assert_depth(f, 1, 0);
        job_done(&job);
    }
}

static void sequences_only_grow(void **state) {
    bool held;
    struct catalog_fixture *f = *state;
    struct job job, now;
    uint64_t last = 0;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    for (int i = 0; i < 50; i++) {
        snprintf(job.stage, sizeof job.stage, "contract");
        job.fraction = i / 50.0;
        assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
        assert_true(held);
        catalog_fixture_get(f, 1, &now);
        assert_true(now.sequence > last);
        assert_string_equal(now.stage, "contract");
        last = now.sequence;
        job_done(&now);
    }
    job_done(&job);
}

static void progress_of_an_ended_job_changes_nothing(void **state) {
    bool held;
    struct catalog_fixture *f = *state;
    struct job job, before, after;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    catalog_fixture_get(f, 1, &before);
    snprintf(job.stage, sizeof job.stage, "late");
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    assert_false(held);
    catalog_fixture_get(f, 1, &after);
    assert_int_equal(before.sequence, after.sequence);
    assert_string_equal(after.stage, "");
    job_done(&job);
}

/* ------------------------------------------------------------------------------------------------ lists, deletion */

static size_t list(struct catalog_fixture *f, struct catalog_filter filter, struct job *jobs, size_t max) {
    size_t count;
    assert_int_equal(catalog_list(f->catalog, &filter, jobs, max, &count, &f->error), STATUS_OK);
    return count;
}

static void lists_are_newest_first_and_filtered(void **state) {
    struct catalog_fixture *f = *state;
    struct job jobs[10], job;
    char id[JOB_ID_BYTES];
    for (int n = 0; n < 6; n++) catalog_fixture_submit(f, n);
    assert_true(catalog_fixture_claim(f, &job));
    job_done(&job);
    assert_int_equal(list(f, (struct catalog_filter){0}, jobs, 10), 6);
    assert_string_equal(jobs[0].id, catalog_fixture_id(5, id));
    assert_int_equal(list(f, (struct catalog_filter){0}, jobs, 4), 4);
    assert_int_equal(list(f, (struct catalog_filter){.after = catalog_fixture_id(2, id)}, jobs, 10), 2);
    assert_int_equal(list(f, (struct catalog_filter){.label = "odd"}, jobs, 10), 3);
    assert_int_equal(list(f, (struct catalog_filter){.label = "' OR 1=1 --"}, jobs, 10), 0);
    assert_int_equal(list(f, (struct catalog_filter){.principal = ""}, jobs, 10), 4);
    assert_int_equal(list(f, (struct catalog_filter){.principal = "third"}, jobs, 10), 2);
    assert_string_equal(jobs[0].principal, "third");
    assert_int_equal(list(f, (struct catalog_filter){.by_state = true, .state = JOB_RUNNING}, jobs, 10), 1);
    assert_int_equal(list(f, (struct catalog_filter){.by_state = true, .state = JOB_FAILED}, jobs, 10), 0);
}

static void usage_follows_every_change(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    bool changed;
    for (int n = 0; n < 4; n++) catalog_fixture_submit(f, n); /* 0 and 3 are "third"'s, 12 bytes each */
    assert_int_equal(catalog_usage(f->catalog, "third").active, 2);
    assert_int_equal(catalog_usage(f->catalog, "third").bytes, 24);
    assert_true(catalog_fixture_claim(f, &job)); /* 0 */
    assert_int_equal(catalog_usage(f->catalog, "third").active, 2);
    job.output_count = 1;
    job.output[0] = (struct job_output){.name = "cloud.ply", .bytes = 100};
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    assert_int_equal(catalog_usage(f->catalog, "third").active, 1);
    assert_int_equal(catalog_usage(f->catalog, "third").bytes, 124);
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_usage(f->catalog, "third").bytes, 124);
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_int_equal(catalog_usage(f->catalog, "third").bytes, 12);
    assert_int_equal(catalog_usage(f->catalog, "").active, 2);
    assert_int_equal(catalog_usage(f->catalog, "nobody").active, 0);
    job_done(&job);
}

static void a_principal_has_limits_of_its_own(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_limits jobs = {.waiting = 100, .principal_jobs = 1}, bytes = {.waiting = 100, .principal_bytes = 20};
    struct job job = {.created_ms = 1, .input_bytes = 12, .input_format = "xyz", .principal = "third"};
    catalog_fixture_submit(f, 3);
    catalog_fixture_id(10, job.id);
    params_defaults(&job.params);
    assert_int_equal(catalog_submit(f->catalog, &job, &jobs, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_jobs");
    assert_int_equal(catalog_submit(f->catalog, &job, &bytes, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    job.principal[0] = 0;
    assert_int_equal(catalog_submit(f->catalog, &job, &jobs, &f->error), STATUS_OK);
}

static void submit_at(struct catalog_fixture *f, int n, int priority, int64_t created_ms) {
    struct job job = {.created_ms = created_ms, .priority = priority, .input_format = "xyz"};
    catalog_fixture_id(n, job.id);
    params_defaults(&job.params);
    assert_int_equal(catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = 10}, &f->error), STATUS_OK);
}

static void a_step_of_priority_is_worth_ten_minutes(void **state) {
    struct catalog_fixture *f = *state;
    static const int64_t step_ms = 10 * 60 * 1000;
    static const int order[] = {2, 1, 3};
    char id[JOB_ID_BYTES];
    struct job job;
    submit_at(f, 1, 5, 1000);
    submit_at(f, 2, 6, 1000 + step_ms - 1);
    submit_at(f, 3, 6, 1000 + step_ms + 1);
    for (int i = 0; i < 3; i++) {
        assert_true(catalog_fixture_claim(f, &job));
        assert_string_equal(job.id, catalog_fixture_id(order[i], id));
        job_done(&job);
    }
}

static void deleting_leaves_a_tombstone(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    bool changed;
    uint64_t uses;
    catalog_fixture_submit(f, 3);
    assert_true(catalog_fixture_claim(f, &job));
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_false(changed); /* it runs */
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    assert_true(changed);
    assert_int_equal(catalog_cloud_uses(f->catalog, job.cloud, &uses, &f->error), STATUS_OK);
    assert_int_equal(uses, 0);
    job_done(&job);
    catalog_fixture_reopen(f);
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    char id[JOB_ID_BYTES];
    assert_int_equal(catalog_get(f->catalog, catalog_fixture_id(3, id), &job, &presence, &tombstone, &f->error),
                     STATUS_OK);
    assert_int_equal(presence, CATALOG_GONE);
    assert_string_equal(tombstone.principal, "third");
    assert_string_equal(tombstone.reason, "deleted");
    assert_true(tombstone.at_ms > 0);
}

static void what_is_past_its_time_is_found(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    char ids[4][JOB_ID_BYTES], id[JOB_ID_BYTES];
    size_t count;
    for (int n = 0; n < 3; n++) catalog_fixture_submit(f, n);
    for (int n = 0; n < 2; n++) {
        assert_true(catalog_fixture_claim(f, &job));
        job.expires_ms = 100 + n * 100;
        assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
        job_done(&job);
    }
    assert_int_equal(catalog_expired(f->catalog, 150, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(ids[0], catalog_fixture_id(0, id));
    assert_int_equal(catalog_expired(f->catalog, 1000, 0, ids, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2); /* a job that waits never expires */
}

static void tombstones_are_forgotten(void **state) {
    struct catalog_fixture *f = *state;
    struct job job;
    char ids[1][JOB_ID_BYTES];
    size_t count;
    bool changed;
    catalog_fixture_submit(f, 1);
    assert_true(catalog_fixture_claim(f, &job));
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    assert_int_equal(catalog_delete(f->catalog, job.id, "expired", &changed, &f->error), STATUS_OK);
    job_done(&job);
    assert_int_equal(catalog_expired(f->catalog, 0, INT64_MAX, ids, 1, &count, &f->error), STATUS_OK);
    assert_int_equal(catalog_fixture_get(f, 1, &job), CATALOG_ABSENT);
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(principals_take_turns_the_oldest_first),
        CATALOG_TEST(the_outlook_has_what_runs_and_what_comes_before),
        CATALOG_TEST(a_result_is_found_by_its_principal_while_it_is_there),
        CATALOG_TEST(how_many_are_ahead),
        CATALOG_TEST(a_full_queue_refuses),
        CATALOG_TEST(an_id_comes_once),
        CATALOG_TEST(done_keeps_everything),
        CATALOG_TEST(only_legal_transitions_change_anything),
        CATALOG_TEST(requeue_counts_attempts),
        CATALOG_TEST(sequences_only_grow),
        CATALOG_TEST(progress_of_an_ended_job_changes_nothing),
        CATALOG_TEST(lists_are_newest_first_and_filtered),
        CATALOG_TEST(usage_follows_every_change),
        CATALOG_TEST(a_principal_has_limits_of_its_own),
        CATALOG_TEST(a_step_of_priority_is_worth_ten_minutes),
        CATALOG_TEST(deleting_leaves_a_tombstone),
        CATALOG_TEST(what_is_past_its_time_is_found),
        CATALOG_TEST(tombstones_are_forgotten),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
