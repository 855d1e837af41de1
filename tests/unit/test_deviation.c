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
        assert_in_range(report->deviation.tried, 1, 8);
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
    assert_non_null(strstr(error.text, "with all 500 points kept, "));
    assert_non_null(strstr(error.text, " are still farther from the mesh than 1e-09, up to "));
    assert_non_null(strstr(error.text, "; use max_deviation="));
    assert_int_equal(run(&cloud, "max_deviation_rel 1e-9 outputs mesh placement optimal", NULL, &result, &error),
                     STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "max_deviation_rel");
    assert_int_equal(run(&few, "max_deviation 1 outputs mesh", NULL, &result, &error), STATUS_DEGENERATE);
    assert_null(result.kept);
    cloud_done(&cloud), cloud_done(&few);
}

/* What would do is told where a bound can't be held. */
static void what_is_told_to_hold_does(void **state) {
    (void)state;
    struct cloud cloud = sphere(500);
    struct pipeline_result result = {0};
    struct error error = {0};
    static const char always[] = "outputs mesh placement optimal denoise outliers";
    char settings[128];
    double bound, share;
    snprintf(settings, sizeof settings, "max_deviation 1e-9 %s", always);
    assert_int_equal(run(&cloud, settings, NULL, &result, &error), STATUS_BAD_PARAMETER);
    const char *use = strstr(error.text, "use ");
    assert_int_equal(sscanf(use, "use max_deviation=%lf, deviation_share=%lf", &bound, &share), 2);
    assert_null(strstr(error.text, "denoise"));
    snprintf(settings, sizeof settings, "max_deviation %g %s", bound, always);
    assert_int_equal(run(&cloud, settings, NULL, &result, &error), STATUS_OK);
    pipeline_result_done(&result);
    snprintf(settings, sizeof settings, "max_deviation 1e-9 deviation_share %g %s", share, always);
    assert_int_equal(run(&cloud, settings, NULL, &result, &error), STATUS_OK);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* A bound that only all points hold is told from two results. */
static void a_tiny_bound_takes_few_trials(void **state) {
    (void)state;
    struct cloud cloud = sphere(N);
    struct pipeline_result result = {0};
    assert_int_equal(run(&cloud, "max_deviation 1e-300 outputs mesh denoise none", NULL, &result, NULL), STATUS_OK);
    assert_int_equal(result.level[0].kept_count, N);
    assert_in_range(result.report.deviation.tried, 1, 2);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

static size_t count_over(const float *distance, size_t n, double bound) {
    size_t over = 0;
    for (size_t i = 0; i < n; i++) over += (double)distance[i] > bound;
    return over;
}

/* Points farther than the bound are as many as are told and no more than allowed, and fewer are kept than for all. */
static void a_share_of_the_points_is_held(void **state) {
    (void)state;
    static const char *const outputs[] = {"error", "preview.png preview_size 64"};
    struct cloud cloud = sphere(N);
    for (size_t i = 0; i < 2; i++) {
        struct pipeline_result all = {0}, most = {0};
        char settings[128];
        snprintf(settings, sizeof settings, "max_deviation 0.1 denoise none outputs %s", outputs[i]);
        assert_int_equal(run(&cloud, settings, NULL, &all, NULL), STATUS_OK);
        snprintf(settings, sizeof settings, "max_deviation 0.1 deviation_share 0.9 denoise none outputs %s",
                 outputs[i]);
        assert_int_equal(run(&cloud, settings, NULL, &most, NULL), STATUS_OK);
        const struct report_deviation *deviation = &most.report.deviation;
        size_t over = count_over(most.distance, N, 0.1);
        assert_in_range(over, 1, N / 10);
        assert_int_equal(deviation->points_over, over);
        assert_true(deviation->share == 0.9 && deviation->reached <= 0.1);
        assert_in_range(count_over(most.distance, N, deviation->reached), N / 10 - 1, N / 10);
        assert_true(most.level[0].kept_count < all.level[0].kept_count);
        assert_int_equal(all.report.deviation.points_over, 0);
        pipeline_result_done(&all), pipeline_result_done(&most);
    }
    cloud_done(&cloud);
}

/* What a mesh of the sphere would have spikes of isn't held, and that is told; with denoise=none it is. */
static void strays_are_dropped_and_not_held(void **state) {
    (void)state;
    enum { STRAYS = 8 };
    struct cloud cloud = sphere(N);
    for (size_t i = 0; i < STRAYS; i++)
        cloud.position[i * N / STRAYS] = vec3_scale(cloud.position[i * N / STRAYS], 1.7 + 0.03 * (double)i);
    struct pipeline_result result = {0};
    char warning[REPORT_WARNING_BYTES];
    bool told = false;
    assert_int_equal(run(&cloud, "max_deviation 0.2 outputs mesh,error", NULL, &result, NULL), STATUS_OK);
    assert_int_equal(result.report.points_outliers, STRAYS);
    const struct distance_stats *dropped = &result.report.level[0].dropped;
    assert_true(result.report.level[0].mesh_to_input.max < 0.5);
    assert_int_equal(dropped->count, STRAYS);
    assert_true(fabs(dropped->max - 0.91 * RADIUS) < 0.2 && fabs(dropped->mean - 0.805 * RADIUS) < 0.2);
    for (size_t i = 0; i < STRAYS; i++)
        assert_true(fabs((double)result.distance[i * N / STRAYS] - (0.7 + 0.03 * (double)i) * RADIUS) < 0.2);
    for (size_t i = 0; report_warning(&result.report, &result.report.level[0], i, warning, sizeof warning); i++)
        told |= strstr(warning, "nor bounded") != NULL;
    assert_true(told);
    pipeline_result_done(&result);
    assert_int_equal(run(&cloud, "max_deviation 0.2 outputs mesh denoise none", NULL, &result, NULL), STATUS_OK);
    assert_int_equal(result.report.points_outliers, 0);
    assert_int_equal(result.report.level[0].dropped.count, 0);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* Far less exact points than the distance between them are held where they came. */
static void no_bounded_point_is_moved(void **state) {
    (void)state;
    struct cloud cloud = sphere(6 * N);
    struct pipeline_result result = {0};
    uint64_t seed = 1;
    for (size_t i = 0; i < cloud.count; i++)
        cloud.position[i] = vec3_scale(cloud.position[i], 1 + 0.05 * (random_unit(&seed) - 0.5));
    assert_int_equal(run(&cloud, "ratio 0.1 outputs mesh", NULL, &result, NULL), STATUS_OK);
    assert_non_null(result.moved);
    pipeline_result_done(&result);
    assert_int_equal(run(&cloud, "max_deviation 1 outputs mesh", NULL, &result, NULL), STATUS_OK);
    assert_null(result.moved);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* A mesh that spans what has no points is told of, if it is bounded. */
static void what_a_bounded_mesh_spans_is_told(void **state) {
    (void)state;
    struct report report = {.deviation = {.bound = 1}};
    struct report_level level = {.has_mesh = true, .mesh_to_input = {.count = 9, .max = 0.9}};
    char warning[REPORT_WARNING_BYTES];
    assert_false(report_warning(&report, &level, 0, warning, sizeof warning));
    level.mesh_to_input.max = 4;
    assert_true(report_warning(&report, &level, 0, warning, sizeof warning));
    assert_non_null(strstr(warning, "the mesh is up to 4 from the points"));
    assert_false(report_warning(&report, &level, 1, warning, sizeof warning));
    report.deviation.bound = 0;
    assert_false(report_warning(&report, &level, 0, warning, sizeof warning));
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
        cmocka_unit_test(what_is_told_to_hold_does),
        cmocka_unit_test(a_tiny_bound_takes_few_trials),
        cmocka_unit_test(a_share_of_the_points_is_held),
        cmocka_unit_test(strays_are_dropped_and_not_held),
        cmocka_unit_test(no_bounded_point_is_moved),
        cmocka_unit_test(what_a_bounded_mesh_spans_is_told),
        cmocka_unit_test(a_result_that_is_further_off_is_none),
        cmocka_unit_test(it_tells_its_progress_and_can_be_cancelled),
        cmocka_unit_test(allocations_may_fail_while_it_searches),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
