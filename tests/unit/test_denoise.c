/* Outliers and noise, on shapes whose points are known without them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/clean/denoise.h"
#include "core/clean/layers.h"
#include "core/clean/outliers.h"
#include "core/clean/shell.h"
#include "core/cloud/morton.h"
#include "core/io/read.h"
#include "core/math/quantile.h"
#include "core/pipeline/pipeline.h"
#include "core/spatial/heights.h"
#include "core/spatial/neighbourhood.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

static double gauss(uint64_t *state) {
    double radius = sqrt(-2 * log(1 - random_unit(state)));
    return radius * cos(2 * M_PI * random_unit(state));
}

static void add_noise(vec3 *point, size_t n, double deviation) {
    uint64_t seed = 11;
    for (size_t i = 0; i < n; i++) {
        double x = gauss(&seed), y = gauss(&seed), z = gauss(&seed);
        point[i] = vec3_add(point[i], vec3_scale((vec3){x, y, z}, deviation));
    }
}

/* The surface of the cube -1 .. 1, side x side points on each of its six faces, with none on an edge. */
static vec3 *cube(size_t side) {
    vec3 *point = malloc(6 * side * side * sizeof *point);
    assert_non_null(point);
    for (size_t i = 0; i < 6 * side * side; i++) {
        size_t face = i / (side * side), cell = i % (side * side);
        double u = (2 * (double)(cell % side) + 1) / (double)side - 1;
        double v = (2 * (double)(cell / side) + 1) / (double)side - 1, w = face % 2 ? 1 : -1;
        point[i] = face / 2 == 0 ? (vec3){w, u, v} : face / 2 == 1 ? (vec3){v, w, u} : (vec3){u, v, w};
    }
    return point;
}

static double off_sphere(vec3 p) { return fabs(vec3_length(p) - 1); }

static double off_cube(vec3 p) { return fabs(fmax(fabs(p.x), fmax(fabs(p.y), fabs(p.z))) - 1); }

static double mean_of(double (*off)(vec3), const vec3 *point, size_t n) {
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += off(point[i]);
    return sum / (double)n;
}

static double largest_of(double (*off)(vec3), const vec3 *point, size_t n) {
    double largest = 0;
    for (size_t i = 0; i < n; i++) largest = fmax(largest, off(point[i]));
    return largest;
}

/* ------------------------------------------------------------------------------------------------ quantiles */

static void a_quantile_is_the_element_of_its_rank(void **state) {
    (void)state;
    float value[] = {5, 1, 4, 1, 3, 9, 2, 6};
    assert_true(quantile_of(value, 8, 0) == 1);
    assert_true(quantile_of(value, 8, 0.5) == 3); /* rank 3 of 1 1 2 3 4 5 6 9 */
    assert_true(quantile_of(value, 8, 1) == 9);
    float equal[100];
    for (int i = 0; i < 100; i++) equal[i] = 7;
    assert_true(quantile_of(equal, 100, 0.3) == 7);
    assert_true(quantile_of(equal, 1, 0.9) == 7);
}

static int by_value(const void *a, const void *b) {
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Few values are selected in another way than many. */
static void a_quantile_is_found_among_few_and_many_of_both_signs(void **state) {
    (void)state;
    static float value[3000], sorted[3000];
    static const size_t counts[] = {1, 2, 3, 8, 9, 16, 17, 32, 33, 128, 1000, 1024, 1025, 3000};
    uint32_t seed = 1;
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (int step = 0; step <= 20; step++) {
            size_t n = counts[c];
            for (size_t i = 0; i < n; i++) {
                seed = seed * 1664525 + 1013904223;
                sorted[i] = value[i] = (float)ldexp((double)(int32_t)(seed & 0xfff00fff), -(int)(seed >> 8 & 63));
            }
            qsort(sorted, n, sizeof *sorted, by_value);
            const double share[] = {step / 20.0, 1 - step / 20.0};
            float found[2];
            quantiles_of(value, n, share, 2, found);
            for (int k = 0; k < 2; k++) assert_true(found[k] == sorted[(size_t)floor(share[k] * (double)(n - 1))]);
            assert_true(quantile_of(value, n, share[0]) == found[0]);
        }
}

static void the_spread_leaves_values_alone(void **state) {
    (void)state;
    const float value[] = {1, 100, 3, 2, 4}, same[] = {1, 100, 3, 2, 4};
    double median, mad;
    assert_int_equal(quantile_spread(value, 5, &median, &mad), STATUS_OK);
    assert_true(median == 3 && mad == 1);
    assert_memory_equal(value, same, sizeof value);
}

/* ------------------------------------------------------------------------------------------------ outliers */

static size_t find_outliers(const vec3 *point, size_t n, unsigned threads, uint8_t *outlier) {
    struct knn *knn = NULL;
    size_t count = SIZE_MAX;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(outliers_find(knn, point, NULL, n, threads, outlier, &count, NULL), STATUS_OK);
    knn_free(knn);
    return count;
}

static vec3 *sphere_with_dust(size_t n, size_t dust) {
    vec3 *point = shape_sphere(n, 1);
    assert_non_null(point = realloc(point, (n + dust) * sizeof *point));
    uint64_t seed = 5;
    for (size_t i = n; i < n + dust; i++) {
        do point[i] = (vec3){3 * random_unit(&seed) - 1.5, 3 * random_unit(&seed) - 1.5, 3 * random_unit(&seed) - 1.5};
        while (off_sphere(point[i]) < 0.2);
    }
    return point;
}

static void dust_is_found_and_no_point_of_the_surface(void **state) {
    (void)state;
    enum { N = 5000, DUST = 250 };
    vec3 *point = sphere_with_dust(N, DUST);
    uint8_t outlier[N + DUST];
    assert_int_equal(find_outliers(point, N + DUST, 2, outlier), DUST);
    for (size_t i = 0; i < N; i++) assert_false(outlier[i]);
    free(point);
}

static void a_stray_close_above_a_surface_is_found(void **state) {
    (void)state;
    enum { SIDE = 40, N = SIDE * SIDE };
    vec3 *point = shape_height_field(SIDE, height_plane);
    assert_non_null(point = realloc(point, (N + 1) * sizeof *point));
    uint8_t outlier[N + 1];
    point[N] = (vec3){0.5, 0.5, height_plane(0.5, 0.5) + 5.0 / SIDE};
    assert_int_equal(find_outliers(point, N + 1, 1, outlier), 1);
    assert_true(outlier[N]);
    free(point);
}

/* Half a spacing off, where the distance to its neighbours is that of any other point. */
static void a_stray_amid_a_surface_is_found(void **state) {
    (void)state;
    enum { N = 5000, STRAYS = 20 }; /* the spacing is 0.05 */
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, (N + STRAYS) * sizeof *point));
    for (size_t i = 0; i < STRAYS; i++) point[N + i] = vec3_scale(point[100 + i * (N / STRAYS)], i % 2 ? 1.03 : 0.97);
    uint8_t outlier[N + STRAYS];
    assert_int_equal(find_outliers(point, N + STRAYS, 2, outlier), STRAYS);
    for (size_t i = 0; i < STRAYS; i++) assert_int_equal(outlier[N + i], OUTLIER_OFF);
    free(point);
}

/* A few points in a corner of which the scanner saw little. */
static void a_sparse_piece_is_kept_among_strays(void **state) {
    (void)state;
    enum { N = 6000, DUST = 300, PIECE = 16 };
    vec3 *point = sphere_with_dust(N, DUST);
    assert_non_null(point = realloc(point, (N + DUST + PIECE) * sizeof *point));
    for (size_t i = 0; i < PIECE; i++)
        point[N + DUST + i] = (vec3){0.1 * (double)(i % 4) - 0.15, 0.1 * (double)(i / 4) - 0.15, 1.12};
    uint8_t outlier[N + DUST + PIECE];
    find_outliers(point, N + DUST + PIECE, 1, outlier);
    size_t kept = 0;
    for (size_t i = 0; i < PIECE; i++) kept += !outlier[N + DUST + i];
    assert_true(kept > PIECE / 2);
    free(point);
}

/* A point in a box of sides 6, at least 0.3 from the unit sphere. */
static vec3 off_the_sphere_at_random(uint64_t *chance) {
    vec3 point;
    do {
        vec3 x = {random_unit(chance), random_unit(chance), random_unit(chance)};
        point = vec3_scale(vec3_sub(x, (vec3){0.5, 0.5, 0.5}), 6);
    } while (off_sphere(point) < 0.3);
    return point;
}

