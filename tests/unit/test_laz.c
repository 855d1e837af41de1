/* LAZ: every item and version of them, written by our own writer and read again; the pairs of LAS and LAZ that lie
 * beside the repository; what broken chunks hear.
 *
 * A round trip shows that reader and writer agree.  That they agree with others, the pairs show (formats 0 to 3), and
 * test_laz.py, which lets laz-perf read what we write.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/io/laz/items.h"
#include "core/io/read.h"
#include "tests/tools/laz_points.h"

enum { POINTS = 3000 };

/* ------------------------------------------------------------------------------------------------ round trips */

static struct laz_bytes write_chunk(const struct laz_layout *layout, const unsigned char *records, size_t n) {
    struct laz_bytes out = {0};
    struct laz_codec *codec = laz_codec_new(layout);
    assert_non_null(codec);
    laz_write_chunk(codec, records, n, &out);
    laz_codec_free(codec);
    assert_false(out.failed);
    return out;
}

/* Twice with the same codec: nothing of a chunk is left in it for the next. */
static void check_round_trip(const struct laz_layout *layout, unsigned format, size_t n) {
    unsigned char *records = laz_points_make(format, layout->record_bytes, n, 77 + format);
    struct laz_bytes chunk = write_chunk(layout, records, n);
    struct laz_codec *codec = laz_codec_new(layout);
    assert_non_null(codec);
    for (int turn = 0; turn < 2; turn++) {
        assert_null(laz_read_begin(codec, chunk.bytes, chunk.used, n));
        for (size_t i = 0; i < n; i++) {
            const unsigned char *record = laz_read_point(codec);
            assert_non_null(record);
            assert_memory_equal(record, records + i * layout->record_bytes, layout->record_bytes);
        }
        assert_null(laz_read_end(codec));
    }
    laz_codec_free(codec);
    free(chunk.bytes), free(records);
}

static void every_format_comes_back(void **state) {
    (void)state;
    static const size_t counts[] = {1, 2, 3, POINTS};
    for (unsigned format = 0; format < LAZ_POINTS_FORMATS; format++)
        for (size_t extra = 0; extra < 6; extra += 5)
            for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
                struct laz_layout layout;
                laz_layout_make(format, laz_points_bytes[format] + extra, &layout);
                check_round_trip(&layout, format, counts[i]);
            }
}

/* The items as of before 2011, and of the layered ones those as of 2019. */
static void every_version_comes_back(void **state) {
    (void)state;
    for (unsigned format = 0; format < LAZ_POINTS_FORMATS; format++) {
        struct laz_layout layout;
        laz_layout_make(format, laz_points_bytes[format] + 3, &layout);
        if (format < 6) layout.compressor = LAZ_POINTWISE;
        for (size_t i = 0; i < layout.item_count; i++) layout.item[i].version = format < 6 ? 1 : 4;
        check_round_trip(&layout, format, POINTS);
    }
}

/* The record of a layout says the same. */
static void a_layout_is_read_as_written(void **state) {
    (void)state;
    for (unsigned format = 0; format < LAZ_POINTS_FORMATS; format++) {
        struct laz_layout layout, again;
        unsigned char record[LAZ_LAYOUT_BYTES];
        laz_layout_make(format, laz_points_bytes[format] + format % 3, &layout);
        size_t n = laz_layout_store(&layout, record);
        assert_null(laz_layout_take(record, n, format, layout.record_bytes, &again));
        assert_int_equal(again.item_count, layout.item_count);
        assert_memory_equal(again.item, layout.item, layout.item_count * sizeof *layout.item);
        assert_non_null(laz_layout_take(record, n - 1, format, layout.record_bytes, &again));
        assert_non_null(laz_layout_take(record, n, format, layout.record_bytes + 1, &again));
        assert_non_null(laz_layout_take(record, n, (format + 6) % LAZ_POINTS_FORMATS, layout.record_bytes, &again));
    }
}

/* ------------------------------------------------------------------------------------------------ broken chunks */

/* All points, or what is wrong. */
static const char *read_chunk(struct laz_codec *codec, const unsigned char *bytes, size_t n, size_t points) {
    const char *wrong = laz_read_begin(codec, bytes, n, points);
    for (size_t i = 0; !wrong && i < points; i++)
        if (!laz_read_point(codec)) return "no point";
    return wrong ? wrong : laz_read_end(codec);
}

