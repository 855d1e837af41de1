/* Resumable uploads: who may write, what is kept, what survives.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/uploads.h"

#include <ftw.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

struct fixture {
    char folder[64], path[STORE_PATH_BYTES];
    struct store *store;
    struct queue *queue;
    struct uploads *uploads;
    struct error error;
    struct problem problem;
};

static const struct uploads_check unchecked;

static void start(struct fixture *f) {
    assert_int_equal(store_open(f->folder, &f->store, &f->error), STATUS_OK);
    store_database_path(f->store, f->path);
    assert_int_equal(queue_open(f->path, &f->queue, &f->error), STATUS_OK);
    assert_int_equal(uploads_open(f->queue, f->store, &f->uploads, &f->error), STATUS_OK);
}

static void stop(struct fixture *f) {
    uploads_close(f->uploads);
    queue_close(f->queue);
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
static void begin(struct fixture *f, const char *piece, struct uploads_info *info) {
    *info = (struct uploads_info){.length = 10};
    struct uploads_writer *writer =
        uploads_create(f->uploads, info, &unchecked, &(struct uploads_limits){10, 10}, &f->problem);
    assert_non_null(writer);
    assert_true(uploads_write(writer, piece, strlen(piece), &f->problem));
    assert_true(uploads_end(writer, INT64_MAX, info, &f->problem));
    uploads_writer_free(writer);
}

static uint64_t offset_of(struct fixture *f, const char *id) {
    struct uploads_info info;
    assert_true(uploads_find(f->uploads, id, &info));
    return info.offset;
}

static void the_newest_writer_has_it(void **state) {
    struct fixture *f = *state;
    struct uploads_info info;
    begin(f, "012", &info);
    struct uploads_writer *old = uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, &f->problem);
    assert_true(uploads_write(old, "34", 2, &f->problem));
    assert_null(uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, &f->problem));
    struct uploads_writer *new = uploads_resume(f->uploads, info.id, 5, UINT64_MAX, &unchecked, &f->problem);
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
    struct uploads_info info;
    begin(f, "01234567", &info);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 8, UINT64_MAX, &unchecked, &f->problem);
    assert_false(uploads_write(writer, "89x", 3, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_BODY_TOO_LARGE);
    uploads_writer_free(writer);
    assert_int_equal(offset_of(f, info.id), 8);
}

static void a_checked_piece_comes_whole_or_not_at_all(void **state) {
    struct fixture *f = *state;
    struct uploads_info info;
    const struct uploads_check right = {.whole = true, .is_sha1 = true, .base64 = "qZk+NkcGgWq6PiVxeFDCbJzQ2J0="};
    begin(f, "", &info);
    for (int i = 0; i < 3; i++) { /* broken off, wrong, right */
        struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 0, UINT64_MAX, &right, &f->problem);
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
    struct uploads_info info = {.length = 10};
    struct uploads_writer *writer =
        uploads_create(f->uploads, &info, &unchecked, &(struct uploads_limits){1, 1}, &f->problem);
    struct uploads_limits one = {1, 1}, one_each = {9, 1};
    assert_null(uploads_create(f->uploads, &(struct uploads_info){.length = 1}, &unchecked, &one, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_TOO_MANY_UPLOADS);
    assert_null(uploads_create(f->uploads, &(struct uploads_info){.length = 1}, &unchecked, &one_each, &f->problem));
    assert_int_equal(f->problem.kind, PROBLEM_RATE_LIMITED);
    struct uploads_info other = {.length = 1, .principal = "other"};
    uploads_writer_free(uploads_create(f->uploads, &other, &unchecked, &one_each, &f->problem));
    assert_true(other.id[0]);
    uploads_writer_free(writer);
    assert_false(uploads_find(f->uploads, info.id, &info));
    assert_int_equal(store_part_open(f->store, info.id, false), -1);
}

static void what_was_written_survives(void **state) {
    struct fixture *f = *state;
    struct uploads_info info;
    begin(f, "012", &info);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 3, UINT64_MAX, &unchecked, &f->problem);
    assert_true(uploads_write(writer, "345", 3, &f->problem));
    uploads_writer_free(writer); /* its connection broke */
    stop(f);
    start(f);
    assert_int_equal(offset_of(f, info.id), 6);
    struct uploads_row row;
    bool found;
    assert_int_equal(uploads_row_next(f->queue, "", &row, &found, &f->error), STATUS_OK);
    assert_int_equal(row.info.offset, 3); /* flushed by then */
    uploads_sweep(f->uploads, 0);
    assert_int_equal(uploads_row_next(f->queue, "", &row, &found, &f->error), STATUS_OK);
    assert_int_equal(row.info.offset, 6);
}

static void sweeping_removes_what_has_expired(void **state) {
    struct fixture *f = *state;
    struct uploads_info info, other;
    begin(f, "0", &info);
    begin(f, "1", &other);
    struct uploads_writer *writer = uploads_resume(f->uploads, info.id, 1, UINT64_MAX, &unchecked, &f->problem);
    assert_true(uploads_end(writer, 5, &info, &f->problem));
    uploads_writer_free(writer);
    uploads_sweep(f->uploads, 10);
    assert_false(uploads_find(f->uploads, info.id, &info));
    assert_true(uploads_find(f->uploads, other.id, &other));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(the_newest_writer_has_it, set_up, tear_down),
        cmocka_unit_test_setup_teardown(no_more_than_the_length_comes, set_up, tear_down),
        cmocka_unit_test_setup_teardown(a_checked_piece_comes_whole_or_not_at_all, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_was_never_ended_was_never_begun, set_up, tear_down),
        cmocka_unit_test_setup_teardown(what_was_written_survives, set_up, tear_down),
        cmocka_unit_test_setup_teardown(sweeping_removes_what_has_expired, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
