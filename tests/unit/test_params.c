/* The table of parameters: every row reads, writes and refuses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
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
        assert_true(strlen(table[i].help) > 8);
    }
}

static void what_is_allowed_is_told_to_its_last_word(void **state) {
    (void)state;
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char text[PARAMS_ALLOWED_BYTES], wider[4 * PARAMS_ALLOWED_BYTES];
        const char *const *choice = table[i].choices;
        params_allowed(&table[i], text, sizeof text);
        params_allowed(&table[i], wider, sizeof wider);
        assert_string_equal(text, wider);
        assert_true(strlen(text) > 8);
        if (!choice) continue;
        for (size_t k = 1; choice[1] && (table[i].type != PARAM_FLAGS || k < PARAMS_OUTPUTS); k++) choice++;
        char end[PARAMS_ALLOWED_BYTES];
        snprintf(end, sizeof end, ", %s%s", *choice, table[i].type == PARAM_FLAGS ? ", separated by commas" : "");
        assert_string_equal(text + strlen(text) - strlen(end), end);
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

/* Sets names and values, a NULL behind them; what params_resolve says. */
static enum status resolve_given(const char *const *word, struct params *params, struct error *error) {
    *params = defaults();
    for (; *word; word += 2) assert_int_equal(params_set(params, word[0], word[1], NULL), STATUS_OK);
    return params_resolve(params, error);
}

static void a_deprecated_name_sets_the_parameter(void **state) {
    (void)state;
    size_t count, rows;
    const struct param_alias *alias = params_aliases(&count);
    const struct param *table = params_table(&rows);
    for (size_t i = 0; i < count; i++) {
        const struct param *param = params_find(alias[i].name);
        assert_ptr_equal(param, params_find(alias[i].of));
        assert_string_equal(param->name, alias[i].of);
        for (size_t k = 0; k < rows; k++) assert_string_not_equal(table[k].name, alias[i].name);
    }
    struct params old, present;
    struct error error = {0};
    assert_int_equal(resolve_given((const char *[]){"cocone", "literal", NULL}, &old, &error), STATUS_OK);
    assert_int_equal(resolve_given((const char *[]){"reconstruction", "literal", NULL}, &present, &error), STATUS_OK);
    assert_int_equal(old.reconstruction, 1);
    assert_memory_equal(&old, &present, sizeof old);
}

static void both_names_must_say_the_same(void **state) {
    (void)state;
    static const struct {
        const char *word[7];
        bool fits;
    } cases[] = {
        {{"cocone", "literal", "reconstruction", "literal"}, true},
        {{"reconstruction", "tight", "cocone", "tight"}, true},
        {{"cocone", "literal", "reconstruction", "tight"}, false},
        {{"reconstruction", "tight", "cocone", "literal"}, false},
        {{"reconstruction", "literal", "cocone", "tight"}, false},
        {{"cocone", "tight", "reconstruction", "literal", "cocone", "literal"}, true},
        {{"cocone", "literal", "reconstruction", "tight", "reconstruction", "literal"}, true},
        {{"cocone", "literal", "reconstruction", "literal", "cocone", "tight"}, false},
        {{"cocone", "literal", "cocone", "tight"}, true},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct params params;
        struct error error = {0};
        enum status status = resolve_given(cases[i].word, &params, &error);
        assert_int_equal(status, cases[i].fits ? STATUS_OK : STATUS_BAD_PARAMETER);
        if (cases[i].fits) continue;
        assert_string_equal(error.where, "cocone");
        assert_string_equal(error.text,
                            "is a deprecated name of reconstruction and conflicts with it; give one of them");
    }
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
    check_refused("cocone", "loose", "one of tight, literal");
    check_refused("points", "-3", "whole number");
    check_refused("points", "1.5", "whole number");
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
    const char *const extra[] = {"label", "dry-run", NULL};
    assert_null(params_suggest("foo", extra)); /* dso is as near as anything of three letters */
    assert_null(params_suggest("x", extra));
    assert_null(params_suggest("point_cloud", extra));
    assert_string_equal(params_suggest("dos", extra), "dso");
    assert_string_equal(params_suggest("Dry_Run", extra), "dry-run");
    assert_string_equal(params_suggest("max-error", extra), "max_error");
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

static void lists_of_columns_are_in_order_or_pairs(void **state) {
    (void)state;
    static const char *const good[] = {"x,y,z", "-,-,z,y,x,-,intensity", "x:1,y:Hoch wert,z:a:b", "z:3,x:1,y:2,t:4"};
    static const char *const bad[] = {"",        "x,y",           "x,y,z,",     "x,,y,z",          "x,y,z,x",
                                      "x:1,y,z", "x,y,z:3",       "x:,y:2,z:3", "-:1,x:2,y:3,z:4", "x,y,z,a b",
                                      "X,Y,Z",   ":1,x:2,y:3,z:4"};
    struct params params = defaults();
    char text[256], longest[COLUMN_LIST_BYTES + 1];
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        assert_int_equal(params_set(&params, "columns", good[i], NULL), STATUS_OK);
        params_format(&params, params_find("columns"), text, sizeof text);
        assert_string_equal(text, good[i]);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) check_refused("columns", bad[i], "different names");
    memset(longest, '-', sizeof longest);
    for (size_t i = 1; i < sizeof longest; i += 2) longest[i] = ',';
    memcpy(longest + COLUMN_LIST_BYTES - 6, "x,y,z", 6); /* as long as is allowed: the NUL is the last byte */
    assert_int_equal(params_set(&params, "columns", longest, NULL), STATUS_OK);
    memcpy(longest + COLUMN_LIST_BYTES - 6, "-x,y,z", 7);
    check_refused("columns", longest, "at most 255 bytes");
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
    params.max_deviation = 0.5;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    params.max_deviation_rel = 0.5;
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "max_deviation_rel");
    params = defaults();
    params.max_deviation = 0.5;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    assert_true(isnan(params.ratio)); /* the bound is the goal */
    params.levels = (struct param_levels){1, {0.5}};
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "levels");
    params = defaults();
    params.deviation_share = 0.9;
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "deviation_share");
    params.max_deviation = 0.5;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    params = defaults();
    params.neighbours_min = 20;
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "neighbours_max");
}

