/* Colours of 8 and 16 bits: what each kind of numbers becomes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/colour_depth.h"
#include "core/io/read.h"
#include "tests/unit/property.h"

/* A cloud of points with a list, a colour of three components, and something before and behind. */
static struct cloud make(const char *type, const char *first, const char *second) {
    char text[640];
    struct cloud cloud = {0};
    struct error error = {0};
    snprintf(text, sizeof text,
             "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty %s red\nproperty %s green\n"
             "property list uchar int a\nproperty float y\nproperty %s blue\nproperty double z\nproperty short i\n"
             "end_header\n1 %s\n5 %s\n",
             type, type, type, first, second);
    if (cloud_read_memory(text, strlen(text), NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

/* The colours of both points, and that nothing else has changed. */
static void check(const struct cloud *cloud, enum scalar_type type, const double expected[6]) {
    static const char *const names[] = {"red", "green", "blue"};
    size_t bytes = 0;
    for (size_t i = 0; i < 2; i++) {
        for (int k = 0; k < 3; k++) assert_true(property_value(cloud, i, names[k]) == expected[3 * i + (size_t)k]);
        assert_true(property_value(cloud, i, "x") == (i ? 5 : 1) && property_value(cloud, i, "y") == (i ? 6 : 2));
        assert_true(property_value(cloud, i, "z") == (i ? 7 : 3) && property_value(cloud, i, "i") == (i ? -8 : -4));
    }
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        if (p->is_list) continue;
        assert_int_equal(p->offset_bytes, bytes);
        bytes += scalar_bytes(p->type);
        if (strcmp(p->name, "red") == 0 || strcmp(p->name, "blue") == 0) assert_int_equal(p->type, type);
    }
    assert_int_equal(cloud->record_bytes, bytes);
}

static const struct {
    const char *what, *type, *first, *second;
    enum colour_bits bits;
    enum scalar_type becomes;
    double colour[6];
    const char *note; /* "" = none */
} cases[] = {
    {"sixteen bits become the upper eight",
     "ushort",
     "65535 256 0 2 255 3 -4",
     "128 257 0 6 32768 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 1, 0, 0, 1, 128},
     "16 bits became 8"},
    {"sixteen bits that hold eight stay what they are",
     "ushort",
     "255 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 1, 7, 0, 0, 9},
     ""},
    {"whole doubles",
     "double",
     "255 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 1, 7, 0, 0, 9},
     ""},
    {"floats up to one",
     "float",
     "1 0.5 0 2 0.25 3 -4",
     "0 0 0 6 1 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 128, 64, 0, 0, 255},
     "0 to 1 became 8 bits"},
    {"doubles that aren't whole",
     "double",
     "254.6 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 1, 7, 0, 0, 9},
     "rounded"},
    {"eight bits become sixteen",
     "uchar",
     "255 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_16,
     SCALAR_UINT16,
     {65535, 257, 1799, 0, 0, 2313},
     "8 bits became 16"},
    {"eight bits stay",
     "uchar",
     "255 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_UINT8,
     {255, 1, 7, 0, 0, 9},
     ""},
    {"kept", "ushort", "65535 1 0 2 7 3 -4", "0 0 0 6 9 7 -8", COLOURS_KEEP, SCALAR_UINT16, {65535, 1, 7, 0, 0, 9}, ""},
    {"no colours",
     "short",
     "-1 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_INT16,
     {-1, 1, 7, 0, 0, 9},
     "as in the input"},
    {"no numbers",
     "double",
     "70000 1 0 2 7 3 -4",
     "0 0 0 6 9 7 -8",
     COLOURS_8,
     SCALAR_FLOAT64,
     {70000, 1, 7, 0, 0, 9},
     "as in the input"},
};

static void each_kind_of_numbers_becomes_what_programs_show(void **state) {
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct cloud cloud = make(cases[i].type, cases[i].first, cases[i].second);
        struct left_out left_out = {0};
        print_message("    %s\n", cases[i].what);
        assert_int_equal(cloud_set_colours(&cloud, cases[i].bits, &left_out, NULL), STATUS_OK);
        check(&cloud, cases[i].becomes, cases[i].colour);
        assert_int_equal(left_out.count, cases[i].note[0] ? 1 : 0);
        if (left_out.count) assert_non_null(strstr(left_out.loss[0].what, cases[i].note));
        cloud_done(&cloud);
    }
}

static void eight_bits_survive_the_way_to_sixteen_and_back(void **state) {
    (void)state;
    for (int v = 0; v < 256; v++) {
        char text[64];
        snprintf(text, sizeof text, "%d 255 0 2 %d 3 -4", v, 255 - v);
        struct cloud cloud = make("uchar", text, "0 0 0 6 9 7 -8");
        assert_int_equal(cloud_set_colours(&cloud, COLOURS_16, NULL, NULL), STATUS_OK);
        assert_int_equal(cloud_set_colours(&cloud, COLOURS_8, NULL, NULL), STATUS_OK);
        check(&cloud, SCALAR_UINT8, (const double[]){v, 255, 255 - v, 0, 0, 9});
        cloud_done(&cloud);
    }
}

static bool countdown(void *ctx) { return (*(int *)ctx)-- == 0; }

static void every_failing_allocation_is_told(void **state) {
    (void)state;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY; n++) {
        int left = n;
        struct cloud cloud = make("uchar", "255 1 0 2 7 3 -4", "0 0 0 6 9 7 -8");
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = cloud_set_colours(&cloud, COLOURS_16, NULL, NULL);
        alloc_fail = NULL;
        cloud_done(&cloud);
        assert_true(n < 10);
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 2);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_kind_of_numbers_becomes_what_programs_show),
        cmocka_unit_test(eight_bits_survive_the_way_to_sixteen_and_back),
        cmocka_unit_test(every_failing_allocation_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
