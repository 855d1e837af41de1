/* What happens when memory runs out in the database, or its disk refuses, at each place in turn: a status, nothing
 * lost, nothing stuck.
 *
 * A job and all that is kept beside it go through their lives in steps.  A step that fails is tried again in the same
 * process once the fault is over, and must succeed then: what failed has left nothing behind that is in its way.  What
 * a step reads must be what the steps before have written.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/storage/uploads.h"
#include "tests/unit/faults.h"
#include "tests/unit/folder.h"

static const char id[] = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e";
static const char hash[] = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";
static const char key[] = "key", who[] = "alice";

struct life {
    char folder[64], url[96];
    struct catalog *catalog;
    struct job job;
    struct error error;
};

/* ------------------------------------------------------------------------------------------------ steps */

static enum status open_it(struct life *life) { return catalog_open(life->url, &life->catalog, &life->error); }

static enum status submit(struct life *life) {
    struct job_key job_key = {.key = key};
    struct job job = {.created_ms = 1, .input_format = "xyz", .label = "label", .input_bytes = 5};
    struct catalog_limits limits = {.waiting = 1};
    memcpy(job.id, id, sizeof job.id);
    memcpy(job.principal, who, sizeof who);
    job.key = &job_key;
    job.webhook = "http://example.org/";
    params_defaults(&job.params);
    return catalog_submit(life->catalog, &job, &limits, &life->error);
}

static enum status keep_reply(struct life *life) {
    return catalog_keep_reply(life->catalog, who, key, 201, "\"1\"", "reply", &life->error);
}

static enum status find_reply(struct life *life) {
    struct catalog_reply record;
    bool found;
    enum status status = catalog_find_reply(life->catalog, who, key, &record, &found, &life->error);
    if (status == STATUS_OK) assert_true(found && record.status == 201 && strcmp(record.made, id) == 0);
    if (status == STATUS_OK) assert_string_equal(record.reply, "reply");
    catalog_reply_done(&record);
    return status;
}

static enum status claim(struct life *life) {
    bool found;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    enum status status = catalog_claim(life->catalog, &by, &life->job, &found, &life->error);
    assert_int_equal(found, status == STATUS_OK);
    if (found) assert_string_equal(life->job.id, id);
    if (found) assert_string_equal(life->job.label, "label");
    return status;
}

static enum status progress(struct life *life) {
    bool held = false;
    struct catalog_lease lease;
    size_t count = 0;
    enum status status = catalog_progress(life->catalog, &life->job, &held, &life->error);
    if (status == STATUS_OK) assert_true(held);
    if (status == STATUS_OK) status = catalog_renew(life->catalog, "host", 60000, &lease, 1, &count, &life->error);
    if (status == STATUS_OK) assert_int_equal(count, 1);
    return status;
}

static enum status requeue(struct life *life) {
    bool changed;
    enum status status = catalog_finish(life->catalog, JOB_REQUEUE, &life->job, &changed, &life->error);
    assert_int_equal(changed, status == STATUS_OK);
    if (changed) job_done(&life->job);
    return status;
}

static enum status finish(struct life *life) {
    bool changed;
    life->job.output_count = 1;
    life->job.expires_ms = 10;
    memcpy(life->job.output[0].name, "cloud.ply", sizeof "cloud.ply");
    life->job.output[0].bytes = 7;
    if (!life->job.report) life->job.report = strdup("{}");
    if (!life->job.report) return STATUS_NO_MEMORY;
    enum status status = catalog_finish(life->catalog, JOB_DONE, &life->job, &changed, &life->error);
    assert_int_equal(changed, status == STATUS_OK);
    if (changed) assert_int_equal(catalog_usage(life->catalog, who).active, 0);
    if (changed) job_done(&life->job);
    return status;
}

static void assert_is_ended(struct job *job) {
    assert_int_equal(job->state, JOB_SUCCESSFUL);
    assert_int_equal(job->attempt, 2);
    assert_int_equal(job->output_count, 1);
    assert_string_equal(job->report, "{}");
    assert_string_equal(job->output[0].name, "cloud.ply");
    assert_string_equal(job->input_format, "xyz");
}

static enum status get(struct life *life) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    enum status status = catalog_get(life->catalog, id, &job, &presence, &tombstone, &life->error);
    if (status == STATUS_OK) assert_int_equal(presence, CATALOG_PRESENT);
    if (status == STATUS_OK) assert_is_ended(&job);
    job_done(&job);
    return status;
}

