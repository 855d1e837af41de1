/* The library as its callers see it: arrays in, arrays out, options by name, progress, cancel, refusals.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/whittle.h"

#include <locale.h>
#include <setjmp.h>
#include <spawn.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

#include "tests/unit/faults.h"
#include "tests/unit/folder.h"
#include "tests/unit/shapes.h"

enum { POINTS = 3000 };

static struct whittle_cloud *sphere(void) {
    vec3 *point = shape_sphere(POINTS, 2);
    struct whittle_cloud *cloud = NULL;
    assert_int_equal(whittle_cloud_from_positions(&point->x, POINTS, &cloud, NULL), WHITTLE_OK);
    free(point);
    return cloud;
}

static struct whittle_options *options_of(const char *ratio, const char *outputs) {
    struct whittle_options *options = whittle_options_new();
    assert_non_null(options);
    assert_int_equal(whittle_options_set(options, "ratio", ratio, NULL), WHITTLE_OK);
    assert_int_equal(whittle_options_set(options, "outputs", outputs, NULL), WHITTLE_OK);
    return options;
}

static void test_a_sphere_comes_out_closed(void **state) {
    (void)state;
    struct whittle_cloud *cloud = sphere();
    struct whittle_options *options = options_of("0.2", "cloud,mesh,dso,error");
    struct whittle_result *result = NULL;
    assert_int_equal(whittle_simplify(cloud, options, NULL, &result, NULL), WHITTLE_OK);
    size_t kept, vertices, triangles, none;
    const uint32_t *id = whittle_result_kept(result, 0, &kept);
    const uint32_t *source = whittle_result_sources(result, 0);
    const double *vertex = whittle_result_vertices(result, 0, &vertices);
    const uint32_t *corner = whittle_result_triangles(result, 0, &triangles);
    assert_int_equal(whittle_result_levels(result), 1);
    assert_int_equal(kept, POINTS / 5);
    assert_int_equal(vertices, kept);
    assert_int_equal(triangles, 2 * kept - 4);
    for (size_t i = 0; i < kept; i++) assert_true(id[i] < POINTS);
    for (size_t i = 0; i < 3 * triangles; i++) assert_true(corner[i] < vertices);
    for (size_t i = 0; i < vertices; i++)
        assert_memory_equal(&vertex[3 * i], &whittle_cloud_positions(cloud)[3 * source[i]], 3 * sizeof(double));
    assert_null(whittle_result_kept(result, 1, &none));
    assert_int_equal(none, 0);
    assert_null(whittle_result_vertices(result, 1, &none));
    assert_null(whittle_result_moved(result));
    double value = 0;
    assert_true(whittle_result_number(result, 0, "mesh.watertight", &value));
    assert_true(value == 1);
    assert_true(whittle_result_number(result, 0, "points_out", &value));
    assert_true(value == POINTS / 5);
    assert_false(whittle_result_number(result, 1, "points_out", &value));
    assert_false(whittle_result_number(result, 0, "nonsense", &value));
    for (size_t i = 0; i < POINTS; i++) {
        assert_true(whittle_result_operator(result)[i] > 0.3f && whittle_result_operator(result)[i] < 3);
        assert_true(whittle_result_distances(result)[i] >= 0 && whittle_result_distances(result)[i] < 0.1f);
    }
    whittle_result_free(result);
    whittle_options_free(options);
    whittle_cloud_free(cloud);
}

static void test_figures_of_what_was_not_made_are_absent(void **state) {
    (void)state;
    struct whittle_cloud *cloud = sphere();
    struct whittle_result *result = NULL;
    double value = -1;
    size_t count;
    assert_int_equal(whittle_simplify(cloud, NULL, NULL, &result, NULL), WHITTLE_OK);
    assert_false(whittle_result_number(result, 0, "mesh.area", &value));
    assert_false(whittle_result_number(result, 0, "error.symmetric.max", &value));
    assert_true(value == -1);
    assert_null(whittle_result_vertices(result, 0, &count));
    assert_null(whittle_result_operator(result));
    assert_null(whittle_result_distances(result));
    size_t names = 0;
    while (whittle_result_number_name(names)) names++;
    assert_true(names > 20);
    whittle_result_free(result);
    whittle_cloud_free(cloud);
}

/* Two columns of one array, a byte between values, and a type of its own for each. */
static void test_attributes_keep_type_and_value(void **state) {
    (void)state;
    struct {
        float x, y, z;
        uint8_t red, pad;
        int16_t level;
    } point[5] = {
        {0, 0, 0, 1, 0, -1}, {1, 0, 0, 2, 0, -2}, {0, 1, 0, 3, 0, -3}, {0, 0, 1, 4, 0, -4}, {1, 1, 1, 5, 0, -5}};
    const size_t stride = sizeof point[0];
    const struct whittle_attribute attributes[] = {{"level", WHITTLE_INT16, &point[0].level, stride},
                                                   {"x", WHITTLE_FLOAT32, &point[0].x, stride},
                                                   {"y", WHITTLE_FLOAT32, &point[0].y, stride},
                                                   {"z", WHITTLE_FLOAT32, &point[0].z, stride},
                                                   {"red", WHITTLE_UINT8, &point[0].red, stride}};
    struct whittle_cloud *cloud = NULL;
    assert_int_equal(whittle_cloud_new(5, attributes, 5, &cloud, NULL), WHITTLE_OK);
    assert_int_equal(whittle_cloud_count(cloud), 5);
    assert_int_equal(whittle_cloud_attribute_count(cloud), 5);
    for (size_t j = 0; j < 5; j++) {
        struct whittle_attribute got = whittle_cloud_attribute(cloud, j);
        assert_string_equal(got.name, attributes[j].name);
        assert_int_equal(got.type, attributes[j].type);
        size_t bytes = got.type == WHITTLE_FLOAT32 ? 4 : got.type == WHITTLE_INT16 ? 2 : 1;
        for (size_t i = 0; i < 5; i++)
            assert_memory_equal((const char *)got.values + i * got.stride_bytes,
                                (const char *)attributes[j].values + i * stride, bytes);
    }
    assert_true(whittle_cloud_positions(cloud)[3 * 4] == 1);
    const uint32_t corners[] = {0, 1, 2, 1, 4, 3};
    size_t triangles;
    assert_null(whittle_cloud_triangles(cloud, &triangles));
    assert_int_equal(whittle_cloud_set_triangles(cloud, corners, 2, NULL), WHITTLE_OK);
    assert_memory_equal(whittle_cloud_triangles(cloud, &triangles), corners, sizeof corners);
    assert_int_equal(triangles, 2);
    whittle_cloud_free(cloud);
}

