/* The contract of catalogs that several hosts share: what one process holds the others see, and what it changes they
 * are told, with nothing in memory that they would have to know.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <pthread.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "tests/unit/catalog_fixture.h"

static struct catalog *open_again(struct catalog_fixture *f) {
    struct catalog *other = NULL;
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_OK);
    return other;
}

static void a_key_is_held_everywhere(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    struct catalog_key_hold here = {0}, there = {0};
    assert_true(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    assert_false(catalog_fixture_holds(other, "ann", "k", &there));
    catalog_release_key(f->catalog, &here);
    assert_true(catalog_fixture_holds(other, "ann", "k", &there));
    assert_false(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    catalog_close(other); /* it ends, and what it held does */
    assert_true(catalog_fixture_holds(f->catalog, "ann", "k", &here));
    catalog_release_key(f->catalog, &here);
}

static void what_is_reserved_counts_everywhere(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    assert_int_equal(catalog_reserve(f->catalog, "ann", 60, 100, &f->error), STATUS_OK);
    assert_int_equal(catalog_reserve(other, "ann", 60, 100, &f->error), STATUS_LIMIT);
    assert_string_equal(f->error.where, "principal_bytes");
    assert_int_equal(catalog_reserve(other, "ann", 40, 100, &f->error), STATUS_OK);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 100);
    catalog_release(f->catalog, "ann", 50);
    assert_int_equal(catalog_usage(other, "ann").reserved, 50);
    catalog_close(other);
    assert_int_equal(catalog_usage(f->catalog, "ann").reserved, 10);
}

static void a_secret_is_the_first_that_is_brought(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char here[CATALOG_SECRET_BYTES], there[CATALOG_SECRET_BYTES];
    assert_int_equal(catalog_secret(other, "key", "aa", there, &f->error), STATUS_OK);
    assert_int_equal(catalog_secret(f->catalog, "key", "bb", here, &f->error), STATUS_OK);
    assert_string_equal(there, "aa");
    assert_string_equal(here, "aa");
    assert_int_equal(catalog_secret(f->catalog, "another", "bb", here, &f->error), STATUS_OK);
    assert_string_equal(here, "bb");
    catalog_close(other);
}

static void count_removals(void *ctx, const char *cloud) {
    (void)cloud;
    ++*(int *)ctx;
}

