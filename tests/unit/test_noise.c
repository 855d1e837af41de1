/* The level of noise that is found is the one that was added.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/clean/noise.h"
#include "core/simplify/normals.h"
#include "core/spatial/knn.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { WIDE = 90, N = WIDE * WIDE };

static double gauss(uint64_t *seed) {
    return sqrt(-2 * log(1 - random_unit(seed))) * cos(2 * M_PI * random_unit(seed));
}

/* Points somewhat off a grid over a field, or of a sphere, with noise across the surface; *spacing = of the grid. */
static vec3 *make(bool sphere, double noise, double outliers, double *spacing) {
    uint64_t seed = 5;
    *spacing = sphere ? sqrt(4 * M_PI * 0.25 / N) : 1.0 / WIDE;
    vec3 *point = sphere ? shape_sphere(N, 0.5) : calloc(N, sizeof *point);
    for (size_t i = 0; i < N; i++) {
        double by = noise * *spacing * gauss(&seed);
        if (random_unit(&seed) < outliers) by = random_unit(&seed) - 0.5;
        if (sphere) {
            point[i] = vec3_scale(point[i], 1 + by / 0.5);
            continue;
        }
        double x = ((double)(i % WIDE) + 0.6 * random_unit(&seed)) / WIDE;
        double y = ((double)i / WIDE + 0.6 * random_unit(&seed)) / WIDE;
        point[i] = (vec3){x, y, 0.05 * sin(6 * x) * cos(5 * y) + by};
    }
    return point;
}

static double level_of(const vec3 *point) {
    struct knn *knn = NULL;
    struct neighbourhood neighbours = {0};
    struct neighbourhood_options options = {2.5, 6, 10, 1};
    vec3 *normal = calloc(N, sizeof *normal);
    double level = -1;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, N, &options, &neighbours), STATUS_OK);
    normals_fit(point, &neighbours, 1, normal, NULL);
    assert_int_equal(noise_estimate(point, normal, &neighbours, &level), STATUS_OK);
    for (int nth = 1; nth <= 2; nth++) {
        double untouched = level;
        faults_in_memory(nth, false);
        assert_int_equal(noise_estimate(point, normal, &neighbours, &untouched), STATUS_NO_MEMORY);
        assert_true(faults_stop() && untouched == level);
    }
    knn_free(knn);
    neighbourhood_done(&neighbours);
    free(normal);
    return level;
}

static void the_level_is_the_one_that_was_added(void **state) {
    (void)state;
    static const double levels[] = {0, 0.05, 0.1, 0.2, 0.4};
    for (int sphere = 0; sphere < 2; sphere++)
        for (size_t i = 0; i < sizeof levels / sizeof *levels; i++) {
            double spacing;
            vec3 *point = make(sphere, levels[i], 0, &spacing);
            double found = level_of(point) / spacing;
            if (fabs(found - levels[i]) > 0.25 * levels[i] + 0.02)
                fail_msg("%s: %g spacings of noise, found %g", sphere ? "sphere" : "field", levels[i], found);
            free(point);
        }
}

static void outliers_hardly_count(void **state) {
    (void)state;
    double spacing;
    vec3 *point = make(false, 0.1, 0.02, &spacing);
    double found = level_of(point) / spacing;
    if (fabs(found - 0.1) > 0.05) fail_msg("found %g", found);
    free(point);
}

static double least_of(const vec3 *point, size_t n) {
    struct knn *knn = NULL;
    double share = -1;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(noise_where_least(knn, point, n, 1, &share), STATUS_OK);
    for (int nth = 1; nth <= 4; nth++) {
        double untouched = share;
        faults_in_memory(nth, false);
        enum status status = noise_where_least(knn, point, n, 1, &untouched);
        if (faults_stop()) assert_true(status == STATUS_NO_MEMORY && untouched == share);
    }
    knn_free(knn);
    return share;
}

static void exact_points_are_off_nothing_where_the_surface_is_evenly_bent(void **state) {
    (void)state;
    for (int sphere = 0; sphere < 2; sphere++)
        for (int noisy = 0; noisy < 2; noisy++) {
            double spacing;
            vec3 *point = make(sphere, noisy ? 0.02 : 0, 0, &spacing);
            double found = least_of(point, N);
            if (noisy ? found < 0.01 || found > 0.02 : found > 0.002)
                fail_msg("%s: found %g", sphere ? "sphere" : "field", found);
            free(point);
        }
}

static void points_too_few_or_in_a_line_tell_of_no_noise_or_of_any(void **state) {
    (void)state;
    vec3 point[40];
    for (int i = 0; i < 40; i++) point[i] = (vec3){i, 2 * i, 0};
    assert_true(least_of(point, 16) == 1);
    assert_true(least_of(point, 40) < 1e-9);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exact_points_are_off_nothing_where_the_surface_is_evenly_bent),
        cmocka_unit_test(points_too_few_or_in_a_line_tell_of_no_noise_or_of_any),
        cmocka_unit_test(the_level_is_the_one_that_was_added),
        cmocka_unit_test(outliers_hardly_count),
    };
    return cmocka_run_group_tests_name("noise", tests, NULL, NULL);
}