/* Strays near what little a scanner saw through a gap are as far from each other as these few points from the rest. */
static void a_few_points_far_away_let_no_strays_stay(void **state) {
    (void)state;
    enum { N = 20000, DUST = 900, ISLANDS = 6, FEW = 6, ALL = N + DUST + ISLANDS * FEW };
    size_t kept = 0;
    for (uint64_t seed = 1; seed <= 12; seed++) {
        uint64_t chance = seed * 7919;
        vec3 *point = shape_sphere(N, 1);
        uint8_t *outlier = malloc(ALL);
        assert_non_null(point = realloc(point, ALL * sizeof *point));
        assert_non_null(outlier);
        for (size_t i = N; i < N + DUST; i++) point[i] = off_the_sphere_at_random(&chance);
        for (size_t i = 0; i < (size_t)ISLANDS * FEW; i++) {
            size_t island = i / FEW;
            vec3 at = {island & 1 ? 2 : -2, island & 2 ? 2 : -2, island & 4 ? 2 : -2};
            vec3 beside = {0.06 * random_unit(&chance), 0.06 * random_unit(&chance), 0};
            point[N + DUST + i] = vec3_add(at, beside);
        }
        find_outliers(point, ALL, 2, outlier);
        for (size_t i = N; i < N + DUST; i++) kept += !outlier[i];
        free(point), free(outlier);
    }
    assert_true(kept <= 6 * DUST / 100);
}

/* Of thousands of strays some are by chance as near to four others as points of a sparse piece are. */
static void strays_that_are_near_others_by_chance_are_found(void **state) {
    (void)state;
    enum { N = 60000, DUST = 6000 }; /* the spacing is 0.0145 */
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, (N + DUST) * sizeof *point));
    uint64_t seed = 5;
    for (size_t i = N; i < N + DUST; i++) {
        vec3 x = {random_unit(&seed), random_unit(&seed), random_unit(&seed)};
        point[i] = vec3_scale(vec3_sub(x, (vec3){0.5, 0.5, 0.5}), 2.4);
    }
    uint8_t *outlier = malloc(N + DUST);
    assert_non_null(outlier);
    find_outliers(point, N + DUST, 2, outlier);
    for (size_t i = N; i < N + DUST; i++)
        if (off_sphere(point[i]) > 0.03) assert_true(outlier[i]);
    free(point), free(outlier);
}

static struct stray_shares estimate(const vec3 *point, size_t n, unsigned threads) {
    struct knn *knn = NULL;
    struct stray_shares shares = {NAN, NAN};
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(outliers_estimate(knn, point, NULL, n, threads, NULL, &shares), STATUS_OK);
    knn_free(knn);
    return shares;
}

/* By what the search for shells has found. */
static struct stray_shares estimate_after_shells(const vec3 *point, size_t n) {
    static struct shell_near near;
    struct knn *knn = NULL;
    struct stray_shares shares = {NAN, NAN};
    double share;
    bool known;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(shell_find(knn, point, n, 2, &share, &near, &known), STATUS_OK);
    assert_int_equal(known, n >= SHELL_PLACES);
    assert_int_equal(outliers_estimate(knn, point, NULL, n, 2, known ? &near : NULL, &shares), STATUS_OK);
    knn_free(knn);
    return shares;
}

static void assert_same_shares(struct stray_shares a, struct stray_shares b) { assert_memory_equal(&a, &b, sizeof a); }

/* Of clouds around the least that is looked at in so many places, without strays and with few and many. */
static void strays_are_the_same_after_shells(void **state) {
    (void)state;
    static const size_t of[][2] = {{SHELL_PLACES - 1, 0}, {SHELL_PLACES, 0}, {3001, 4}, {20011, 0}, {20000, 1000}};
    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        struct ordered_points ordered = {0};
        vec3 *point = sphere_with_dust(of[i][0], of[i][1]);
        size_t n = of[i][0] + of[i][1];
        assert_int_equal(order_points(point, n, 1, &ordered), STATUS_OK);
        assert_same_shares(estimate_after_shells(ordered.point, n), estimate(ordered.point, n, 1));
        ordered_points_done(&ordered);
        free(point);
    }
}

static void many_strays_are_told_by_some_places(void **state) {
    (void)state;
    enum { N = 20000, DUST = 1000, SIDE = 40 };
    vec3 *point = sphere_with_dust(N, DUST), *corners = cube(SIDE);
    struct ordered_points ordered = {0};
    assert_int_equal(order_points(point, N + DUST, 1, &ordered), STATUS_OK);
    struct stray_shares shares = estimate(ordered.point, N + DUST, 1), again = estimate(ordered.point, N + DUST, 5);
    assert_true(shares.far > OUTLIERS_MANY && shares.far < 0.05);
    assert_true(shares.far == again.far && shares.alone == again.alone);
    assert_true(estimate(point, N, 1).far == 0);
    assert_true(estimate(point, OUTLIERS_MIN_POINTS - 1, 1).far == 0);
    assert_true(estimate(corners, 6 * SIDE * SIDE, 1).far < OUTLIERS_MANY / 4);
    ordered_points_done(&ordered);
    free(point), free(corners);
}

static void few_strays_are_told_by_how_far_off_they_are(void **state) {
    (void)state;
    enum { N = 20000, DUST = 200 };
    vec3 *point = sphere_with_dust(N, DUST);
    struct ordered_points ordered = {0};
    assert_int_equal(order_points(point, N + DUST, 1, &ordered), STATUS_OK);
    struct stray_shares shares = estimate(ordered.point, N + DUST, 1);
    assert_true(shares.far < OUTLIERS_MANY && shares.alone > OUTLIERS_ALONE && shares.alone <= shares.far);
    ordered_points_done(&ordered);
    for (size_t i = N; i < N + DUST; i++) /* a few spacings off, as leaves are */
        point[i] = vec3_scale(point[i - N], 1.08 + 0.1 * (double)(i % 7) / 7);
    assert_int_equal(order_points(point, N + DUST, 1, &ordered), STATUS_OK);
    assert_true(estimate(ordered.point, N + DUST, 1).alone < OUTLIERS_ALONE);
    ordered_points_done(&ordered);
    free(point);
}

/* Of points in their order; how many stand off. */
static size_t survey(const vec3 *point, size_t n, unsigned threads, uint8_t *off, size_t *scattered) {
    const struct neighbourhood_options options = {.radius = 3, .min = 8, .max = 16, .threads = threads};
    struct neighbourhood neighbours = {0};
    struct knn *knn = NULL;
    size_t count = SIZE_MAX;
    assert_int_equal(knn_new(point, n, threads, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, n, &options, &neighbours), STATUS_OK);
    assert_int_equal(outliers_survey(point, NULL, &neighbours, threads, off, &count, scattered), STATUS_OK);
    neighbourhood_done(&neighbours);
    knn_free(knn);
    return count;
}

/* A ball of which a cap is sampled at a twelfth of the distances. */
static void who_was_sampled_by_need_has_no_strays(void **state) {
    (void)state;
    enum { FINE = 20000, COARSE = 130 };
    vec3 *fine = shape_sphere(FINE, 1), *point = shape_sphere(COARSE, 1);
    size_t n = 0;
    assert_non_null(point = realloc(point, (FINE + COARSE) * sizeof *point));
    for (size_t i = 0; i < COARSE; i++)
        if (point[i].z < 0.93) point[n++] = point[i];
    assert_true(n > 100);
    for (size_t i = 0; i < FINE; i++)
        if (fine[i].z >= 0.93) point[n++] = fine[i];
    struct stray_shares shares = estimate(point, n, 1);
    assert_true(shares.far == 0 && shares.alone == 0);
    free(fine), free(point);
}

