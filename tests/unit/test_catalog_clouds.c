/* The contract of catalogs: who sees which clouds, for how long.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "server/base/away.h"
#include "tests/unit/catalog_fixture.h"

/* 64 times the letter. */
static const char *name_of(char letter) {
    static char name[JOB_HASH_BYTES];
    memset(name, letter, JOB_HASH_BYTES - 1);
    return name;
}

static void put(struct catalog_fixture *f, char letter, const char *principal, int64_t created_ms, int64_t expires_ms) {
    struct catalog_cloud record = {
        .created_ms = created_ms, .expires_ms = expires_ms, .bytes = 10, .points = 4, .format = "xyz"};
    snprintf(record.sha256, sizeof record.sha256, "%s", name_of(letter));
    snprintf(record.principal, sizeof record.principal, "%s", principal);
    assert_int_equal(catalog_put_cloud(f->catalog, &record, 0, &f->error), STATUS_OK);
}

static bool sees(struct catalog_fixture *f, char letter, const char *principal, struct catalog_cloud *record) {
    bool found;
    assert_int_equal(catalog_get_cloud(f->catalog, name_of(letter), principal, record, &found, &f->error), STATUS_OK);
    catalog_cloud_done(&(struct catalog_cloud){.report = record->report});
    return found;
}

