/* PLY: every type in every encoding to the bit, lists, order of points, header checks, limits, failing allocations.
 * Single good and bad files are folders under tests/fixtures.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/formats/ply_header.h"
#include "core/io/out/write.h"
#include "core/io/padding.h"
#include "core/io/read.h"
#include "core/io/reader.h"
#include "core/io/sniff.h"

enum { BYTES = 1 << 16, POINTS = 40, LARGE = 50000 };

static const char four[] =
    "ply\nformat ascii 1.0\ncomment four\nelement vertex 4\nproperty uchar tag\nproperty float y\n"
    "property double x\nproperty int z\nproperty list uchar ushort near\nelement face 2\n"
    "property list uchar int vertex_indices\nend_header\n"
    "1 0.5 0.1 10 2 7 8\n2 1.5 0.2 20 0\n3 2.5 0.3 30 1 9\n4 3.5 0.4 40 3 1 2 3\n3 0 1 2\n4 0 1 2 3\n";

static struct cloud read_text(const char *text) {
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(text, strlen(text), NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

/* Writes and reads again. */
static struct cloud rewrite(const struct cloud *cloud, const uint32_t *ids, size_t n, enum encoding encoding) {
    FILE *file = tmpfile();
    assert_non_null(file);
    struct cloud again = {0};
    struct error error = {0};
    assert_int_equal(cloud_write_ply(fileno(file), cloud, ids, n, encoding, &error), STATUS_OK);
    rewind(file);
    if (cloud_read(fileno(file), NULL, NULL, &again, &error)) fail_msg("%s", error.text);
    fclose(file);
    return again;
}

/* ------------------------------------------------------------------------------------------------ bits */

static uint64_t next_random(uint64_t *state) {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    return *state ^= *state << 17;
}

/* Any bit pattern of a type, but for NaN with a payload, which text can't carry. */
static void random_scalar(unsigned char *to, enum scalar_type type, uint64_t *state) {
    uint64_t bits = next_random(state);
    memcpy(to, &bits, scalar_bytes(type));
    if (isnan(scalar_load(to, type))) scalar_store(to, type, -HUGE_VAL);
}

/* A cloud with a property of every type, random bits in it, and x, y, z of the type given. */
static struct cloud random_cloud(enum scalar_type xyz_type, uint64_t state) {
    struct cloud cloud = {.count = POINTS, .property_count = SCALAR_TYPE_COUNT + 3, .xyz = {8, 9, 10}};
    cloud.property = alloc_zeroed(cloud.property_count, sizeof *cloud.property);
    for (size_t j = 0; j < cloud.property_count; j++) {
        struct property *p = &cloud.property[j];
        p->type = j < SCALAR_TYPE_COUNT ? (enum scalar_type)j : xyz_type;
        snprintf(p->name, sizeof p->name, "p%zu", j);
        if (j >= SCALAR_TYPE_COUNT) snprintf(p->name, sizeof p->name, "%.1s", &"xyz"[j - SCALAR_TYPE_COUNT]);
        p->offset_bytes = cloud.record_bytes;
        cloud.record_bytes += scalar_bytes(p->type);
    }
    cloud.record = alloc_array(POINTS, cloud.record_bytes);
    cloud.position = alloc_array(POINTS, sizeof *cloud.position);
    for (size_t i = 0; i < POINTS; i++) {
        double xyz[3];
        for (size_t j = 0; j < cloud.property_count; j++) {
            unsigned char *at = cloud.record + i * cloud.record_bytes + cloud.property[j].offset_bytes;
            random_scalar(at, cloud.property[j].type, &state);
            if (j < SCALAR_TYPE_COUNT) continue;
            while (!isfinite(xyz[j - 8] = scalar_load(at, xyz_type))) random_scalar(at, xyz_type, &state);
        }
        cloud.position[i] = (vec3){xyz[0], xyz[1], xyz[2]};
    }
    return cloud;
}

static void every_type_survives_both_encodings_to_the_bit(void **state) {
    (void)state;
    for (int type = 0; type < SCALAR_TYPE_COUNT; type++)
        for (int encoding = ENCODING_BINARY; encoding <= ENCODING_ASCII; encoding++) {
            struct cloud cloud = random_cloud((enum scalar_type)type, 12345u + (unsigned)type);
            struct cloud again = rewrite(&cloud, NULL, POINTS, (enum encoding)encoding);
            assert_int_equal(again.record_bytes, cloud.record_bytes);
            assert_memory_equal(again.record, cloud.record, POINTS * cloud.record_bytes);
            assert_memory_equal(again.position, cloud.position, POINTS * sizeof *cloud.position);
            cloud_done(&cloud);
            cloud_done(&again);
        }
}

