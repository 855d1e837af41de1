/* A bounded deviation: it holds as measured, hardly fewer points would do, and what can't be held is refused.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/pipeline/pipeline.h"
#include "core/pipeline/pipeline_run.h"
#include "tests/unit/shapes.h"

enum { N = 2000, RADIUS = 7 };

static struct cloud sphere(size_t n) {
    struct cloud cloud = {.count = n, .position = shape_sphere(n, RADIUS), .property_count = 3, .record_bytes = 24};
    cloud.property = calloc(3, sizeof *cloud.property);
    cloud.record = calloc(n, 24);
    for (size_t i = 0; i < 3; i++) {
        cloud.xyz[i] = (uint32_t)i;
        cloud.property[i] = (struct property){.type = SCALAR_FLOAT64, .offset_bytes = 8 * i};
        snprintf(cloud.property[i].name, sizeof cloud.property[i].name, "%c", "xyz"[i]);
    }
    return cloud;
}

static enum status run(const struct cloud *cloud, const char *settings, const struct progress *progress,
                       struct pipeline_result *result, struct error *error) {
    struct params params;
    char name[64], value[64];
    int used;
    params_defaults(&params);
    for (; sscanf(settings, " %63s %63s%n", name, value, &used) == 2; settings += used)
        assert_int_equal(params_set(&params, name, value, error), STATUS_OK);
    assert_int_equal(params_resolve(&params, error), STATUS_OK);
    return pipeline_run(cloud, &params, progress, result, error);
}

/* The deviation that was measured; how many points were kept. */
static double deviation_of(const struct cloud *cloud, const char *settings, size_t *kept) {
    struct pipeline_result result = {0};
    struct error error = {0};
    enum status status = run(cloud, settings, NULL, &result, &error);
    if (status) print_error("%s: %s\n", settings, error.text);
    assert_int_equal(status, STATUS_OK);
    const struct report *report = &result.report;
    const struct report_level *level = &report->level[0];
    double deviation = level->has_mesh ? level->input_to_mesh.max : level->tangent.max;
    if (report->deviation.bound > 0) {
        assert_true(report->deviation.reached == deviation);
        assert_true(deviation <= report->deviation.bound);
        assert_in_range(report->deviation.tried, 1, 24);
    }
    *kept = result.level[0].kept_count;
    assert_int_equal(level->points_out, *kept);
    pipeline_result_done(&result);
    return deviation;
}

static void the_bound_holds_and_fewer_points_break_it(void **state) {
    (void)state;
    struct cloud cloud = sphere(N);
    static const char *const outputs[] = {"cloud", "mesh", "cloud,mesh placement optimal", "mesh refine none"};
    for (size_t i = 0; i < 4; i++)
        for (double bound = 0.05; bound < 0.5; bound *= 8) {
            char settings[128];
            size_t kept, fewer;
            snprintf(settings, sizeof settings, "max_deviation %g outputs %s", bound, outputs[i]);
            assert_true(deviation_of(&cloud, settings, &kept) <= bound);
            assert_in_range(kept, 4, N - 1);
            snprintf(settings, sizeof settings, "points %zu outputs %s", kept * 3 / 4, outputs[i]);
            assert_true(deviation_of(&cloud, settings, &fewer) > bound);
        }
    cloud_done(&cloud);
}