static void single_strays_are_told_by_all_neighbourhoods(void **state) {
    (void)state;
    enum { N = 20000, STRAYS = 4, LEAVES = 200 };
    static uint8_t off[N + LEAVES], again[N + LEAVES];
    vec3 *point = shape_sphere(N, 1);
    size_t scattered;
    assert_non_null(point = realloc(point, (N + LEAVES) * sizeof *point));
    assert_int_equal(survey(point, N, 1, off, &scattered), 0);
    assert_int_equal(scattered, 0);
    for (size_t i = 0; i < STRAYS; i++) point[N + i] = vec3_scale(point[i * N / STRAYS], 1.5 + 0.4 * (double)i);
    for (size_t strays = 1; strays <= STRAYS; strays++) {
        assert_int_equal(survey(point, N + strays, 1, off, &scattered), strays);
        assert_int_equal(scattered, strays);
        for (size_t i = 0; i < N + strays; i++) assert_int_equal(off[i], i >= N);
    }
    assert_int_equal(survey(point, N + STRAYS, 5, again, &scattered), STRAYS);
    assert_memory_equal(off, again, N + STRAYS);
    for (size_t i = N; i < N + LEAVES; i++) point[i] = vec3_scale(point[i - N], 1.08 + 0.1 * (double)(i % 7) / 7);
    assert_int_equal(survey(point, N + LEAVES, 1, off, &scattered), 0);
    assert_int_equal(scattered, 0);
    enum { FEW = 500 };
    for (size_t i = 0; i < FEW; i++) point[i] = point[i * N / FEW];
    point[FEW] = (vec3){0, 0, 9};
    assert_int_equal(survey(point, FEW + 1, 1, off, &scattered), 0);
    assert_int_equal(scattered, 0);
    free(point);
}

/* ------------------------------------------------------------------------------------------------ layers */

static size_t find_layers(const vec3 *point, size_t n, unsigned threads, uint8_t *outlier) {
    struct knn *knn = NULL;
    struct planes *planes = NULL;
    size_t count = SIZE_MAX;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(outliers_find(knn, point, NULL, n, threads, outlier, &count, &planes), STATUS_OK);
    assert_int_equal(layers_find(point, NULL, n, threads, planes, outlier, &count), STATUS_OK);
    planes_free(planes);
    knn_free(knn);
    return count;
}

static void assert_same_offsets(const struct offsets *a, const struct offsets *b, size_t n) {
    const float *each[][2] = {{a->second, b->second},    {a->third, b->third}, {a->quarter, b->quarter},
                              {a->usual, b->usual},      {a->rough, b->rough}, {a->radius, b->radius},
                              {a->sparsity, b->sparsity}};
    for (size_t i = 0; i < sizeof each / sizeof *each; i++)
        assert_memory_equal(each[i][0], each[i][1], n * sizeof(float));
}

/* Trust that is lost and won back, at points here and there, few or many, and at half of all. */
static void offsets_are_the_same_whoever_was_trusted_before(void **state) {
    (void)state;
    enum { N = 6000, TIMES = 9 };
    vec3 *point = sphere_with_dust(N - 100, 100);
    add_noise(point, N - 100, 0.05);
    uint8_t *trusted = malloc(N);
    struct knn *knn = NULL;
    struct planes *kept = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(planes_new(knn, point, N, 2, &kept), STATUS_OK);
    for (size_t time = 0; time < TIMES; time++) {
        static const size_t loses[TIMES] = {N, 50, 70, 2, 50, N, 1000, 500, 1000};
        const struct offsets *again = NULL, *fresh = NULL;
        struct planes *own = NULL;
        for (size_t p = 0; p < N; p++) trusted[p] = p % loses[time] != time;
        assert_int_equal(planes_measure(kept, trusted, 2, &again), STATUS_OK);
        assert_int_equal(planes_new(knn, point, N, 1, &own), STATUS_OK);
        assert_int_equal(planes_measure(own, trusted, 1, &fresh), STATUS_OK);
        assert_same_offsets(again, fresh, N);
        planes_free(own);
    }
    planes_free(kept);
    knn_free(knn);
    free(trusted), free(point);
}

/* Neighbours of a point that were looked for among all that are trusted, by what they are called there. */
static void assert_near_are(const struct planes *planes, const uint8_t *trusted, const vec3 *point, size_t n) {
    enum { K = OFFSETS_K + 1 };
    vec3 *left = malloc(n * sizeof *left);
    uint32_t *name = malloc(n * sizeof *name), *found = malloc(n * K * sizeof *found);
    double *distance_sq = malloc(n * K * sizeof *distance_sq);
    size_t count = 0;
    struct knn *knn = NULL;
    for (size_t p = 0; p < n; p++)
        if (trusted[p]) name[count] = (uint32_t)p, left[count++] = point[p];
    assert_int_equal(knn_new(left, count, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(knn_search(knn, point, n, K, 1, found, distance_sq), STATUS_OK);
    for (size_t p = 0; p < n; p++)
        for (unsigned i = 0, taken = 0; i < K && taken < OFFSETS_K; i++)
            if (name[found[p * K + i]] != p) assert_int_equal(planes_near(planes, p)[taken++], name[found[p * K + i]]);
    knn_free(knn);
    free(left), free(name), free(found), free(distance_sq);
}

/* Here and there, and in all of a place, where no trusted point is among the nearest of all, for many or for a few
 * (looked for in other ways); and again the same. */
static void neighbours_are_those_that_are_trusted(void **state) {
    (void)state;
    enum { N = 3000 };
    vec3 *point = shape_sphere(N, 1);
    uint8_t *trusted = malloc(N);
    struct knn *knn = NULL;
    struct planes *planes = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(planes_new(knn, point, N, 2, &planes), STATUS_OK);
    static const double top[] = {2, 0.7, 2, 0.95, 0.95, 2};
    for (size_t time = 0; time < sizeof top / sizeof *top; time++) {
        for (size_t p = 0; p < N; p++) trusted[p] = (time > 0 || p % 7 > 0) && point[p].z < top[time];
        assert_int_equal(planes_trust(planes, trusted, 2), STATUS_OK);
        assert_near_are(planes, trusted, point, N);
    }
    planes_free(planes);
    knn_free(knn);
    free(trusted), free(point);
}

static void doubles_that_are_less_exact_go(void **state) {
    (void)state;
    enum { N = 6000 }; /* the spacing is 0.046 */
    vec3 *point = shape_sphere(N, 1), *doubled = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, 2 * N * sizeof *point));
    add_noise(doubled, N, 0.015);
    memcpy(&point[N], doubled, N * sizeof *point);
    static uint8_t outlier[2 * N], again[2 * N];
    assert_true(find_layers(point, 2 * N, 1, outlier) > N / 2);
    size_t lost = 0;
    double before = 0, after = 0;
    for (size_t i = 0; i < N; i++) lost += outlier[i] != 0;
    for (size_t i = 0; i < 2 * N; i++) {
        before += off_sphere(point[i]);
        after += outlier[i] ? 0 : off_sphere(point[i]);
    }
    assert_true(lost < N / 20);
    assert_true(after < before / 8);
    find_layers(point, 2 * N, 5, again);
    assert_memory_equal(outlier, again, sizeof outlier);
    free(point), free(doubled);
}

static double estimate_layers(const vec3 *point, size_t n, unsigned threads) {
    struct knn *knn = NULL;
    double share = -1;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(layers_estimate(knn, point, n, threads, &share), STATUS_OK);
    knn_free(knn);
    return share;
}

/* Of doubles of a third of the points; of few points nothing is said. */
static void some_patches_tell_of_doubles(void **state) {
    (void)state;
    enum { N = 12000, DOUBLES = N / 3, ALL = N + DOUBLES, FEW = 3000 };
    vec3 *point = shape_sphere(N, 1), *noisy = shape_sphere(N, 1);
    add_noise(noisy, N, 0.002);
    assert_true(estimate_layers(point, N, 1) < 0.01 && estimate_layers(noisy, N, 1) < 0.03);
    assert_non_null(point = realloc(point, ALL * sizeof *point));
    for (size_t i = 0; i < DOUBLES; i++) point[N + i] = point[3 * i];
    add_noise(&point[N], DOUBLES, 0.01);
    double share = estimate_layers(point, ALL, 1);
    assert_true(share > LAYERS_MANY && share < (double)DOUBLES / ALL);
    assert_true(estimate_layers(point, ALL, 5) == share);
    assert_true(estimate_layers(&point[ALL - FEW], FEW, 1) == 0);
    free(point), free(noisy);
}

/* Where the more exact layer has details as small as its neighbourhoods they are off their neighbours' planes, but by
 * less than doubles are. */
static void details_beside_doubles_stay(void **state) {
    (void)state;
    enum { N = 20000 }; /* the spacing is 0.025, a detail 0.16 wide */
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, 2 * N * sizeof *point));
    for (size_t i = 0; i < N; i++)
        point[i] = vec3_scale(point[i], 1 + 0.01 * sin(40 * point[i].x) * sin(40 * point[i].y));
    memcpy(&point[N], point, N * sizeof *point);
    add_noise(&point[N], N, 0.02);
    static uint8_t outlier[2 * N];
    assert_true(find_layers(point, 2 * N, 2, outlier) > N / 2);
    size_t lost = 0;
    for (size_t i = 0; i < N; i++) lost += outlier[i] != 0;
    assert_true(lost < N / 200);
    free(point);
}

