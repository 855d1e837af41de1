/* The table of clouds: who sees what, for how long.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/clouds.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

struct fixture {
    char folder[64], path[96];
    struct queue *queue;
    struct error error;
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_clouds.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    snprintf(f->path, sizeof f->path, "%s/queue.db", f->folder);
    *state = f;
    return queue_open(f->path, &f->queue, &f->error) == STATUS_OK ? 0 : -1;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    queue_close(f->queue);
    unlink(f->path);
    rmdir(f->folder);
    free(f);
    return 0;
}

/* 64 times the letter. */
static const char *name_of(char letter) {
    static char name[JOB_HASH_BYTES];
    memset(name, letter, JOB_HASH_BYTES - 1);
    return name;
}

static void put(struct fixture *f, char letter, const char *principal, int64_t created_ms, int64_t expires_ms) {
    struct clouds_record record = {
        .created_ms = created_ms, .expires_ms = expires_ms, .bytes = 10, .points = 4, .format = "xyz"};
    snprintf(record.sha256, sizeof record.sha256, "%s", name_of(letter));
    snprintf(record.principal, sizeof record.principal, "%s", principal);
    assert_int_equal(clouds_put(f->queue, &record, &f->error), STATUS_OK);
}

static bool sees(struct fixture *f, char letter, const char *principal, struct clouds_record *record) {
    bool found;
    assert_int_equal(clouds_get(f->queue, name_of(letter), principal, record, &found, &f->error), STATUS_OK);
    clouds_record_done(&(struct clouds_record){.report = record->report});
    return found;
}

static void submit(struct fixture *f, char letter, const char *principal) {
    struct job job = {.id = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e", .created_ms = 5, .input_bytes = 10};
    params_defaults(&job.params);
    snprintf(job.cloud, sizeof job.cloud, "%s", name_of(letter));
    snprintf(job.principal, sizeof job.principal, "%s", principal);
    assert_int_equal(queue_submit(f->queue, &job, &(struct queue_limits){.waiting = 10}, &f->error), STATUS_OK);
}

static void each_sees_what_it_has_uploaded(void **state) {
    struct fixture *f = *state;
    struct clouds_record record;
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
    assert_int_equal(clouds_delete(f->queue, name_of('a'), "bob", &f->error), STATUS_OK);
    assert_false(sees(f, 'a', "bob", &record));
    assert_true(sees(f, 'a', "ann", &record));
}

static void putting_again_only_keeps_longer(void **state) {
    struct fixture *f = *state;
    struct clouds_record record;
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
    struct fixture *f = *state;
    struct clouds_record record;
    char names[4][JOB_HASH_BYTES];
    size_t count;
    put(f, 'a', "ann", 1, 100);
    put(f, 'a', "bob", 1, 100);
    put(f, 'b', "bob", 1, 300);
    submit(f, 'a', "ann");
    assert_int_equal(clouds_expire(f->queue, 200, names, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_string_equal(names[0], name_of('a'));
    assert_false(sees(f, 'a', "bob", &record));
    assert_true(sees(f, 'a', "ann", &record));
    assert_true(sees(f, 'b', "bob", &record));
    uint64_t uses;
    assert_int_equal(queue_cloud_uses(f->queue, name_of('a'), &uses, &f->error), STATUS_OK);
    assert_int_equal(uses, 2); /* ann's row and her job */
}

static void lists_are_newest_first_and_go_on_where_they_ended(void **state) {
    struct fixture *f = *state;
    struct clouds_record records[4];
    size_t count;
    for (int i = 0; i < 4; i++) put(f, (char)('a' + i), "ann", 10 - i / 2, 100); /* two of each time */
    put(f, 'e', "bob", 50, 100);
    assert_int_equal(clouds_list(f->queue, "ann", NULL, records, 3, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 3);
    assert_int_equal(records[0].sha256[0], 'b');
    assert_int_equal(records[1].sha256[0], 'a');
    assert_int_equal(records[2].sha256[0], 'd');
    char after[JOB_HASH_BYTES];
    memcpy(after, records[2].sha256, sizeof after);
    assert_int_equal(clouds_list(f->queue, "ann", after, records, 4, &count, &f->error), STATUS_OK);
    assert_int_equal(count, 1);
    assert_int_equal(records[0].sha256[0], 'c');
}

static void names_are_told_from_other_text(void **state) {
    (void)state;
    assert_true(clouds_id_valid(name_of('a')));
    assert_false(clouds_id_valid(""));
    assert_false(clouds_id_valid("aaaa"));
    assert_false(clouds_id_valid(name_of('A')));
    assert_false(clouds_id_valid(name_of('/')));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(each_sees_what_it_has_uploaded, set_up, tear_down),
        cmocka_unit_test_setup_teardown(putting_again_only_keeps_longer, set_up, tear_down),
        cmocka_unit_test_setup_teardown(expiry_waits_for_the_owners_jobs, set_up, tear_down),
        cmocka_unit_test_setup_teardown(lists_are_newest_first_and_go_on_where_they_ended, set_up, tear_down),
        cmocka_unit_test(names_are_told_from_other_text),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