static void a_fraction_of_the_diagonal_is_the_same_length(void **state) {
    (void)state;
    struct cloud cloud = sphere(N);
    struct pipeline_result result = {0};
    char settings[128];
    size_t a, b;
    assert_int_equal(run(&cloud, "ratio 0.1", NULL, &result, NULL), STATUS_OK);
    snprintf(settings, sizeof settings, "outputs mesh max_deviation %.17g", 0.004 * result.report.diagonal);
    assert_true(deviation_of(&cloud, settings, &a) == deviation_of(&cloud, "outputs mesh max_deviation_rel 0.004", &b));
    assert_int_equal(a, b);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

static void the_larger_count_of_two_goals_is_kept(void **state) {
    (void)state;
    struct cloud cloud = sphere(N);
    size_t alone, kept;
    deviation_of(&cloud, "outputs mesh max_deviation_rel 0.004", &alone);
    assert_in_range(alone, 100, N / 2);
    deviation_of(&cloud, "outputs mesh max_deviation_rel 0.004 ratio 0.5", &kept);
    assert_int_equal(kept, N / 2);
    deviation_of(&cloud, "outputs mesh max_deviation_rel 0.004 points 20", &kept);
    assert_in_range(kept, alone * 9 / 10, alone * 11 / 10);
    deviation_of(&cloud, "outputs cloud max_deviation_rel 1", &kept);
    assert_int_equal(kept, 1);
    deviation_of(&cloud, "outputs mesh max_deviation 1e300", &kept);
    assert_int_equal(kept, 4);
    cloud_done(&cloud);
}

static void what_all_points_do_not_hold_is_refused(void **state) {
    (void)state;
    struct cloud cloud = sphere(500), few = sphere(3);
    struct pipeline_result result = {0};
    struct error error = {0};
    assert_int_equal(run(&cloud, "max_deviation 1e-9 outputs mesh placement optimal", NULL, &result, &error),
                     STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "max_deviation");
    assert_non_null(strstr(error.text, "with all 500 points kept"));
    assert_int_equal(run(&cloud, "max_deviation_rel 1e-9 outputs mesh placement optimal", NULL, &result, &error),
                     STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "max_deviation_rel");
    assert_int_equal(run(&few, "max_deviation 1 outputs mesh", NULL, &result, &error), STATUS_DEGENERATE);
    assert_null(result.kept);
    cloud_done(&cloud), cloud_done(&few);
}

/* Whatever the search found: what the finished result is off by decides. */
static void a_result_that_is_further_off_is_none(void **state) {
    (void)state;
    struct params params;
    struct error error = {0};
    params_defaults(&params);
    params.max_deviation = 1;
    struct run *run = calloc(1, sizeof *run);
    run->params = &params, run->error = &error;
    for (int follows = 0; follows < 2; follows++) {
        run->mesh_follows = follows;
        double *reached = follows ? &run->report.level[0].input_to_mesh.max : &run->report.level[0].tangent.max;
        *reached = 1;
        assert_int_equal(pipeline_verify(run), STATUS_OK);
        assert_true(run->report.deviation.bound == 1 && run->report.deviation.reached == 1);
        *reached = 1.001;
        assert_int_equal(pipeline_verify(run), STATUS_ENGINE);
        assert_non_null(strstr(error.text, "the result is 1.001 from the input"));
        *reached = NAN;
        assert_int_equal(pipeline_verify(run), STATUS_ENGINE);
    }
    free(run);
}

static int never_back(void *ctx, const char *stage, double fraction) {
    double *last = ctx;
    assert_true(fraction >= *last && fraction <= 1);
    *last = fraction;
    return strcmp(stage, "search") == 0 && fraction > 0.5;
}

static void it_tells_its_progress_and_can_be_cancelled(void **state) {
    (void)state;
    struct cloud cloud = sphere(N);
    struct pipeline_result result = {0};
    double fraction = 0;
    struct progress progress = {never_back, &fraction};
    assert_int_equal(run(&cloud, "max_deviation_rel 0.001 outputs mesh threads 2", &progress, &result, NULL),
                     STATUS_CANCELLED);
    assert_null(result.kept);
    cloud_done(&cloud);
}

static bool fails_at_zero(void *ctx) { return (*(int *)ctx)-- == 0; }

static void allocations_may_fail_while_it_searches(void **state) {
    (void)state;
    struct cloud cloud = sphere(60);
    enum status status = STATUS_NO_MEMORY;
    int failed = 0;
    for (int nth = 0; status; nth += 23) {
        struct pipeline_result result = {0};
        struct error error = {0};
        int countdown = nth;
        alloc_fail_ctx = &countdown, alloc_fail = fails_at_zero;
        status = run(&cloud, "max_deviation_rel 0.05 outputs mesh threads 1", NULL, &result, &error);
        alloc_fail = NULL;
        bool met = countdown < 0;
        assert_int_equal(status, met ? STATUS_NO_MEMORY : STATUS_OK);
        failed += met;
        pipeline_result_done(&result);
    }
    assert_true(failed > 20);
    cloud_done(&cloud);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_bound_holds_and_fewer_points_break_it),
        cmocka_unit_test(a_fraction_of_the_diagonal_is_the_same_length),
        cmocka_unit_test(the_larger_count_of_two_goals_is_kept),
        cmocka_unit_test(what_all_points_do_not_hold_is_refused),
        cmocka_unit_test(a_result_that_is_further_off_is_none),
        cmocka_unit_test(it_tells_its_progress_and_can_be_cancelled),
        cmocka_unit_test(allocations_may_fail_while_it_searches),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
