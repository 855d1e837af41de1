/* Scans one after the other that don't fit, and what looks like them: thin walls, noise, scans that do fit.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/clean/misfit.h"
#include "core/cloud/morton.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { N = 12000 };

/* Adds n points at random on a lump about 1 in radius, `inside` so far within it, of which a cap of z > above is left
 * out. */
static void add_lump(vec3 *point, size_t n, uint64_t seed, double inside, double above) {
    for (size_t i = 0; i < n;) {
        double z = 2 * random_unit(&seed) - 1, turn = 2 * M_PI * random_unit(&seed), across = sqrt(1 - z * z);
        vec3 to = {across * cos(turn), across * sin(turn), z};
        double radius = 1 + 0.15 * sin(3 * to.x) * cos(4 * to.y) - inside;
        if (z <= above) point[i++] = vec3_scale(to, radius);
    }
}

static void shift(vec3 *point, size_t n, vec3 by) {
    for (size_t i = 0; i < n; i++) point[i] = vec3_add(point[i], by);
}

static void turn(vec3 *point, size_t n, vec3 by) {
    for (size_t i = 0; i < n; i++) point[i] = vec3_add(point[i], vec3_cross(by, point[i]));
}

/* Adds n points at random on the faces of a box from the origin on that are away from it. */
static void add_corner(vec3 *point, size_t n, uint64_t seed, vec3 size) {
    for (size_t i = 0; i < n; i++) {
        double x = random_unit(&seed), y = random_unit(&seed);
        vec3 on[3] = {{1, x, y}, {x, 1, y}, {x, y, 1}};
        point[i] = (vec3){on[i % 3].x * size.x, on[i % 3].y * size.y, on[i % 3].z * size.z};
    }
}

/* Adds n points at random on a slope. */
static void add_slope(vec3 *point, size_t n, uint64_t seed, double at_first, double at_last) {
    for (size_t i = 0; i < n; i++) {
        double x = random_unit(&seed), y = random_unit(&seed);
        point[i] = (vec3){x, y, at_first + (at_last - at_first) * x};
    }
}