/* Details that are dropped too, and are off by less, don't make the farthest doubles strays: as such they would stay
 * for the company of each other. */
static void the_farthest_doubles_go_amid_details_and_strays(void **state) {
    (void)state;
    enum { N = 24000, DOUBLES = N / 3, DUST = N / 20, ALL = N + DOUBLES + DUST };
    vec3 *point = sphere_with_dust(N, DUST);
    assert_non_null(point = realloc(point, ALL * sizeof *point));
    for (size_t i = 0; i < N; i++)
        point[i] = vec3_scale(point[i], 1 + 0.006 * sin(70 * point[i].x) * sin(70 * point[i].y) * sin(70 * point[i].z));
    for (size_t i = 0; i < DOUBLES; i++) point[N + DUST + i] = point[3 * i];
    add_noise(&point[N + DUST], DOUBLES, 0.03);
    static uint8_t outlier[ALL];
    size_t far = 0, kept = 0, lost = 0;
    assert_true(find_layers(point, ALL, 2, outlier) > DOUBLES / 2);
    for (size_t i = 0; i < N; i++) lost += outlier[i] != 0;
    for (size_t i = N + DUST; i < ALL; i++) {
        bool is_far = off_sphere(point[i]) > 0.03;
        far += is_far, kept += is_far && !outlier[i];
    }
    assert_true(kept < far / 20);
    assert_true(lost < N / 20);
    free(point);
}

/* Amid doubles few planes pass through it; without them it is as above. */
static void a_sparse_piece_is_kept_among_doubles(void **state) {
    (void)state;
    enum { N = 6000, DUST = 300, PIECE = 16, ALL = 2 * N + DUST + PIECE };
    vec3 *point = sphere_with_dust(N, DUST), *doubled = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, ALL * sizeof *point));
    for (size_t i = 0; i < PIECE; i++)
        point[N + DUST + i] = (vec3){0.1 * (double)(i % 4) - 0.15, 0.1 * (double)(i / 4) - 0.15, 1.12};
    add_noise(doubled, N, 0.015);
    memcpy(&point[N + DUST + PIECE], doubled, N * sizeof *point);
    static uint8_t outlier[ALL];
    assert_true(find_layers(point, ALL, 1, outlier) > N / 2);
    size_t kept = 0, strays = 0;
    for (size_t i = 0; i < PIECE; i++) kept += !outlier[N + DUST + i];
    for (size_t i = N; i < N + DUST; i++) strays += !outlier[i];
    assert_true(kept > PIECE / 2);
    assert_int_equal(strays, 0);
    free(point), free(doubled);
}

static void noise_that_is_the_same_everywhere_is_no_layer(void **state) {
    (void)state;
    enum { SIDE = 40, N = 6 * SIDE * SIDE };
    static uint8_t outlier[N];
    for (int i = 0; i < 4; i++) {
        vec3 *point = cube(SIDE); /* the spacing is 0.05 */
        add_noise(point, N, i * 0.008);
        assert_int_equal(find_layers(point, N, 2, outlier), 0);
        free(point);
    }
}

/* Low shrubs on a flat field: patches of points at any height, beside which the field is far more exact. */
static void rough_patches_are_no_layer(void **state) {
    (void)state;
    enum { SIDE = 72, N = SIDE * SIDE, PATCH = 6, APART = 12 };
    vec3 *point = shape_height_field(SIDE, height_plane);
    uint64_t seed = 3;
    for (size_t i = 0; i < N; i++)
        if (i % SIDE % APART < PATCH && i / SIDE % APART < PATCH) point[i].z += 2 * random_unit(&seed) / SIDE;
    static uint8_t outlier[N];
    assert_int_equal(find_layers(point, N, 2, outlier), 0);
    free(point);
}

/* Firs on rough ground, seen from above, and a twentieth of strays: the points of a tree lie in tufts that are far off
 * the ground's planes, and off each other's. */
static void trees_are_no_layer(void **state) {
    (void)state;
    enum { TREES = 100, OF_TREE = 60, GROUND = 5000, STRAYS = 800, ALL = TREES * OF_TREE + GROUND + STRAYS };
    static vec3 point[ALL];
    static uint8_t outlier[ALL];
    uint64_t seed = 5;
    size_t n = 0;
    for (int i = 0; i < GROUND; i++)
        point[n++] = (vec3){10 * random_unit(&seed), 10 * random_unit(&seed), 0.01 * gauss(&seed)};
    for (int t = 0; t < TREES; t++) {
        vec3 foot = {t % 10 + random_unit(&seed), t / 10 + random_unit(&seed), 0.3};
        double height = 1.5 + random_unit(&seed);
        for (int i = 0; i < OF_TREE; i++) {
            double down = sqrt(random_unit(&seed)), angle = 2 * M_PI * random_unit(&seed);
            double out = 0.45 * down * (0.7 + 0.3 * sqrt(random_unit(&seed)));
            point[n++] = vec3_add(foot, (vec3){out * cos(angle), out * sin(angle), height * (1 - down)});
        }
    }
    for (int i = 0; i < STRAYS; i++)
        point[n++] = (vec3){10 * random_unit(&seed), 10 * random_unit(&seed), 2.8 * random_unit(&seed)};
    assert_int_equal(find_layers(point, ALL, 2, outlier), 0);
}

/* A floor as a depth camera sees it, from near to far: noise and steps of the depth grow with its square. */
static void noise_that_grows_with_the_depth_is_no_layer(void **state) {
    (void)state;
    enum { SIDE = 160, N = SIDE * SIDE };
    static const double height[] = {0.7, 1, 1.3};
    static uint8_t outlier[N];
    uint64_t seed = 3;
    vec3 *point = malloc(N * sizeof *point);
    assert_non_null(point);
    for (int h = 0; h < 3; h++) {
        for (int i = 0; i < N; i++) {
            double u = (double)(i % SIDE) / SIDE - 0.5, down = 0.15 + (double)(i / SIDE) / SIDE,
                   depth = height[h] / down;
            depth += gauss(&seed) * (0.0012 + 0.0022 * depth * depth);
            double step = 0.0001 + 0.0007 * depth * depth;
            depth = step * round(depth / step);
            point[i] = (vec3){u * depth, depth, -down * depth};
        }
        assert_int_equal(find_layers(point, N, 2, outlier), 0);
    }
    free(point);
}

/* As a depth camera has them, whose planes are exact but for jumps. */
static void steps_of_rounded_coordinates_are_no_layers(void **state) {
    (void)state;
    enum { SIDE = 80, N = SIDE * SIDE };
    static uint8_t outlier[N];
    vec3 *point = shape_height_field(SIDE, height_saddle);
    for (size_t i = 0; i < N; i++) point[i].z = floor(point[i].z * 150) / 150;
    assert_int_equal(find_layers(point, N, 2, outlier), 0);
    free(point);
}

/* A sphere and a ball of so many points far from it, of random places in a cube; whether each of these is an outlier.
 */
static size_t find_ball_beside_sphere(size_t count, double side, uint8_t *outlier) {
    enum { N = 8000 }; /* the spacing is 0.04 */
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, (N + count) * sizeof *point));
    uint8_t *all = malloc(N + count);
    assert_non_null(all);
    uint64_t seed = 9;
    for (size_t i = N; i < N + count; i++)
        point[i] = vec3_add((vec3){2, 2, 2},
                            vec3_scale((vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)}, side));
    size_t found = find_outliers(point, N + count, 1, all);
    memcpy(outlier, all + N, count);
    free(point), free(all);
    return found;
}

static void a_small_cluster_far_away_is_found(void **state) {
    (void)state;
    enum { CLUSTER = 14 };
    uint8_t outlier[CLUSTER];
    assert_int_equal(find_ball_beside_sphere(CLUSTER, 0.3, outlier), CLUSTER);
    for (size_t i = 0; i < CLUSTER; i++) assert_true(outlier[i]);
}

/* Strays are hardly ever so near to each other as points of a surface are. */
static void a_small_cluster_as_dense_as_the_surface_is_kept(void **state) {
    (void)state;
    enum { CLUSTER = 14 };
    uint8_t outlier[CLUSTER];
    assert_int_equal(find_ball_beside_sphere(CLUSTER, 0.1, outlier), 0);
}

