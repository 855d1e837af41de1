/* The contract of blob stores.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/clock.h"
#include "server/base/digest.h"
#include "tests/unit/blobs_fixture.h"

#define PUT(f, folder, ...)                                                                                            \
    assert_int_equal(blobs_fixture_put(f, folder, (const char *const[]){__VA_ARGS__, NULL}), STATUS_OK)

static void what_was_put_is_there(void **state) {
    struct blobs_fixture *f = *state;
    assert_false(blobs_fixture_has(f, "clouds/a", ""));
    PUT(f, "clouds", "a", "first");
    assert_true(blobs_fixture_has(f, "clouds/a", "first"));
    assert_false(blobs_fixture_has(f, "clouds/b", ""));
    assert_int_equal(blobs_read(f->blobs, "clouds/b", NULL), -1);
    assert_int_equal(errno, ENOENT);
    blobs_fixture_reopen(f);
    assert_true(blobs_fixture_has(f, "clouds/a", "first"));
}

static void an_empty_blob_is_one(void **state) {
    struct blobs_fixture *f = *state;
    PUT(f, "clouds", "a", "");
    assert_true(blobs_fixture_has(f, "clouds/a", ""));
}

static void a_name_that_is_there_is_replaced(void **state) {
    struct blobs_fixture *f = *state;
    PUT(f, "clouds", "a", "first, and longer");
    int before = blobs_read(f->blobs, "clouds/a", NULL);
    PUT(f, "clouds", "a", "second");
    assert_true(blobs_fixture_has(f, "clouds/a", "second"));
    char found[32] = "";
    assert_int_equal(pread(before, found, sizeof found - 1, 0), 17); /* who reads it reads what it was */
    assert_string_equal(found, "first, and longer");
    close(before);
}

static void several_are_put_at_once(void **state) {
    struct blobs_fixture *f = *state;
    char text[512];
    PUT(f, "jobs/1/outputs", "mesh.ply", "m", "cloud.ply", "c", "report.json", "{}");
    assert_true(blobs_fixture_has(f, "jobs/1/outputs/mesh.ply", "m"));
    assert_true(blobs_exist(f->blobs, "jobs/1/outputs"));
    assert_true(blobs_exist(f->blobs, "jobs/1"));
    assert_false(blobs_exist(f->blobs, "jobs/2"));
    assert_string_equal(blobs_fixture_list(f, "jobs/1/outputs", text), "cloud.ply,mesh.ply,report.json,");
}

static void names_are_listed_once_and_in_order(void **state) {
    struct blobs_fixture *f = *state;
    char text[512];
    assert_string_equal(blobs_fixture_list(f, "clouds", text), "");
    assert_string_equal(blobs_fixture_list(f, "nowhere", text), "");
    PUT(f, "jobs/2/outputs", "b", "2", "a", "2");
    PUT(f, "jobs/1/outputs", "a", "1");
    PUT(f, "jobs/1/outputs.2", "a", "1");
    PUT(f, "jobs/10/outputs", "a", "1");
    assert_string_equal(blobs_fixture_list(f, "jobs", text), "1,10,2,");
    assert_string_equal(blobs_fixture_list(f, "jobs/1", text), "outputs,outputs.2,");
    assert_string_equal(blobs_fixture_list(f, "jobs/1/outputs", text), "a,");
}

static void what_is_removed_is_gone_and_nothing_else(void **state) {
    struct blobs_fixture *f = *state;
    PUT(f, "jobs/1/outputs", "a", "1", "b", "2");
    PUT(f, "jobs/1/outputs.2", "a", "1");
    PUT(f, "jobs/10/outputs", "a", "1");
    int open_still = blobs_read(f->blobs, "jobs/1/outputs/b", NULL);
    blobs_remove(f->blobs, "jobs/1/outputs/a", NULL);
    assert_false(blobs_fixture_has(f, "jobs/1/outputs/a", ""));
    assert_true(blobs_fixture_has(f, "jobs/1/outputs/b", "2"));
    blobs_remove(f->blobs, "jobs/1/outputs", NULL);
    assert_false(blobs_exist(f->blobs, "jobs/1/outputs"));
    assert_true(blobs_fixture_has(f, "jobs/1/outputs.2/a", "1"));
    blobs_remove(f->blobs, "jobs/1", NULL);
    assert_false(blobs_exist(f->blobs, "jobs/1"));
    assert_true(blobs_fixture_has(f, "jobs/10/outputs/a", "1"));
    blobs_remove(f->blobs, "jobs/1", NULL);
    blobs_remove(f->blobs, "clouds/never", NULL);
    char found[4] = "";
    assert_int_equal(pread(open_still, found, 3, 0), 1);
    assert_string_equal(found, "2");
    close(open_still);
}

