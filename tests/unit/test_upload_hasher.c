/* Hashing behind the writer: the hash is that of the file, whoever did which part of it, and leaving early leaks
 * nothing and waits for nobody.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/upload_hasher.h"

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

enum { PIECE_BYTES = 64 * 1024, STEP_BYTES = 2 * 1024 * 1024, DISK_BLOCK_BYTES = 512 };

struct fixture {
    int fd;
    struct thread_pool *threads;
};

static int set_up(void **state) {
    static struct fixture f;
    char name[] = "/tmp/test_behind.XXXXXX";
    f.fd = mkstemp(name);
    unlink(name);
    *state = &f;
    return f.fd >= 0 && thread_pool_open(2, &f.threads) == STATUS_OK ? 0 : -1;
}

static int tear_down(void **state) {
    struct fixture *f = *state;
    thread_pool_close(f->threads);
    close(f->fd);
    return 0;
}

/* Writes that many bytes, in pieces, as a body comes in. */
static void write_bytes(struct fixture *f, struct upload_hasher *hasher, size_t bytes) {
    static char piece[PIECE_BYTES];
    for (size_t done = 0; done < bytes;) {
        size_t count = bytes - done < PIECE_BYTES ? bytes - done : PIECE_BYTES;
        memset(piece, (int)(done / PIECE_BYTES), count);
        assert_int_equal(write(f->fd, piece, count), count);
        upload_hasher_advance(hasher, count);
        done += count;
    }
}

static void assert_hash(struct fixture *f, struct upload_hasher *hasher, size_t bytes) {
    char found[DIGEST_HEX_BYTES], wanted[DIGEST_HEX_BYTES];
    uint64_t length = 0;
    assert_int_equal(upload_hasher_finish(hasher, found), 0);
    assert_int_equal(digest_file(f->fd, wanted, &length), 0);
    assert_int_equal(length, bytes);
    assert_string_equal(found, wanted);
    upload_hasher_free(hasher);
}

static void test_hash_is_the_files(void **state) {
    struct fixture *f = *state;
    const size_t lengths[] = {0, 1, STEP_BYTES - 1, STEP_BYTES, STEP_BYTES + 1, 40 * STEP_BYTES + 12345};
    enum { ALONE, LENGTH_KNOWN, LENGTH_UNKNOWN, WAYS };
    for (size_t i = 0; i < WAYS * (sizeof lengths / sizeof *lengths); i++) {
        size_t bytes = lengths[i / WAYS], way = i % WAYS;
        struct upload_hasher *hasher =
            upload_hasher_new(way == ALONE ? NULL : f->threads, f->fd, way == LENGTH_KNOWN ? bytes : UINT64_MAX);
        assert_non_null(hasher);
        assert_int_equal(ftruncate(f->fd, 0) | lseek(f->fd, 0, SEEK_SET), 0);
        write_bytes(f, hasher, bytes);
        assert_hash(f, hasher, bytes);
    }
}

/* Room is made ahead of the writer, never beyond what is expected. */
static void test_nothing_is_reserved_beyond_the_end(void **state) {
    struct fixture *f = *state;
    size_t bytes = 9 * STEP_BYTES;
    struct stat facts;
    struct upload_hasher *hasher = upload_hasher_new(f->threads, f->fd, bytes);
    write_bytes(f, hasher, bytes);
    assert_hash(f, hasher, bytes);
    assert_int_equal(fstat(f->fd, &facts), 0);
    assert_int_equal(facts.st_size, bytes);
    assert_in_range((size_t)facts.st_blocks * DISK_BLOCK_BYTES, bytes, bytes + STEP_BYTES / 2);
}

static void test_unreadable_file(void **state) {
    struct fixture *f = *state;
    for (int threads = 0; threads < 2; threads++) {
        char hex[DIGEST_HEX_BYTES];
        struct upload_hasher *hasher = upload_hasher_new(threads ? f->threads : NULL, f->fd, UINT64_MAX);
        upload_hasher_advance(hasher, 3 * STEP_BYTES); /* which were never written */
        assert_int_equal(upload_hasher_finish(hasher, hex), -1);
        assert_int_equal(errno, EIO);
        upload_hasher_free(hasher);
    }
    assert_null(upload_hasher_new(f->threads, -1, UINT64_MAX));
}

/* Both threads are kept busy, so some are left while their step still waits. */
static void test_left_at_any_time(void **state) {
    struct fixture *f = *state;
    for (int i = 0; i < 20; i++) {
        struct upload_hasher *hasher = upload_hasher_new(f->threads, f->fd, UINT64_MAX);
        assert_int_equal(ftruncate(f->fd, 0) | lseek(f->fd, 0, SEEK_SET), 0);
        write_bytes(f, hasher, STEP_BYTES + 4 * PIECE_BYTES);
        upload_hasher_free(hasher);
    }
    upload_hasher_free(NULL);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_hash_is_the_files, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_nothing_is_reserved_beyond_the_end, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_unreadable_file, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_left_at_any_time, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