static void a_small_piece_of_a_surface_far_away_is_kept(void **state) {
    (void)state;
    enum { N = 8000, SIDE = 4, PIECE = SIDE * SIDE }; /* the spacing is 0.04 */
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, (N + PIECE) * sizeof *point));
    uint64_t seed = 9;
    for (size_t i = 0; i < PIECE; i++)
        point[N + i] = (vec3){2 + 0.04 * (double)(i % SIDE), 2 + 0.04 * (double)(i / SIDE), 0.01 * random_unit(&seed)};
    uint8_t outlier[N + PIECE];
    find_outliers(point, N + PIECE, 1, outlier);
    for (size_t i = N; i < N + PIECE; i++) assert_false(outlier[i]);
    free(point);
}

/* A ring on far ground, with the noise of its ranges, and a point far before its end. */
static void a_line_of_points_far_away_is_kept(void **state) {
    (void)state;
    enum { N = 8000, LINE = 12 };
    vec3 *point = shape_sphere(N, 1);
    assert_non_null(point = realloc(point, (N + LINE + 1) * sizeof *point));
    uint64_t seed = 9;
    for (size_t i = 0; i < LINE; i++) point[N + i] = (vec3){4 + 0.01 * random_unit(&seed), 0.2 * (double)i, -1};
    point[N + LINE] = (vec3){4, 0.2 * (LINE - 1) + 2.4, -1};
    uint8_t outlier[N + LINE + 1];
    assert_int_equal(find_outliers(point, N + LINE + 1, 1, outlier), 1);
    assert_true(outlier[N + LINE]);
    free(point);
}

static void two_objects_and_two_densities_lose_nothing(void **state) {
    (void)state;
    enum { FINE = 6000, COARSE = 300 };
    vec3 *point = shape_sphere(FINE, 1), *other = shape_sphere(COARSE, 1);
    assert_non_null(point = realloc(point, (FINE + COARSE) * sizeof *point));
    for (size_t i = 0; i < COARSE; i++) point[FINE + i] = vec3_add(other[i], (vec3){4, 0, 0});
    uint8_t outlier[FINE + COARSE];
    assert_int_equal(find_outliers(point, FINE + COARSE, 1, outlier), 0);
    free(point), free(other);
}

static void edges_and_corners_of_clean_shapes_are_no_outliers(void **state) {
    (void)state;
    enum { SIDE = 20, N = 6 * SIDE * SIDE, GRID = 30 };
    vec3 *point = cube(SIDE), *open = shape_height_field(GRID, height_saddle);
    uint8_t outlier[N];
    assert_int_equal(find_outliers(point, N, 1, outlier), 0);
    assert_int_equal(find_outliers(open, GRID * GRID, 1, outlier), 0);
    free(point), free(open);
}

/* ------------------------------------------------------------------------------------------------ noise */

static struct denoise_result smooth(const vec3 *point, size_t n, unsigned threads) {
    struct denoise_result result = {0};
    assert_int_equal(denoise_smooth(point, n, &(struct denoise_known){0}, threads, &result), STATUS_OK);
    return result;
}

/* Of a thick shell, whose points have neighbourhoods of several sizes. */
static void what_is_known_of_points_changes_nothing(void **state) {
    (void)state;
    enum { N = 12000, K = DENOISE_NEAR };
    vec3 *point = shape_sphere(N, 1); /* the spacing is 0.032 */
    add_noise(point, N / 2, 0.06), add_noise(&point[N / 2], N / 2, 0.025);
    uint32_t *near = malloc((size_t)N * K * sizeof *near);
    struct knn *knn = NULL;
    double share = 0;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(shell_find(knn, point, N, 1, &share, NULL, NULL), STATUS_OK);
    assert_true(share >= SHELL_MANY);
    for (size_t p = 0; p < N; p++) {
        uint32_t found[K + 1];
        double distance_sq[K + 1];
        assert_int_equal(knn_search(knn, &point[p], 1, K + 1, 1, found, distance_sq), STATUS_OK);
        for (unsigned i = 0, taken = 0; i <= K && taken < K; i++)
            if (found[i] != p) near[p * K + taken++] = found[i];
    }
    const struct denoise_known known[] = {{NULL, false}, {near, true}, {near, false}, {NULL, true}};
    struct denoise_result made[4] = {0};
    for (int i = 0; i < 4; i++) {
        assert_int_equal(denoise_smooth(point, N, &known[i], 2, &made[i]), STATUS_OK);
        assert_memory_equal(made[i].point, made[0].point, N * sizeof *point);
        assert_memory_equal(made[i].stray, made[0].stray, N);
    }
    for (int i = 0; i < 4; i++) denoise_done(&made[i]);
    knn_free(knn);
    free(near), free(point);
}

static void noise_on_a_sphere_falls_to_a_third(void **state) {
    (void)state;
    enum { N = 10000 };
    const double deviations[] = {0.005, 0.02, 0.05}; /* the spacing is 0.035 */
    for (int i = 0; i < 3; i++) {
        vec3 *point = shape_sphere(N, 1);
        add_noise(point, N, deviations[i]);
        double before = mean_of(off_sphere, point, N);
        struct denoise_result result = smooth(point, N, 2);
        assert_true(mean_of(off_sphere, result.point, N) < before / 3);
        assert_true(fabs(result.noise / deviations[i] - 1) < 0.35);
        denoise_done(&result);
        free(point);
    }
}

/* Of a scanner that is held in the hand, points lie nearer to each other than to the surface. */
static void noise_of_several_spacings_falls_to_a_fifth(void **state) {
    (void)state;
    enum { N = 20000 };
    const double spacing = 0.025, deviations[] = {1, 2}; /* of the spacing */
    for (int i = 0; i < 2; i++) {
        vec3 *point = shape_sphere(N, 1);
        add_noise(point, N, deviations[i] * spacing);
        double before = mean_of(off_sphere, point, N);
        struct denoise_result result = smooth(point, N, 2);
        assert_true(mean_of(off_sphere, result.point, N) < before / 5);
        denoise_done(&result);
        free(point);
    }
}

static void a_smoothed_sphere_does_not_shrink(void **state) {
    (void)state;
    enum { N = 10000 };
    vec3 *point = shape_sphere(N, 1);
    double radius = 0;
    add_noise(point, N, 0.02);
    struct denoise_result result = smooth(point, N, 2);
    for (size_t i = 0; i < N; i++) radius += vec3_length(result.point[i]) / N;
    assert_true(fabs(radius - 1) < 0.002);
    denoise_done(&result);
    free(point);
}

static void edges_of_a_noisy_cube_stay_sharp(void **state) {
    (void)state;
    enum { SIDE = 40, N = 6 * SIDE * SIDE }; /* spacing 0.05 */
    vec3 *point = cube(SIDE), *clean = cube(SIDE);
    add_noise(point, N, 0.01);
    double before = 0, after = 0, rounded = 0;
    struct denoise_result result = smooth(point, N, 2);
    size_t edge = 0;
    for (size_t i = 0; i < N; i++) {
        vec3 c = {fabs(clean[i].x), fabs(clean[i].y), fabs(clean[i].z)};
        if ((c.x > 0.9) + (c.y > 0.9) + (c.z > 0.9) < 2) continue; /* two spacings from an edge */
        before += off_cube(point[i]), after += off_cube(result.point[i]);
        rounded += 1 - fmax(fabs(result.point[i].x), fmax(fabs(result.point[i].y), fabs(result.point[i].z)));
        edge++;
    }
    assert_true(edge > 800);
    assert_true(after < 0.6 * before);
    assert_true(rounded / (double)edge < 0.003); /* a fillet would take 0.01 and more away */
    denoise_done(&result);
    free(point), free(clean);
}

static void without_noise_hardly_anything_moves(void **state) {
    (void)state;
    enum { N = 10000, SIDE = 40, CUBE = 6 * SIDE * SIDE };
    vec3 *sphere = shape_sphere(N, 1), *box = cube(SIDE);
    struct denoise_result a = smooth(sphere, N, 2), b = smooth(box, CUBE, 2);
    assert_true(largest_of(off_sphere, a.point, N) < 0.035 * 0.02);
    assert_true(mean_of(off_cube, b.point, CUBE) < 0.05 * 0.002);
    assert_true(largest_of(off_cube, b.point, CUBE) < 0.05 * 0.1);
    assert_int_equal(a.stray_count + b.stray_count, 0);
    denoise_done(&a), denoise_done(&b);
    free(sphere), free(box);
}

