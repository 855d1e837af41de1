/* Queries and JSON parameters: what is right is taken, everything else is refused by name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/query.h"

#include <jansson.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "api/codecs/params_json.h"

static const char *const extra[] = {"label", NULL};
static struct params params;
static struct problem problem;

#define DECODE(...)                                                                                                    \
    query_decode_params((const struct query_pair[]){__VA_ARGS__},                                                      \
                        sizeof((const struct query_pair[]){__VA_ARGS__}) / sizeof(struct query_pair), extra, &params,  \
                        &problem)

static void assert_refused(enum problem_kind kind, const char *parameter) {
    assert_int_equal(problem.kind, kind);
    assert_string_equal(problem.error[0].parameter, parameter);
}

static void nothing_means_defaults(void **state) {
    (void)state;
    struct params defaults;
    struct error error;
    params_defaults(&defaults);
    assert_int_equal(params_resolve(&defaults, &error), STATUS_OK);
    assert_true(query_decode_params(NULL, 0, NULL, &params, &problem));
    assert_memory_equal(&params, &defaults, sizeof params);
}

static void values_are_taken(void **state) {
    (void)state;
    assert_true(DECODE({"points", "17"}, {"outputs", "mesh,cloud"}, {"label", "anything & more"}));
    assert_int_equal(params.points, 17);
    assert_int_equal(params.outputs, OUTPUT_MESH | OUTPUT_CLOUD);
    assert_true(isnan(params.ratio));
}

static void deprecated_names_are_taken(void **state) {
    (void)state;
    assert_true(DECODE({"cocone", "literal"}));
    assert_int_equal(params.reconstruction, 1);
    assert_true(DECODE({"cocone", "literal"}, {"reconstruction", "literal"}));
    assert_false(DECODE({"cocone", "literal"}, {"reconstruction", "tight"}));
    assert_refused(PROBLEM_CONFLICTING_PARAMETERS, "cocone");
    assert_false(DECODE({"cocone", "literal"}, {"cocone", "literal"}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "cocone");
    assert_false(DECODE({"cocone", "loose"}));
    assert_refused(PROBLEM_INVALID_PARAMETER, "cocone");
    assert_string_equal(problem.error[0].allowed, "one of tight, literal");
}

static void unknown_names_are_refused_with_the_nearest(void **state) {
    (void)state;
    assert_false(DECODE({"ratoi", "0.1"}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "ratoi");
    assert_string_equal(problem.error[0].suggestion, "ratio");
    assert_non_null(strstr(problem.detail, "did you mean ratio"));
    assert_false(DECODE({"lable", "x"}));
    assert_string_equal(problem.error[0].suggestion, "label");
    assert_false(DECODE({"", "x"}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "");
}

static void repeated_names_are_refused(void **state) {
    (void)state;
    assert_false(DECODE({"seed", "1"}, {"seed", "1"}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "seed");
    assert_false(DECODE({"label", "a"}, {"label", "b"}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "label");
}

static void a_repeated_list_is_one_list(void **state) {
    (void)state;
    assert_true(DECODE({"outputs", "cloud"}, {"ratio", "0.2"}, {"outputs", "mesh,report"}));
    assert_int_equal(params.outputs, OUTPUT_CLOUD | OUTPUT_MESH | OUTPUT_REPORT);
    assert_float_equal(params.ratio, 0.2, 0);
    assert_true(DECODE({"levels", "0.1"}, {"levels", "0.4"}));
    assert_int_equal(params.levels.count, 2);
    assert_true(DECODE({"viewpoint", "1"}, {"viewpoint", "2"}, {"viewpoint", "3"}));
    assert_int_equal(params.viewpoint.count, 3);
    assert_false(DECODE({"outputs", "cloud"}, {"outputs", "moon"}));
    assert_refused(PROBLEM_INVALID_PARAMETER, "outputs");
    assert_string_equal(problem.error[0].value, "cloud,moon");
    assert_false(DECODE({"outputs", "cloud"}, {"outputs", NULL}));
    assert_refused(PROBLEM_INVALID_PARAMETER, "outputs");
    char lengthy[3000];
    memset(lengthy, '1', sizeof lengthy - 1);
    lengthy[sizeof lengthy - 1] = 0;
    assert_false(DECODE({"crop", lengthy}, {"crop", lengthy}));
    assert_refused(PROBLEM_UNKNOWN_PARAMETER, "crop");
}

static void bad_values_are_refused_with_what_is_allowed(void **state) {
    (void)state;
    params.ratio = 42;
    assert_false(DECODE({"ratio", "2"}));
    assert_refused(PROBLEM_INVALID_PARAMETER, "ratio");
    assert_non_null(strstr(problem.error[0].allowed, "at most 1"));
    assert_float_equal(params.ratio, 42, 0); /* untouched */
    assert_false(DECODE({"ratio", NULL}));
    assert_refused(PROBLEM_INVALID_PARAMETER, "ratio");
}

