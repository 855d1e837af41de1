/* The store: what is visible is complete, and what isn't kept leaves nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/store.h"

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

#include "tests/unit/folder.h"

static const char id[] = "0198c7d2-4a10-7cc3-9d0e-6f1f2b3c4d5e";

struct fixture {
    char folder[64];
    struct store *store;
    struct error error;
};

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    snprintf(f->folder, sizeof f->folder, "/tmp/test_store.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    *state = f;
    return store_open(f->folder, "", &f->store, &f->error) == STATUS_OK ? 0 : -1;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    store_close(f->store);
    folder_remove(f->folder);
    free(f);
    return 0;
}

static void write_file(const char *folder, const char *name, const char *text) {
    char path[SCRATCH_PATH_BYTES + 64];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    fputs(text, file);
    fclose(file);
}

static void assert_content(int fd, const char *text) {
    char found[256] = "";
    assert_true(fd >= 0);
    assert_true(read(fd, found, sizeof found - 1) >= 0);
    assert_string_equal(found, text);
    close(fd);
}

/* ------------------------------------------------------------------------------------------------ clouds */

static void upload(struct fixture *f, struct scratch_file *upload, const char *text) {
    assert_int_equal(scratch_file_begin(store_scratch(f->store), upload, &f->error), STATUS_OK);
    assert_int_equal(write(upload->fd, text, strlen(text)), strlen(text));
    assert_int_equal(scratch_file_sync(upload, &f->error), STATUS_OK);
}

static void an_upload_is_visible_once_it_is_kept(void **state) {
    struct fixture *f = *state;
    struct scratch_file u;
    upload(f, &u, "cloud");
    assert_int_equal(folder_entries(f->folder, "tmp"), 1);
    assert_int_equal(folder_entries(f->folder, "clouds"), 0);
    assert_int_equal(store_upload_keep(f->store, &u, "abc", &f->error), STATUS_OK);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
    assert_true(store_cloud_exists(f->store, "abc"));
    assert_content(store_cloud_open(f->store, "abc"), "cloud");
    scratch_file_drop(store_scratch(f->store), &u); /* has ended: nothing happens */
    assert_true(store_cloud_exists(f->store, "abc"));
    store_cloud_delete(f->store, "abc", NULL);
    assert_false(store_cloud_exists(f->store, "abc"));
}

static void a_dropped_upload_leaves_nothing(void **state) {
    struct fixture *f = *state;
    struct scratch_file u;
    upload(f, &u, "cloud");
    scratch_file_drop(store_scratch(f->store), &u);
    scratch_file_drop(store_scratch(f->store), &u);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
    assert_int_equal(u.fd, -1);
}