/* Between a cloud's upload and its job's row nobody else removes it, and of a host that has gone it is found. */
static void a_cloud_that_is_expected_stays(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f);
    char names[2][JOB_HASH_BYTES];
    int removals = 0;
    bool removed;
    size_t count;
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud1", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_remove_cloud(other, "cloud1", 999, count_removals, &removals, &removed, &f->error),
                     STATUS_OK);
    assert_false(removed);
    assert_int_equal(catalog_list_unused_clouds(other, 999, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    catalog_fixture_submit(f, 1); /* on cloud1 */
    assert_int_equal(catalog_remove_cloud(other, "cloud1", 2000, count_removals, &removals, &removed, &f->error),
                     STATUS_OK);
    assert_false(removed);
    assert_int_equal(catalog_expect_cloud(f->catalog, "cloud0", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_list_unused_clouds(other, 1000, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "cloud0");
    assert_int_equal(removals, 0);
    assert_int_equal(catalog_remove_cloud(other, "cloud0", 1000, count_removals, &removals, &removed, &f->error),
                     STATUS_OK);
    assert_true(removed);
    assert_int_equal(removals, 1);
    assert_int_equal(catalog_list_unused_clouds(other, 9000, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    catalog_close(other);
}

/* "third" has 3 and 6. */
static void turns_are_taken_across_hosts(void **state) {
    static const int order[] = {1, 3, 2, 6, 4};
    struct catalog_fixture *f = *state;
    struct catalog *other = open_again(f), *const hosts[] = {f->catalog, other};
    char id[JOB_ID_BYTES];
    for (int n = 6; n > 0; n -= n == 6 ? 2 : 1) catalog_fixture_submit(f, n);
    for (int i = 0; i < 5; i++) {
        struct catalog_claim by = {i % 2 ? "b" : "a", 60000, INT64_MAX};
        struct job job;
        bool found;
        assert_int_equal(catalog_claim(hosts[i % 2], &by, &job, &found, &f->error), STATUS_OK);
        assert_true(found);
        assert_string_equal(job.id, catalog_fixture_id(order[i], id));
        job_done(&job);
    }
    catalog_close(other);
}

/* What a host is told of another one's changes, to be waited for. */
struct told {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    int times[CATALOG_DELETED + 1];
};

static void hear(void *ctx, enum catalog_change change, const char *id) {
    struct told *told = ctx;
    (void)id;
    pthread_mutex_lock(&told->lock);
    told->times[change]++;
    pthread_cond_broadcast(&told->changed);
    pthread_mutex_unlock(&told->lock);
}

static void wait_for(struct told *told, enum catalog_change change) {
    struct timespec end;
    clock_gettime(CLOCK_REALTIME, &end);
    end.tv_sec += 120;
    pthread_mutex_lock(&told->lock);
    while (!told->times[change])
        if (pthread_cond_timedwait(&told->changed, &told->lock, &end) != 0) fail_msg("change %d isn't told", change);
    told->times[change] = 0;
    pthread_mutex_unlock(&told->lock);
}

static void others_are_told(void **state) {
    struct catalog_fixture *f = *state;
    struct told told = {PTHREAD_MUTEX_INITIALIZER, PTHREAD_COND_INITIALIZER, {0}};
    struct catalog *other = open_again(f);
    struct job job;
    bool held, changed;
    catalog_watch(other, hear, &told);
    catalog_fixture_submit(f, 1);
    wait_for(&told, CATALOG_WAITS);
    assert_true(catalog_fixture_claim(f, &job));
    wait_for(&told, CATALOG_CHANGED);
    snprintf(job.stage, sizeof job.stage, "refine");
    assert_int_equal(catalog_progress(f->catalog, &job, &held, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_CHANGED);
    assert_int_equal(catalog_cancel(f->catalog, job.id, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_CANCELLED);
    assert_true(catalog_fixture_finish(f, JOB_DISMISS, &job));
    wait_for(&told, CATALOG_CHANGED);
    assert_int_equal(catalog_delete(f->catalog, job.id, "deleted", &changed, &f->error), STATUS_OK);
    wait_for(&told, CATALOG_DELETED);
    catalog_close(other);
    job_done(&job);
}

static void a_newer_schema_is_refused_and_an_older_one_upgraded(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog *other = NULL;
    assert_int_equal(catalog_migrate(f->url, &f->error), STATUS_OK); /* again: nothing happens */
    assert_true(catalog_fixture_set_version(f, "count + 1"));
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_UNSUPPORTED);
    assert_non_null(strstr(f->error.text, "newer"));
    assert_int_equal(catalog_migrate(f->url, &f->error), STATUS_UNSUPPORTED);
    assert_true(catalog_fixture_set_version(f, "0"));
    assert_int_equal(catalog_open(f->url, &other, &f->error), STATUS_UNSUPPORTED);
    assert_non_null(strstr(f->error.text, "whittled migrate"));
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(a_key_is_held_everywhere),
        CATALOG_TEST(what_is_reserved_counts_everywhere),
        CATALOG_TEST(a_secret_is_the_first_that_is_brought),
        CATALOG_TEST(a_cloud_that_is_expected_stays),
        CATALOG_TEST(turns_are_taken_across_hosts),
        CATALOG_TEST(others_are_told),
        CATALOG_TEST(a_newer_schema_is_refused_and_an_older_one_upgraded),
    };
    return catalog_fixture_run_shared(tests, sizeof tests / sizeof *tests);
}
