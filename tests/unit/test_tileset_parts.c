/* A tileset of points in a file, made part by part, is the one that memory makes of the same points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <fcntl.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/out/kept_file.h"
#include "core/tileset/tileset.h"
#include "tests/unit/folder.h"
#include "tests/unit/shapes.h"

enum { POINTS = 200000, PROPERTIES = 6, PATH_BYTES = 300 };

struct record {
    double x, y, z;
    uint16_t colour[3];
} __attribute__((packed));

static char base[PATH_BYTES - 64];
static struct cloud cloud;
static uint32_t *rank; /* of each rank: the point */

/* Uneven, with some points far from the others, which a part of few has. */
static int make_cloud(void **state) {
    static const char *const name[PROPERTIES] = {"x", "y", "z", "red", "green", "blue"};
    uint64_t seed = 3;
    (void)state;
    folder_make_in_memory(base, sizeof base);
    cloud = (struct cloud){.count = POINTS,
                           .position = alloc_array(POINTS, sizeof *cloud.position),
                           .property_count = PROPERTIES,
                           .property = alloc_zeroed(PROPERTIES, sizeof *cloud.property),
                           .record_bytes = sizeof(struct record),
                           .record = alloc_array(POINTS, sizeof(struct record)),
                           .xyz = {0, 1, 2},
                           .form = "arrays"};
    rank = alloc_array(POINTS, sizeof *rank);
    assert_true(cloud.position && cloud.property && cloud.record && rank);
    for (size_t j = 0; j < PROPERTIES; j++) {
        struct property *property = &cloud.property[j];
        snprintf(property->name, sizeof property->name, "%s", name[j]);
        property->type = j < 3 ? SCALAR_FLOAT64 : SCALAR_UINT16;
        property->offset_bytes = j < 3 ? 8 * j : 24 + 2 * (j - 3);
    }
    for (size_t i = 0; i < POINTS; i++) {
        double x = pow(random_unit(&seed), 3), y = random_unit(&seed), far = i % 1000 ? 0 : 3 * random_unit(&seed);
        struct record record = {500000 + 100 * x, 100 * (y + far), sin(9 * x) + cos(7 * y), {0, 0, 0}};
        for (size_t k = 0; k < 3; k++) record.colour[k] = (uint16_t)(i % (k == 2 && i > POINTS / 2 ? 60000 : 200));
        memcpy(cloud.record + i * sizeof record, &record, sizeof record);
        cloud.position[i] = (vec3){record.x, record.y, record.z};
        rank[i] = (uint32_t)i;
    }
    for (size_t i = POINTS - 1; i > 0; i--) {
        size_t other = (size_t)(random_unit(&seed) * (double)(i + 1));
        uint32_t kept = rank[i];
        rank[i] = rank[other], rank[other] = kept;
    }
    return 0;
}

static int remove_cloud(void **state) {
    (void)state;
    cloud_done(&cloud);
    free(rank);
    folder_remove(base);
    return 0;
}