/* A big-endian file made from a little-endian one by turning every scalar round. */
static void big_endian_reads_as_little_endian_does(void **state) {
    (void)state;
    struct cloud cloud = random_cloud(SCALAR_FLOAT32, 99), again = {0};
    static unsigned char file[BYTES];
    size_t used =
        (size_t)snprintf((char *)file, BYTES, "ply\nformat binary_big_endian 1.0\nelement vertex %d\n", POINTS);
    for (size_t j = 0; j < cloud.property_count; j++)
        used += (size_t)snprintf((char *)file + used, BYTES - used, "property %s %s\n",
                                 cloud_write_type_name(cloud.property[j].type), cloud.property[j].name);
    used += (size_t)snprintf((char *)file + used, BYTES - used, "end_header\n");
    for (size_t i = 0; i < POINTS; i++)
        for (size_t j = 0; j < cloud.property_count; j++) {
            size_t bytes = scalar_bytes(cloud.property[j].type);
            const unsigned char *at = cloud.record + i * cloud.record_bytes + cloud.property[j].offset_bytes;
            for (size_t k = 0; k < bytes; k++) file[used++] = at[bytes - 1 - k];
        }
    struct error error = {0};
    if (cloud_read_memory(file, used, NULL, NULL, &again, &error)) fail_msg("%s", error.text);
    assert_string_equal(again.form, "ply/binary_big_endian");
    assert_memory_equal(again.record, cloud.record, POINTS * cloud.record_bytes);
    assert_memory_equal(again.position, cloud.position, POINTS * sizeof *cloud.position);
    cloud_done(&cloud);
    cloud_done(&again);
}

static void points_come_out_in_the_order_of_the_ids_with_their_lists(void **state) {
    (void)state;
    static const uint32_t ids[] = {3, 0, 3, 2};
    for (int encoding = ENCODING_BINARY; encoding <= ENCODING_ASCII; encoding++) {
        struct cloud cloud = read_text(four), again = rewrite(&cloud, ids, 4, (enum encoding)encoding);
        const struct property *p = &cloud.property[4], *q = &again.property[4];
        assert_string_equal(again.comments, "comment four\n");
        assert_int_equal(again.triangle_count, 0);
        for (size_t i = 0; i < 4; i++) {
            assert_memory_equal(again.record + i * again.record_bytes, cloud.record + ids[i] * cloud.record_bytes,
                                cloud.record_bytes);
            size_t bytes = p->list_offset[ids[i] + 1] - p->list_offset[ids[i]];
            assert_int_equal(q->list_offset[i + 1] - q->list_offset[i], bytes);
            assert_memory_equal(q->list_data + q->list_offset[i], p->list_data + p->list_offset[ids[i]], bytes);
        }
        cloud_done(&cloud);
        cloud_done(&again);
    }
}

