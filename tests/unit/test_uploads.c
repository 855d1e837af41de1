/* Resumable uploads: who may write, what is kept, what survives.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/uploads.h"

#include <dlfcn.h>
#include <ftw.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "server/storage/store.h"

#include "server/catalog/sqlite/catalog_sqlite.h"

static bool knows(struct uploads *uploads, const char *id, struct catalog_upload *info) {
    struct error error = {0};
    bool found = false;
    assert_int_equal(uploads_find(uploads, id, info, &found, &error), STATUS_OK);
    return found;
}

struct fixture {
    char folder[64], url[CATALOG_URL_BYTES];
    struct store *store;
    struct catalog *catalog;
    struct uploads *uploads;
    struct error error;
    struct problem problem;
};

static const struct uploads_check unchecked;

static void start(struct fixture *f) {
    assert_int_equal(store_open(f->folder, "", &f->store, &f->error), STATUS_OK);
    catalog_url("", f->folder, f->url);
    assert_int_equal(catalog_open(f->url, &f->catalog, &f->error), STATUS_OK);
    assert_int_equal(uploads_open(f->catalog, f->store, false, &f->uploads, &f->error), STATUS_OK);
}

static void stop(struct fixture *f) {
    uploads_close(f->uploads);
    catalog_close(f->catalog);
    store_close(f->store);
}

static int set_up(void **state) {
    struct fixture *f = calloc(1, sizeof *f);
    if (!f) return -1;
    snprintf(f->folder, sizeof f->folder, "/tmp/test_uploads.XXXXXX");
    if (!mkdtemp(f->folder)) return -1;
    *state = f;
    start(f);
    return 0;
}

static int remove_one(const char *path, const struct stat *facts, int type, struct FTW *place) {
    (void)facts;
    (void)type;
    (void)place;
    return remove(path);
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    stop(f);
    int failed = nftw(f->folder, remove_one, 8, FTW_DEPTH | FTW_PHYS);
    free(f);
    return failed;
}

/* Begins an upload of 10 bytes, with a first piece. */
static void begin(struct fixture *f, const char *piece, struct catalog_upload *info) {
    *info = (struct catalog_upload){.length = 10};
    struct uploads_writer *writer =
        uploads_create(f->uploads, info, &unchecked, &(struct uploads_limits){10, 10, 0}, &f->problem);
    assert_non_null(writer);
    assert_true(uploads_write(writer, piece, strlen(piece), &f->problem));
    assert_true(uploads_end(writer, INT64_MAX, info, &f->problem));
    uploads_writer_free(writer);
}

static uint64_t offset_of(struct fixture *f, const char *id) {
    struct catalog_upload info;
    assert_true(knows(f->uploads, id, &info));
    return info.offset;
}