/* A process that stood still for longer than what it has begun may be late: a store to which it can be does nothing of
 * it. */
static void a_removal_that_was_begun_long_ago_removes_nothing_from_a_remote_store(void **state) {
    struct blobs_fixture *f = *state;
    enum { SLACK_S = 4 };
    struct blobs_removal late = {.begun_ms = clock_ms() - 1000 * (BLOBS_REMOVAL_S + SLACK_S)};
    struct blobs_removal at_once = {.begun_ms = clock_ms()};
    PUT(f, "clouds", "a", "first");
    bool is_gone = blobs_remove(f->blobs, "clouds/a", &late);
    assert_int_equal(is_gone && late.is_settled, !blobs_is_remote(f->blobs));
    assert_int_equal(blobs_fixture_has(f, "clouds/a", "first"), blobs_is_remote(f->blobs));
    assert_true(blobs_remove(f->blobs, "clouds/a", &at_once) && at_once.is_settled);
    assert_false(blobs_fixture_has(f, "clouds/a", ""));
}

static void a_copy_outlives_what_it_is_of(void **state) {
    struct blobs_fixture *f = *state;
    char text[512];
    PUT(f, "jobs/1/outputs", "a", "one", "b", "two");
    assert_int_equal(blobs_copy(f->blobs, "jobs/1/outputs", "jobs/2/outputs", &f->error), STATUS_OK);
    blobs_remove(f->blobs, "jobs/1", NULL);
    assert_string_equal(blobs_fixture_list(f, "jobs/2/outputs", text), "a,b,");
    assert_true(blobs_fixture_has(f, "jobs/2/outputs/b", "two"));
    assert_int_not_equal(blobs_copy(f->blobs, "jobs/1/outputs", "jobs/3/outputs", &f->error), STATUS_OK);
}

static void names_that_lead_elsewhere_are_nobodys(void **state) {
    struct blobs_fixture *f = *state;
    static const char *const names[] = {
        "", "/", "clouds/", "/etc/passwd", "../scratch/a", "clouds/../a", "clouds//a", "clouds/.", "clouds/.a", "."};
    PUT(f, "clouds", "a", "x");
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        assert_int_equal(blobs_read(f->blobs, names[i], NULL), -1);
        assert_false(blobs_exist(f->blobs, names[i]));
        blobs_remove(f->blobs, names[i], NULL);
        const char *const put[] = {"a", "y", NULL};
        if (!strchr("c", names[i][0]) || names[i][0] == 0)
            assert_int_equal(blobs_fixture_put(f, names[i], put), STATUS_BAD_PARAMETER);
    }
    assert_true(blobs_fixture_has(f, "clouds/a", "x"));
}

/* What a backend that renames has checked is its caller's word; one that copies looks. */
static void a_content_that_is_not_its_hash_is_refused_where_it_is_copied(void **state) {
    struct blobs_fixture *f = *state;
    char wrong[DIGEST_HEX_BYTES];
    PUT(f, "clouds", "probe", "x");
    bool renames = faccessat(f->scratch_fd, "probe", F_OK, 0) != 0;
    if (renames) return;
    assert_true(digest_text("another", wrong));
    int fd = openat(f->scratch_fd, "a", O_WRONLY | O_CREAT, 0600);
    assert_int_equal(write(fd, "text", 4), 4);
    close(fd);
    struct blobs_source source = {"a", f->scratch_fd, "a", wrong};
    assert_int_equal(blobs_put(f->blobs, "clouds", &source, 1, &f->error), STATUS_MALFORMED);
    assert_false(blobs_exist(f->blobs, "clouds/a"));
}

static void a_large_blob_is_read_at_any_place(void **state) {
    struct blobs_fixture *f = *state;
    enum { BYTES = 3 << 20 };
    char *bytes = malloc(BYTES + 1), found[16] = "", hex[DIGEST_HEX_BYTES];
    for (int i = 0; i < BYTES; i++) bytes[i] = (char)('a' + i % 23);
    bytes[BYTES] = 0;
    assert_true(digest_text(bytes, hex));
    int fd = openat(f->scratch_fd, "large", O_WRONLY | O_CREAT, 0600);
    assert_int_equal(write(fd, bytes, BYTES), BYTES);
    close(fd);
    struct blobs_source source = {"large", f->scratch_fd, "large", hex};
    assert_int_equal(blobs_put(f->blobs, "clouds", &source, 1, &f->error), STATUS_OK);
    fd = blobs_read(f->blobs, "clouds/large", NULL);
    assert_int_equal(lseek(fd, 0, SEEK_END), BYTES);
    assert_int_equal(pread(fd, found, 10, 2000001), 10);
    assert_memory_equal(found, bytes + 2000001, 10);
    close(fd);
    free(bytes);
}

