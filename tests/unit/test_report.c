/* Reports as JSON: all there, null where JSON has no number, and whole or not at all where memory runs out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/report_json.h"

#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

/* Two levels, everything measured, something lost on the way. */
static struct report full_report(void) {
    struct report report = {.points_in = 100, .diagonal = 2, .format = "ply/ascii", .level_count = 2, .total_ms = 3};
    for (int i = 0; i < 2; i++)
        report.level[i] = (struct report_level){.ratio = 0.5 / (i + 1),
                                                .points_out = 50 / (uint64_t)(i + 1),
                                                .tangent = {100, 1, 1, 1},
                                                .has_mesh = true,
                                                .has_error = true,
                                                .unsupported = 0.5,
                                                .watertight = true,
                                                .input_to_mesh = {100, 1, 2, 3},
                                                .mesh_to_input = {10, 1, 2, 4},
                                                .surface_to_mesh = {10, 1, 2, 5},
                                                .symmetric = {110, 1, 2, 6},
                                                .dropped = {5, 1, 2, 7},
                                                .reference = "points",
                                                .reconstruction = "tight"};
    report_add_stage(&report, "order", 1);
    report_add_stage(&report, "refine", 2);
    report_add_stage(&report, "refine", 3);
    left_out_add(&report.left_out, "cloud.xyz", "colours");
    return report;
}

static double number_at(json_t *json, const char *outer, const char *inner, const char *name) {
    json_t *member = json_object_get(json_object_get(json_object_get(json, outer), inner), name);
    assert_non_null(member);
    return json_number_value(member);
}

static void every_figure_is_there(void **state) {
    (void)state;
    struct report report = full_report();
    json_t *json = report_json(&report);
    assert_non_null(json);
    assert_int_equal(json_array_size(json_object_get(json, "levels")), 2);
    static const char *const ways[] = {"input_to_mesh", "mesh_to_input", "surface_to_mesh", "symmetric", "dropped"};
    static const char *const old_ways[] = {"forward", "backward", "surface"};
    for (int i = 0; i < 5; i++) {
        assert_true(number_at(json, "error", ways[i], "max") == 3 + i);
        assert_true(number_at(json, "error", ways[i], "max_rel") == (3 + i) / 2.0);
    }
    for (int i = 0; i < 3; i++) assert_true(number_at(json, "error", old_ways[i], "max") == 3 + i);
    json_t *error = json_object_get(json, "error");
    assert_true(json_number_value(json_object_get(error, "max")) == 3);
    assert_true(json_number_value(json_object_get(error, "mean_rel")) == 0.5);
    assert_true(json_number_value(json_object_get(error, "hausdorff")) == 6);
    assert_int_equal(json_array_size(json_object_get(json, "warnings")), 1);
    assert_true(number_at(json, "cloud", "tangent_error", "mean_rel") == 0.5);
    assert_true(json_number_value(json_object_get(json_object_get(json, "timings_ms"), "refine")) == 5);
    assert_int_equal(json_array_size(json_object_get(json, "left_out")), 1);
    json_decref(json);
}

static void a_cloud_without_size_has_no_fractions(void **state) {
    (void)state;
    struct report report = full_report();
    report.diagonal = 0;
    json_t *json = report_json(&report);
    json_t *forward = json_object_get(json_object_get(json, "error"), "forward");
    assert_true(json_is_null(json_object_get(forward, "mean_rel")));
    assert_true(json_number_value(json_object_get(forward, "mean")) == 1);
    json_decref(json);
}

static long allocations_left;

static void *failing_malloc(size_t size_bytes) { return allocations_left-- > 0 ? malloc(size_bytes) : NULL; }

/* However early memory runs out, there is the whole report or none: never one that lacks a member. */
static void without_memory_it_is_whole_or_none(void **state) {
    (void)state;
    struct report report = full_report();
    json_t *wanted = report_json(&report), *got = NULL;
    long tried = 0;
    json_set_alloc_funcs(failing_malloc, free);
    for (; !got; tried++) {
        allocations_left = tried;
        got = report_json(&report);
    }
    json_set_alloc_funcs(malloc, free);
    assert_true(json_equal(wanted, got));
    assert_true(tried > 100); /* and it did fail before */
    json_decref(wanted);
    json_decref(got);
}

/* Another disk may have room, so it isn't told as what can't be helped. */
static void a_full_disk_is_told_as_one(void **state) {
    (void)state;
    struct report report = full_report();
    struct params params;
    struct error error = {0};
    params_defaults(&params);
    int fd = open("/dev/full", O_WRONLY | O_CLOEXEC);
    assert_true(fd >= 0);
    assert_int_equal(report_json_write(fd, &report, &params, &error), STATUS_NO_SPACE);
    assert_non_null(strstr(error.text, "can't write the report"));
    close(fd);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_figure_is_there),
        cmocka_unit_test(a_cloud_without_size_has_no_fractions),
        cmocka_unit_test(without_memory_it_is_whole_or_none),
        cmocka_unit_test(a_full_disk_is_told_as_one),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