static void submit(struct catalog_fixture *f, char letter, const char *principal) {
    struct job job = {.id = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e", .created_ms = 5, .input_bytes = 10};
    params_defaults(&job.params);
    snprintf(job.cloud, sizeof job.cloud, "%s", name_of(letter));
    snprintf(job.principal, sizeof job.principal, "%s", principal);
    assert_int_equal(catalog_submit(f->catalog, &job, &(struct catalog_limits){.waiting = 10}, &f->error), STATUS_OK);
}

static void each_sees_what_it_has_uploaded(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_cloud record;
    put(f, 'a', "ann", 1, 100);
    put(f, 'b', "bob", 2, 100);
    submit(f, 'c', "ann");
    assert_true(sees(f, 'a', "ann", &record));
    assert_false(sees(f, 'a', "bob", &record));
    assert_false(sees(f, 'a', "", &record));
    assert_true(sees(f, 'c', "ann", &record));
    assert_false(sees(f, 'c', "bob", &record));
    put(f, 'a', "bob", 3, 200);
    assert_true(sees(f, 'a', "bob", &record));
    assert_int_equal(record.created_ms, 3);
    assert_true(sees(f, 'a', NULL, &record));
    assert_int_equal(catalog_delete_cloud(f->catalog, name_of('a'), "bob", &f->error), STATUS_OK);
    assert_false(sees(f, 'a', "bob", &record));
    assert_true(sees(f, 'a', "ann", &record));
}

static void putting_again_only_keeps_longer(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_cloud record;
    put(f, 'a', "", 1, 100);
    put(f, 'a', "", 7, 50);
    assert_true(sees(f, 'a', "", &record));
    assert_int_equal(record.created_ms, 1);
    assert_int_equal(record.expires_ms, 100);
    put(f, 'a', "", 8, 150);
    assert_true(sees(f, 'a', "", &record));
    assert_int_equal(record.expires_ms, 150);
}

static void expiry_waits_for_the_owners_jobs(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_cloud record;
    char names[4][JOB_HASH_BYTES];
    size_t count;
    put(f, 'a', "ann", 1, 100);
    put(f, 'a', "bob", 1, 100);
    put(f, 'b', "bob", 1, 300);
    submit(f, 'a', "ann");
    assert_int_equal(catalog_expire_clouds(f->catalog, 200, names, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], name_of('a'));
    assert_false(sees(f, 'a', "bob", &record));
    assert_true(sees(f, 'a', "ann", &record));
    assert_true(sees(f, 'b', "bob", &record));
    uint64_t uses;
    assert_int_equal(catalog_cloud_uses(f->catalog, name_of('a'), &uses, &f->error), STATUS_OK);
    assert_int_equal(uses, 2); /* ann's row and her job */
}

static void lists_are_newest_first_and_go_on_where_they_ended(void **state) {
    struct catalog_fixture *f = *state;
    struct catalog_cloud records[4];
    size_t count;
    for (int i = 0; i < 4; i++) put(f, (char)('a' + i), "ann", 10 - i / 2, 100); /* two of each time */
    put(f, 'e', "bob", 50, 100);
    assert_int_equal(catalog_list_clouds(f->catalog, "ann", NULL, records, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 3);
    assert_int_equal(records[0].sha256[0], 'b');
    assert_int_equal(records[1].sha256[0], 'a');
    assert_int_equal(records[2].sha256[0], 'd');
    char after[JOB_HASH_BYTES];
    memcpy(after, records[2].sha256, sizeof after);
    assert_int_equal(catalog_list_clouds(f->catalog, "ann", after, records, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_int_equal(records[0].sha256[0], 'c');
}

static bool is_waited_for(struct catalog_fixture *f, char letter, int64_t now_ms) {
    enum status status = catalog_expect_cloud(f->catalog, name_of(letter), now_ms, &f->error);
    return status == STATUS_IO && error_is_away(&f->error);
}

/* Nobody may put it again until it was removed for certain, when what was asked for before can't happen any more; also
 * where the process that asked has ended. */
static void a_removal_that_may_come_late_is_waited_for(void **state) {
    enum { BEGUN = 5000, OVER = BEGUN + CATALOG_REMOVAL_GRACE_MS };
    struct catalog_fixture *f = *state;
    int removals = 0;
    assert_true(catalog_fixture_removes(f->catalog, name_of('a'), BEGUN, false, &removals));
    assert_true(catalog_fixture_removes(f->catalog, name_of('b'), BEGUN, true, &removals));
    catalog_fixture_reopen(f);
    assert_true(is_waited_for(f, 'a', BEGUN));
    assert_int_equal(catalog_expect_cloud(f->catalog, name_of('b'), BEGUN, &f->error), STATUS_OK);
    put(f, 'b', "ann", BEGUN, 0);
    assert_false(catalog_fixture_removes(f->catalog, name_of('a'), OVER - 1, true, &removals));
    assert_int_equal(removals, 2);
    assert_true(catalog_fixture_removes(f->catalog, name_of('a'), OVER, true, &removals));
    assert_int_equal(removals, 3);
    assert_int_equal(catalog_expect_cloud(f->catalog, name_of('a'), OVER, &f->error), STATUS_OK);
    put(f, 'a', "ann", OVER, 0);
}

static void a_removal_that_was_left_unsure_is_tried_again_in_time(void **state) {
    enum { BEGUN = 5000, OVER = BEGUN + CATALOG_REMOVAL_GRACE_MS };
    struct catalog_fixture *f = *state;
    char names[2][JOB_HASH_BYTES];
    int removals = 0;
    size_t count;
    assert_true(catalog_fixture_removes(f->catalog, name_of('a'), BEGUN, false, &removals));
    assert_int_equal(catalog_list_unused_clouds(f->catalog, OVER - 1, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_list_unused_clouds(f->catalog, OVER, names, 2, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], name_of('a'));
}

/* Also after a start; and again unless it is taken away. */
static void a_mark_is_due_after_its_time(void **state) {
    struct catalog_fixture *f = *state;
    char names[3][CATALOG_MARK_BYTES];
    size_t count;
    assert_int_equal(catalog_mark(f->catalog, "jobs/a", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_mark(f->catalog, "jobs/b", 1000, &f->error), STATUS_OK);
    assert_int_equal(catalog_mark(f->catalog, "jobs/b", 3000, &f->error), STATUS_OK);
    catalog_fixture_reopen(f);
    assert_int_equal(catalog_claim_marks(f->catalog, 999, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_claim_marks(f->catalog, 1000, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "jobs/a");
    assert_int_equal(catalog_claim_marks(f->catalog, 2999, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 0);
    assert_int_equal(catalog_claim_marks(f->catalog, INT64_MAX, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 2);
    assert_int_equal(catalog_unmark(f->catalog, "jobs/a", &f->error), STATUS_OK);
    assert_int_equal(catalog_claim_marks(f->catalog, INT64_MAX, names, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], "jobs/b");
}

static void names_are_told_from_other_text(void **state) {
    (void)state;
    assert_true(catalog_cloud_id_valid(name_of('a')));
    assert_false(catalog_cloud_id_valid(""));
    assert_false(catalog_cloud_id_valid("aaaa"));
    assert_false(catalog_cloud_id_valid(name_of('A')));
    assert_false(catalog_cloud_id_valid(name_of('/')));
}

int main(void) {
    struct CMUnitTest tests[] = {
        CATALOG_TEST(each_sees_what_it_has_uploaded),
        CATALOG_TEST(putting_again_only_keeps_longer),
        CATALOG_TEST(expiry_waits_for_the_owners_jobs),
        CATALOG_TEST(lists_are_newest_first_and_go_on_where_they_ended),
        CATALOG_TEST(a_removal_that_may_come_late_is_waited_for),
        CATALOG_TEST(a_removal_that_was_left_unsure_is_tried_again_in_time),
        CATALOG_TEST(a_mark_is_due_after_its_time),
        cmocka_unit_test(names_are_told_from_other_text),
    };
    return catalog_fixture_run(tests, sizeof tests / sizeof *tests);
}