static void the_same_content_twice_is_one_cloud(void **state) {
    struct fixture *f = *state;
    struct scratch_file a, b;
    upload(f, &a, "same");
    upload(f, &b, "same");
    assert_int_equal(store_upload_keep(f->store, &a, "abc", &f->error), STATUS_OK);
    assert_int_equal(store_upload_keep(f->store, &b, "abc", &f->error), STATUS_OK);
    assert_int_equal(folder_entries(f->folder, "clouds"), 1);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

/* ------------------------------------------------------------------------------------------------ outputs */

static void outputs_appear_together_with_their_hashes(void **state) {
    struct fixture *f = *state;
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t count;
    char path[SCRATCH_PATH_BYTES];
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    write_file(path, "mesh.ply", "");
    write_file(path, "cloud.ply", "abc");
    write_file(path, ".hidden", "x");
    assert_false(store_outputs_exist(f->store, id, 1));
    assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_OK);
    assert_true(store_outputs_exist(f->store, id, 1));
    assert_int_equal(count, 2);
    assert_string_equal(outputs[0].name, "cloud.ply");
    assert_int_equal(outputs[0].bytes, 3);
    assert_string_equal(outputs[0].sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    assert_string_equal(outputs[1].sha256, "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    assert_content(store_output_open(f->store, id, 1, "cloud.ply"), "abc");
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

static void outputs_of_a_second_run_take_the_place_of_the_first(void **state) {
    struct fixture *f = *state;
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t count;
    char path[SCRATCH_PATH_BYTES];
    static const char *const texts[] = {"first", "second"};
    for (int i = 0; i < 2; i++) {
        assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
        write_file(path, "cloud.ply", texts[i]);
        assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_OK);
    }
    assert_content(store_output_open(f->store, id, 1, "cloud.ply"), "second");
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

/* Where blobs are apart other hosts put some, too, and the first attempt's may be left by one that died. */
static void what_is_left_of_a_first_attempt_is_no_later_one_s(void **state) {
    struct fixture *f = *state;
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t count;
    char path[SCRATCH_PATH_BYTES], url[128];
    store_close(f->store);
    f->store = NULL;
    snprintf(url, sizeof url, "file:%.80s/apart", f->folder);
    assert_int_equal(store_open(f->folder, url, &f->store, &f->error), STATUS_OK);
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    write_file(path, "cloud.ply", "first");
    assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_OK);
    assert_true(store_outputs_exist(f->store, id, 1));
    assert_false(store_outputs_exist(f->store, id, 2));
    assert_int_equal(store_output_open(f->store, id, 2, "cloud.ply"), -1);
    assert_int_equal(store_outputs_count(f->store, id, 2), 0);
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 2, path, &f->error), STATUS_OK);
    write_file(path, "cloud.ply", "second");
    assert_int_equal(store_outputs_keep(f->store, id, 2, NULL, outputs, &count, &f->error), STATUS_OK);
    assert_content(store_output_open(f->store, id, 2, "cloud.ply"), "second");
    store_outputs_delete(f->store, id, 1);
    assert_true(store_outputs_exist(f->store, id, 2));
}

static void a_run_begins_with_an_empty_folder(void **state) {
    struct fixture *f = *state;
    char path[SCRATCH_PATH_BYTES];
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    write_file(path, "half", "x");
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    int fd = open(path, O_RDONLY | O_DIRECTORY);
    assert_int_not_equal(unlinkat(fd, "half", 0), 0);
    close(fd);
    scratch_run_drop(store_scratch(f->store), id, 1);
    scratch_run_drop(store_scratch(f->store), id, 1);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

static void what_is_no_plain_file_is_no_output(void **state) {
    struct fixture *f = *state;
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t count;
    char path[SCRATCH_PATH_BYTES], link[SCRATCH_PATH_BYTES + 16];
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    snprintf(link, sizeof link, "%s/cloud.ply", path);
    assert_int_equal(symlink("/etc/passwd", link), 0);
    assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_IO);
    assert_false(store_outputs_exist(f->store, id, 1));
    unlink(link);
    assert_int_equal(mkfifo(link, 0600), 0);
    assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_IO);
}

static void names_that_lead_elsewhere_are_refused(void **state) {
    struct fixture *f = *state;
    static const char *const names[] = {"../log", "..", ".", "/etc/passwd", "a/b", ".hidden"};
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t count;
    char path[SCRATCH_PATH_BYTES];
    close(store_log_open(f->store, id, true));
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    assert_int_equal(store_outputs_keep(f->store, id, 1, NULL, outputs, &count, &f->error), STATUS_OK);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        assert_int_equal(store_output_open(f->store, id, 1, names[i]), -1);
}

