/* Clouds joined: types that hold the values of both, names that say the same, what some lack, failing allocations.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/io/join.h"
#include "core/io/read.h"
#include "tests/unit/property.h"

/* A cloud of one point at 0 0 0 with these properties, "float a\nuchar b\n", and their values. */
static struct cloud make(const char *properties, const char *values) {
    char text[640] =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty double x\nproperty double y\nproperty double z\n";
    struct cloud cloud = {0};
    struct error error = {0};
    for (const char *at = properties; *at;) {
        size_t n = strcspn(at, "\n"), used = strlen(text);
        snprintf(text + used, sizeof text - used, "property %.*s\n", (int)n, at);
        at += n + (at[n] == '\n');
    }
    size_t used = strlen(text);
    snprintf(text + used, sizeof text - used, "end_header\n0 0 0 %s\n", values);
    if (cloud_read_memory(text, strlen(text), NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

static enum status join_two(struct cloud *a, struct cloud *b, struct cloud *out, struct error *error) {
    struct cloud_join join = {0};
    enum status status = cloud_join_add(&join, a, "a", error);
    if (status)
        cloud_done(b);
    else
        status = cloud_join_add(&join, b, "folder/b", error);
    if (!status) return cloud_join_end(&join, out, error);
    cloud_join_done(&join);
    return status;
}

static struct cloud joined(const char *a, const char *a_values, const char *b, const char *b_values) {
    struct cloud one = make(a, a_values), two = make(b, b_values), out = {0};
    struct error error = {0};
    if (join_two(&one, &two, &out, &error)) fail_msg("%s", error.text);
    assert_int_equal(out.count, 2);
    return out;
}

/* ------------------------------------------------------------------------------------------------ types, names */

static const struct {
    const char *a, *b;
    enum scalar_type becomes;
} types[] = {
    {"uchar", "uchar", SCALAR_UINT8},   {"uchar", "char", SCALAR_INT16},     {"ushort", "short", SCALAR_INT32},
    {"uint", "int", SCALAR_FLOAT64},    {"float", "ushort", SCALAR_FLOAT32}, {"float", "int", SCALAR_FLOAT64},
    {"double", "char", SCALAR_FLOAT64}, {"uchar", "uint", SCALAR_UINT32},    {"float", "double", SCALAR_FLOAT64},
};

static void types_hold_the_values_of_both(void **state) {
    (void)state;
    for (size_t i = 0; i < 2 * sizeof types / sizeof *types; i++) {
        char a[32], b[32];
        bool swapped = i % 2;
        snprintf(a, sizeof a, "%s v", swapped ? types[i / 2].b : types[i / 2].a);
        snprintf(b, sizeof b, "%s v", swapped ? types[i / 2].a : types[i / 2].b);
        struct cloud cloud = joined(a, "120", b, "7");
        assert_int_equal(cloud.property[3].type, types[i / 2].becomes);
        assert_true(property_value(&cloud, 0, "v") == 120 && property_value(&cloud, 1, "v") == 7);
        cloud_done(&cloud);
    }
}

static void names_that_say_the_same_are_one(void **state) {
    static const char *const same[][2] = {
        {"red", "R"},       {"intensity", "scalar_Intensity"}, {"classification", "class"}, {"gps_time", "GpsTime"},
        {"nx", "normal_x"}, {"return_number", "ReturnNumber"}, {"scalar_mine", "Mine"}};
    (void)state;
    for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
        char a[80], b[80];
        snprintf(a, sizeof a, "float %s", same[i][0]), snprintf(b, sizeof b, "float %s", same[i][1]);
        struct cloud cloud = joined(a, "1", b, "2");
        assert_int_equal(cloud.property_count, 4);
        assert_true(property_value(&cloud, 1, same[i][0]) == 2);
        assert_null(cloud.left_out);
        cloud_done(&cloud);
    }
    assert_false(attribute_is_same("red", "green") || attribute_is_same("mine", "yours"));
    assert_null(attribute_usual_name("a_name_that_is_longer_than_any_that_is_known"));
}

static void exact_names_come_before_those_that_say_the_same(void **state) {
    (void)state;
    struct cloud cloud =
        joined("float scalar_Intensity\nuchar intensity", "1 2", "uchar intensity\nfloat scalar_Intensity", "3 4");
    assert_int_equal(cloud.property_count, 5);
    assert_true(property_value(&cloud, 1, "intensity") == 3 && property_value(&cloud, 1, "scalar_Intensity") == 4);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ what some lack */

static void what_a_cloud_lacks_is_zero_and_told(void **state) {
    (void)state;
    struct cloud cloud = joined("float a\nlist uchar int l", "1 2 5 6", "ushort b", "9");
    assert_true(property_value(&cloud, 0, "a") == 1 && property_value(&cloud, 1, "a") == 0);
    assert_true(property_value(&cloud, 0, "b") == 0 && property_value(&cloud, 1, "b") == 9);
    assert_int_equal(cloud.property[4].list_offset[1], 8);
    assert_int_equal(cloud.property[4].list_offset[2], 8);
    assert_string_equal(cloud.left_out, "b has no a, l: 0 there\na has no b: 0 there\n");
    cloud_done(&cloud);
}

static void colours_of_other_depths_have_the_same_white(void **state) {
    (void)state;
    struct cloud cloud =
        joined("uchar red\nuchar green\nuchar blue", "255 1 0", "ushort red\nushort green\nushort blue", "65535 257 3");
    assert_true(property_value(&cloud, 0, "red") == 65535 && property_value(&cloud, 1, "red") == 65535);
    assert_true(property_value(&cloud, 0, "green") == 257 && property_value(&cloud, 1, "blue") == 3);
    cloud_done(&cloud);
}

static void lists_of_another_kind_are_left_out_and_told(void **state) {
    (void)state;
    struct cloud cloud = joined("list uchar int l", "1 5", "float l", "7");
    assert_int_equal(cloud.property_count, 4);
    assert_int_equal(cloud.property[3].list_offset[2], 4);
    assert_non_null(strstr(cloud.left_out, "l of folder/b: of another kind than the others'\n"));
    cloud_done(&cloud);
}

static void places_of_scanners_are_numbered_on(void **state) {
    (void)state;
    struct cloud a = make("ushort scan", "1"), b = make("", ""), out = {0};
    struct error error = {0};
    a.view = calloc(2, sizeof *a.view), a.view_count = 2;
    b.view = calloc(1, sizeof *b.view), b.view_count = 1;
    a.view[1] = (vec3){1, 0, 0}, b.view[0] = (vec3){0, 7, 0};
    assert_int_equal(join_two(&a, &b, &out, &error), STATUS_OK);
    assert_int_equal(out.view_count, 3);
    assert_true(property_value(&out, 0, "scan") == 1 && property_value(&out, 1, "scan") == 2);
    assert_true(out.view[1].x == 1 && out.view[2].y == 7);
    assert_null(out.left_out);
    cloud_done(&out);
}

static void a_place_of_one_alone_is_none_of_the_other(void **state) {
    (void)state;
    struct cloud a = make("", ""), b = make("", ""), out = {0};
    b.view = calloc(1, sizeof *b.view), b.view_count = 1;
    assert_int_equal(join_two(&a, &b, &out, NULL), STATUS_OK);
    assert_int_equal(out.view_count, 2);
    assert_true(isnan(out.view[0].x) && out.view[1].x == 0);
    assert_true(property_value(&out, 0, "scan") == 0 && property_value(&out, 1, "scan") == 1);
    cloud_done(&out);
}

/* ------------------------------------------------------------------------------------------------ limits, memory */

static void more_properties_than_a_cloud_has_are_refused(void **state) {
    struct cloud_join join = {0};
    struct error error = {0};
    enum status status = STATUS_OK;
    (void)state;
    for (int i = 0; i < CLOUD_MAX_PROPERTIES && !status; i++) {
        char name[32];
        snprintf(name, sizeof name, "uchar p%d", i);
        struct cloud cloud = make(name, "1");
        status = cloud_join_add(&join, &cloud, "one", &error);
    }
    assert_int_equal(status, STATUS_LIMIT);
    assert_string_equal(error.where, "properties");
    cloud_join_done(&join);
}

static bool countdown(void *ctx) { return (*(int *)ctx)-- == 0; }

static void every_failing_allocation_is_told(void **state) {
    (void)state;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY; n++) {
        struct cloud a = make("list uchar int l\nuchar red\nuchar green\nuchar blue", "1 5 1 2 3"), out = {0};
        struct cloud b = make("ushort red\nushort green\nushort blue\nlist uchar int m", "1 2 3 1 6");
        struct error error = {0};
        int left = n;
        a.view = calloc(1, sizeof *a.view), a.view_count = 1;
        alloc_fail = countdown, alloc_fail_ctx = &left;
        status = join_two(&a, &b, &out, &error);
        alloc_fail = NULL;
        assert_true(status == STATUS_OK || (status == STATUS_NO_MEMORY && error.text[0]));
        if (status) assert_int_equal(out.count, 0);
        cloud_done(&out);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 10);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(types_hold_the_values_of_both),
        cmocka_unit_test(names_that_say_the_same_are_one),
        cmocka_unit_test(exact_names_come_before_those_that_say_the_same),
        cmocka_unit_test(what_a_cloud_lacks_is_zero_and_told),
        cmocka_unit_test(colours_of_other_depths_have_the_same_white),
        cmocka_unit_test(lists_of_another_kind_are_left_out_and_told),
        cmocka_unit_test(places_of_scanners_are_numbered_on),
        cmocka_unit_test(a_place_of_one_alone_is_none_of_the_other),
        cmocka_unit_test(more_properties_than_a_cloud_has_are_refused),
        cmocka_unit_test(every_failing_allocation_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
