/* The table of parameters: every row reads, writes and refuses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/params.h"

static struct params defaults(void) {
    struct params params;
    params_defaults(&params);
    return params;
}

static void every_default_reads_back_as_itself(void **state) {
    (void)state;
    size_t count;
    const struct param *table = params_table(&count);
    assert_true(count > 10);
    struct params params = defaults();
    for (size_t i = 0; i < count; i++) {
        char text[256];
        params_format(&params, &table[i], text, sizeof text);
        assert_string_equal(text, table[i].default_text);
        if (text[0]) assert_int_equal(params_set(&params, table[i].name, text, NULL), STATUS_OK);
        params_allowed(&table[i], text, sizeof text);
        assert_true(strlen(text) > 8 && strlen(table[i].help) > 8);
    }
}

static void check_refused(const char *name, const char *value, const char *part) {
    struct params before = defaults(), after = before;
    struct error error = {0};
    assert_int_equal(params_set(&after, name, value, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, name);
    assert_non_null(strstr(error.text, part));
    assert_memory_equal(&before, &after, sizeof before);
}

static void values_out_of_range_are_refused_and_change_nothing(void **state) {
    (void)state;
    check_refused("ratio", "0", "over 0, at most 1");
    check_refused("ratio", "1.5", "at most 1");
    check_refused("ratio", "-0.1", "over 0");
    check_refused("ratio", "ten", "a number");
    check_refused("ratio", "", "a number");
    check_refused("ratio", "nan", "a number");
    check_refused("ratio", "0x1p-3", "a number");
    check_refused("ratio", " 0.1", "a number");
    check_refused("ratio", "0.1x", "a number");
    check_refused("points", "0", "whole number from 1");
    check_refused("points", "-3", "whole number");
    check_refused("points", "1e3", "whole number");
    check_refused("points", "99999999999999999999999", "whole number");
    check_refused("dso", "RMS", "one of rms, sum, none");
    check_refused("outputs", "mesh,", "one or more of");
    check_refused("outputs", "meshes", "one or more of");
}

static void an_unknown_name_gets_a_suggestion(void **state) {
    (void)state;
    check_refused("raito", "0.1", "did you mean 'ratio'");
    check_refused("neighborhood", "3", "did you mean 'neighbourhood'");
    struct error error = {0};
    struct params params = defaults();
    assert_int_equal(params_set(&params, "xyzzyplugh", "1", &error), STATUS_BAD_PARAMETER);
    assert_null(strstr(error.text, "did you mean"));
    const char *const extra[] = {"label", NULL};
    assert_string_equal(params_suggest("lable", extra), "label");
}

static void the_edge_of_a_range_is_taken(void **state) {
    (void)state;
    struct params params = defaults();
    assert_int_equal(params_set(&params, "ratio", "1", NULL), STATUS_OK);
    assert_true(params.ratio == 1);
    assert_int_equal(params_set(&params, "outputs", "mesh,cloud", NULL), STATUS_OK);
    assert_int_equal(params.outputs, OUTPUT_MESH | OUTPUT_CLOUD);
}

/* Their files would have the same name. */
static void levels_that_are_nearly_the_same_are_refused(void **state) {
    (void)state;
    struct params params = defaults();
    struct error error = {0};
    assert_int_equal(params_set(&params, "levels", "0.1,0.5,0.499999999999", &error), STATUS_BAD_PARAMETER);
    assert_non_null(strstr(error.text, "different"));
    assert_int_equal(params_set(&params, "levels", "0.5,0.1,0.5", NULL), STATUS_BAD_PARAMETER);
    assert_int_equal(params_set(&params, "levels", "0.1,0.4999999,0.5", NULL), STATUS_OK);
    assert_true(params.levels.ratio[0] == 0.5 && params.levels.ratio[2] == 0.1);
}

static void goals_that_conflict_are_named(void **state) {
    (void)state;
    struct params params = defaults();
    struct error error = {0};
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    assert_true(params.ratio == 0.1);
    params.points = 7;
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "points");
    params = defaults();
    params.points = 7;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    assert_true(isnan(params.ratio));
    params.neighbours_min = 20;
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "neighbours_max");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_default_reads_back_as_itself),
        cmocka_unit_test(values_out_of_range_are_refused_and_change_nothing),
        cmocka_unit_test(an_unknown_name_gets_a_suggestion),
        cmocka_unit_test(the_edge_of_a_range_is_taken),
        cmocka_unit_test(levels_that_are_nearly_the_same_are_refused),
        cmocka_unit_test(goals_that_conflict_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