static void a_log_is_appended_to(void **state) {
    struct fixture *f = *state;
    assert_int_equal(store_log_open(f->store, id, false), -1);
    for (int i = 0; i < 2; i++) {
        int fd = store_log_open(f->store, id, true);
        assert_int_equal(write(fd, "line\n", 5), 5);
        close(fd);
    }
    assert_content(store_log_open(f->store, id, false), "line\nline\n");
    store_job_delete(f->store, id);
    assert_int_equal(store_log_open(f->store, id, false), -1);
    assert_int_equal(folder_entries(f->folder, "jobs"), 0);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

/* ------------------------------------------------------------------------------------------------ opening, cleaning */

static void a_folder_has_one_owner(void **state) {
    struct fixture *f = *state;
    struct store *second = NULL;
    assert_int_equal(store_open(f->folder, "", &second, &f->error), STATUS_IO);
    assert_non_null(strstr(f->error.text, "another whittled"));
    assert_null(second);
    store_close(f->store);
    assert_int_equal(store_open(f->folder, "", &f->store, &f->error), STATUS_OK);
}

static void a_lock_file_that_is_removed_lets_nobody_in(void **state) {
    struct fixture *f = *state;
    struct store *second = NULL;
    char path[SCRATCH_PATH_BYTES];
    snprintf(path, sizeof path, "%s/lock", f->folder);
    assert_int_equal(unlink(path), 0);
    assert_int_equal(store_open(f->folder, "", &second, &f->error), STATUS_IO);
    assert_non_null(strstr(f->error.text, "another whittled"));
    assert_int_equal(unlink(path), 0); /* made by the second, which had it for itself */
    write_file(f->folder, "lock", "");
    assert_int_equal(store_open(f->folder, "", &second, &f->error), STATUS_IO);
    assert_null(second);
}

static void the_identity_is_kept(void **state) {
    struct fixture *f = *state;
    char identity[SCRATCH_IDENTITY_BYTES] = "x";
    assert_int_equal(scratch_identity(store_scratch(f->store), identity, &f->error), STATUS_OK);
    assert_string_equal(identity, "");
    assert_int_equal(scratch_set_identity(store_scratch(f->store), "first", &f->error), STATUS_OK);
    assert_int_equal(scratch_set_identity(store_scratch(f->store), "0123456789abcdef0123456789abcdef", &f->error),
                     STATUS_OK);
    store_close(f->store);
    assert_int_equal(store_open(f->folder, "", &f->store, &f->error), STATUS_OK);
    assert_int_equal(scratch_identity(store_scratch(f->store), identity, &f->error), STATUS_OK);
    assert_string_equal(identity, "0123456789abcdef0123456789abcdef");
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
}

static void a_path_that_cannot_be_made_is_refused(void **state) {
    struct fixture *f = *state;
    struct store *store = NULL;
    assert_int_equal(store_open("/proc/nothing/here", "", &store, &f->error), STATUS_IO);
    assert_int_equal(store_open("", "", &store, &f->error), STATUS_IO);
    assert_int_equal(store_open("/dev/null", "", &store, &f->error), STATUS_IO);
}

/* By its first letter: kept, gone, or not known. */
static enum store_fate by_first_letter(void *ctx, enum store_thing thing, const char *name) {
    ++((int *)ctx)[thing];
    return name[0] == 'k' ? STORE_KEEP : name[0] == 'g' ? STORE_REMOVE : STORE_SET_ASIDE;
}

static void keep_cloud(struct fixture *f, const char *name) {
    struct scratch_file u;
    upload(f, &u, name);
    assert_int_equal(store_upload_keep(f->store, &u, name, &f->error), STATUS_OK);
}

static void cleaning_removes_what_is_over_and_sets_aside_what_nobody_knows(void **state) {
    struct fixture *f = *state;
    struct scratch_file u;
    char path[SCRATCH_PATH_BYTES], lost[SCRATCH_PATH_BYTES + 80];
    int asked[3] = {0};
    struct store_cleaned cleaned;
    upload(f, &u, "x");
    close(u.fd);
    assert_int_equal(scratch_run_begin(store_scratch(f->store), id, 1, path, &f->error), STATUS_OK);
    write_file(path, "cloud.ply", "x");
    keep_cloud(f, "known");
    keep_cloud(f, "stray");
    close(store_log_open(f->store, "kept-job", true));
    close(store_log_open(f->store, "gone-job", true));
    close(store_log_open(f->store, "stray-job", true));
    close(scratch_part_open(store_scratch(f->store), "stray-part", true));
    close(scratch_part_open(store_scratch(f->store), "gone-part", true));
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &cleaned, &f->error), STATUS_OK);
    assert_int_equal(cleaned.removed, 4); /* two of tmp/ */
    assert_int_equal(cleaned.set_aside, 3);
    assert_int_equal(cleaned.left, 0);
    assert_int_equal(asked[STORE_CLOUD], 2);
    assert_int_equal(asked[STORE_JOB], 3);
    assert_int_equal(asked[STORE_PART], 2);
    assert_int_equal(folder_entries(f->folder, "tmp"), 0);
    assert_int_equal(folder_entries(f->folder, "clouds"), 1);
    assert_int_equal(folder_entries(f->folder, "jobs"), 1);
    assert_int_equal(folder_entries(f->folder, "uploads"), 0);
    snprintf(lost, sizeof lost, "%s/%s/clouds/stray", f->folder, cleaned.place);
    assert_content(open(lost, O_RDONLY), "stray");
    snprintf(lost, sizeof lost, "%s/%s/jobs/stray-job/log", f->folder, cleaned.place);
    assert_content(open(lost, O_RDONLY), "");
    assert_int_equal(store_lost(f->store), 3);
}