static void the_newest_writer_has_it(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    begin(f, "012", &info);
    struct uploads_writer *old = uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_true(uploads_write(old, "34", 2, &f->problem));
    assert_null(uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, 0, &f->problem));
    struct uploads_writer *new = uploads_resume(f->uploads, info.id, 5, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_non_null(new);
    assert_false(uploads_write(old, "x", 1, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_OFFSET_MISMATCH);
    assert_false(uploads_end(old, INT64_MAX, &info, &f->problem));
    uploads_writer_free(old);
    assert_true(uploads_write(new, "5", 1, &f->problem));
    assert_true(uploads_end(new, INT64_MAX, &info, &f->problem));
    assert_int_equal(info.offset, 6);
    uploads_writer_free(new);
}

static void no_more_than_the_length_comes(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    begin(f, "01234567", &info);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 8, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_false(uploads_write(writer, "89x", 3, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_BODY_TOO_LARGE);
    uploads_writer_free(writer);
    assert_int_equal(offset_of(f, info.id), 8);
}

static void a_checked_piece_comes_whole_or_not_at_all(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    const struct uploads_check right = {.whole = true, .is_sha1 = true, .base64 = "qZk+NkcGgWq6PiVxeFDCbJzQ2J0="};
    begin(f, "", &info);
    for (int i = 0; i < 3; i++) { /* broken off, wrong, right */
        struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 0, UINT64_MAX, &right, 0, &f->problem);
        assert_true(uploads_write(writer, "ab", 2, &f->problem));
        assert_int_equal(offset_of(f, info.id), 0);
        if (i) assert_true(uploads_write(writer, i == 1 ? "x" : "c", 1, &f->problem));
        if (i) assert_int_equal(uploads_end(writer, INT64_MAX, &info, &f->problem), i == 2);
        if (i == 1) assert_int_equal(f->problem.kind, PROBLEM_CHECKSUM_MISMATCH);
        uploads_writer_free(writer);
    }
    assert_int_equal(offset_of(f, info.id), 3);
}

static void what_was_never_ended_was_never_begun(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info = {.length = 10};
    struct uploads_writer *writer =
        uploads_create(f->uploads, &info, &unchecked, &(struct uploads_limits){1, 1, 0}, &f->problem);
    struct uploads_limits one = {1, 1, 0}, one_each = {9, 1, 0};
    assert_null(uploads_create(f->uploads, &(struct catalog_upload){.length = 1}, &unchecked, &one, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_TOO_MANY_UPLOADS);
    assert_null(uploads_create(f->uploads, &(struct catalog_upload){.length = 1}, &unchecked, &one_each, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_RATE_LIMITED);
    struct catalog_upload other = {.length = 1, .principal = "other"};
    uploads_writer_free(uploads_create(f->uploads, &other, &unchecked, &one_each, &f->problem));
    assert_true(other.id[0]);
    uploads_writer_free(writer);
    assert_false(knows(f->uploads, info.id, &info));
    assert_int_equal(scratch_part_open(store_scratch(f->store), info.id, false), -1);
}

static void what_was_written_survives(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    begin(f, "012", &info);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_true(uploads_write(writer, "345", 3, &f->problem));
    uploads_writer_free(writer); /* its connection broke */
    stop(f);
    start(f);
    assert_int_equal(offset_of(f, info.id), 6);
    struct catalog_upload row;
    bool found;
    assert_int_equal(catalog_next_upload(f->catalog, "", &row, &found, &f->error), STATUS_OK);
    assert_int_equal(row.offset, 3); /* flushed by then */
    uploads_sweep(f->uploads, 0);
    assert_int_equal(catalog_next_upload(f->catalog, "", &row, &found, &f->error), STATUS_OK);
    assert_int_equal(row.offset, 6);
}

static void sweeping_removes_what_has_expired(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info, other;
    begin(f, "0", &info);
    begin(f, "1", &other);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 1, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_true(uploads_end(writer, 5, &info, &f->problem));
    uploads_writer_free(writer);
    uploads_sweep(f->uploads, 10);
    assert_false(knows(f->uploads, info.id, &info));
    assert_true(knows(f->uploads, other.id, &other));
}

static uint64_t reserved(struct fixture *f) { return catalog_usage(f->catalog, "").reserved; }

static void bytes_are_reserved_before_they_come(void **state) {
    struct fixture *f = *state;
    const struct uploads_limits limits = {10, 10, 25};
    struct catalog_upload first = {.length = 10}, second = {.length = 10}, third = {.length = 10};
    struct uploads_writer *one = uploads_create(f->uploads, &first, &unchecked, &limits, &f->problem);
    struct uploads_writer *two = uploads_create(f->uploads, &second, &unchecked, &limits, &f->problem);
    assert_int_equal(reserved(f), 20); /* nothing has come */
    assert_null(uploads_create(f->uploads, &third, &unchecked, &limits, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_RATE_LIMITED);
    assert_int_equal(reserved(f), 20);
    uploads_writer_free(two); /* undone */
    assert_int_equal(reserved(f), 10);
    assert_true(uploads_end(one, INT64_MAX, &first, &f->problem));
    uploads_writer_free(one);
    stop(f);
    start(f);
    assert_int_equal(reserved(f), 10);
    assert_int_equal(uploads_complete(f->uploads, first.id, "cloud", &f->error), STATUS_OK);
    assert_int_equal(reserved(f), 0);
}

static void what_has_no_length_reserves_as_it_comes(void **state) {
    struct fixture *f = *state;
    const struct uploads_limits limits = {10, 10, 10};
    const struct uploads_check right = {.whole = true, .is_sha1 = true, .base64 = "qZk+NkcGgWq6PiVxeFDCbJzQ2J0="};
    struct catalog_upload a = {.length = UINT64_MAX}, b = {.length = UINT64_MAX};
    struct uploads_writer *one = uploads_create(f->uploads, &a, &unchecked, &limits, &f->problem);
    struct uploads_writer *two = uploads_create(f->uploads, &b, &right, &limits, &f->problem);
    assert_true(uploads_write(one, "0123", 4, &f->problem));
    assert_true(uploads_write(two, "ab", 2, &f->problem));
    assert_true(uploads_write(two, "c", 1, &f->problem));
    assert_int_equal(reserved(f), 7);
    assert_false(uploads_write(one, "4567", 4, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_RATE_LIMITED);
    assert_int_equal(reserved(f), 7);
    assert_true(uploads_end(two, INT64_MAX, &b, &f->problem));
    uploads_writer_free(two);
    assert_int_equal(reserved(f), 7);
    two = uploads_resume(f->uploads, b.id, 3, UINT64_MAX, &right, 10, &f->problem);
    assert_true(uploads_write(two, "xyz", 3, &f->problem)); /* a piece that is never right */
    assert_int_equal(reserved(f), 10);
    uploads_writer_free(two);
    assert_int_equal(reserved(f), 7);
    assert_null(uploads_resume(f->uploads, b.id, 3, 7, &unchecked, 10, &f->problem)); /* a length is told: 4 + 7 */
    two = uploads_resume(f->uploads, b.id, 3, 6, &unchecked, 10, &f->problem);
    assert_non_null(two);
    assert_int_equal(reserved(f), 10);
    uploads_writer_free(two);
    uploads_writer_free(one);
    assert_int_equal(uploads_delete(f->uploads, b.id, &f->error), STATUS_OK);
    assert_int_equal(reserved(f), 0);
}

/* ------------------------------------------------------------------------------------------------ failures */

static ssize_t (*real_pwrite)(int fd, const void *bytes, size_t count, off_t offset);
static size_t most_at_once = SIZE_MAX;

/* In libc's place: what a disk that fills, or a signal, makes of a write. */
ssize_t pwrite(int fd, const void *bytes, size_t count, off_t offset) {
    if (!real_pwrite) *(void **)&real_pwrite = dlsym(RTLD_NEXT, "pwrite");
    return real_pwrite(fd, bytes, count < most_at_once ? count : most_at_once, offset);
}

static void a_write_that_is_cut_short_goes_on(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    char text[11] = "";
    most_at_once = 3;
    begin(f, "0123456789", &info);
    most_at_once = SIZE_MAX;
    assert_int_equal(offset_of(f, info.id), 10);
    int fd = scratch_part_open(store_scratch(f->store), info.id, false);
    assert_int_equal(pread(fd, text, 10, 0), 10);
    close(fd);
    assert_string_equal(text, "0123456789");
}

/* Another connection, which makes the table refuse. */
static void refuse_rows(struct fixture *f, const char *when) {
    char text[256];
    snprintf(text, sizeof text,
             "DROP TRIGGER IF EXISTS no; CREATE TRIGGER no BEFORE %s ON uploads BEGIN SELECT RAISE(ABORT, 'no'); END",
             when);
    catalog_sqlite_enter(catalog_sqlite_of(f->catalog));
    assert_int_equal(sql_execute(catalog_sqlite_of(f->catalog)->writer, text, &f->error), STATUS_OK);
    sql_unlock(catalog_sqlite_of(f->catalog)->writer);
}

static void what_has_no_row_is_not_told_as_success(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    begin(f, "012", &info);
    refuse_rows(f, "INSERT");
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, 0, &f->problem);
    assert_true(uploads_write(writer, "3", 1, &f->problem));
    assert_false(uploads_end(writer, INT64_MAX, &info, &f->problem));
    uploads_writer_free(writer);
    assert_int_equal(uploads_complete(f->uploads, info.id, "cloud", &f->error), STATUS_IO);
    assert_true(knows(f->uploads, info.id, &info));
    assert_string_equal(info.cloud, "");
    struct catalog_upload fresh = {.length = 5};
    writer = uploads_create(f->uploads, &fresh, &unchecked, &(struct uploads_limits){10, 10, 0}, &f->problem);
    assert_false(uploads_end(writer, INT64_MAX, &fresh, &f->problem));
    uploads_writer_free(writer);
    assert_false(knows(f->uploads, fresh.id, &fresh));
    refuse_rows(f, "DELETE");
    assert_int_equal(uploads_delete(f->uploads, info.id, &f->error), STATUS_IO);
    catalog_sqlite_enter(catalog_sqlite_of(f->catalog));
    assert_int_equal(sql_execute(catalog_sqlite_of(f->catalog)->writer, "DROP TRIGGER no", &f->error), STATUS_OK);
    sql_unlock(catalog_sqlite_of(f->catalog)->writer);
}

static void what_a_row_says_is_there_after_a_restart(void **state) {
    struct fixture *f = *state;
    struct catalog_upload open, whole, found;
    begin(f, "012", &open);
    begin(f, "0123456789", &whole);
    assert_int_equal(uploads_complete(f->uploads, whole.id, "cloud", &f->error), STATUS_OK);
    stop(f);
    start(f);
    assert_int_equal(offset_of(f, open.id), 3);
    assert_true(knows(f->uploads, whole.id, &found));
    assert_string_equal(found.cloud, "cloud");
}

static void a_link_that_fails_is_not_told_as_success(void **state) {
    struct fixture *f = *state;
    struct catalog_upload info;
    begin(f, "0123456789", &info);
    assert_int_equal(store_part_keep(f->store, info.id, "no/such/name", &f->error), STATUS_BAD_PARAMETER);
    assert_int_equal(store_part_keep(f->store, info.id, "cloud", &f->error), STATUS_OK);
    assert_true(store_cloud_exists(f->store, "cloud"));
    assert_int_equal(store_part_keep(f->store, info.id, "cloud", &f->error), STATUS_OK); /* it is there already */
    char in_the_way[80];
    snprintf(in_the_way, sizeof in_the_way, "%s/clouds/folder", f->folder);
    assert_int_equal(mkdir(in_the_way, 0700), 0);
    assert_int_equal(store_part_keep(f->store, info.id, "folder", &f->error), STATUS_IO);
    scratch_part_delete(store_scratch(f->store), info.id);
    assert_int_equal(store_part_keep(f->store, info.id, "other", &f->error), STATUS_IO);
    assert_false(store_cloud_exists(f->store, "other"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_newest_writer_has_it, set_up, tear_down),
        cmocka_unit_test_setup_teardown(no_more_than_the_length_comes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_checked_piece_comes_whole_or_not_at_all, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_was_never_ended_was_never_begun, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_was_written_survives, set_up, tear_down),
        cmocka_unit_test_setup_teardown(sweeping_removes_what_has_expired, set_up, tear_down),
        cmocka_unit_test_setup_teardown(bytes_are_reserved_before_they_come, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_has_no_length_reserves_as_it_comes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_write_that_is_cut_short_goes_on, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_has_no_row_is_not_told_as_success, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_a_row_says_is_there_after_a_restart, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_link_that_fails_is_not_told_as_success, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