static void a_point_that_no_surface_is_near_stays_and_is_marked(void **state) {
    (void)state;
    enum { N = 5000 };
    vec3 *point = shape_sphere(N, 1);
    add_noise(point, N, 0.005);
    point[N / 2] = (vec3){0, 0, 0.5};
    struct denoise_result result = smooth(point, N, 1);
    assert_int_equal(result.stray_count, 1);
    assert_true(result.stray[N / 2] && vec3_equal(result.point[N / 2], point[N / 2]));
    denoise_done(&result);
    free(point);
}

static void few_points_stay_where_they_are(void **state) {
    (void)state;
    for (size_t n = 1; n < DENOISE_MIN_POINTS; n++) {
        vec3 *point = shape_sphere(n, 1);
        uint8_t outlier[DENOISE_MIN_POINTS];
        struct denoise_result result = smooth(point, n, 1);
        assert_memory_equal(result.point, point, n * sizeof *point);
        assert_int_equal(result.stray_count, 0);
        assert_int_equal(find_outliers(point, n, 1, outlier), 0);
        denoise_done(&result);
        free(point);
    }
}

static void flat_and_straight_clouds_survive(void **state) {
    (void)state;
    enum { SIDE = 8, N = SIDE * SIDE };
    vec3 *plane = shape_height_field(SIDE, height_plane), line[N];
    for (size_t i = 0; i < N; i++) line[i] = (vec3){(double)i / N, 0, 0};
    uint8_t outlier[N];
    struct denoise_result a = smooth(plane, N, 1), b = smooth(line, N, 1);
    for (size_t i = 0; i < N; i++) {
        assert_true(vec3_distance(a.point[i], plane[i]) < 1e-12);
        assert_true(vec3_distance(b.point[i], line[i]) < 1e-12);
    }
    assert_int_equal(find_outliers(plane, N, 1, outlier), 0);
    assert_int_equal(find_outliers(line, N, 1, outlier), 0);
    denoise_done(&a), denoise_done(&b);
    free(plane);
}

/* Strays far away make everything else small in the frame that all of them share. */
static void points_whose_squares_vanish_stay(void **state) {
    (void)state;
    enum { N = 200 };
    static const double radius[] = {1e-20, 1e-30, 1e-150, 1e-200, 1e-310};
    for (size_t r = 0; r < sizeof radius / sizeof *radius; r++) {
        vec3 *point = shape_sphere(N, radius[r]);
        struct denoise_result result = smooth(point, N, 1);
        for (size_t i = 0; i < N; i++) assert_true(vec3_distance(result.point[i], point[i]) <= radius[r]);
        assert_int_equal(result.stray_count, 0);
        denoise_done(&result);
        free(point);
    }
}

/* The far half of what a depth camera sees is many times as noisy as the near one. */
static void each_place_is_smoothed_as_its_noise_takes(void **state) {
    (void)state;
    enum { SIDE = 120, N = SIDE * SIDE };
    vec3 *point = shape_height_field(SIDE, height_plane);
    double before[2] = {0}, after[2] = {0};
    uint64_t seed = 7;
    for (size_t i = 0; i < N; i++) point[i].z += gauss(&seed) * (point[i].x < 0.6 ? 0.02 : 1.2) / SIDE;
    struct denoise_result result = smooth(point, N, 2);
    for (size_t i = 0; i < N; i++) {
        bool far = point[i].x >= 0.6;
        before[far] += fabs(point[i].z - height_plane(point[i].x, point[i].y));
        after[far] += fabs(result.point[i].z - height_plane(result.point[i].x, result.point[i].y));
    }
    assert_true(after[0] < before[0] / 2);
    assert_true(after[1] < before[1] / 3);
    denoise_done(&result);
    free(point);
}

/* ------------------------------------------------------------------------------------------------ shells */

/* n points on each of two spheres, of which the outer one has radius 1: evenly, or anywhere. */
static vec3 *hollow_ball(size_t n, double inside, bool anywhere) {
    vec3 *outer = shape_sphere(n, 1), *inner = shape_sphere(n, inside), *both = malloc(2 * n * sizeof *both);
    uint64_t seed = 11;
    assert_true(outer && inner && both);
    for (size_t i = 0; i < n; i++) {
        both[2 * i] = outer[i];
        both[2 * i + 1] = (vec3){inner[i].y, inner[i].z, inner[i].x}; /* not behind those */
    }
    for (size_t i = 0; anywhere && i < 2 * n; i++) {
        vec3 at = {gauss(&seed), gauss(&seed), gauss(&seed)};
        both[i] = vec3_scale(vec3_unit(at), i % 2 ? inside : 1);
    }
    free(outer), free(inner);
    return both;
}

static double shell_share(const vec3 *point, size_t n, unsigned threads) {
    struct knn *knn = NULL;
    double share = NAN;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(shell_find(knn, point, n, threads, &share, NULL, NULL), STATUS_OK);
    knn_free(knn);
    return share;
}

static void walls_make_no_shell(void **state) {
    (void)state;
    enum { N = 5000 };
    const double thickness[] = {0.05, 0.07}; /* the spacing is 0.05 */
    for (int i = 0; i < 2; i++) {
        vec3 *wall = hollow_ball(N, 1 - thickness[i], true);
        assert_true(shell_share(wall, 2 * N, 1) < SHELL_MANY / 4);
        add_noise(wall, 2 * N, thickness[i] / 2);
        assert_true(shell_share(wall, 2 * N, 1) > SHELL_MANY);
        free(wall);
    }
}

static void noise_as_large_as_the_spacing_makes_a_shell(void **state) {
    (void)state;
    enum { N = 20000 };
    const double deviations[] = {0.015, 0.03, 0.05}; /* the spacing is 0.025 */
    for (int i = 0; i < 3; i++) {
        vec3 *point = shape_sphere(N, 1);
        add_noise(point, N, deviations[i]);
        double share = shell_share(point, N, 1);
        assert_true(share > 2 * SHELL_MANY);
        assert_true(share == shell_share(point, N, 5));
        free(point);
    }
}

static void noise_of_several_spacings_makes_a_shell(void **state) {
    (void)state;
    enum { N = 20000 };
    const double deviations[] = {0.07, 0.14, 0.18}; /* the spacing is 0.025 */
    for (int i = 0; i < 3; i++) {
        vec3 *point = shape_sphere(N, 1);
        add_noise(point, N, deviations[i]);
        assert_true(shell_share(point, N, 1) > SHELL_MANY);
        free(point);
    }
}

/* As thin for their width, widely, as those with noise, but no denser in the middle. */
static void bodies_of_points_are_no_shell(void **state) {
    (void)state;
    enum { N = 20000 };
    uint64_t seed = 5;
    vec3 *point = malloc(N * sizeof *point);
    assert_non_null(point);
    for (size_t i = 0; i < N; i++) {
        vec3 way = vec3_unit((vec3){gauss(&seed), gauss(&seed), gauss(&seed)});
        point[i] = vec3_scale(way, cbrt(random_unit(&seed)));
        point[i].z *= 0.3;
    }
    assert_true(shell_share(point, N, 1) < SHELL_MANY);
    free(point);
}

/* Crowns 4.5 apart, from 6 to 18 high, seen from above by beams that go .8 deep among leaves; one seed, one wood. */
static void make_wood(vec3 *point, size_t n, uint64_t seed) {
    enum { ROWS = 22 };
    static const double APART = 4.5, DEEP = 0.8, STEEP = 4.2;
    vec3 top[ROWS * ROWS];
    for (int i = 0; i < ROWS * ROWS; i++)
        top[i] = (vec3){APART * (i % ROWS + 0.8 * random_unit(&seed)), APART * (i / ROWS + 0.8 * random_unit(&seed)),
                        6 + 12 * random_unit(&seed)};
    for (size_t p = 0; p < n; p++) {
        vec3 at = {APART * ROWS * random_unit(&seed), APART * ROWS * random_unit(&seed), 0};
        for (int i = 0; i < ROWS * ROWS; i++)
            at.z = fmax(at.z, top[i].z - STEEP * hypot(at.x - top[i].x, at.y - top[i].y));
        at.z = fmax(0.02 * gauss(&seed), at.z + DEEP * log(1 - random_unit(&seed)));
        point[p] = at;
    }
}

/* From far off it is a layer, whose points fill balls near by, as noise does. */
static void a_wood_is_no_shell(void **state) {
    (void)state;
    enum { N = 11000 };
    vec3 *point = malloc(N * sizeof *point);
    assert_non_null(point);
    for (uint64_t seed = 1; seed <= 3; seed++) {
        make_wood(point, N, seed);
        assert_true(shell_share(point, N, 1) < SHELL_MANY / 4);
    }
    free(point);
}