static void a_chunk_of_other_length_is_refused(void **state) {
    (void)state;
    for (unsigned format = 0; format < LAZ_POINTS_FORMATS; format++) {
        struct laz_layout layout;
        laz_layout_make(format, laz_points_bytes[format] + 2, &layout);
        unsigned char *records = laz_points_make(format, layout.record_bytes, POINTS, 5);
        struct laz_bytes chunk = write_chunk(&layout, records, POINTS);
        struct laz_codec *codec = laz_codec_new(&layout);
        assert_non_null(codec);
        laz_put(&chunk, "behind", 6);
        chunk.used -= 6;
        assert_non_null(read_chunk(codec, chunk.bytes, chunk.used + 6, POINTS));
        for (size_t cut = 1; cut < chunk.used; cut += 1 + chunk.used / 40) {
            unsigned char *part = malloc(chunk.used - cut);
            assert_non_null(part);
            memcpy(part, chunk.bytes, chunk.used - cut);
            assert_non_null(read_chunk(codec, part, chunk.used - cut, POINTS));
            free(part);
        }
        assert_non_null(read_chunk(codec, chunk.bytes, chunk.used, POINTS + 100));
        assert_null(read_chunk(codec, chunk.bytes, chunk.used, POINTS));
        laz_codec_free(codec);
        free(chunk.bytes), free(records);
    }
}

/* Whatever the bytes are, reading ends, and within them (config=asan sees beyond). */
static void any_bytes_end(void **state) {
    (void)state;
    uint64_t s = 99;
    for (unsigned format = 0; format < LAZ_POINTS_FORMATS; format++) {
        struct laz_layout layout;
        laz_layout_make(format, laz_points_bytes[format] + 2, &layout);
        unsigned char *records = laz_points_make(format, layout.record_bytes, 300, 5);
        struct laz_bytes chunk = write_chunk(&layout, records, 300);
        struct laz_codec *codec = laz_codec_new(&layout);
        assert_non_null(codec);
        for (int turn = 0; turn < 200; turn++) {
            unsigned char *damaged = malloc(chunk.used);
            assert_non_null(damaged);
            memcpy(damaged, chunk.bytes, chunk.used);
            for (uint64_t k = 1 + laz_points_next(&s) % 4; k > 0; k--)
                damaged[laz_points_next(&s) % chunk.used] = (unsigned char)laz_points_next(&s);
            (void)read_chunk(codec, damaged, chunk.used, 300);
            free(damaged);
        }
        laz_codec_free(codec);
        free(chunk.bytes), free(records);
    }
}

/* ------------------------------------------------------------------------------------------------ pairs */

static const char *const pairs[][2] = {{"laz/1815.laz", "laz/1815.las"},
                                       {"laz/autzen_trim.laz", "scans/autzen_trim.las"},
                                       {"laz/extrabytes.laz", "laz/extrabytes.las"},
                                       {"laz/no-points-1.3.laz", "laz/no-points-1.3.las"},
                                       {"laz/point-color-time.laz", "laz/point-color-time.las"},
                                       {"laz/point-color.laz", "laz/point-color.las"},
                                       {"laz/point-time-1.4.laz", "laz/point-time.las"},
                                       {"laz/point-time.laz", "laz/point-time.las"},
                                       {"laz/point10-1.0.laz", "laz/point10-1.0.las"},
                                       {"laz/point10.laz", "laz/point10.las"}};

static enum status read_shared(const char *name, unsigned threads, struct cloud *cloud) {
    char path[256];
    const struct cloud_limits limits = {.threads = threads};
    struct error error;
    snprintf(path, sizeof path, "../shared/data/%s", name);
    return cloud_read_path(path, &limits, NULL, cloud, &error);
}

static void laz_and_las_are_the_same(void **state) {
    (void)state;
    if (access("../shared/data/laz/1815.laz", R_OK) != 0) {
        print_message("skipped: ../shared/data isn't there\n");
        skip();
    }
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
        for (unsigned threads = 1; threads < 4; threads += 2) {
            struct cloud laz = {0}, las = {0};
            enum status status = read_shared(pairs[i][0], threads, &laz);
            print_message("%s\n", pairs[i][0]);
            assert_int_equal(status, read_shared(pairs[i][1], threads, &las));
            assert_int_equal(status, strstr(pairs[i][0], "no-points") ? STATUS_MALFORMED : STATUS_OK);
            assert_int_equal(laz.count, las.count);
            assert_int_equal(laz.record_bytes, las.record_bytes);
            assert_memory_equal(laz.record ? (void *)laz.record : "", las.record ? (void *)las.record : "",
                                laz.count * laz.record_bytes);
            cloud_done(&laz), cloud_done(&las);
        }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_format_comes_back),
        cmocka_unit_test(every_version_comes_back),
        cmocka_unit_test(a_layout_is_read_as_written),
        cmocka_unit_test(a_chunk_of_other_length_is_refused),
        cmocka_unit_test(any_bytes_end),
        cmocka_unit_test(laz_and_las_are_the_same),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