/* What is found in n points as a file has them; their order is left in *ordered. */
static bool find(const vec3 *point, size_t n, struct ordered_points *ordered, struct misfit *misfit) {
    struct knn *knn = NULL;
    bool found = false, again = false;
    struct misfit same;
    assert_int_equal(order_points(point, n, 1, ordered), STATUS_OK);
    assert_int_equal(knn_new(ordered->point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(misfit_find(knn, ordered->point, ordered->original, n, 1, &found, misfit), STATUS_OK);
    assert_int_equal(misfit_find(knn, ordered->point, ordered->original, n, 3, &again, &same), STATUS_OK);
    assert_true(found == again && (!found || (vec3_equal(misfit->shift, same.shift) && misfit->last == same.last)));
    knn_free(knn);
    return found;
}

static bool is_found(const vec3 *point, size_t n) {
    struct ordered_points ordered = {0};
    struct misfit misfit;
    bool found = find(point, n, &ordered, &misfit);
    ordered_points_done(&ordered);
    return found;
}

/* How many points of the file from `begin` to `end` are doubles. */
static size_t doubles_between(const struct ordered_points *ordered, const uint8_t *is_double, size_t begin,
                              size_t end) {
    size_t count = 0;
    for (size_t p = 0; p < ordered->count; p++)
        count += is_double[p] && ordered->original[p] >= begin && ordered->original[p] < end;
    return count;
}

static void a_scan_that_is_off_is_found_and_goes(void **state) {
    (void)state;
    static vec3 point[2 * N];
    static uint8_t is_double[2 * N];
    const vec3 off[] = {{0.012, -0.009, 0.02}, {0, 0, 0.02}, {0.015, 0, 0}};
    for (size_t i = 0; i < sizeof off / sizeof *off; i++) {
        struct ordered_points ordered = {0};
        struct misfit misfit;
        size_t count;
        add_lump(point, N, 1, 0, 1), add_lump(point + N, N, 2, 0, 1);
        shift(point + N, N, off[i]);
        assert_true(find(point, 2 * (size_t)N, &ordered, &misfit));
        assert_in_range(misfit.last, N - 100, N - 1);
        assert_in_range(misfit.first, N, N + 100);
        vec3 wrong = vec3_sub(vec3_scale(misfit.shift, ordered.scale), off[i]);
        assert_true(vec3_length(wrong) < 0.1 * vec3_length(off[i]));
        assert_int_equal(misfit_doubles(ordered.point, ordered.original, 2 * (size_t)N, &misfit, 2, is_double, &count),
                         STATUS_OK);
        assert_true(doubles_between(&ordered, is_double, N, 2 * (size_t)N) > 0.99 * N);
        assert_true(doubles_between(&ordered, is_double, 0, N) < 0.01 * N);
        assert_int_equal(count, doubles_between(&ordered, is_double, 0, 2 * (size_t)N));
        ordered_points_done(&ordered);
    }
}

static void so_is_one_that_is_turned(void **state) {
    (void)state;
    static vec3 point[2 * N];
    const vec3 by[] = {{0.012, -0.009, 0.02}, {0.02, 0, 0}}, off[] = {{0, 0, 0}, {0.01, 0.01, -0.01}};
    for (size_t i = 0; i < 2; i++) {
        struct ordered_points ordered = {0};
        struct misfit misfit;
        double wrong = 0;
        add_lump(point, N, 1, 0, 1), add_lump(point + N, N, 2, 0, 1);
        turn(point + N, N, by[i]), shift(point + N, N, off[i]);
        assert_true(find(point, 2 * (size_t)N, &ordered, &misfit));
        for (size_t p = 0; p < ordered.count; p++) {
            vec3 place = vec3_add(vec3_scale(ordered.point[p], ordered.scale), ordered.centre);
            vec3 moved = vec3_scale(misfit_at(&misfit, ordered.point[p]), ordered.scale);
            vec3 truth = vec3_add(vec3_cross(by[i], place), off[i]);
            wrong = fmax(wrong, vec3_distance(moved, truth));
        }
        assert_true(wrong < 0.006);
        assert_in_range(misfit.first, N, N + 100);
        ordered_points_done(&ordered);
    }
}

static void of_many_scans_the_first_stays(void **state) {
    (void)state;
    static vec3 point[4 * N];
    static uint8_t is_double[4 * N];
    struct ordered_points ordered = {0};
    struct misfit misfit;
    size_t count;
    const vec3 off[] = {{0, 0, 0}, {0.012, -0.009, 0.02}, {-0.02, 0.01, -0.01}, {0.02, 0.01, -0.015}};
    for (size_t i = 0; i < 4; i++) add_lump(&point[i * N], N, i + 1, 0, 1), shift(&point[i * N], N, off[i]);
    assert_true(find(point, 4 * (size_t)N, &ordered, &misfit));
    assert_true(misfit.several);
    assert_int_equal(misfit_doubles(ordered.point, ordered.original, 4 * (size_t)N, &misfit, 1, is_double, &count),
                     STATUS_OK);
    assert_true(doubles_between(&ordered, is_double, 0, N) < 0.02 * N);
    assert_true(doubles_between(&ordered, is_double, 3 * (size_t)N, 4 * (size_t)N) > 0.95 * N);
    ordered_points_done(&ordered);
    assert_true(find(point, 2 * (size_t)N, &ordered, &misfit));
    assert_false(misfit.several);
    ordered_points_done(&ordered);
}

/* The second shows all of the lump, twice as densely, the first all but a cap. */
static void the_fuller_scan_stays_and_so_does_what_it_has_not(void **state) {
    (void)state;
    static vec3 point[3 * N];
    static uint8_t is_double[3 * N];
    struct ordered_points ordered = {0};
    struct misfit misfit;
    size_t count, cap = 0;
    add_lump(point, N, 1, 0, 1), add_lump(point + N, 2 * (size_t)N, 2, 0, 0.5);
    shift(point + N, 2 * (size_t)N, (vec3){0.012, -0.009, 0.02});
    assert_true(find(point, 3 * (size_t)N, &ordered, &misfit));
    assert_int_equal(misfit_doubles(ordered.point, ordered.original, 3 * (size_t)N, &misfit, 1, is_double, &count),
                     STATUS_OK);
    for (size_t i = 0; i < N; i++) cap += point[i].z > 0.6;
    assert_true(cap > N / 10);
    assert_true(doubles_between(&ordered, is_double, N, 3 * (size_t)N) < 0.01 * N);
    assert_in_range(doubles_between(&ordered, is_double, 0, N), 0.7 * N, N - (double)cap);
    ordered_points_done(&ordered);
}

/* Nor what has no second sheet at all. */
static void walls_and_scans_that_fit_are_not_found(void **state) {
    (void)state;
    static vec3 point[2 * N];
    uint64_t seed = 9;
    add_lump(point, N, 1, 0, 1), add_lump(point + N, N, 2, 0.03, 1);
    assert_false(is_found(point, 2 * (size_t)N)); /* both sides of a shell */
    add_lump(point, N, 1, 0, -0.5), add_lump(point + N, N, 2, 0.03, -0.5);
    assert_false(is_found(point, 2 * (size_t)N)); /* of a bowl */
    add_corner(point, N, 1, (vec3){1, 1, 1}), add_corner(point + N, N, 2, (vec3){0.98, 0.96, 0.99});
    assert_false(is_found(point, 2 * (size_t)N)); /* of three walls that meet */
    add_slope(point, N, 1, 0.005, 0.04), add_slope(point + N, N, 2, -0.005, -0.04);
    assert_false(is_found(point, 2 * (size_t)N)); /* of a wedge */
    add_lump(point, N, 1, 0, 1), add_lump(point + N, N, 2, 0, 1);
    assert_false(is_found(point, 2 * (size_t)N)); /* two scans that fit */
    shift(point + N, N, (vec3){0.012, -0.009, 0.02});
    for (size_t i = 2 * (size_t)N - 1; i > 0; i--) {
        size_t j = random_next(&seed) % (i + 1);
        vec3 other = point[j];
        point[j] = point[i], point[i] = other;
    }
    assert_false(is_found(point, 2 * (size_t)N)); /* in no order */
    for (size_t i = 0; i < 2 * (size_t)N; i++) point[i] = (vec3){1, 1, (double)i};
    assert_false(is_found(point, 2 * (size_t)N)); /* on a line */
    assert_false(is_found(point, 100));
}

static void every_allocation_may_fail(void **state) {
    (void)state;
    static vec3 point[2 * N];
    static uint8_t is_double[2 * N];
    struct ordered_points ordered = {0};
    struct misfit misfit;
    struct knn *knn = NULL;
    add_lump(point, N, 1, 0, 1), add_lump(point + N, N, 2, 0, 1);
    shift(point + N, N, (vec3){0.012, -0.009, 0.02});
    assert_int_equal(order_points(point, 2 * (size_t)N, 1, &ordered), STATUS_OK);
    assert_int_equal(knn_new(ordered.point, 2 * (size_t)N, 1, &knn, NULL), STATUS_OK);
    long failed = 0;
    for (bool happened = true; happened; failed += happened) {
        bool found = false;
        size_t count;
        faults_in_memory(failed + 1, false);
        enum status status = misfit_find(knn, ordered.point, ordered.original, 2 * (size_t)N, 1, &found, &misfit);
        if (!status && found)
            status = misfit_doubles(ordered.point, ordered.original, 2 * (size_t)N, &misfit, 1, is_double, &count);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(failed > 5);
    knn_free(knn);
    ordered_points_done(&ordered);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_scan_that_is_off_is_found_and_goes),
        cmocka_unit_test(so_is_one_that_is_turned),
        cmocka_unit_test(of_many_scans_the_first_stays),
        cmocka_unit_test(the_fuller_scan_stays_and_so_does_what_it_has_not),
        cmocka_unit_test(walls_and_scans_that_fit_are_not_found),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