static void files_are_named_by_outputs_and_levels(void **state) {
    static const char *const names[] = {"cloud_0.5.ply", "cloud_0.125.ply", "cloud.ply",      "report.json",
                                        "error.ply",     "mesh_0.5.glb",    "mesh_0.125.glb", "mesh.glb"};
    enum { NAMES = sizeof names / sizeof names[0] };
    (void)state;
    struct params params = defaults();
    char name[PARAMS_FILE_BYTES];
    assert_int_equal(params_set(&params, "outputs", "cloud,report,error,mesh.glb", NULL), STATUS_OK);
    assert_int_equal(params_file_count(&params), 4);
    assert_int_equal(params_set(&params, "levels", "0.5,0.125", NULL), STATUS_OK);
    assert_int_equal(params_file_count(&params), NAMES);
    for (unsigned i = 0; i < NAMES; i++) {
        assert_true(params_file(&params, i, name));
        assert_string_equal(name, names[i]);
    }
    assert_false(params_file(&params, NAMES, name));
}

/* Four clouds at 15 levels and the finest are as many as a job may write. */
static void more_files_than_a_job_may_write_are_refused(void **state) {
    (void)state;
    struct params params = defaults();
    struct error error = {0};
    for (int i = 0; i < 15; i++) params.levels.ratio[params.levels.count++] = 0.9 - 0.05 * i;
    assert_int_equal(params_set(&params, "outputs", "cloud,xyz,pcd,las", NULL), STATUS_OK);
    assert_int_equal(params_file_count(&params), PARAMS_MAX_FILES);
    struct params most = params;
    assert_int_equal(params_resolve(&most, &error), STATUS_OK);
    assert_int_equal(params_set(&params, "outputs", "cloud,xyz,pcd,las,report", NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "outputs");
    assert_string_equal(error.text, "65 files with all levels, at most 64 are written");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_default_reads_back_as_itself),
        cmocka_unit_test(what_is_allowed_is_told_to_its_last_word),
        cmocka_unit_test(a_deprecated_name_sets_the_parameter),
        cmocka_unit_test(both_names_must_say_the_same),
        cmocka_unit_test(values_out_of_range_are_refused_and_change_nothing),
        cmocka_unit_test(an_unknown_name_gets_a_suggestion),
        cmocka_unit_test(the_edge_of_a_range_is_taken),
        cmocka_unit_test(levels_that_are_nearly_the_same_are_refused),
        cmocka_unit_test(lists_of_columns_are_in_order_or_pairs),
        cmocka_unit_test(goals_that_conflict_are_named),
        cmocka_unit_test(files_are_named_by_outputs_and_levels),
        cmocka_unit_test(more_files_than_a_job_may_write_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