static void conflicts_are_refused(void **state) {
    (void)state;
    assert_false(DECODE({"ratio", "0.5"}, {"points", "5"}));
    assert_int_equal(problem.kind, PROBLEM_CONFLICTING_PARAMETERS);
}

static void all_faults_are_told(void **state) {
    (void)state;
    assert_false(DECODE({"a_b_c", "1"}, {"ratio", "x"}, {"seed", "1"}, {"seed", "2"}));
    assert_int_equal(problem.error_count, 3);
    assert_int_equal(problem.kind, PROBLEM_UNKNOWN_PARAMETER); /* of the first */
}

static void check_takes_only_its_names(void **state) {
    (void)state;
    const struct query_pair ratio = {"ratio", "1"}, label = {"label", "x"}, labels[] = {{"label", "x"}, {"label", "x"}};
    assert_true(query_check(NULL, 0, NULL, &problem));
    assert_true(query_check(&label, 1, extra, &problem));
    assert_false(query_check(&ratio, 1, extra, &problem));
    assert_string_equal(problem.error[0].suggestion, ""); /* a parameter's name is no help here */
    assert_false(query_check(labels, 2, extra, &problem));
}

/* ------------------------------------------------------------------------------------------------ JSON */

static bool decode_json(const char *text) {
    json_t *json = json_loads(text, JSON_DECODE_ANY, NULL);
    assert_non_null(json);
    bool ok = params_from_json(json, &params, &problem);
    json_decref(json);
    return ok;
}

static void json_and_back(void **state) {
    (void)state;
    struct params first;
    assert_true(decode_json("{\"ratio\":0.1,\"outputs\":[\"mesh\",\"report\"],\"seed\":7,\"dso_exponent\":-1}"));
    first = params;
    json_t *json = params_to_json(&first);
    assert_true(params_from_json(json, &params, &problem));
    assert_memory_equal(&params, &first, sizeof params);
    json_decref(json);
    assert_true(decode_json("{\"levels\":[0.5,0.1,0.02]}"));
    assert_int_equal(params.levels.count, 3);
    assert_true(decode_json("{\"points\":4294967294.0}"));
    assert_int_equal(params.points, 4294967294);
}

static void json_of_a_wrong_type_is_refused(void **state) {
    (void)state;
    static const char *const wrong[] = {"[]",
                                        "3",
                                        "{\"ratio\":null}",
                                        "{\"ratio\":{}}",
                                        "{\"ratio\":true}",
                                        "{\"points\":1.5}",
                                        "{\"outputs\":[]}",
                                        "{\"outputs\":[1]}",
                                        "{\"outputs\":[null]}",
                                        "{\"placement\":[[]]}",
                                        "{\"points\":1e300}",
                                        "{\"levels\":[0.1,\"x\"]}",
                                        "{\"levels\":0.5}",
                                        "{\"levels\":\"0.5\"}",
                                        "{\"nonsense\":1}"};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) assert_false(decode_json(wrong[i]));
}

/* What is told is the value as it came, and an array. */
static void a_list_that_is_no_array_is_told_so(void **state) {
    (void)state;
    static const struct {
        const char *json, *name, *value, *takes;
    } wrong[] = {
        {"{\"where\":\"z>0\"}", "where", "\"z>0\"", "an array of texts, such as [\"intensity>100\""},
        {"{\"where\":[\"z<0,x>0\"]}", "where", "[\"z<0,x>0\"]", "an array of texts"},
        {"{\"outputs\":\"cloud,mesh\"}", "outputs", "\"cloud,mesh\"", "an array of texts, such as [\"cloud\", \""},
        {"{\"viewpoint\":\"0,0,1\"}", "viewpoint", "\"0,0,1\"", "an array of numbers, such as [0, 0, 1]"},
        {"{\"levels\":0.5}", "levels", "0.5", "an array of numbers, such as [0.2, 0.1]"},
        {"{\"properties\":\"none\"}", "properties", "\"none\"", "an array of texts"},
        {"{\"weights\":\"rgb:1\"}", "weights", "\"rgb:1\"", "an array of texts, such as [\"rgb:0.2\""},
        {"{\"columns\":\"x,y,z\"}", "columns", "\"x,y,z\"", "an array of texts, such as [\"-\", \"x\""},
    };
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        assert_false(decode_json(wrong[i].json));
        assert_int_equal(problem.kind, PROBLEM_INVALID_PARAMETER);
        assert_int_equal(problem.error_count, 1);
        assert_string_equal(problem.error[0].parameter, wrong[i].name);
        assert_string_equal(problem.error[0].value, wrong[i].value);
        assert_memory_equal(problem.error[0].allowed, wrong[i].takes, strlen(wrong[i].takes));
        assert_non_null(strstr(problem.detail, wrong[i].takes));
    }
    struct params before = params;
    assert_false(decode_json("{\"where\":\"z>0\",\"ratio\":2,\"outputs\":[\"cloud\"]}"));
    assert_int_equal(problem.error_count, 2);
    assert_memory_equal(&params, &before, sizeof params);
}

