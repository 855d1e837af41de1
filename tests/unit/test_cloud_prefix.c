/* Prefixes of cloud files: each format, lists, blocks that end anywhere, files that are too short or not ours.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/prefix.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/io/out/write.h"
#include "core/io/read.h"
#include "core/io/reader.h"

enum { LARGE = 40000 };

static int file_of(const void *bytes, size_t n) {
    FILE *file = tmpfile();
    assert_non_null(file);
    int fd = dup(fileno(file));
    fclose(file);
    assert_int_equal(write(fd, bytes, n), n);
    lseek(fd, 0, SEEK_SET);
    return fd;
}

static char *content(int fd, size_t *bytes) {
    off_t end = lseek(fd, 0, SEEK_END);
    char *text = calloc(1, (size_t)end + 1);
    assert_int_equal(pread(fd, text, (size_t)end, 0), end);
    *bytes = (size_t)end;
    return text;
}

/* The prefix as text; NULL where there is none, and then why. */
static char *prefix(int from, uint64_t n, size_t *bytes, enum status *status, uint64_t *held) {
    struct error error = {0};
    int to = file_of("", 0);
    lseek(from, 0, SEEK_SET);
    *status = cloud_prefix_copy(from, to, n, held, &error);
    char *text = *status ? NULL : content(to, bytes);
    close(to);
    return text;
}

static void expect_text(const char *file, uint64_t n, const char *expected) {
    size_t bytes;
    enum status status;
    uint64_t held = 0;
    int from = file_of(file, strlen(file));
    char *text = prefix(from, n, &bytes, &status, &held);
    assert_int_equal(status, STATUS_OK);
    assert_string_equal(text, expected);
    free(text);
    close(from);
}

static enum status status_of(const void *file, size_t n, uint64_t points, uint64_t *held) {
    size_t bytes;
    enum status status;
    int from = file_of(file, n);
    free(prefix(from, points, &bytes, &status, held));
    close(from);
    return status;
}

#define HEAD(n)                                                                                                        \
    "ply\nformat ascii 1.0\ncomment element vertex 9\nelement vertex " n "\nproperty float x\n"                        \
    "property float y\nproperty float z\nend_header\n"

static void text_is_counted_in_lines(void **state) {
    (void)state;
    expect_text(HEAD("3") "1 2 3\n4 5 6\n7 8 9\n", 2, HEAD("2") "1 2 3\n4 5 6\n");
    expect_text("1 2 3\n4 5 6\n", 1, "1 2 3\n");
    expect_text("# x y z red\n1 2 3 9\n4 5 6 9\n", 1, "# x y z red\n1 2 3 9\n");
    expect_text("# x y z red\n1 2 3 9\n", 1, "# x y z red\n1 2 3 9\n");
}

static void more_than_there_is_is_a_limit(void **state) {
    static const char ply[] = HEAD("3") "1 2 3\n4 5 6\n7 8 9\n", xyz[] = "# x y z a\n1 2 3 4\n";
    uint64_t held = 0;
    (void)state;
    assert_int_equal(status_of(ply, sizeof ply - 1, 4, &held), STATUS_LIMIT);
    assert_int_equal(held, 3);
    assert_int_equal(status_of(xyz, sizeof xyz - 1, 2, &held), STATUS_LIMIT);
    assert_int_equal(held, 1);
}

static void files_of_others_are_refused(void **state) {
    static const char faces[] = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
                                "property float z\nelement face 0\nproperty list uchar int vertex_indices\n"
                                "end_header\n1 2 3\n";
    static const char big[] = "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\n"
                              "property float y\nproperty float z\nend_header\n............";
    static const char cut[] = HEAD("3") "1 2 3\n4 5 6";
    uint64_t held;
    (void)state;
    assert_int_equal(status_of(faces, sizeof faces - 1, 1, &held), STATUS_MALFORMED);
    assert_int_equal(status_of(big, sizeof big - 1, 1, &held), STATUS_MALFORMED);
    assert_int_equal(status_of(cut, sizeof cut - 1, 3, &held), STATUS_MALFORMED);
    assert_int_equal(status_of("ply\nformat", 10, 1, &held), STATUS_MALFORMED);
}

/* A cloud of n points; lists of 0 to 5 items where asked for. */
static struct cloud cloud_of(size_t n, bool lists) {
    struct cloud cloud = {0};
    struct error error = {0};
    char *text = NULL;
    size_t bytes;
    FILE *out = open_memstream(&text, &bytes);
    fprintf(out, "ply\nformat ascii 1.0\nelement vertex %zu\nproperty double x\nproperty uchar tag\nproperty float y\n",
            n);
    fprintf(out, "property float z\n%send_header\n", lists ? "property list ushort short near\n" : "");
    for (size_t i = 0; i < n; i++) {
        fprintf(out, "%zu.5 %zu 2 3", i, i % 256);
        for (size_t j = 0; lists && j <= i % 6; j++) fprintf(out, " %zu", j ? i % 7 + j : i % 6);
        fprintf(out, "\n");
    }
    fclose(out);
    if (cloud_read_memory(text, bytes, NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    free(text);
    return cloud;
}

static char *written(const struct cloud *cloud, size_t n, enum encoding encoding, size_t *bytes) {
    struct error error = {0};
    int fd = file_of("", 0);
    assert_int_equal(cloud_write_ply(fd, cloud, NULL, n, encoding, &error), STATUS_OK);
    char *text = content(fd, bytes);
    close(fd);
    return text;
}

static void equals_what_the_writer_writes(void **state) {
    static const size_t counts[] = {1, 2, 1000, LARGE - 1, LARGE};
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        enum encoding encoding = kind & 1 ? ENCODING_ASCII : ENCODING_BINARY;
        struct cloud cloud = cloud_of(LARGE, kind & 2);
        size_t bytes, expected_bytes, got_bytes = 0;
        char *whole = written(&cloud, LARGE, encoding, &bytes);
        int from = file_of(whole, bytes);
        for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
            enum status status;
            uint64_t held;
            char *expected = written(&cloud, counts[i], encoding, &expected_bytes);
            char *got = prefix(from, counts[i], &got_bytes, &status, &held);
            assert_int_equal(status, STATUS_OK);
            assert_int_equal(got_bytes, expected_bytes);
            assert_memory_equal(got, expected, expected_bytes);
            free(expected);
            free(got);
        }
        close(from);
        free(whole);
        cloud_done(&cloud);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(text_is_counted_in_lines),
        cmocka_unit_test(more_than_there_is_is_a_limit),
        cmocka_unit_test(files_of_others_are_refused),
        cmocka_unit_test(equals_what_the_writer_writes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