static void test_what_is_no_cloud_is_refused(void **state) {
    (void)state;
    const double good[] = {0, 1, 2}, bad[] = {0, (double)NAN, 2};
    const struct {
        size_t count, attributes;
        struct whittle_attribute attribute[4];
        enum whittle_status status;
        const char *where;
    } cases[] = {
        {3, 2, {{"x", WHITTLE_FLOAT64, good, 0}, {"y", WHITTLE_FLOAT64, good, 0}}, WHITTLE_BAD_PARAMETER, "z"},
        {3, 1, {{"a b", WHITTLE_FLOAT64, good, 0}}, WHITTLE_BAD_PARAMETER, "attributes"},
        {3, 1, {{"", WHITTLE_FLOAT64, good, 0}}, WHITTLE_BAD_PARAMETER, "attributes"},
        {3, 1, {{NULL, WHITTLE_FLOAT64, good, 0}}, WHITTLE_BAD_PARAMETER, "attributes"},
        {3, 1, {{"x", (enum whittle_type)8, good, 0}}, WHITTLE_BAD_PARAMETER, "x"},
        {3, 1, {{"x", WHITTLE_FLOAT64, NULL, 0}}, WHITTLE_BAD_PARAMETER, "x"},
        {3, 2, {{"x", WHITTLE_FLOAT64, good, 0}, {"x", WHITTLE_FLOAT64, good, 0}}, WHITTLE_BAD_PARAMETER, "x"},
        {3, 257, {{"x", WHITTLE_FLOAT64, good, 0}}, WHITTLE_LIMIT, "attributes"},
        {0, 1, {{"x", WHITTLE_FLOAT64, good, 0}}, WHITTLE_DEGENERATE, "points"},
        {UINT32_MAX, 1, {{"x", WHITTLE_FLOAT64, good, 0}}, WHITTLE_LIMIT, "points"},
        {3,
         3,
         {{"x", WHITTLE_FLOAT64, good, 0}, {"y", WHITTLE_FLOAT64, bad, 0}, {"z", WHITTLE_FLOAT64, good, 0}},
         WHITTLE_MALFORMED,
         "y"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct whittle_cloud *cloud = NULL;
        struct whittle_error error = {0};
        assert_int_equal(whittle_cloud_new(cases[i].count, cases[i].attribute, cases[i].attributes, &cloud, &error),
                         cases[i].status);
        assert_int_equal(error.code, cases[i].status);
        assert_string_equal(error.where, cases[i].where);
        assert_true(error.text[0]);
        assert_null(cloud);
    }
    struct whittle_cloud *cloud = sphere();
    const uint32_t corners[] = {0, 1, POINTS};
    struct whittle_error error = {0};
    assert_int_equal(whittle_cloud_set_triangles(cloud, corners, 1, &error), WHITTLE_MALFORMED);
    assert_non_null(strstr(error.text, "triangle 0"));
    whittle_cloud_free(cloud);
}

static void test_options_say_what_they_take(void **state) {
    (void)state;
    struct whittle_options *options = whittle_options_new();
    struct whittle_option option = {0};
    struct whittle_error error = {0};
    char text[200];
    size_t n = 0;
    for (; whittle_option_at(n, &option); n++) {
        whittle_option_allowed(n, text, sizeof text);
        assert_true(option.name[0] && option.help[0] && text[0]);
        if (option.default_text[0])
            assert_int_equal(whittle_options_set(options, option.name, option.default_text, NULL), WHITTLE_OK);
    }
    assert_true(n > 10);
    whittle_option_allowed(n, text, sizeof text);
    assert_string_equal(text, "");
    assert_int_equal(whittle_options_set(options, "ratio", "2", &error), WHITTLE_BAD_PARAMETER);
    assert_string_equal(error.where, "ratio");
    assert_int_equal(whittle_options_set(options, "rati", "1", &error), WHITTLE_BAD_PARAMETER);
    assert_non_null(strstr(error.text, "ratio"));
    assert_true(whittle_memory(1000000, 24, options) > 100000000);
    struct whittle_cloud *cloud = sphere();
    struct whittle_result *result = NULL;
    assert_int_equal(whittle_options_set(options, "cocone", "literal", &error), WHITTLE_OK);
    assert_int_equal(whittle_options_set(options, "reconstruction", "tight", &error), WHITTLE_OK);
    assert_int_equal(whittle_simplify(cloud, options, NULL, &result, &error), WHITTLE_BAD_PARAMETER);
    assert_string_equal(error.where, "cocone");
    assert_int_equal(whittle_options_set(options, "cocone", "tight", &error), WHITTLE_OK);
    assert_int_equal(whittle_options_set(options, "ratio", "0.5", NULL), WHITTLE_OK);
    assert_int_equal(whittle_options_set(options, "points", "5", NULL), WHITTLE_OK);
    assert_int_equal(whittle_simplify(cloud, options, NULL, &result, &error), WHITTLE_BAD_PARAMETER);
    assert_null(result);
    assert_int_equal(whittle_memory(1000000, 24, options), UINT64_MAX);
    whittle_cloud_free(cloud);
    whittle_options_free(options);
}

static void a_bound_of_memory_is_held(void **state) {
    (void)state;
    struct whittle_options *options = whittle_options_new();
    struct whittle_cloud *cloud = sphere();
    struct whittle_result *result = NULL;
    struct whittle_error error;
    assert_int_equal(whittle_options_set(options, "outputs", "cloud,mesh", NULL), WHITTLE_OK);
    whittle_options_set_memory(options, 1 << 20);
    assert_int_equal(whittle_simplify(cloud, options, NULL, &result, &error), WHITTLE_NO_MEMORY);
    assert_non_null(strstr(error.text, "and 1 MiB have no room for more: allow more memory"));
    whittle_options_set_memory(options, 1 << 30);
    assert_int_equal(whittle_simplify(cloud, options, NULL, &result, &error), WHITTLE_OK);
    whittle_result_free(result);
    whittle_cloud_free(cloud);
    whittle_options_free(options);
}

struct watch {
    double last;
    double stop_at;
};

static int watch_tick(void *context, const char *stage, double fraction) {
    struct watch *watch = context;
    assert_true(stage[0] && fraction >= 0 && fraction <= 1.000001);
    watch->last = fraction;
    return fraction >= watch->stop_at;
}

static void test_progress_is_told_and_cancels(void **state) {
    (void)state;
    struct whittle_cloud *cloud = sphere();
    struct whittle_options *options = options_of("0.2", "cloud,mesh");
    struct whittle_result *result = NULL;
    struct whittle_error error = {0};
    struct watch watch = {0, 2};
    const struct whittle_progress progress = {watch_tick, &watch};
    assert_int_equal(whittle_simplify(cloud, options, &progress, &result, NULL), WHITTLE_OK);
    assert_true(watch.last > 0.5);
    whittle_result_free(result);
    result = NULL;
    watch = (struct watch){0, 0.3};
    assert_int_equal(whittle_simplify(cloud, options, &progress, &result, &error), WHITTLE_CANCELLED);
    assert_string_equal(whittle_status_name(error.code), "cancelled");
    assert_null(result);
    whittle_options_free(options);
    whittle_cloud_free(cloud);
}

static void test_files_are_told_by_their_content(void **state) {
    (void)state;
    const char text[] = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
    struct whittle_cloud *cloud = NULL;
    struct whittle_error error = {0};
    assert_int_equal(whittle_cloud_read_memory(text, sizeof text - 1, NULL, NULL, &cloud, NULL), WHITTLE_OK);
    assert_int_equal(whittle_cloud_count(cloud), 4);
    whittle_cloud_free(cloud);
    cloud = NULL;
    assert_int_equal(whittle_cloud_read("/nonexistent/cloud.ply", NULL, NULL, &cloud, &error), WHITTLE_IO);
    assert_int_equal(whittle_cloud_read_memory("ply\nformat", 10, NULL, NULL, &cloud, &error), WHITTLE_MALFORMED);
    assert_null(cloud);
}

static void test_columns_of_a_text_have_the_names_that_the_caller_says(void **state) {
    (void)state;
    const char text[] = "id,chainage,offset,level\n7,1,2,3\n8,4,5,6\n", ply[] = "ply\nformat ascii 1.0\n";
    const double expected[] = {1, 2, 3, 4, 5, 6};
    struct whittle_cloud *cloud = NULL;
    struct whittle_error error = {0};
    assert_int_equal(whittle_cloud_read_memory(text, sizeof text - 1, "", NULL, &cloud, &error), WHITTLE_MALFORMED);
    assert_int_equal(whittle_cloud_read_memory(text, sizeof text - 1, "x,y", NULL, &cloud, &error),
                     WHITTLE_BAD_PARAMETER);
    assert_string_equal(error.where, "columns");
    assert_int_equal(whittle_cloud_read_memory(ply, sizeof ply - 1, "x,y,z", NULL, &cloud, &error), WHITTLE_MALFORMED);
    assert_non_null(strstr(error.text, "names its own"));
    assert_null(cloud);
    assert_int_equal(whittle_cloud_read_memory(text, sizeof text - 1, "x:chainage,y:3,z:level", NULL, &cloud, &error),
                     WHITTLE_OK);
    assert_int_equal(whittle_cloud_count(cloud), 2);
    assert_memory_equal(whittle_cloud_positions(cloud), expected, sizeof expected);
    whittle_cloud_free(cloud);
}

/* One thread, so that allocations come in the same order each time. */
static enum whittle_status make_all(void) {
    static const double xyz[] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 1, 1};
    struct whittle_cloud *cloud = NULL;
    struct whittle_options *options = whittle_options_new();
    struct whittle_result *result = NULL;
    struct whittle_error error = {0};
    enum whittle_status status = options ? WHITTLE_OK : WHITTLE_NO_MEMORY;
    if (!status) status = whittle_options_set(options, "threads", "1", &error);
    if (!status) status = whittle_cloud_from_positions(xyz, 5, &cloud, &error);
    if (!status) status = whittle_simplify(cloud, options, NULL, &result, &error);
    assert_true((status == WHITTLE_OK) == (result != NULL));
    whittle_result_free(result);
    whittle_cloud_free(cloud);
    whittle_options_free(options);
    return status;
}