static enum status list(struct life *life) {
    struct job jobs[4];
    size_t count;
    struct catalog_filter filter = {.label = "label", .principal = who};
    enum status status = catalog_list(life->catalog, &filter, jobs, 4, &count, &life->error);
    assert_int_equal(count, status == STATUS_OK);
    if (count) assert_is_ended(&jobs[0]);
    if (count) job_done(&jobs[0]);
    return status;
}

static bool count_due(void *ctx, const struct catalog_webhook *row) {
    assert_string_equal(row->job, id);
    assert_string_equal(row->principal, who);
    assert_int_equal(row->attempts, 0);
    ++*(int *)ctx;
    return true;
}

static enum status webhook(struct life *life) {
    int due = 0;
    enum status status = catalog_each_webhook_due(life->catalog, INT64_MAX, count_due, &due, &life->error);
    if (status == STATUS_OK) assert_int_equal(due, 1);
    if (status == STATUS_OK) status = catalog_postpone_webhook(life->catalog, id, 1, &life->error);
    return status;
}

static enum status deliver(struct life *life) { return catalog_end_webhook(life->catalog, id, &life->error); }

static enum status keep_cloud(struct life *life) {
    struct catalog_cloud record = {.created_ms = 1, .expires_ms = 10, .bytes = 5, .format = "xyz"};
    memcpy(record.sha256, hash, sizeof hash);
    memcpy(record.principal, who, sizeof who);
    return catalog_put_cloud(life->catalog, &record, 0, &life->error);
}

static enum status look_at_cloud(struct life *life) {
    struct catalog_cloud record;
    bool found;
    size_t count;
    uint64_t uses = 0;
    enum status status = catalog_get_cloud(life->catalog, hash, who, &record, &found, &life->error);
    if (status == STATUS_OK) assert_true(found && strcmp(record.format, "xyz") == 0);
    catalog_cloud_done(&record);
    if (status == STATUS_OK) status = catalog_cloud_uses(life->catalog, hash, &uses, &life->error);
    if (status == STATUS_OK) assert_int_equal(uses, 1);
    if (status == STATUS_OK) status = catalog_list_clouds(life->catalog, who, NULL, &record, 1, &count, &life->error);
    if (status == STATUS_OK) assert_int_equal(count, 1);
    if (status == STATUS_OK) catalog_cloud_done(&record);
    return status;
}

static enum status expire_cloud(struct life *life) {
    char names[2][JOB_HASH_BYTES];
    size_t count;
    enum status status = catalog_expire_clouds(life->catalog, 20, names, 2, &count, &life->error);
    if (status == STATUS_OK) assert_int_equal(count, 1);
    if (status == STATUS_OK) assert_string_equal(names[0], hash);
    return status;
}

static enum status keep_part(struct life *life) {
    struct catalog_upload row = {.offset = 3, .length = 9, .boot = "boot"};
    memcpy(row.id, id, sizeof id);
    return catalog_put_upload(life->catalog, &row, &life->error);
}

static enum status find_part(struct life *life) {
    struct catalog_upload row;
    bool found;
    enum status status = catalog_next_upload(life->catalog, "", &row, &found, &life->error);
    if (status == STATUS_OK) assert_true(found && row.offset == 3 && strcmp(row.boot, "boot") == 0);
    return status;
}

static enum status delete_part(struct life *life) {
    bool deleted;
    return catalog_delete_upload(life->catalog, id, INT64_MAX, &deleted, &life->error);
}

static enum status close_and_open(struct life *life) {
    catalog_close(life->catalog);
    life->catalog = NULL;
    return open_it(life);
}

static enum status move_times(struct life *life) { return catalog_move_times(life->catalog, 5, &life->error); }

static enum status expire(struct life *life) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    enum status found = catalog_get(life->catalog, id, &job, &presence, &tombstone, &life->error);
    if (found == STATUS_OK) assert_int_equal(job.expires_ms, 15);
    job_done(&job);
    if (found != STATUS_OK) return found;

    char ids[2][JOB_ID_BYTES];
    size_t count;
    enum status status = catalog_expired(life->catalog, 20, 0, ids, 2, &count, &life->error);
    if (status == STATUS_OK) assert_int_equal(count, 1);
    if (status == STATUS_OK) assert_string_equal(ids[0], id);
    return status;
}

static enum status delete (struct life *life) {
    bool changed; enum status status = catalog_delete(life->catalog, id, "deleted", &changed, &life->error);
    assert_int_equal(changed, status == STATUS_OK);
    return status;
}

