/* The contract of catalogs: batches, whose jobs come together and whose webhook is due once, when all have ended.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/unit/catalog_fixture.h"

enum { THREE = 3, HUNDRED = 100, MANY_JOBS = 16 };
static const int64_t forever = INT64_C(1) << 60;

/* Batch n of so many jobs, which are n + 1, n + 2, ...; *jobs is the caller's, to free. */
static struct catalog_batch batch_of(int n, size_t size, struct job **jobs) {
    struct catalog_batch batch = {
        .created_ms = 1000 + n, .size = size, .webhook = "http://host/hook", .principal = "ann", .label = "halls"};
    catalog_fixture_id(n, batch.id);
    *jobs = calloc(size, sizeof **jobs);
    assert_non_null(*jobs);
    for (size_t i = 0; i < size; i++) {
        struct job *job = &(*jobs)[i];
        catalog_fixture_id(n + 1 + (int)i, job->id);
        memcpy(job->batch, batch.id, sizeof job->batch);
        snprintf(job->principal, sizeof job->principal, "ann");
        snprintf(job->cloud, sizeof job->cloud, "cloud%zu", i);
        snprintf(job->input_format, sizeof job->input_format, "xyz");
        job->created_ms = batch.created_ms;
        job->input_bytes = 10;
        params_defaults(&job->params);
    }
    return batch;
}

static enum status submit(struct catalog_fixture *f, int n, size_t size, const struct catalog_limits *limits) {
    struct job *jobs;
    struct catalog_batch batch = batch_of(n, size, &jobs);
    enum status status = catalog_submit_batch(f->catalog, &batch, jobs, limits, &f->error);
    free(jobs);
    return status;
}

static const struct catalog_limits plenty = {.waiting = 1000};

static bool get(struct catalog_fixture *f, int n, struct catalog_batch *batch) {
    char id[JOB_ID_BYTES];
    bool found;
    assert_int_equal(catalog_get_batch(f->catalog, catalog_fixture_id(n, id), batch, &found, &f->error), STATUS_OK);
    return found;
}

static bool count_due(void *ctx, const struct catalog_webhook *webhook) {
    char id[JOB_ID_BYTES];
    assert_string_equal(webhook->job, catalog_fixture_id(HUNDRED, id));
    assert_string_equal(webhook->principal, "ann");
    ++*(int *)ctx;
    return true;
}

static int due(struct catalog_fixture *f) {
    int count = 0;
    assert_int_equal(catalog_each_webhook_due(f->catalog, forever, count_due, &count, &f->error), STATUS_OK);
    return count;
}