/* 10% and 10k, as on the command line; JSON has numbers. */
static void shares_and_counts_are_written_as_people_do(void **state) {
    (void)state;
    assert_true(DECODE({"ratio", "7%"}));
    assert_true(params.ratio == 0.07);
    assert_true(DECODE({"points", "10k"}));
    assert_int_equal(params.points, 10000);
    assert_true(DECODE({"levels", "50%,0.1"}));
    assert_int_equal(params.levels.count, 2);
    assert_true(DECODE({"where", "z > 0, class == 2 | 6"}));
    assert_string_equal(params.where, "z>0,class==2|6");
    assert_false(DECODE({"ratio", "110%"}));
    assert_string_equal(problem.error[0].value, "110%");
    assert_false(DECODE({"spacing", "1%"}));
    assert_false(DECODE({"points", "10%"}));
    assert_false(decode_json("{\"ratio\":\"10%\"}"));
    assert_false(decode_json("{\"points\":\"10k\"}"));
}

static void a_long_list_is_cut_and_refused(void **state) {
    (void)state;
    json_t *json = json_object(), *list = json_array();
    for (int i = 0; i < 10000; i++) json_array_append_new(list, json_string("cloud"));
    json_object_set_new(json, "outputs", list);
    bool ok = params_from_json(json, &params, &problem);
    json_decref(json);
    assert_false(ok);
}

static void the_schema_has_every_row(void **state) {
    (void)state;
    size_t count, alias_count;
    const struct param *table = params_table(&count);
    const struct param_alias *aliases = params_aliases(&alias_count);
    char *text = params_schema();
    json_t *json = json_loads(text, 0, NULL), *properties = json_object_get(json, "properties");
    assert_int_equal(json_object_size(properties), count + alias_count);
    for (size_t i = 0; i < count; i++) {
        json_t *row = json_object_get(properties, table[i].name);
        assert_string_equal(json_string_value(json_object_get(row, "description")), table[i].help);
        assert_int_equal(json_object_get(row, "default") != NULL, table[i].default_text[0] != 0);
        assert_int_equal(json_is_true(json_object_get(row, "deprecated")), strcmp(table[i].name, "max_error") == 0);
    }
    for (size_t i = 0; i < alias_count; i++) {
        json_t *row = json_object_get(properties, aliases[i].name), *of = json_object_get(properties, aliases[i].of);
        assert_true(json_is_true(json_object_get(row, "deprecated")));
        assert_null(json_object_get(row, "default"));
        assert_true(json_equal(json_object_get(row, "enum"), json_object_get(of, "enum")));
    }
    json_decref(json);
    free(text);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_means_defaults),
        cmocka_unit_test(values_are_taken),
        cmocka_unit_test(deprecated_names_are_taken),
        cmocka_unit_test(unknown_names_are_refused_with_the_nearest),
        cmocka_unit_test(repeated_names_are_refused),
        cmocka_unit_test(a_repeated_list_is_one_list),
        cmocka_unit_test(bad_values_are_refused_with_what_is_allowed),
        cmocka_unit_test(conflicts_are_refused),
        cmocka_unit_test(all_faults_are_told),
        cmocka_unit_test(check_takes_only_its_names),
        cmocka_unit_test(json_and_back),
        cmocka_unit_test(json_of_a_wrong_type_is_refused),
        cmocka_unit_test(a_list_that_is_no_array_is_told_so),
        cmocka_unit_test(shares_and_counts_are_written_as_people_do),
        cmocka_unit_test(a_long_list_is_cut_and_refused),
        cmocka_unit_test(the_schema_has_every_row),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