static void property_order_and_types_are_kept(void **state) {
    (void)state;
    struct cloud cloud = read_text(four);
    assert_int_equal(cloud.count, 4);
    assert_int_equal(cloud.record_bytes, 1 + 4 + 8 + 4);
    assert_int_equal(cloud.xyz[0], 2);
    assert_int_equal(cloud.xyz[1], 1);
    assert_int_equal(cloud.xyz[2], 3);
    assert_true(vec3_equal(cloud.position[2], (vec3){0.3, 2.5, 30}));
    assert_int_equal(cloud.triangle_count, 3);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ larger files */

/* More vertices than a block and a write buffer hold. */
static void blocks_and_buffers_join_without_a_seam(void **state) {
    (void)state;
    for (int encoding = ENCODING_BINARY; encoding <= ENCODING_ASCII; encoding++) {
        struct cloud cloud = read_text("ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\n"
                                       "property double z\nend_header\n0 0 0\n");
        cloud.record = alloc_resize(cloud.record, LARGE, cloud.record_bytes);
        cloud.position = alloc_resize(cloud.position, LARGE, sizeof *cloud.position);
        cloud.count = LARGE;
        for (size_t i = 0; i < LARGE; i++) {
            cloud.position[i] = (vec3){(double)i / 3, -(double)i, 1e-7 * (double)i};
            memcpy(cloud.record + i * sizeof(vec3), &cloud.position[i], sizeof(vec3));
        }
        struct cloud again = rewrite(&cloud, NULL, LARGE, (enum encoding)encoding);
        assert_int_equal(again.count, LARGE);
        assert_memory_equal(again.position, cloud.position, LARGE * sizeof *cloud.position);
        cloud_done(&cloud);
        cloud_done(&again);
    }
}

static void a_point_without_a_position_in_a_later_block_is_dropped(void **state) {
    (void)state;
    static const char header[] = "ply\nformat binary_little_endian 1.0\nelement vertex 50000\nproperty uchar a\n"
                                 "property float x\nproperty float y\nproperty float z\nend_header\n";
    size_t head = sizeof header - 1, size = head + (size_t)LARGE * 13, at = head + (size_t)40001 * 13 + 5;
    unsigned char *file = alloc_zeroed(size, 1);
    memcpy(file, header, head);
    float bad = (float)NAN, next = 7;
    memcpy(file + at, &bad, sizeof bad);
    memcpy(file + at + 13, &next, sizeof next);
    struct cloud cloud;
    struct error error = {0};
    assert_int_equal(cloud_read_memory(file, size, NULL, NULL, &cloud, &error), STATUS_OK);
    assert_int_equal(cloud.count, LARGE - 1);
    assert_true(cloud.position[40000].y == 0 && cloud.position[40001].y == 7);
    assert_string_equal(cloud.left_out, "1 point without a position (a coordinate is nan or infinite)\n");
    cloud_done(&cloud);
    free(file);
}

/* ------------------------------------------------------------------------------------------------ header check */

static void header_check_asks_for_more_until_the_header_ends(void **state) {
    (void)state;
    const char *end = strstr(four, "end_header\n") + 11;
    struct ply_summary summary;
    struct error error = {0};
    for (size_t n = 4; n < sizeof four - 1; n++) {
        assert_int_equal(ply_header_check(four, n, sizeof four - 1, &summary, &error), STATUS_OK);
        assert_int_equal(summary.complete, four + n >= end);
    }
    assert_int_equal(summary.vertex_count, 4);
    assert_int_equal(summary.face_count, 2);
    assert_int_equal(summary.property_count, 5);
    assert_int_equal(summary.record_bytes, 17);
    assert_int_equal(summary.header_bytes, end - four);
    assert_false(summary.bytes_exact);
    assert_int_equal(summary.bytes_expected, end - four + 4 * 10 + 2 * 2 - 1);
    assert_int_equal(ply_header_check(four, 20, 20, &summary, &error), STATUS_MALFORMED);
}

static void header_check_compares_with_the_length(void **state) {
    (void)state;
    static const char header[] = "ply\nformat binary_little_endian 1.0\nelement vertex 100\nproperty float x\n"
                                 "property float y\nproperty float z\nend_header\n";
    const size_t n = sizeof header - 1;
    struct ply_summary summary;
    struct error error = {0};
    assert_int_equal(ply_header_check(header, n, n + 1200, &summary, &error), STATUS_OK);
    assert_true(summary.complete && summary.bytes_exact && summary.bytes_expected == n + 1200);
    assert_int_equal(ply_header_check(header, n, UINT64_MAX, &summary, &error), STATUS_OK);
    assert_int_equal(ply_header_check(header, n, n + 1199, &summary, &error), STATUS_MALFORMED);
    assert_int_equal(ply_header_check(header, n, n + 1201 + PADDING_MOST_BYTES, &summary, &error), STATUS_OK);
    assert_int_equal(summary.bytes_expected, n + 1200);
}

static void sniffing_tells_kinds_apart(void **state) {
    (void)state;
    assert_int_equal(cloud_sniff("", 0).kind, CLOUD_KIND_EMPTY);
    assert_int_equal(cloud_sniff("ply\n", 4).kind, CLOUD_KIND_PLY);
    assert_int_equal(cloud_sniff("ply\r\n", 5).kind, CLOUD_KIND_PLY);
    assert_int_equal(cloud_sniff("plywood", 7).kind, CLOUD_KIND_TEXT);
    assert_int_equal(cloud_sniff("1 2 3\n", 6).kind, CLOUD_KIND_TEXT);
    assert_int_equal(cloud_sniff("1 2\0 3", 6).kind, CLOUD_KIND_OTHER);
    assert_int_equal(cloud_sniff("\x1f\x8b\x08", 3).kind, CLOUD_KIND_GZIP);
    assert_non_null(strstr(cloud_sniff("\x28\xb5\x2f\xfd", 4).looks_like, "zstd"));
    assert_int_equal(cloud_sniff("COFF 1 0 0\n", 11).kind, CLOUD_KIND_OFF);
    assert_int_equal(cloud_sniff("# one\n\nv 1 2 3\n", 15).kind, CLOUD_KIND_OBJ);
    assert_int_equal(cloud_sniff("g x y z\n1 2 3\n", 14).kind, CLOUD_KIND_OBJ);
    assert_int_equal(cloud_sniff("v x y\n1 2 3\n", 12).kind, CLOUD_KIND_TEXT);
    assert_int_equal(cloud_sniff("solid x\nfacet normal", 20).kind, CLOUD_KIND_STL);
    assert_int_equal(cloud_sniff("VERSION 0.7\n", 12).kind, CLOUD_KIND_PCD);
    assert_string_equal(cloud_sniff("# .PCD v0.7\nDATA binary\n", 24).form, "pcd/binary");
    assert_int_equal(cloud_sniff("LASF", 4).kind, CLOUD_KIND_LAS);
}

/* ------------------------------------------------------------------------------------------------ limits, cancel */

static void limits_hold_before_anything_is_read(void **state) {
    (void)state;
    struct cloud cloud;
    struct error error = {0};
    const size_t n = sizeof four - 1;
    assert_int_equal(cloud_read_memory(four, n, &(struct cloud_limits){.max_points = 3}, NULL, &cloud, &error),
                     STATUS_LIMIT);
    assert_int_equal(cloud_read_memory(four, n, &(struct cloud_limits){.max_properties = 4}, NULL, &cloud, &error),
                     STATUS_LIMIT);
    assert_int_equal(
        cloud_read_memory(four, n, &(struct cloud_limits){.max_points = 4, .max_properties = 5}, NULL, &cloud, &error),
        STATUS_OK);
    cloud_done(&cloud);
}

static int stop(void *ctx, const char *stage, double fraction) {
    assert_string_equal(stage, "read");
    assert_true(fraction >= 0 && fraction <= 1);
    return ++*(int *)ctx >= 1;
}

static void cancel_stops_reading(void **state) {
    (void)state;
    int ticks = 0;
    struct progress progress = {stop, &ticks};
    struct cloud cloud;
    struct error error = {0};
    assert_int_equal(cloud_read_memory(four, sizeof four - 1, NULL, &progress, &cloud, &error), STATUS_CANCELLED);
    assert_int_equal(ticks, 1);
}

/* ------------------------------------------------------------------------------------------------ faults */

static bool countdown(void *ctx) { return (*(int *)ctx)-- == 0; }

static void every_failing_allocation_is_survived(void **state) {
    (void)state;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY; n++) {
        struct cloud cloud = {0};
        struct error error = {0};
        int left = n;
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = cloud_read_memory(four, sizeof four - 1, NULL, NULL, &cloud, &error);
        alloc_fail = NULL;
        assert_int_equal(status, error.code);
        if (status) assert_null(cloud.position);
        cloud_done(&cloud);
        assert_true(n < 100);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 8);
}