/* The n most important points, in the order of the input. */
static struct kept_file write_kept(size_t n) {
    struct kept_file file = {.path = alloc_array(PATH_BYTES, 1), .count = n, .record_bytes = cloud.record_bytes};
    uint32_t *of = alloc_array(POINTS, sizeof *of);
    assert_true(file.path && of);
    for (size_t i = 0; i < POINTS; i++) of[rank[i]] = (uint32_t)i;
    snprintf(file.path, PATH_BYTES, "%s/kept.0", base);
    const struct kept_head head = {.mark = KEPT_MARK, .count = n, .record_bytes = cloud.record_bytes, .of = 5};
    struct sink sink;
    int fd = open(file.path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    assert_true(fd >= 0);
    assert_int_equal(sink_init(&sink, fd), STATUS_OK);
    sink_bytes(&sink, &head, sizeof head);
    for (size_t i = 0; i < POINTS; i++)
        if (of[i] < n)
            kept_put(&sink, (uint64_t)of[i] << 31, cloud.position[i], cloud.record + i * cloud.record_bytes,
                     cloud.record_bytes);
    assert_int_equal(sink_done(&sink, STATUS_OK, NULL), STATUS_OK);
    assert_int_equal(close(fd), 0);
    assert_true(kept_file_is(&file, 5));
    assert_false(kept_file_is(&file, 6));
    free(of);
    return file;
}

static enum status write_archive(const char *name, const struct tileset_points *points, struct error *error) {
    char path[PATH_BYTES];
    snprintf(path, sizeof path, "%s/%s", base, name);
    int fd = open(path, O_RDWR | O_CREAT | O_TRUNC, 0600);
    assert_true(fd >= 0);
    enum status status = tileset_write_archive(fd, points, NULL, error);
    assert_int_equal(close(fd), 0);
    return status;
}

static unsigned char *read_archive(const char *name, size_t *bytes) {
    char path[PATH_BYTES];
    struct stat about;
    snprintf(path, sizeof path, "%s/%s", base, name);
    int fd = open(path, O_RDONLY);
    assert_true(fd >= 0 && fstat(fd, &about) == 0);
    *bytes = (size_t)about.st_size;
    unsigned char *data = alloc_array(*bytes, 1);
    assert_non_null(data);
    assert_int_equal(read(fd, data, *bytes), (ssize_t)*bytes);
    assert_int_equal(close(fd), 0);
    return data;
}

static struct tileset_points beyond(const struct cloud *like, const struct kept_file *file) {
    return (struct tileset_points){.cloud = like, .n = (size_t)file->count, .file = file, .threads = 2};
}

static void parts_are_what_memory_makes(void **state) {
    static const size_t count[] = {POINTS, 150000, 70000, 1000, 1}, most[] = {POINTS, 60000, 33000, 2000, 1500};
    (void)state;
    for (size_t c = 0; c < sizeof count / sizeof *count; c++)
        for (size_t m = 0; m < sizeof most / sizeof *most; m++) {
            struct kept_file file = write_kept(count[c]);
            struct cloud like = cloud;
            struct error error = {0};
            like.count = 0, like.record = NULL, like.position = NULL;
            file.most_points = most[m];
            const struct tileset_points inside = {
                .cloud = &cloud, .kept = rank, .n = count[c], .threads = 1, .packing = {m == 1, m == 2}};
            struct tileset_points outside = beyond(&like, &file);
            outside.packing = inside.packing;
            size_t a_bytes, b_bytes;
            assert_int_equal(write_archive("inside", &inside, &error), STATUS_OK);
            if (write_archive("outside", &outside, &error)) fail_msg("%s: %s", error.where, error.text);
            unsigned char *a = read_archive("inside", &a_bytes), *b = read_archive("outside", &b_bytes);
            assert_int_equal(a_bytes, b_bytes);
            assert_memory_equal(a, b, a_bytes);
            free(a), free(b);
            kept_file_done(&file);
        }
}

static void a_file_that_is_cut_is_told(void **state) {
    (void)state;
    struct kept_file file = write_kept(POINTS);
    struct cloud like = cloud;
    struct error error = {0};
    like.count = 0;
    file.most_points = 50000;
    assert_int_equal(truncate(file.path, 1000000), 0);
    assert_false(kept_file_is(&file, 5));
    const struct tileset_points points = beyond(&like, &file);
    assert_int_equal(write_archive("outside", &points, &error), STATUS_IO);
    assert_non_null(strstr(error.text, "too short"));
    kept_file_done(&file);
}

static bool is_last(void *ctx) {
    long *left = ctx;
    return --*left == 0;
}

static void any_allocation_may_fail(void **state) {
    (void)state;
    struct kept_file file = write_kept(40000);
    struct cloud like = cloud;
    long left = 0, refused = 0;
    like.count = 0;
    file.most_points = 33000;
    struct tileset_points points = beyond(&like, &file);
    points.threads = 1;
    for (long nth = 1; left <= 0; nth += 1 + nth / 16) {
        struct error error = {0};
        left = nth;
        alloc_fail_ctx = &left, alloc_fail = is_last;
        enum status status = write_archive("outside", &points, &error);
        alloc_fail = NULL;
        assert_true(status == STATUS_NO_MEMORY || (status == STATUS_OK && left > 0));
        if (status) assert_true(error.text[0] != 0);
        refused += status != STATUS_OK;
    }
    assert_true(refused > 20);
    kept_file_done(&file);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(parts_are_what_memory_makes),
                                       cmocka_unit_test(a_file_that_is_cut_is_told),
                                       cmocka_unit_test(any_allocation_may_fail)};
    return cmocka_run_group_tests(tests, make_cloud, remove_cloud);
}