static void what_is_lost_twice_is_kept_twice(void **state) {
    struct fixture *f = *state;
    int asked[3] = {0};
    struct store_cleaned first, second;
    keep_cloud(f, "stray");
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &first, &f->error), STATUS_OK);
    keep_cloud(f, "stray");
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &second, &f->error), STATUS_OK);
    assert_string_not_equal(first.place, second.place);
    assert_int_equal(store_lost(f->store), 2);
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &second, &f->error), STATUS_OK);
    assert_string_equal(second.place, "");
}

static void what_cannot_be_set_aside_stays(void **state) {
    struct fixture *f = *state;
    int asked[3] = {0};
    struct store_cleaned cleaned;
    keep_cloud(f, "stray");
    write_file(f->folder, "lost+found", "no folder");
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &cleaned, &f->error), STATUS_OK);
    assert_int_equal(cleaned.set_aside, 1); /* beside it */
    assert_int_equal(strncmp(cleaned.place, "lost+found.whittled/", 20), 0);
    keep_cloud(f, "stray");
    char path[SCRATCH_PATH_BYTES];
    snprintf(path, sizeof path, "%s/lost+found.whittled", f->folder);
    folder_remove(path);
    write_file(f->folder, "lost+found.whittled", "no folder either");
    assert_int_equal(store_clean(f->store, by_first_letter, asked, &cleaned, &f->error), STATUS_OK);
    assert_int_equal(cleaned.left, 1);
    assert_true(store_cloud_exists(f->store, "stray"));
}

#define TEST(name) cmocka_unit_test_setup_teardown(name, set_up, tear_down)

int main(void) {
    const struct CMUnitTest tests[] = {
        TEST(an_upload_is_visible_once_it_is_kept),
        TEST(a_dropped_upload_leaves_nothing),
        TEST(the_same_content_twice_is_one_cloud),
        TEST(outputs_appear_together_with_their_hashes),
        TEST(outputs_of_a_second_run_take_the_place_of_the_first),
        TEST(what_is_left_of_a_first_attempt_is_no_later_one_s),
        TEST(a_run_begins_with_an_empty_folder),
        TEST(what_is_no_plain_file_is_no_output),
        TEST(names_that_lead_elsewhere_are_refused),
        TEST(a_log_is_appended_to),
        TEST(a_folder_has_one_owner),
        TEST(a_path_that_cannot_be_made_is_refused),
        TEST(a_lock_file_that_is_removed_lets_nobody_in),
        TEST(the_identity_is_kept),
        TEST(cleaning_removes_what_is_over_and_sets_aside_what_nobody_knows),
        TEST(what_is_lost_twice_is_kept_twice),
        TEST(what_cannot_be_set_aside_stays),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