static void noise_is_told_by_nothing_beside_it(void **state) {
    (void)state;
    enum { TIMES = 100 };
    double of_noise = 0, of_waves = 0;
    uint64_t seed = 4;
    uint32_t id[HEIGHTS_K];
    for (uint32_t i = 0; i < HEIGHTS_K; i++) id[i] = i;
    for (int t = 0; t < TIMES; t++) {
        vec3 noise[HEIGHTS_K], wave[HEIGHTS_K];
        for (int i = 0; i < HEIGHTS_K; i++) {
            noise[i] = wave[i] = (vec3){random_unit(&seed), random_unit(&seed), 0.1 * gauss(&seed)};
            wave[i].z = 0.14 * sin(2 * M_PI * (wave[i].x + t));
        }
        of_noise += heights_nugget(noise, id, HEIGHTS_K) / TIMES;
        of_waves += heights_nugget(wave, id, HEIGHTS_K) / TIMES;
    }
    assert_true(of_noise > 0.9 && of_noise < 1.1);
    assert_true(of_waves < 0.3);
    vec3 flat[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    assert_true(heights_nugget(flat, id, 3) == 1);
}

static void what_is_thick_however_widely_one_looks_is_no_shell(void **state) {
    (void)state;
    enum { SIDE = 40, CUBE = 6 * SIDE * SIDE, GRID = 120, N = 20000 };
    vec3 *point = cube(SIDE), *steps = shape_height_field(GRID, height_saddle), *sphere = shape_sphere(N, 1), *dust;
    uint64_t seed = 3;
    assert_non_null(dust = malloc(N * sizeof *dust));
    for (size_t i = 0; i < N; i++) dust[i] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
    for (size_t i = 0; i < GRID * GRID; i++) steps[i].z = floor(steps[i].z * 40) / 40;
    assert_true(shell_share(point, CUBE, 1) < SHELL_MANY / 4);
    assert_true(shell_share(steps, GRID * GRID, 1) < SHELL_MANY / 4);
    assert_true(shell_share(sphere, N, 1) == 0);
    assert_true(shell_share(dust, N, 1) < SHELL_MANY / 4);
    assert_true(shell_share(dust, SHELL_MIN_POINTS - 1, 1) == 0);
    add_noise(sphere, N, 0.004); /* a sixth of the spacing */
    assert_true(shell_share(sphere, N, 1) < SHELL_MANY / 4);
    free(point), free(steps), free(sphere), free(dust);
}

/* ------------------------------------------------------------------------------------------------ neighbourhoods */

static unsigned neighbours_max(const vec3 *point, size_t n, unsigned max) {
    struct knn *knn = NULL;
    struct neighbourhood neighbours = {0};
    struct neighbourhood_options options = {2.5, 6, max, 2};
    unsigned most = 0;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, n, &options, &neighbours), STATUS_OK);
    for (size_t i = 0; i < n; i++) most = neighbours.count[i] > most ? neighbours.count[i] : most;
    neighbourhood_done(&neighbours);
    knn_free(knn);
    return most;
}

static void noise_and_not_curvature_widens_neighbourhoods(void **state) {
    (void)state;
    enum { N = 5000, SIDE = 24, CUBE = 6 * SIDE * SIDE, COARSE = 150 };
    vec3 *sphere = shape_sphere(N, 1), *coarse = shape_sphere(COARSE, 1), *box = cube(SIDE);
    assert_true(neighbours_max(sphere, N, 10) <= 10);
    assert_true(neighbours_max(coarse, COARSE, 10) <= 10);
    assert_true(neighbours_max(box, CUBE, 10) <= 10);
    const double deviations[] = {0.01, 0.03, 0.1}; /* the spacing is 0.05 */
    for (int i = 0; i < 3; i++) {
        vec3 *noisy = shape_sphere(N, 1);
        add_noise(noisy, N, deviations[i]);
        unsigned most = neighbours_max(noisy, N, 10);
        assert_true(most > 10 && most <= 30);
        assert_in_range(neighbours_max(noisy, N, KNN_MAX_K - 1), 18, KNN_MAX_K - 1); /* three times would overflow */
        free(noisy);
    }
    free(sphere), free(coarse), free(box);
}

/* Walls of hardly more than the spacing, which is 0.05: a ball of points holds both sides, but nothing between them. */
static void both_sides_of_a_wall_are_no_noise(void **state) {
    (void)state;
    enum { N = 5000 };
    const double thickness[] = {0.05, 0.07, 0.09};
    for (int i = 0; i < 3; i++) {
        vec3 *both = hollow_ball(N, 1 - thickness[i], false), *anywhere = hollow_ball(N, 1 - thickness[i], true);
        assert_true(neighbours_max(both, 2 * N, 10) <= 10);
        assert_true(neighbours_max(anywhere, 2 * N, 10) <= 10);
        add_noise(both, 2 * N, thickness[i] / 3);
        assert_true(neighbours_max(both, 2 * N, 10) > 10);
        free(both), free(anywhere);
    }
}

/* ------------------------------------------------------------------------------------------------ both */

static void threads_do_not_change_a_bit(void **state) {
    (void)state;
    enum { N = 9000, DUST = 300 };
    vec3 *point = sphere_with_dust(N, DUST);
    add_noise(point, N, 0.03);
    uint8_t one_outlier[N + DUST], many_outlier[N + DUST];
    struct denoise_result one = smooth(point, N, 1), many = smooth(point, N, 5);
    assert_memory_equal(one.point, many.point, N * sizeof *point);
    assert_memory_equal(one.stray, many.stray, N);
    assert_true(one.noise == many.noise);
    assert_int_equal(find_outliers(point, N + DUST, 1, one_outlier), find_outliers(point, N + DUST, 5, many_outlier));
    assert_memory_equal(one_outlier, many_outlier, sizeof one_outlier);
    denoise_done(&one), denoise_done(&many);
    free(point);
}

static void every_allocation_may_fail(void **state) {
    (void)state;
    enum { N = 1200 };
    vec3 *point = sphere_with_dust(N - 30, 30);
    add_noise(point, N - 30, 0.1);
    struct knn *knn = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    long failures = 0;
    for (;;) {
        uint8_t outlier[N];
        size_t count;
        double share;
        struct stray_shares shares;
        struct denoise_result result = {0};
        faults_in_memory(failures + 1, false);
        struct planes *planes = NULL;
        enum status found = outliers_find(knn, point, NULL, N, 1, outlier, &count, &planes);
        enum status layered = found ? found : layers_find(point, NULL, N, 1, planes, outlier, &count);
        planes_free(planes);
        enum status estimated = layered ? layered : outliers_estimate(knn, point, NULL, N, 1, NULL, &shares);
        enum status shelled = estimated ? estimated : shell_find(knn, point, N, 1, &share, NULL, NULL);
        enum status status = shelled ? shelled : denoise_smooth(point, N, &(struct denoise_known){0}, 1, &result);
        bool happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        if (!happened) {
            denoise_done(&result);
            break;
        }
        assert_null(result.point);
        failures++;
    }
    assert_true(failures > 15);
    knn_free(knn);
    free(point);
}

static void every_allocation_of_an_estimate_may_fail(void **state) {
    (void)state;
    enum { N = 3200 };
    vec3 *point = shape_sphere(N, 1);
    struct knn *knn = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    long failures = 0;
    for (bool happened = true; happened; failures += happened) {
        double share;
        faults_in_memory(failures + 1, false);
        enum status status = layers_estimate(knn, point, N, 1, &share);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failures > 10);
    knn_free(knn);
    free(point);
}

/* ------------------------------------------------------------------------------------------------ pipeline */

static struct cloud cloud_of(const vec3 *point, size_t n) {
    char *text = malloc(n * 80), *end = text;
    struct cloud cloud = {0};
    for (size_t i = 0; i < n; i++)
        end += snprintf(end, 80, "%.9g %.9g %.9g %zu\n", point[i].x, point[i].y, point[i].z, i);
    assert_int_equal(cloud_read_memory(text, (size_t)(end - text), NULL, NULL, &cloud, NULL), STATUS_OK);
    free(text);
    return cloud;
}