static void every_failing_allocation_with_padding_is_survived(void **state) {
    (void)state;
    char padded[sizeof four + 1];
    snprintf(padded, sizeof padded, "%s\x1a", four);
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY && n < 100; n++) {
        struct cloud cloud = {0};
        int left = n;
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = cloud_read_memory(padded, sizeof padded - 1, NULL, NULL, &cloud, NULL);
        alloc_fail = NULL;
        assert_true(status ? !cloud.left_out : cloud.left_out != NULL);
        cloud_done(&cloud);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 8);
}

static void every_failing_allocation_of_a_pipe_is_survived(void **state) {
    (void)state;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY && n < 100; n++) {
        struct cloud cloud = {0};
        int left = n, ends[2];
        assert_int_equal(pipe(ends), 0);
        assert_int_equal(write(ends[1], four, sizeof four - 1), sizeof four - 1);
        close(ends[1]);
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = cloud_read(ends[0], NULL, NULL, &cloud, NULL);
        alloc_fail = NULL;
        close(ends[0]);
        cloud_done(&cloud);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 9);
}

static void writing_without_memory_or_room_is_told(void **state) {
    (void)state;
    struct cloud cloud = read_text(four);
    struct error error = {0};
    int left = 0;
    alloc_fail = countdown;
    alloc_fail_ctx = &left;
    assert_int_equal(cloud_write_ply(1, &cloud, NULL, 4, ENCODING_BINARY, &error), STATUS_NO_MEMORY);
    alloc_fail = NULL;
    int full = open("/dev/full", O_WRONLY);
    assert_true(full >= 0);
    assert_int_equal(cloud_write_ply(full, &cloud, NULL, 4, ENCODING_ASCII, &error), STATUS_NO_SPACE);
    assert_non_null(strstr(error.text, "No space left"));
    close(full);
    cloud_done(&cloud);
}