/* Each puts and reads blobs of its own, and one that is everybody's. */
static void *put_and_read(void *ctx) {
    struct blobs_fixture *f = ctx;
    static _Atomic int next;
    int number = next++;
    for (int i = 0; i < 20; i++) {
        char name[32], folder[64], path[128], hash[DIGEST_HEX_BYTES];
        snprintf(name, sizeof name, "n%d-%d", number, i);
        snprintf(folder, sizeof folder, "jobs/%d/outputs", i);
        snprintf(path, sizeof path, "%s/%s", folder, name);
        int fd = openat(f->scratch_fd, name, O_WRONLY | O_CREAT, 0600);
        ssize_t n = write(fd, name, strlen(name));
        close(fd);
        struct error error = {0};
        digest_text(name, hash);
        struct blobs_source source = {name, f->scratch_fd, name, hash};
        if (n < 0 || blobs_put(f->blobs, folder, &source, 1, &error) != STATUS_OK || !blobs_exist(f->blobs, path))
            return ctx;
    }
    return NULL;
}

static void many_threads_put_side_by_side(void **state) {
    struct blobs_fixture *f = *state;
    enum { THREADS = 4 };
    pthread_t threads[THREADS];
    void *failed;
    char text[512];
    for (int i = 0; i < THREADS; i++) assert_int_equal(pthread_create(&threads[i], NULL, put_and_read, f), 0);
    for (int i = 0; i < THREADS; i++) {
        pthread_join(threads[i], &failed);
        assert_null(failed);
    }
    blobs_fixture_list(f, "jobs/7/outputs", text);
    int names = 0;
    for (const char *c = text; *c; c++) names += *c == ',';
    assert_int_equal(names, THREADS);
}

static void urls_are_told_from_other_text(void **state) {
    char url[BLOBS_URL_BYTES];
    (void)state;
    assert_true(blobs_url_valid("file:/var/lib/whittled"));
    assert_false(blobs_url_valid("file:"));
    assert_false(blobs_url_valid("/var/lib/whittled"));
    assert_false(blobs_url_valid("ftp://host/"));
    assert_true(blobs_url_valid("s3://bucket/prefix?endpoint=http://127.0.0.1:80"));
    assert_true(blobs_url_valid("s3://bucket?region=eu&endpoint=https%3A%2F%2Fhost&keys=/etc/keys"));
    assert_false(blobs_url_valid("s3://bucket/prefix"));
    assert_false(blobs_url_valid("s3://?endpoint=http://host"));
    assert_false(blobs_url_valid("s3://bucket?endpoint=host:80"));
    assert_false(blobs_url_valid("s3://bucket?endpoint=http://host&colour=red"));
    blobs_url("", "/data", url);
    assert_string_equal(url, "file:/data");
    blobs_url("file:/else", "/data", url);
    assert_string_equal(url, "file:/else");
}

int main(void) {
    struct CMUnitTest tests[] = {
        BLOBS_TEST(what_was_put_is_there),
        BLOBS_TEST(an_empty_blob_is_one),
        BLOBS_TEST(a_name_that_is_there_is_replaced),
        BLOBS_TEST(several_are_put_at_once),
        BLOBS_TEST(names_are_listed_once_and_in_order),
        BLOBS_TEST(what_is_removed_is_gone_and_nothing_else),
        BLOBS_TEST(a_removal_that_was_begun_long_ago_removes_nothing_from_a_remote_store),
        BLOBS_TEST(a_copy_outlives_what_it_is_of),
        BLOBS_TEST(names_that_lead_elsewhere_are_nobodys),
        BLOBS_TEST(a_content_that_is_not_its_hash_is_refused_where_it_is_copied),
        BLOBS_TEST(a_large_blob_is_read_at_any_place),
        BLOBS_TEST(many_threads_put_side_by_side),
        cmocka_unit_test(urls_are_told_from_other_text),
    };
    return blobs_fixture_run(tests, sizeof tests / sizeof *tests);
}
