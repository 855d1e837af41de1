/* What happens when memory runs out, and when the system refuses, at each place in turn: a status, nothing leaked,
 * nothing half done, and everything as before for whoever comes next.
 *
 * Each test does the same work again and again, and lets the n-th allocation or the n-th call fail, n = 1, 2, ... until
 * the work gets through.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/io/out/file_out.h"
#include "core/io/out/write.h"
#include "core/io/reader.h"
#include "server/catalog/catalog.h"
#include "server/storage/store.h"
#include "server/storage/upload.h"
#include "tests/unit/faults.h"
#include "tests/unit/folder.h"

static const char id[] = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e";
static const char cloud_text[] = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";

/* ------------------------------------------------------------------------------------------------ a folder */

struct fixture {
    char folder[64], url[96];
    struct error error;
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    folder_make_in_memory(f->folder, sizeof f->folder);
    snprintf(f->url, sizeof f->url, "sqlite:%s/whittled.db", f->folder);
    *state = f;
    return 0;
}

/* ------------------------------------------------------------------------------------------------ the queue */

/* How far the work has come, each step with success. */
enum step { NOTHING, OPENED, SUBMITTED, CLAIMED, TOLD, FINISHED, READ, DELETED, DONE };

static enum step work_on_queue(struct fixture *f, enum status *status) {
    struct catalog *catalog = NULL;
    struct job job = {0}, mine = {.created_ms = 1, .input_format = "xyz", .label = "label"}, listed[4];
    struct catalog_filter filter = {0};
    struct catalog_limits limits = {.waiting = 10};
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    size_t count = 0;
    bool found = false, changed = false, held = false;
    struct catalog_claim by = {"host", 60000, INT64_MAX};
    enum step step = NOTHING;
    memcpy(mine.id, id, sizeof mine.id);
    params_defaults(&mine.params);
    *status = catalog_open(f->url, &catalog, &f->error);
    if (*status == STATUS_OK) step = OPENED, *status = catalog_submit(catalog, &mine, &limits, &f->error);
    if (*status == STATUS_OK) step = SUBMITTED, *status = catalog_claim(catalog, &by, &job, &found, &f->error);
    if (*status == STATUS_OK) step = CLAIMED, *status = catalog_progress(catalog, &job, &held, &f->error);
    job.output_count = 1;
    memcpy(job.output[0].name, "cloud.ply", sizeof "cloud.ply");
    if (*status == STATUS_OK) step = TOLD, *status = catalog_finish(catalog, JOB_DONE, &job, &changed, &f->error);
    job_done(&job);
    if (*status == STATUS_OK) step = FINISHED, *status = catalog_list(catalog, &filter, listed, 4, &count, &f->error);
    for (size_t i = 0; i < count; i++) job_done(&listed[i]);
    if (*status == STATUS_OK) *status = catalog_get(catalog, id, &job, &presence, &tombstone, &f->error);
    if (*status == STATUS_OK) step = READ;
    job_done(&job);
    if (*status == STATUS_OK) *status = catalog_delete(catalog, id, "deleted", &changed, &f->error);
    if (*status == STATUS_OK) step = DONE;
    catalog_close(catalog);
    return step;
}

/* What is there afterwards must be what was said to be done, or one step more: the step that failed. */
static void look_at_queue(struct fixture *f, enum step step) {
    struct catalog *catalog = NULL;
    struct job job;
    enum catalog_presence presence;
    struct catalog_tombstone tombstone;
    assert_int_equal(catalog_open(f->url, &catalog, &f->error), STATUS_OK);
    assert_int_equal(catalog_get(catalog, id, &job, &presence, &tombstone, &f->error), STATUS_OK);
    if (step == OPENED || step == NOTHING) assert_int_equal(presence, CATALOG_ABSENT);
    if (step >= SUBMITTED && step < READ) assert_int_equal(presence, CATALOG_PRESENT);
    if (step == CLAIMED || step == TOLD) assert_int_equal(job.state, JOB_RUNNING);
    if (step == FINISHED) assert_int_equal(job.state, JOB_SUCCESSFUL);
    if (step == FINISHED) assert_int_equal(job.output_count, 1);
    if (step == DONE) assert_int_equal(presence, CATALOG_GONE);
    job_done(&job);
    catalog_close(catalog);
}