static void missing_file_and_folder_are_io(void **state) {
    (void)state;
    struct cloud cloud;
    struct error error = {0};
    assert_int_equal(cloud_read_path("tests/no such file", NULL, NULL, &cloud, &error), STATUS_IO);
    assert_int_equal(cloud_read_path("tests", NULL, NULL, &cloud, &error), STATUS_IO);
    assert_int_equal(cloud_read(-1, NULL, NULL, &cloud, &error), STATUS_IO);
}

/* A pipe that never ends, from a header that says how much there is: reading stops by itself. */
static void endless_pipe_is_left_when_the_promise_is_over(void **state) {
    (void)state;
    static const char header[] = "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\n"
                                 "property float y\nproperty float z\nend_header\n";
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    static char zeros[BYTES + PADDING_MOST_BYTES + 13];
    memcpy(zeros, header, sizeof header - 1);
    fcntl(ends[1], F_SETPIPE_SZ, 4 * BYTES);
    assert_int_equal(write(ends[1], zeros, sizeof zeros), sizeof zeros);
    struct cloud cloud;
    struct error error = {0};
    assert_int_equal(cloud_read(ends[0], NULL, NULL, &cloud, &error), STATUS_OK); /* though ends[1] is open */
    assert_int_equal(cloud.count, 1);
    assert_string_equal(cloud.left_out, "bytes behind all that the header counts: more than 65536\n");
    cloud_done(&cloud);
    close(ends[0]);
    close(ends[1]);
}

static void reading_starts_where_the_file_stands(void **state) {
    (void)state;
    FILE *file = tmpfile();
    assert_non_null(file);
    fprintf(file, "skipped%s", four);
    fflush(file);
    assert_int_equal(lseek(fileno(file), 7, SEEK_SET), 7);
    struct cloud cloud;
    struct error error = {0};
    assert_int_equal(cloud_read(fileno(file), NULL, NULL, &cloud, &error), STATUS_OK);
    assert_int_equal(cloud.count, 4);
    cloud_done(&cloud);
    fclose(file);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_type_survives_both_encodings_to_the_bit),
        cmocka_unit_test(big_endian_reads_as_little_endian_does),
        cmocka_unit_test(points_come_out_in_the_order_of_the_ids_with_their_lists),
        cmocka_unit_test(property_order_and_types_are_kept),
        cmocka_unit_test(blocks_and_buffers_join_without_a_seam),
        cmocka_unit_test(a_point_without_a_position_in_a_later_block_is_dropped),
        cmocka_unit_test(header_check_asks_for_more_until_the_header_ends),
        cmocka_unit_test(header_check_compares_with_the_length),
        cmocka_unit_test(sniffing_tells_kinds_apart),
        cmocka_unit_test(limits_hold_before_anything_is_read),
        cmocka_unit_test(cancel_stops_reading),
        cmocka_unit_test(every_failing_allocation_is_survived),
        cmocka_unit_test(every_failing_allocation_with_padding_is_survived),
        cmocka_unit_test(every_failing_allocation_of_a_pipe_is_survived),
        cmocka_unit_test(writing_without_memory_or_room_is_told),
        cmocka_unit_test(missing_file_and_folder_are_io),
        cmocka_unit_test(endless_pipe_is_left_when_the_promise_is_over),
        cmocka_unit_test(reading_starts_where_the_file_stands),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