static struct pipeline_result run(const struct cloud *cloud, const char *denoise, const char *threads) {
    struct params params;
    struct pipeline_result result = {0};
    params_defaults(&params);
    assert_int_equal(params_set(&params, "denoise", denoise, NULL), STATUS_OK);
    assert_int_equal(params_set(&params, "threads", threads, NULL), STATUS_OK);
    assert_int_equal(params_set(&params, "outputs", "dso,report", NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    assert_int_equal(pipeline_run(cloud, &params, NULL, &result, NULL), STATUS_OK);
    return result;
}

static void only_full_moves_points_and_both_drop_outliers(void **state) {
    (void)state;
    enum { N = 4000, DUST = 120 };
    vec3 *point = sphere_with_dust(N, DUST);
    add_noise(point, N, 0.01);
    struct cloud cloud = cloud_of(point, N + DUST);
    struct pipeline_result none = run(&cloud, "none", "2"), outliers = run(&cloud, "outliers", "2"),
                           full = run(&cloud, "full", "2"), again = run(&cloud, "full", "1");
    assert_true(!none.moved && !outliers.moved && full.moved);
    assert_int_equal(none.report.points_outliers, 0);
    assert_in_range(outliers.report.points_outliers, DUST, DUST + 10);
    assert_in_range(full.report.points_outliers, DUST, DUST + 10);
    assert_int_equal(full.level[0].kept_count, (N + DUST) / 10);
    for (size_t i = 0; i < full.level[0].kept_count; i++) assert_true(full.kept[i] < N);
    for (size_t i = 0; i < outliers.level[0].kept_count; i++) assert_true(outliers.kept[i] < N);
    assert_true(mean_of(off_sphere, full.moved, N) < mean_of(off_sphere, cloud.position, N) / 2);
    assert_memory_equal(full.moved, again.moved, (N + DUST) * sizeof *full.moved);
    assert_memory_equal(full.kept, again.kept, full.level[0].kept_count * sizeof *full.kept);
    assert_true(full.report.diagonal < none.report.diagonal); /* of what is left */
    pipeline_result_done(&none), pipeline_result_done(&outliers), pipeline_result_done(&full);
    pipeline_result_done(&again);
    cloud_done(&cloud);
    free(point);
}

/* Positions that are whole numbers can move by whole numbers alone, and duplicates move together. */
static void moved_points_fit_the_type_of_their_coordinates(void **state) {
    (void)state;
    enum { N = 3000 };
    vec3 *point = shape_sphere(N, 400);
    add_noise(point, N, 8);
    for (size_t i = 0; i < N; i++)
        point[i] =
            i % 100 == 99 ? point[i - 1] : (vec3){nearbyint(point[i].x), nearbyint(point[i].y), nearbyint(point[i].z)};
    struct cloud cloud = cloud_of(point, N);
    for (int axis = 0; axis < 3; axis++) cloud.property[cloud.xyz[axis]].type = SCALAR_INT32;
    cloud_move(&cloud, point);
    struct pipeline_result full = run(&cloud, "full", "0");
    size_t moved = 0;
    for (size_t i = 0; i < N; i++) {
        vec3 p = full.moved[i];
        assert_true(p.x == nearbyint(p.x) && p.y == nearbyint(p.y) && p.z == nearbyint(p.z));
        if (i % 100 == 99) assert_true(vec3_equal(p, full.moved[i - 1]));
        moved += !vec3_equal(p, cloud.position[i]);
    }
    assert_true(moved > N / 2);
    cloud_move(&cloud, full.moved);
    for (size_t i = 0; i < N; i++) {
        const unsigned char *record = &cloud.record[i * cloud.record_bytes];
        const struct property *id = &cloud.property[3], *x = &cloud.property[cloud.xyz[0]];
        assert_true(scalar_load(record + x->offset_bytes, x->type) == full.moved[i].x);
        assert_true(scalar_load(record + id->offset_bytes, id->type) == (double)i);
    }
    pipeline_result_done(&full);
    cloud_done(&cloud);
    free(point);
}

static void tiny_clouds_pass_through_the_pipeline(void **state) {
    (void)state;
    const vec3 point[] = {{0, 0, 0}, {1, 0, 0}, {0, 0, 0}, {0, 1, 0}};
    for (size_t n = 1; n <= 4; n++) {
        struct cloud cloud = cloud_of(point, n);
        struct pipeline_result result = run(&cloud, "full", "1");
        assert_int_equal(result.level[0].kept_count, 1);
        assert_memory_equal(result.moved, cloud.position, n * sizeof *point);
        assert_int_equal(result.report.points_outliers, 0);
        pipeline_result_done(&result);
        cloud_done(&cloud);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_quantile_is_the_element_of_its_rank),
        cmocka_unit_test(a_quantile_is_found_among_few_and_many_of_both_signs),
        cmocka_unit_test(the_spread_leaves_values_alone),
        cmocka_unit_test(dust_is_found_and_no_point_of_the_surface),
        cmocka_unit_test(a_stray_close_above_a_surface_is_found),
        cmocka_unit_test(a_stray_amid_a_surface_is_found),
        cmocka_unit_test(a_sparse_piece_is_kept_among_strays),
        cmocka_unit_test(a_few_points_far_away_let_no_strays_stay),
        cmocka_unit_test(strays_that_are_near_others_by_chance_are_found),
        cmocka_unit_test(many_strays_are_told_by_some_places),
        cmocka_unit_test(strays_are_the_same_after_shells),
        cmocka_unit_test(few_strays_are_told_by_how_far_off_they_are),
        cmocka_unit_test(who_was_sampled_by_need_has_no_strays),
        cmocka_unit_test(single_strays_are_told_by_all_neighbourhoods),
        cmocka_unit_test(offsets_are_the_same_whoever_was_trusted_before),
        cmocka_unit_test(neighbours_are_those_that_are_trusted),
        cmocka_unit_test(doubles_that_are_less_exact_go),
        cmocka_unit_test(details_beside_doubles_stay),
        cmocka_unit_test(the_farthest_doubles_go_amid_details_and_strays),
        cmocka_unit_test(a_sparse_piece_is_kept_among_doubles),
        cmocka_unit_test(some_patches_tell_of_doubles),
        cmocka_unit_test(noise_that_is_the_same_everywhere_is_no_layer),
        cmocka_unit_test(rough_patches_are_no_layer),
        cmocka_unit_test(trees_are_no_layer),
        cmocka_unit_test(noise_that_grows_with_the_depth_is_no_layer),
        cmocka_unit_test(steps_of_rounded_coordinates_are_no_layers),
        cmocka_unit_test(a_small_cluster_far_away_is_found),
        cmocka_unit_test(a_small_cluster_as_dense_as_the_surface_is_kept),
        cmocka_unit_test(a_small_piece_of_a_surface_far_away_is_kept),
        cmocka_unit_test(a_line_of_points_far_away_is_kept),
        cmocka_unit_test(two_objects_and_two_densities_lose_nothing),
        cmocka_unit_test(edges_and_corners_of_clean_shapes_are_no_outliers),
        cmocka_unit_test(what_is_known_of_points_changes_nothing),
        cmocka_unit_test(noise_on_a_sphere_falls_to_a_third),
        cmocka_unit_test(noise_of_several_spacings_falls_to_a_fifth),
        cmocka_unit_test(a_smoothed_sphere_does_not_shrink),
        cmocka_unit_test(edges_of_a_noisy_cube_stay_sharp),
        cmocka_unit_test(without_noise_hardly_anything_moves),
        cmocka_unit_test(a_point_that_no_surface_is_near_stays_and_is_marked),
        cmocka_unit_test(few_points_stay_where_they_are),
        cmocka_unit_test(each_place_is_smoothed_as_its_noise_takes),
        cmocka_unit_test(walls_make_no_shell),
        cmocka_unit_test(noise_as_large_as_the_spacing_makes_a_shell),
        cmocka_unit_test(noise_of_several_spacings_makes_a_shell),
        cmocka_unit_test(bodies_of_points_are_no_shell),
        cmocka_unit_test(a_wood_is_no_shell),
        cmocka_unit_test(noise_is_told_by_nothing_beside_it),
        cmocka_unit_test(what_is_thick_however_widely_one_looks_is_no_shell),
        cmocka_unit_test(flat_and_straight_clouds_survive),
        cmocka_unit_test(points_whose_squares_vanish_stay),
        cmocka_unit_test(noise_and_not_curvature_widens_neighbourhoods),
        cmocka_unit_test(both_sides_of_a_wall_are_no_noise),
        cmocka_unit_test(threads_do_not_change_a_bit),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(every_allocation_of_an_estimate_may_fail),
        cmocka_unit_test(only_full_moves_points_and_both_drop_outliers),
        cmocka_unit_test(moved_points_fit_the_type_of_their_coordinates),
        cmocka_unit_test(tiny_clouds_pass_through_the_pipeline),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
