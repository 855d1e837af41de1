/* The contract of catalogs: webhooks, each delivered by one host.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "tests/unit/catalog_fixture.h"

static const int64_t ever = INT64_C(1) << 60;

struct seen {
    struct catalog_webhook row[4];
    int count;
};

static bool note(void *ctx, const struct catalog_webhook *webhook) {
    struct seen *seen = ctx;
    seen->row[seen->count++] = *webhook;
    return seen->count < 4;
}

static int due(struct catalog *catalog, int64_t now_ms, struct seen *seen) {
    struct error error;
    seen->count = 0;
    assert_int_equal(catalog_each_webhook_due(catalog, now_ms, note, seen, &error), STATUS_OK);
    return seen->count;
}

static bool claim(struct catalog *catalog, const struct catalog_webhook *row, const char *owner, int64_t until_ms) {
    struct error error;
    bool claimed;
    assert_int_equal(catalog_claim_webhook(catalog, row, owner, until_ms, &claimed, &error), STATUS_OK);
    return claimed;
}

/* A job with a webhook that has ended. */
static void end_job(struct catalog_fixture *f, int n) {
    struct job job = {.created_ms = 1000 + n, .input_format = "xyz", .webhook = "http://host/hook", .principal = "ann"};
    catalog_fixture_id(n, job.id);
    params_defaults(&job.params);
    assert_int_equal(catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = 9}, &f->error), STATUS_OK);
    assert_true(catalog_fixture_claim(f, &job));
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    job_done(&job);
}

static void it_is_due_when_its_job_has_ended(void **state) {
    struct catalog_fixture *f = *state;
    struct job job = {.created_ms = 1, .input_format = "xyz", .webhook = "http://host/hook", .principal = "ann"};
    struct seen seen;
    catalog_fixture_id(1, job.id);
    params_defaults(&job.params);
    assert_int_equal(catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = 9}, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, ever, &seen), 0);
    assert_true(catalog_fixture_claim(f, &job));
    assert_int_equal(due(f->catalog, ever, &seen), 0);
    assert_true(catalog_fixture_finish(f, JOB_DONE, &job));
    assert_int_equal(due(f->catalog, ever, &seen), 1);
    assert_string_equal(seen.row[0].job, job.id);
    assert_string_equal(seen.row[0].url, "http://host/hook");
    assert_string_equal(seen.row[0].principal, "ann");
    assert_int_equal(seen.row[0].attempts, 0);
    assert_int_equal(due(f->catalog, seen.row[0].due_ms - 1, &seen), 0);
    job_done(&job);
}

static void one_host_has_it_at_a_time(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = NULL;
    struct seen here, there;
    end_job(f, 1);
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, ever, &here), 1);
    assert_int_equal(due(other, ever, &there), 1);
    assert_true(claim(f->catalog, &here.row[0], "a", ever + 1000));
    assert_false(claim(other, &there.row[0], "b", ever + 2000)); /* by what it has seen before */
    assert_int_equal(due(other, ever, &there), 0);
    assert_int_equal(due(other, ever + 1000, &there), 1); /* its host has gone */
    assert_true(claim(other, &there.row[0], "b", ever + 2000));
    assert_false(claim(f->catalog, &here.row[0], "a", ever + 3000));
    assert_int_equal(catalog_end_webhook(other, there.row[0].job, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, ever + 9000, &here), 0);
    catalog_close(other);
}

static void what_a_host_had_is_due_when_it_begins(void **state) {
    struct catalog_fixture *f = *state;
    struct seen seen;
    end_job(f, 1), end_job(f, 2), end_job(f, 3);
    assert_int_equal(due(f->catalog, ever, &seen), 3);
    assert_true(claim(f->catalog, &seen.row[0], "a", ever + 1));
    assert_true(claim(f->catalog, &seen.row[1], "a", ever + 1));
    assert_true(claim(f->catalog, &seen.row[2], "b", ever + 1));
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_return_webhooks(f->catalog, "a", seen.row[1].job, 7, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, 7, &seen), 1);
    assert_int_equal(catalog_return_webhooks(f->catalog, "a", NULL, 7, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, ever, &seen), 2);
    assert_int_equal(seen.row[0].attempts, 0); /* it has not failed */
}

static void a_failure_counts_and_is_tried_later(void **state) {
    struct catalog_fixture *f = *state;
    struct seen seen;
    end_job(f, 1);
    assert_int_equal(due(f->catalog, ever, &seen), 1);
    assert_true(claim(f->catalog, &seen.row[0], "a", ever + 1));
    assert_int_equal(catalog_postpone_webhook(f->catalog, seen.row[0].job, 5000, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, 4999, &seen), 0);
    assert_int_equal(due(f->catalog, 5000, &seen), 1);
    assert_int_equal(seen.row[0].attempts, 1);
    assert_int_equal(catalog_return_webhooks(f->catalog, "a", NULL, 1, &f->error), STATUS_OK);
    assert_int_equal(due(f->catalog, 4999, &seen), 0); /* it was not among what the host had */
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(it_is_due_when_its_job_has_ended),
        CATALOG_TEST(one_host_has_it_at_a_time),
        CATALOG_TEST(what_a_host_had_is_due_when_it_begins),
        CATALOG_TEST(a_failure_counts_and_is_tried_later),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