static void its_jobs_are_jobs_in_their_order(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_batch batch;
    struct job jobs[4];
    size_t count;
    catalog_fixture_submit(f, 1);
    assert_int_equal(submit(f, HUNDRED, THREE, &plenty), STATUS_OK);
    catalog_fixture_assert_depth(f, 4, 0);
    catalog_fixture_reopen(f);
    assert_true(get(f, HUNDRED, &batch));
    assert_int_equal(batch.size, THREE);
    assert_int_equal(batch.job_count, THREE);
    assert_string_equal(batch.label, "halls");
    assert_string_equal(batch.principal, "ann");
    assert_string_equal(batch.job[2].cloud, "cloud2");
    assert_int_equal(batch.job[2].state, JOB_ACCEPTED);
    struct catalog_filter filter = {.batch = batch.id};
    assert_int_equal(catalog_list(f->catalog, &filter, jobs, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, THREE);
    assert_string_equal(jobs[2].id, batch.job[0].id);
    assert_string_equal(jobs[2].batch, batch.id);
    for (size_t i = 0; i < count; i++) job_done(&jobs[i]);
    catalog_batch_done(&batch);
    assert_false(get(f, 7, &batch));
    catalog_batch_done(&batch);
}

static void all_of_it_fits_or_nothing_does(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_batch batch;
    catalog_fixture_submit(f, 1);
    assert_int_equal(submit(f, HUNDRED, THREE, &(struct catalog_limits){.waiting = 3}), STATUS_LIMIT);
    assert_string_equal(f->error.where, "queue");
    struct catalog_limits two = {.waiting = 9, .principal_jobs = 2}, bytes = {.waiting = 9, .principal_bytes = 29};
    assert_int_equal(submit(f, HUNDRED, THREE, &two), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_jobs");
    assert_int_equal(submit(f, HUNDRED, THREE, &bytes), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    assert_false(get(f, HUNDRED, &batch));
    catalog_fixture_assert_depth(f, 1, 0);
    struct catalog_limits just = {.waiting = 4, .principal_jobs = 3, .principal_bytes = 30};
    assert_int_equal(submit(f, HUNDRED, THREE, &just), STATUS_OK);
    assert_int_equal(catalog_usage(f->catalog, "ann").bytes, 30);
    assert_int_equal(catalog_usage(f->catalog, "ann").active, THREE);
}

static void it_is_told_when_the_last_has_ended_however(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_batch batch;
    struct job job;
    assert_int_equal(submit(f, HUNDRED, THREE, &plenty), STATUS_OK);
    for (int i = 0; i < THREE; i++) {
        assert_int_equal(due(f), 0);
        assert_true(catalog_fixture_claim(f, &job));
        if (i == 1) {
            assert_true(catalog_fixture_finish(f, JOB_REQUEUE, &job));
            job_done(&job);
            assert_int_equal(due(f), 0);
            assert_true(catalog_fixture_claim(f, &job));
        }
        assert_true(catalog_fixture_finish(f, i == 2 ? JOB_FAIL : JOB_DONE, &job));
        job_done(&job);
    }
    assert_int_equal(due(f), 1);
    assert_true(get(f, HUNDRED, &batch));
    assert_int_equal(batch.job[0].state, JOB_SUCCESSFUL);
    assert_int_equal(batch.job[2].state, JOB_FAILED);
    assert_true(batch.job[1].finished_ms > 0);
    catalog_batch_done(&batch);
}

/* An earlier result serves the first, or all of them: then the end is there at once. */
static void jobs_that_are_served_have_ended(void **state) {
    struct catalog_fixture *f = *state;
    struct job *jobs;
    struct catalog_batch batch = batch_of(HUNDRED, 2, &jobs), read;
    jobs[0].state = JOB_SUCCESSFUL;
    jobs[0].output_count = 1;
    jobs[0].output[0] = (struct job_output){"cloud.ply", 5, "aa"};
    assert_int_equal(catalog_submit_batch(f->catalog, &batch, jobs, &plenty, &f->error), STATUS_OK);
    catalog_fixture_assert_depth(f, 1, 0);
    assert_int_equal(catalog_usage(f->catalog, "ann").bytes, 25);
    assert_int_equal(due(f), 0);
    assert_true(get(f, HUNDRED, &read));
    assert_int_equal(read.job[0].state, JOB_SUCCESSFUL);
    assert_int_equal(read.job[1].state, JOB_ACCEPTED);
    catalog_batch_done(&read);
    struct job claimed;
    assert_true(catalog_fixture_claim(f, &claimed));
    assert_true(catalog_fixture_finish(f, JOB_DONE, &claimed));
    job_done(&claimed);
    assert_int_equal(due(f), 1);
    char id[JOB_ID_BYTES];
    assert_int_equal(catalog_end_webhook(f->catalog, catalog_fixture_id(HUNDRED, id), &f->error), STATUS_OK);
    assert_int_equal(due(f), 0);
    free(jobs);
}

static void it_goes_with_the_last_of_its_jobs(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_batch batch;
    struct job job;
    bool changed;
    assert_int_equal(submit(f, HUNDRED, 2, &plenty), STATUS_OK);
    for (int i = 0; i < 2; i++) {
        assert_true(catalog_fixture_claim(f, &job));
        assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
        assert_true(get(f, HUNDRED, &batch));
        catalog_batch_done(&batch);
        if (i == 1) assert_int_equal(due(f), 1);
        assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
        assert_true(changed);
        job_done(&job);
        assert_int_equal(get(f, HUNDRED, &batch), i == 0);
        catalog_batch_done(&batch);
    }
    assert_int_equal(due(f), 0);
}

static void they_are_listed_newest_first(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_batch batches[4];
    size_t count;
    for (int n = HUNDRED; n < HUNDRED + 30; n += 10) assert_int_equal(submit(f, n, 2, &plenty), STATUS_OK);
    assert_int_equal(catalog_list_batches(f->catalog, "ann", NULL, batches, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2);
    assert_int_equal(batches[0].created_ms, 1000 + HUNDRED + 20);
    assert_int_equal(batches[1].job_count, 2);
    char after[JOB_ID_BYTES];
    memcpy(after, batches[1].id, sizeof after);
    for (size_t i = 0; i < count; i++) catalog_batch_done(&batches[i]);
    assert_int_equal(catalog_list_batches(f->catalog, NULL, after, batches, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    catalog_batch_done(&batches[0]);
    assert_int_equal(catalog_list_batches(f->catalog, "bob", NULL, batches, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
}

/* A key stands for the batch; the same batch isn't made again under it. */
static void its_key_is_kept_with_it(void **state) {
    struct catalog_fixture *f = *state;
    struct job *jobs;
    struct job_key key = {.key = "k", .fingerprint = "print"};
    struct catalog_batch batch = batch_of(HUNDRED, 2, &jobs);
    struct catalog_reply reply;
    bool found;
    batch.key = &key;
    assert_int_equal(catalog_submit_batch(f->catalog, &batch, jobs, &plenty, &f->error), STATUS_OK);
    assert_int_equal(catalog_find_reply(f->catalog, "ann", "k", &reply, &found, &f->error), STATUS_OK);
    assert_true(found);
    assert_string_equal(reply.made, batch.id);
    catalog_reply_done(&reply);
    free(jobs);
}

/* Ends whatever it can get, over a catalog of its own. */
static void *end_some(void *ctx) {
    struct catalog *catalog = ctx;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    struct error error;
    for (bool found = true; found;) {
        struct job job;
        bool changed = false;
        if (catalog_claim(catalog, &by, &job, &found, &error) != STATUS_OK) return "claim";
        if (found && (catalog_finish(catalog, JOB_DONE, &job, &changed, &error) != STATUS_OK || !changed))
            return "finish";
        if (found) job_done(&job);
    }
    return NULL;
}

/* Two hosts end jobs side by side: whichever is the last, it makes the webhook due. */
static void the_last_end_of_two_hosts_is_told(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = NULL;
    char id[JOB_ID_BYTES];
    void *wrong[2];
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_OK);
    for (int n = 0; n < 8; n++) {
        pthread_t thread[2];
        assert_int_equal(submit(f, HUNDRED, MANY_JOBS, &plenty), STATUS_OK);
        assert_int_equal(pthread_create(&thread[0], NULL, end_some, f->catalog), 0);
        assert_int_equal(pthread_create(&thread[1], NULL, end_some, other), 0);
        for (int i = 0; i < 2; i++) assert_int_equal(pthread_join(thread[i], &wrong[i]), 0);
        assert_null(wrong[0]);
        assert_null(wrong[1]);
        assert_int_equal(due(f), 1);
        for (int i = 1; i <= MANY_JOBS; i++) {
            bool changed;
            catalog_fixture_id(HUNDRED + i, id);
            assert_int_equal(catalog_delete(f->catalog, id, "deleted", &changed, &f->error), STATUS_OK);
        }
    }
    catalog_close(other);
}

/* Each begin and each end is seen, also of jobs that have gone since; two batches at the same point are the same. */
static void its_state_grows_with_each_begin_and_end(void **state) {
    struct catalog_batch_job jobs[THREE] = {{.state = JOB_ACCEPTED}, {.state = JOB_ACCEPTED}, {.state = JOB_ACCEPTED}};
    struct catalog_batch batch = {.size = THREE, .job_count = THREE, .job = jobs};
    static const enum job_state ends[THREE] = {JOB_SUCCESSFUL, JOB_FAILED, JOB_DISMISSED};
    (void)state;
    assert_int_equal(catalog_batch_state(&batch), 0);
    for (int i = 0; i < THREE; i++) {
        jobs[i].state = JOB_RUNNING;
        assert_int_equal(catalog_batch_state(&batch), 2 * i + 1);
        jobs[i].state = ends[i];
        assert_int_equal(catalog_batch_state(&batch), 2 * i + 2);
    }
    for (batch.job_count = 0; batch.job_count < THREE; batch.job_count++)
        assert_int_equal(catalog_batch_state(&batch), 2 * THREE);
    jobs[2].state = JOB_ACCEPTED; /* the others have gone */
    batch.job = &jobs[2], batch.job_count = 1;
    assert_int_equal(catalog_batch_state(&batch), 4);
}

int main(void) {
    struct CMUnitTest tests[] = {
        cmocka_unit_test(its_state_grows_with_each_begin_and_end),
        CATALOG_TEST(its_jobs_are_jobs_in_their_order),
        CATALOG_TEST(all_of_it_fits_or_nothing_does),
        CATALOG_TEST(it_is_told_when_the_last_has_ended_however),
        CATALOG_TEST(jobs_that_are_served_have_ended),
        CATALOG_TEST(it_goes_with_the_last_of_its_jobs),
        CATALOG_TEST(they_are_listed_newest_first),
        CATALOG_TEST(its_key_is_kept_with_it),
        CATALOG_TEST(the_last_end_of_two_hosts_is_told),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