static enum status look_at_tombstone(struct life *life) {
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    enum status status = catalog_get(life->catalog, id, &job, &presence, &tombstone, &life->error);
    if (status == STATUS_OK) assert_int_equal(presence, CATALOG_GONE);
    if (status == STATUS_OK) assert_string_equal(tombstone.reason, "deleted");
    return status;
}

static enum status forget_keys(struct life *life) { return catalog_forget_keys(life->catalog, 100, &life->error); }

static enum status (*const steps[])(struct life *life) = {
    open_it,           submit,         keep_reply, find_reply,  claim,      progress,
    requeue,           claim,          finish,     get,         list,       webhook,
    deliver,           keep_part,      find_part,  delete_part, keep_cloud, look_at_cloud,
    expire_cloud,      close_and_open, get,        move_times,  expire,     delete,
    look_at_tombstone, forget_keys};

/* ------------------------------------------------------------------------------------------------ lives */

/* How many steps failed at first, with one of the statuses; opening also as STATUS_IO, for SQLite doesn't always say
 * why it can't. */
static int live(struct life *life, const enum status *allowed) {
    int failures = 0;
    for (size_t i = 0; i < sizeof steps / sizeof *steps; i++) {
        enum status status = steps[i](life);
        if (status == STATUS_OK) continue;
        faults_stop();
        failures++;
        bool known = status == allowed[0] || status == allowed[1] || (i == 0 && status == STATUS_IO);
        if (!known) print_error("step %zu, status %d: %s\n", i, status, life->error.text);
        assert_true(known);
        enum status again = steps[i](life);
        if (again != STATUS_OK) print_error("step %zu, again: %s\n", i, life->error.text);
        assert_int_equal(again, STATUS_OK);
    }
    if (failures)
        catalog_sqlite_refresh_usage(catalog_sqlite_of(life->catalog),
                                     who); /* older figures stand where the last change had no memory */
    assert_int_equal(catalog_usage(life->catalog, who).bytes, 0);
    uint64_t waiting, running;
    catalog_depth(life->catalog, &waiting, &running);
    assert_int_equal(waiting + running, 0);
    return failures;
}

static void begin(struct life *life) {
    memset(life, 0, sizeof *life);
    folder_make_in_memory(life->folder, sizeof life->folder);
    snprintf(life->url, sizeof life->url, "sqlite:%s/whittled.db", life->folder);
}

static void end(struct life *life) {
    catalog_close(life->catalog);
    folder_remove(life->folder);
}

static void every_allocation_fails_in_turn(void **state) {
    static const enum status allowed[] = {STATUS_NO_MEMORY, STATUS_IO};
    struct life life;
    int failures = 0;
    (void)state;
    bool happened = true;
    for (long nth = 1; happened; nth += 1 + nth / 16) { /* SQLite makes thousands */
        begin(&life);
        faults_in_memory(nth, nth % 2);
        int failed = live(&life, allowed);
        happened = faults_stop() || failed;
        failures += failed;
        end(&life);
    }
    assert_true(failures > 60);
}

/* How many steps failed, over all lives in which the point fails. */
static int lives_with(const char *point, int number, enum status expected) {
    const enum status allowed[] = {expected, expected};
    struct life life;
    int failures = 0;
    bool happened = true;
    for (long nth = 1; happened; nth++) {
        begin(&life);
        faults_in_calls(point, nth, nth % 2, number);
        int failed = live(&life, allowed);
        happened = faults_stop() || failed;
        failures += failed;
        end(&life);
    }
    return failures;
}

static void every_call_of_the_disk_fails_in_turn(void **state) {
    static const struct {
        const char *point;
        int number;
        enum status status;
    } faults[] = {{"database-open", EMFILE, STATUS_IO},      {"database-open", EIO, STATUS_IO},
                  {"database-read", EIO, STATUS_IO},         {"database-write", ENOSPC, STATUS_NO_SPACE},
                  {"database-write", EIO, STATUS_IO},        {"database-sync", EIO, STATUS_IO},
                  {"database-map", ENOSPC, STATUS_NO_SPACE}, {"database-map", EIO, STATUS_IO}};
    (void)state;
    for (size_t i = 0; i < sizeof faults / sizeof *faults; i++) {
        int failures = lives_with(faults[i].point, faults[i].number, faults[i].status);
        print_message("%s, %s: %d steps failed\n", faults[i].point, strerror(faults[i].number), failures);
        assert_true(failures > 0);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_allocation_fails_in_turn),
        cmocka_unit_test(every_call_of_the_disk_fails_in_turn),
    };
    return cmocka_run_group_tests(tests, faults_set_up, NULL);
}