static void remove_database(struct fixture *f) {
    static const char *const names[] = {"whittled.db", "whittled.db-wal", "whittled.db-shm"};
    int fd = open(f->folder, O_RDONLY | O_DIRECTORY);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) unlinkat(fd, names[i], 0);
    close(fd);
}

static void every_allocation_of_the_queue_fails_in_turn(void **state) {
    struct fixture *f = *state;
    enum status status;
    long failures = 0;
    for (long nth = 1;; nth += 1 + nth / 8) { /* SQLite makes thousands */
        faults_in_memory(nth, false);
        enum step step = work_on_queue(f, &status);
        bool happened = faults_stop();
        if (status != STATUS_OK) assert_true(status == STATUS_NO_MEMORY || status == STATUS_IO);
        look_at_queue(f, step);
        remove_database(f);
        failures += status != STATUS_OK;
        if (!happened) break;
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(failures > 20);
}

static void every_commit_that_fails_leaves_the_queue_as_it_was(void **state) {
    struct fixture *f = *state;
    enum status status;
    for (long nth = 1;; nth++) {
        faults_in_calls("commit", nth, false, EIO);
        enum step step = work_on_queue(f, &status);
        bool happened = faults_stop();
        look_at_queue(f, step);
        remove_database(f);
        if (!happened) break;
        assert_int_equal(status, STATUS_IO);
    }
    assert_int_equal(status, STATUS_OK);
}

/* ------------------------------------------------------------------------------------------------ the store */

static enum status write_output(const char *folder) {
    char path[SCRATCH_PATH_BYTES + 16];
    snprintf(path, sizeof path, "%s/cloud.ply", folder);
    int fd = open(path, O_WRONLY | O_CREAT, 0600);
    assert_true(fd >= 0);
    assert_int_equal(write(fd, "abc", 3), 3);
    close(fd);
    return STATUS_OK;
}

/* An upload becomes a cloud; a problem counts as the status that made it. */
static enum status work_on_upload(struct store *store, struct error *error) {
    struct admission admission = {.max_points = 100};
    struct upload_facts facts;
    struct problem problem = {0};
    struct upload *upload = upload_new(store, NULL, UINT64_MAX, 1000, &admission, &problem);
    enum status status = upload ? STATUS_OK : STATUS_IO;
    if (upload &&
        !(upload_write(upload, cloud_text, sizeof cloud_text - 1, &problem) && upload_end(upload, &facts, &problem)))
        status = STATUS_IO;
    if (status == STATUS_IO && problem.kind == PROBLEM_STORAGE_FULL) status = STATUS_NO_SPACE;
    if (status == STATUS_OK) status = upload_sync(upload, error);
    if (status == STATUS_OK) status = upload_keep(upload, error);
    upload_free(upload);
    return status;
}

static enum status work_on_store(struct fixture *f) {
    struct store *store = NULL;
    struct job_output outputs[JOB_MAX_OUTPUTS];
    char path[SCRATCH_PATH_BYTES];
    size_t count;
    enum status status = store_open(f->folder, "", &store, &f->error);
    if (status == STATUS_OK) status = work_on_upload(store, &f->error);
    if (status == STATUS_OK) status = scratch_run_begin(store_scratch(store), id, 1, path, &f->error);
    if (status == STATUS_OK) status = write_output(path);
    if (status == STATUS_OK) status = store_outputs_keep(store, id, 1, NULL, outputs, &count, &f->error);
    if (store) scratch_run_drop(store_scratch(store), id, 1);
    store_close(store);
    return status;
}

static enum store_fate keep_all(void *ctx, enum store_thing thing, const char *name) {
    (void)ctx, (void)thing, (void)name;
    return STORE_KEEP;
}

static void look_at_store(struct fixture *f, enum status worked) {
    struct store *store = NULL;
    struct stat facts;
    struct store_cleaned cleaned;
    assert_int_equal(store_open(f->folder, "", &store, &f->error), STATUS_OK);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
    assert_int_equal(store_clean(store, keep_all, NULL, &cleaned, &f->error), STATUS_OK);
    int fd = store_output_open(store, id, 1, "cloud.ply");
    if (worked == STATUS_OK) assert_true(fd >= 0);
    if (fd >= 0) assert_int_equal(fstat(fd, &facts), 0);
    if (fd >= 0) assert_int_equal(facts.st_size, 3);
    if (fd >= 0) close(fd);
    store_job_delete(store, id);
    assert_int_equal(folder_entries(f->folder, "jobs"), 0);
    store_close(store);
}

static void every_call_of_the_store_fails_in_turn(void **state) {
    struct fixture *f = *state;
    static const struct {
        int number;
        enum status status;
    } kinds[] = {{ENOSPC, STATUS_NO_SPACE}, {EDQUOT, STATUS_NO_SPACE}, {EIO, STATUS_IO}, {EMFILE, STATUS_IO}};
    for (size_t i = 0; i < sizeof kinds / sizeof *kinds; i++)
        for (long nth = 1;; nth++) {
            faults_in_calls("", nth, false, kinds[i].number);
            enum status status = work_on_store(f);
            bool happened = faults_stop();
            look_at_store(f, status);
            if (!happened) break;
            assert_true(status == kinds[i].status || status == STATUS_OK); /* OK: where removing failed */
        }
}

static void every_allocation_of_the_store_fails_in_turn(void **state) {
    struct fixture *f = *state;
    for (long nth = 1;; nth++) {
        faults_in_memory(nth, false);
        enum status status = work_on_store(f);
        bool happened = faults_stop();
        look_at_store(f, status);
        if (!happened) break;
        assert_int_not_equal(status, STATUS_OK);
    }
}

/* ------------------------------------------------------------------------------------------------ outputs */

static enum status write_cloud(const struct cloud *cloud, const char *path, struct error *error) {
    struct file_out out = {0};
    enum status status = file_out_begin(&out, path, error);
    if (status == STATUS_OK) status = cloud_write_ply(out.fd, cloud, NULL, cloud->count, ENCODING_BINARY, error);
    if (status == STATUS_OK) return file_out_commit(&out, 1, error);
    file_out_abort(&out);
    return status;
}

static void every_call_of_a_writer_fails_in_turn(void **state) {
    struct fixture *f = *state;
    struct cloud cloud;
    char path[96];
    static const char text[] = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
                               "property float z\nend_header\n0 0 0\n1 2 3\n";
    assert_int_equal(cloud_ply_read(text, sizeof text - 1, NULL, NULL, &cloud, NULL), STATUS_OK);
    snprintf(path, sizeof path, "%s/out.ply", f->folder);
    static const int numbers[] = {ENOSPC, EFBIG, EIO, EMFILE};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        for (long nth = 1;; nth++) {
            faults_in_calls("", nth, false, numbers[i]);
            enum status status = write_cloud(&cloud, path, &f->error);
            if (!faults_stop()) break;
            assert_int_equal(status, status_from_errno(numbers[i]));
            assert_true(folder_entries(f->folder, ".") == 0 ||
                        (access(path, R_OK) == 0 && folder_entries(f->folder, ".") == 1));
            unlink(path);
        }
    cloud_done(&cloud);
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, faults_tear_down)

int main(void) {
    const struct CMUnitTest tests[] = {
        TEST(every_allocation_of_the_queue_fails_in_turn), TEST(every_commit_that_fails_leaves_the_queue_as_it_was),
        TEST(every_call_of_the_store_fails_in_turn),       TEST(every_allocation_of_the_store_fails_in_turn),
        TEST(every_call_of_a_writer_fails_in_turn),
    };
    return cmocka_run_group_tests(tests, faults_set_up, NULL);
}