static void test_each_allocation_may_fail(void **state) {
    (void)state;
    long faults = 0, borne = 0;
    for (long nth = 1;; nth++) {
        faults_in_memory(nth, false);
        enum whittle_status status = make_all();
        bool happened = faults_stop();
        if (!happened) {
            assert_int_equal(status, WHITTLE_OK);
            break;
        }
        assert_true(status == WHITTLE_NO_MEMORY || status == WHITTLE_OK);
        borne += status == WHITTLE_OK;
        faults++;
    }
    assert_true(faults > 10);
    assert_true(borne <= 3); /* position, record and property keep the room that giving back would have saved */
}

/* A program in German, whose numbers have commas. */
static bool speak_german(const char *folder) {
    char name[128];
    int status;
    pid_t child;
    snprintf(name, sizeof name, "%s/de_DE.UTF-8", folder);
    char *command[] = {(char *)"localedef", (char *)"--no-archive", (char *)"-i", (char *)"de_DE",
                       (char *)"-f",        (char *)"UTF-8",        name,         NULL};
    if (posix_spawnp(&child, command[0], NULL, NULL, command, environ) != 0 || waitpid(child, &status, 0) != child)
        return false;
    return status == 0 && setenv("LOCPATH", folder, 1) == 0 && setlocale(LC_ALL, "de_DE.UTF-8");
}

