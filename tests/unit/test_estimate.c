/* Estimates: nothing is claimed without measurements, sizes far apart teach nothing, outliers don't count.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/estimate.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

static struct job job_of(uint64_t points, double ratio) {
    struct job job = {.input_points = points, .input_bytes = 12 * points, .input_format = "ply/ascii"};
    params_defaults(&job.params);
    job.params.ratio = ratio;
    return job;
}

static double expected(struct estimate *estimate, const struct job *job) {
    struct job_cost cost = estimate_cost(job);
    return estimate_seconds(estimate, &cost);
}

static void learn(struct estimate *estimate, const struct job *job, double seconds, int64_t at) {
    struct job_cost cost = estimate_cost(job);
    estimate_learn(estimate, &cost, seconds, at);
}

static void unknown_until_measured(void **state) {
    struct estimate *estimate = estimate_new();
    struct job job = job_of(1000, 0.1), twice = job_of(2000, 0.1), far = job_of(5000, 0.1);
    (void)state;
    assert_true(isnan(expected(estimate, &job)));
    learn(estimate, &job, 1, 1);
    learn(estimate, &job, 0, 2); /* measured nothing */
    assert_true(isnan(expected(estimate, &job)));
    learn(estimate, &job, 3, 3);
    assert_float_equal(expected(estimate, &job), 2, 1e-9);
    assert_float_equal(expected(estimate, &twice), 4, 1e-9);
    assert_true(isnan(expected(estimate, &far)));
    estimate_free(estimate);
}

static void only_work_makes_a_kind(void **state) {
    struct estimate *estimate = estimate_new();
    struct job job = job_of(1000, 0.1), seeded = job, mesh = job, finer = job_of(1000, 0.4), text = job;
    (void)state;
    for (int i = 0; i < 3; i++) learn(estimate, &job, 1, i);
    seeded.params.seed = 7;
    seeded.params.threads = 3;
    mesh.params.outputs |= OUTPUT_MESH;
    snprintf(text.input_format, sizeof text.input_format, "xyz");
    assert_float_equal(expected(estimate, &seeded), 1, 1e-9);
    assert_true(isnan(expected(estimate, &mesh)));
    assert_true(isnan(expected(estimate, &finer)));
    assert_true(isnan(expected(estimate, &text)));
    estimate_free(estimate);
}

static void the_latest_count_and_outliers_do_not(void **state) {
    struct estimate *estimate = estimate_new();
    struct job job = job_of(1000, 0.1);
    (void)state;
    for (int i = 0; i < 16; i++) learn(estimate, &job, 1, 100 + i);
    learn(estimate, &job, 900, 200);
    learn(estimate, &job, 900, 3); /* older than all that is known */
    assert_float_equal(expected(estimate, &job), 1, 1e-9);
    for (int i = 0; i < 16; i++) learn(estimate, &job, 2, 300 + i);
    assert_float_equal(expected(estimate, &job), 2, 1e-9);
    estimate_free(estimate);
}

static void old_kinds_give_way(void **state) {
    struct estimate *estimate = estimate_new();
    (void)state;
    for (int i = 0; i < 200; i++) {
        struct job job = job_of(1000, 0.1);
        job.params.neighbours_max = 10;
        job.params.neighbourhood = 1 + i * 0.01;
        learn(estimate, &job, 1, i);
        learn(estimate, &job, 1, i);
        assert_float_equal(expected(estimate, &job), 1, 1e-9);
    }
    estimate_free(estimate);
}

static void workers_are_given_jobs_as_they_become_free(void **state) {
    double busy[2] = {3, 1};
    (void)state;
    assert_float_equal(estimate_assign(busy, 2, 5), 6, 0);
    assert_float_equal(estimate_assign(busy, 2, 1), 4, 0);
    assert_true(isnan(estimate_assign(busy, 2, NAN)));
    assert_true(isnan(estimate_assign(busy, 2, 1)));
}

static void what_takes_longer_than_expected_goes_by_its_own_pace(void **state) {
    (void)state;
    assert_float_equal(estimate_rest(10, 4, 0.9), 6, 0);
    assert_float_equal(estimate_rest(10, 20, 0.5), 20, 0);
    assert_float_equal(estimate_rest(NAN, 20, 0.8), 5, 1e-9);
    assert_true(isnan(estimate_rest(10, 20, 0.1)));
    assert_true(isnan(estimate_rest(NAN, 1, 0)));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(unknown_until_measured),
        cmocka_unit_test(only_work_makes_a_kind),
        cmocka_unit_test(the_latest_count_and_outliers_do_not),
        cmocka_unit_test(old_kinds_give_way),
        cmocka_unit_test(workers_are_given_jobs_as_they_become_free),
        cmocka_unit_test(what_takes_longer_than_expected_goes_by_its_own_pace),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
