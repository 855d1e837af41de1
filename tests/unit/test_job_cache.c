/* Documents kept in memory: found, forgotten, and never older than a deletion.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/job_cache.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct job job_of(unsigned number, const char *principal) {
    struct job job = {.sequence = 40 + number};
    snprintf(job.id, sizeof job.id, "0198c7d2-4a10-7cc3-9d0e-%012x", number);
    snprintf(job.principal, sizeof job.principal, "%s", principal);
    return job;
}

static void keep(struct job_cache *cache, const struct job *job, const char *text) {
    job_cache_keep(cache, job_cache_now(cache), job, text);
}

static void assert_kept(struct job_cache *cache, const struct job *job, const char *text) {
    char principal[JOB_PRINCIPAL_BYTES] = "";
    uint64_t sequence = 0;
    char *found = job_cache_find(cache, job->id, principal, &sequence);
    assert_non_null(found);
    assert_string_equal(found, text);
    assert_string_equal(principal, job->principal);
    assert_int_equal(sequence, job->sequence);
    free(found);
}

static void assert_absent(struct job_cache *cache, const struct job *job) {
    char principal[JOB_PRINCIPAL_BYTES];
    uint64_t sequence;
    assert_null(job_cache_find(cache, job->id, principal, &sequence));
}

static void what_is_kept_is_found_with_its_owner(void **state) {
    struct job job = job_of(1, "ann"), other = job_of(2, "");
    assert_absent(*state, &job);
    keep(*state, &job, "{\"a\":1}");
    assert_kept(*state, &job, "{\"a\":1}");
    assert_absent(*state, &other);
    keep(*state, &job, "{\"a\":2}");
    assert_kept(*state, &job, "{\"a\":2}");
}

static void what_is_forgotten_is_gone(void **state) {
    struct job job = job_of(1, ""), other = job_of(2, "");
    keep(*state, &job, "1");
    keep(*state, &other, "2");
    job_cache_forget(*state, job.id);
    assert_absent(*state, &job);
    assert_kept(*state, &other, "2");
    keep(*state, &job, "3");
    job_cache_forget(*state, NULL);
    assert_absent(*state, &job);
    assert_absent(*state, &other);
}

static void what_was_read_before_a_deletion_is_not_kept_after_it(void **state) {
    struct job job = job_of(1, "");
    uint64_t since = job_cache_now(*state);
    job_cache_forget(*state, job.id);
    job_cache_keep(*state, since, &job, "stale");
    assert_absent(*state, &job);
}

static void a_long_document_is_not_kept(void **state) {
    struct job job = job_of(1, "");
    char *text = calloc(1, 20000);
    memset(text, ' ', 19999);
    keep(*state, &job, text);
    assert_absent(*state, &job);
    free(text);
}

static void many_share_the_slots(void **state) {
    enum { MANY = 5000 };
    unsigned found = 0;
    for (unsigned i = 0; i < MANY; i++) {
        struct job job = job_of(i, "");
        keep(*state, &job, job.id);
        assert_kept(*state, &job, job.id);
    }
    for (unsigned i = 0; i < MANY; i++) {
        struct job job = job_of(i, "");
        char principal[JOB_PRINCIPAL_BYTES];
        uint64_t sequence;
        char *text = job_cache_find(*state, job.id, principal, &sequence);
        if (text) assert_string_equal(text, job.id);
        found += text != NULL;
        free(text);
    }
    assert_in_range(found, 512, 1024);
}

static int open_documents(void **state) {
    *state = job_cache_new();
    return *state ? 0 : -1;
}

static int close_documents(void **state) {
    job_cache_free(*state);
    return 0;
}

#define WITH_DOCUMENTS(test) cmocka_unit_test_setup_teardown(test, open_documents, close_documents)

int main(void) {
    const struct CMUnitTest tests[] = {
        WITH_DOCUMENTS(what_is_kept_is_found_with_its_owner),
        WITH_DOCUMENTS(what_is_forgotten_is_gone),
        WITH_DOCUMENTS(what_was_read_before_a_deletion_is_not_kept_after_it),
        WITH_DOCUMENTS(a_long_document_is_not_kept),
        WITH_DOCUMENTS(many_share_the_slots),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