static void the_program_s_locale_changes_nothing(void **state) {
    (void)state;
    static const char *const given[][2] = {
        {"ratio", "0.25"}, {"where", "z>-1.5,x<0.75"}, {"crop", "-1.5,-2,-2.5,2,2,2.5"}};
    char folder[64], text[16];
    struct whittle_cloud *cloud = sphere(), *read = NULL;
    folder_make_in_memory(folder, sizeof folder);
    bool is_german = speak_german(folder);
    folder_remove(folder); /* it is loaded */
    if (!is_german) {
        whittle_cloud_free(cloud);
        print_message("skipped: localedef has no de_DE here\n");
        skip();
    }
    assert_int_equal(snprintf(text, sizeof text, "%.1f", 0.5), 3);
    assert_string_equal(text, "0,5"); /* so it is German */
    struct whittle_options *options = whittle_options_new();
    for (size_t i = 0; i < sizeof given / sizeof *given; i++)
        assert_int_equal(whittle_options_set(options, given[i][0], given[i][1], NULL), WHITTLE_OK);
    assert_int_equal(whittle_options_set(options, "ratio", "0,25", NULL), WHITTLE_BAD_PARAMETER);
    struct whittle_options *others = whittle_options_new(); /* for what a sphere has not */
    assert_int_equal(whittle_options_set(others, "weights", "rgb:0.5", NULL), WHITTLE_OK);
    whittle_options_free(others);
    static const char pcd[] = "VERSION .7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\n"
                              "VIEWPOINT 0.5 -1.25 2 1 0 0 0\nPOINTS 2\nDATA ascii\n0.5 1.5 2.5\n-1e-1 2 3\n";
    assert_int_equal(whittle_cloud_read_memory(pcd, sizeof pcd - 1, NULL, NULL, &read, NULL), WHITTLE_OK);
    assert_true(whittle_cloud_positions(read)[0] == 0.5 && whittle_cloud_positions(read)[3] == -0.1);
    struct whittle_result *german = NULL, *plain = NULL;
    assert_int_equal(whittle_simplify(cloud, options, NULL, &german, NULL), WHITTLE_OK);
    setlocale(LC_ALL, "C");
    assert_int_equal(whittle_simplify(cloud, options, NULL, &plain, NULL), WHITTLE_OK);
    size_t n, m;
    const uint32_t *ids = whittle_result_kept(german, 0, &n), *same = whittle_result_kept(plain, 0, &m);
    assert_int_equal(n, m);
    assert_memory_equal(ids, same, n * sizeof *ids);
    whittle_result_free(german), whittle_result_free(plain);
    whittle_options_free(options);
    whittle_cloud_free(read), whittle_cloud_free(cloud);
}

static void test_nothing_is_freed_twice_or_needed(void **state) {
    (void)state;
    whittle_cloud_free(NULL);
    whittle_options_free(NULL);
    whittle_result_free(NULL);
    assert_true(whittle_version()[0]);
    assert_string_equal(whittle_status_name((enum whittle_status)99), "unknown");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_a_sphere_comes_out_closed),
        cmocka_unit_test(test_figures_of_what_was_not_made_are_absent),
        cmocka_unit_test(test_attributes_keep_type_and_value),
        cmocka_unit_test(test_what_is_no_cloud_is_refused),
        cmocka_unit_test(test_options_say_what_they_take),
        cmocka_unit_test(a_bound_of_memory_is_held),
        cmocka_unit_test(test_progress_is_told_and_cancels),
        cmocka_unit_test(test_files_are_told_by_their_content),
        cmocka_unit_test(test_columns_of_a_text_have_the_names_that_the_caller_says),
        cmocka_unit_test(test_each_allocation_may_fail),
        cmocka_unit_test(the_program_s_locale_changes_nothing),
        cmocka_unit_test(test_nothing_is_freed_twice_or_needed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
