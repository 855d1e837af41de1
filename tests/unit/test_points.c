/* Order, neighbours, normals and the discrete shape operator, on shapes whose answers are known.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/cloud/cloud.h"
#include "core/cloud/morton.h"
#include "core/cloud/on_grid_lines.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "core/spatial/density.h"
#include "core/spatial/tube.h"
#include "core/spatial/two_sheets.h"
#include "core/surface/sheet/scan_lines.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

/* ------------------------------------------------------------------------------------------------ grids */

/* Where a ball's surface crosses the lines of a grid; and points anywhere on the faces of a cube. */
static void vertices_of_a_volume_are_on_grid_lines(void **state) {
    (void)state;
    enum { CELLS = 24, MOST = 6 * CELLS * CELLS, ON_CUBE = 3000 };
    vec3 *point = malloc(MOST * sizeof *point);
    uint64_t random = 1;
    size_t n = 0;
    bool are = false;
    for (int i = 0; i < CELLS; i++)
        for (int j = 0; j < CELLS; j++) {
            double u = -1 + (i + 0.5) * 2 / CELLS, v = -1 + (j + 0.5) * 2 / CELLS, rest = 1 - u * u - v * v;
            double w = rest > 0 ? sqrt(rest) : 0;
            for (int side = 0; side < 2 && w > 0; side++, w = -w) {
                point[n++] = (vec3){u, v, w};
                point[n++] = (vec3){v, w, u};
                point[n++] = (vec3){w, u, v};
            }
        }
    assert_int_equal(on_grid_lines(point, n, 1, &are), STATUS_OK);
    assert_true(are);
    for (size_t i = 0; i < ON_CUBE; i++) {
        double u = random_unit(&random), v = random_unit(&random), w = (double)(i % 2);
        point[i] = i % 3 == 0 ? (vec3){u, v, w} : i % 3 == 1 ? (vec3){v, w, u} : (vec3){w, u, v};
    }
    assert_int_equal(on_grid_lines(point, ON_CUBE, 2, &are), STATUS_OK);
    assert_false(are);
    free(point);
}

static double change_of(const vec3 *point, size_t n) {
    struct knn *knn = NULL;
    struct ordered_points ordered = {0};
    double change = -1;
    assert_int_equal(order_points(point, n, 1, &ordered), STATUS_OK);
    assert_int_equal(knn_new(ordered.point, ordered.count, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(density_change(knn, ordered.point, ordered.count, 1, &change), STATUS_OK);
    knn_free(knn);
    ordered_points_done(&ordered);
    return change;
}

/* Along axes that are tilted, so that no two points have a coordinate in common. */
static void grids_are_even_and_points_at_random_are_not(void **state) {
    (void)state;
    enum { CELLS = 60, MOST = 6 * CELLS * CELLS, AT_RANDOM = 3000 };
    vec3 *point = malloc(MOST * sizeof *point);
    uint64_t random = 1;
    size_t n = 0;
    for (int i = 0; i < CELLS; i++)
        for (int j = 0; j < CELLS; j++) {
            double u = -1 + (i + 0.3) * 2 / CELLS, v = -1 + (j + 0.3) * 2 / CELLS;
            for (int side = -1; side < 2 && fabs(u) < 0.6 && fabs(v) < 0.6; side += 2) {
                point[n++] = (vec3){u, v, side * 0.6};
                point[n++] = (vec3){v, side * 0.6, u};
                point[n++] = (vec3){side * 0.6, u, v};
            }
        }
    for (size_t i = 0; i < n; i++)
        point[i] = (vec3){0.8 * point[i].x - 0.6 * point[i].y, 0.6 * point[i].x + 0.8 * point[i].y, point[i].z};
    assert_true(change_of(point, n) < 0.14);
    for (size_t i = 0; i < AT_RANDOM; i++) {
        double u = random_unit(&random), v = random_unit(&random), w = (double)(i % 2);
        point[i] = i % 3 == 0 ? (vec3){u, v, w} : i % 3 == 1 ? (vec3){v, w, u} : (vec3){w, u, v};
    }
    assert_true(change_of(point, AT_RANDOM) > 0.16);
    assert_true(change_of(point, 50) == 0);
    free(point);
}

/* ------------------------------------------------------------------------------------------------ plates */

static double share_on_plates(const vec3 *point, size_t n) {
    struct knn *knn = NULL;
    double share = -1;
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(two_sheets_share(knn, point, n, 2, &share), STATUS_OK);
    knn_free(knn);
    return share;
}

/* Anywhere on both sides of a square, in units of what points are apart on either side; a sheet with as much noise, and
 * one that goes up and down by as much in steps ten wide. */
static void points_on_both_sides_are_on_a_plate(void **state) {
    (void)state;
    enum { N = 8000 };
    static const double APART[] = {1, 1.5, 2};
    double side = sqrt(N / 2.0);
    vec3 *plate = malloc(N * sizeof *plate), *noise = malloc(N * sizeof *noise), *stepped = malloc(N * sizeof *stepped);
    for (size_t trial = 0; trial < sizeof APART / sizeof *APART; trial++) {
        uint64_t random = 11;
        for (size_t i = 0; i < N; i++) {
            double x = side * random_unit(&random), y = side * random_unit(&random), z = 0;
            for (int k = 0; k < 4; k++) z += APART[trial] * (random_unit(&random) - 0.5);
            plate[i] = (vec3){x, y, i % 2 ? APART[trial] : 0};
            noise[i] = (vec3){x, y, z};
            stepped[i] = (vec3){x, y, fmod(x, 20) < 10 ? APART[trial] : 0};
        }
        assert_true(share_on_plates(plate, N) > TWO_SHEETS_MOSTLY);
        assert_true(share_on_plates(noise, N) < 0.02);
        assert_true(share_on_plates(stepped, N) < 0.02);
    }
    assert_true(share_on_plates(plate, 200) == 0);
    for (size_t i = 0; i < N; i++) plate[i].z *= 0.35 / 2; /* two flights over a plain */
    assert_true(share_on_plates(plate, N) < 0.02);
    free(plate), free(noise), free(stepped);
}

/* ------------------------------------------------------------------------------------------------ bars */

static double share_on_bars(const vec3 *point, size_t n, bool *are_round) {
    struct knn *knn = NULL;
    struct ordered_points ordered = {0};
    double share = -1;
    assert_int_equal(order_points(point, n, 1, &ordered), STATUS_OK);
    assert_int_equal(knn_new(ordered.point, ordered.count, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(tube_share(knn, ordered.point, ordered.count, 1, &share, are_round), STATUS_OK);
    knn_free(knn);
    ordered_points_done(&ordered);
    return share;
}

/* Round ones of six points around, and square ones; half of them; a line with noise; a rod that is filled. */
static void points_all_around_are_on_bars(void **state) {
    (void)state;
    enum { N = 2000 };
    static const double RADIUS = 1, LENGTH = 300;
    bool are_round = false;
    vec3 *round = malloc(N * sizeof *round), *square = malloc(N * sizeof *square), *half = malloc(N * sizeof *half),
         *filled = malloc(N * sizeof *filled);
    uint64_t random = 3;
    for (size_t i = 0; i < N; i++) {
        double angle = 2 * M_PI * random_unit(&random), x = LENGTH * random_unit(&random);
        double inner = sqrt(random_unit(&random));
        round[i] = (vec3){x, RADIUS * cos(angle), RADIUS * sin(angle)};
        half[i] = (vec3){x, RADIUS * cos(angle / 2), RADIUS * sin(angle / 2)};
        double side = 2 * random_unit(&random) - 1, end = i % 2 ? 1 : -1;
        square[i] = i % 4 < 2 ? (vec3){x, side, end} : (vec3){x, end, side};
        filled[i] = (vec3){x, inner * round[i].y, inner * round[i].z};
    }
    assert_true(share_on_bars(round, N, &are_round) > 0.95);
    assert_true(are_round);
    assert_true(share_on_bars(square, N, &are_round) > 0.9);
    assert_false(are_round);
    assert_true(share_on_bars(half, N, &are_round) < 0.05);
    assert_true(share_on_bars(filled, N, &are_round) < 0.05);
    assert_true(share_on_bars(round, 60, &are_round) == 0);
    free(round), free(square), free(half), free(filled);
}

/* ------------------------------------------------------------------------------------------------ order */

static void duplicates_and_negative_zero_become_one_point(void **state) {
    (void)state;
    const vec3 point[] = {{1, 0, 0}, {0, 0, 0}, {1, -0.0, 0}, {1, 0, 0}, {0, 2, 0}};
    struct ordered_points ordered = {0};
    assert_int_equal(order_points(point, 5, 1, &ordered), STATUS_OK);
    assert_int_equal(ordered.count, 3);
    int seen[5] = {0};
    for (size_t i = 0; i < 3; i++) seen[ordered.original[i]]++;
    assert_int_equal(seen[0], 1); /* the lowest id of 0, 2, 3 */
    assert_int_equal(seen[1], 1);
    assert_int_equal(seen[4], 1);
    assert_true(fabs(ordered.scale - sqrt(5)) < 1e-15);
    ordered_points_done(&ordered);
}

static void one_point_is_a_frame_of_its_own(void **state) {
    (void)state;
    const vec3 point[] = {{1e6, -3, 5}, {1e6, -3, 5}};
    struct ordered_points ordered = {0};
    assert_int_equal(order_points(point, 2, 1, &ordered), STATUS_OK);
    assert_int_equal(ordered.count, 1);
    assert_true(ordered.scale == 1 && vec3_length(ordered.point[0]) == 0);
    ordered_points_done(&ordered);
}

static void huge_and_tiny_coordinates_are_normalised(void **state) {
    (void)state;
    const double sizes[] = {9e299, 1e-300, 1e-310};
    for (int s = 0; s < 3; s++) {
        const vec3 point[] = {{-sizes[s], 0, 0}, {sizes[s], 0, 0}, {0, sizes[s], 0}};
        struct ordered_points ordered = {0};
        assert_int_equal(order_points(point, 3, 1, &ordered), STATUS_OK);
        assert_int_equal(ordered.count, 3);
        for (size_t i = 0; i < 3; i++) {
            assert_true(vec3_is_finite(ordered.point[i]));
            assert_true(vec3_length(ordered.point[i]) <= 0.5 + 1e-12);
        }
        ordered_points_done(&ordered);
    }
}

/* The nearest double, where the C library's hypot on amd64 is one off; else results differ from processor to processor.
 */
static void the_diagonal_is_the_same_on_all_processors(void **state) {
    (void)state;
    static const struct {
        vec3 box;
        double diagonal;
    } cases[] = {{{54, 34, 0}, 0x1.fe7f6f939a553p+5},
                 {{0, 90, 86}, 0x1.f1ee85590e272p+6},
                 {{94, 0, 56}, 0x1.b5aaa259099adp+6},
                 {{0x1.bp-895, 0x1.1p-895, 0}, 0x1.fe7f6f939a553p-895},
                 {{0x1.bp905, 0, 0x1.1p905}, 0x1.fe7f6f939a553p905}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct ordered_points frame;
        order_frame_of((vec3){-cases[i].box.x / 2, 0, 0}, (vec3){cases[i].box.x / 2, cases[i].box.y, cases[i].box.z},
                       &frame);
        if (frame.diagonal != cases[i].diagonal) fail_msg("box %zu: %a", i, frame.diagonal);
    }
}

static void the_order_does_not_depend_on_the_input_s(void **state) {
    (void)state;
    enum { N = 3000 };
    vec3 *point = shape_sphere(N, 1), reversed[N];
    for (size_t i = 0; i < N; i++) reversed[i] = point[N - 1 - i];
    struct ordered_points a = {0}, b = {0};
    assert_int_equal(order_points(point, N, 1, &a), STATUS_OK);
    assert_int_equal(order_points(reversed, N, 4, &b), STATUS_OK);
    assert_int_equal(a.count, N);
    assert_memory_equal(a.point, b.point, N * sizeof *a.point);
    for (size_t i = 0; i < N; i++) assert_int_equal(a.original[i], N - 1 - b.original[i]);
    ordered_points_done(&a), ordered_points_done(&b);
    free(point);
}

/* ------------------------------------------------------------------------------------------------ neighbours */

/* A scan in metres far from zero, and one point at zero: the frame is the scan's, and each of its points is there. */
static void a_stray_does_not_spoil_the_frame(void **state) {
    (void)state;
    enum { N = 5000 };
    vec3 *point = shape_sphere(N, 20);
    for (size_t i = 0; i < N; i++) point[i] = vec3_add(point[i], (vec3){500000, 5400000, 300});
    struct ordered_points alone = {0}, beside = {0};
    assert_int_equal(order_points(point, N, 1, &alone), STATUS_OK);
    point[77] = (vec3){0, 0, 0};
    assert_int_equal(order_points(point, N, 1, &beside), STATUS_OK);
    assert_true(alone.scale == alone.diagonal);
    assert_true(beside.diagonal > 5.4e6 && beside.scale < 2 * alone.scale && beside.scale > alone.scale / 2);
    assert_int_equal(beside.count, N);
    size_t far = 0;
    for (size_t i = 0; i < N; i++) far += vec3_length(beside.point[i]) > 1;
    assert_int_equal(far, 1);
    ordered_points_done(&alone), ordered_points_done(&beside);
    free(point);
}

/* Points that share a whole key, as in a billionth of the box, are along a curve of their own. */
static void a_crowd_in_one_cell_is_in_order(void **state) {
    (void)state;
    enum { N = 20000 };
    vec3 *point = shape_sphere(N, 1e-9);
    for (size_t i = 0; i < N; i++) point[i] = vec3_add(point[i], (vec3){0.3, 0.4, 0.5});
    for (int i = 0; i < 8; i++) point[i] = (vec3){i & 1, i >> 1 & 1, i >> 2 & 1};
    struct ordered_points all = {0};
    assert_int_equal(order_points(point, N, 1, &all), STATUS_OK);
    double jumps = 0;
    for (size_t i = 1; i < all.count; i++) {
        double jump = vec3_distance(all.point[i], all.point[i - 1]) * all.scale;
        if (jump < 1e-8) jumps += jump;
    }
    assert_true(jumps / N < 0.1e-9); /* the spacing is 0.025e-9; along x alone it would be 0.9e-9 */
    ordered_points_done(&all);
    free(point);
}

/* A stray makes all others share the upper half of their keys; with duplicates among them. */
static void a_stray_far_away_leaves_the_others_in_order(void **state) {
    (void)state;
    enum { N = 50000 };
    vec3 *point = shape_sphere(N, 1), *reversed = malloc(N * sizeof *reversed);
    point[7] = (vec3){1e3, 1e3, 1e3};
    for (size_t i = 1000; i < 2000; i++) point[i] = point[i + 20000];
    for (size_t i = 0; i < N; i++) reversed[i] = point[N - 1 - i];
    struct ordered_points a = {0}, b = {0};
    double jumps = 0;
    assert_int_equal(order_points(point, N, 1, &a), STATUS_OK);
    assert_int_equal(order_points(reversed, N, 4, &b), STATUS_OK);
    assert_int_equal(a.count, N - 1000);
    assert_int_equal(b.count, N - 1000);
    assert_memory_equal(a.point, b.point, a.count * sizeof *a.point);
    for (size_t i = 0; i < N; i++) assert_true(a.distinct[i] == b.distinct[N - 1 - i]);
    for (size_t i = 1; i + 1 < a.count; i++) jumps += vec3_distance(a.point[i], a.point[i - 1]) * a.scale;
    assert_true(jumps / N < 0.05); /* the spacing is 0.016; in no order it would be 1.3 */
    ordered_points_done(&a), ordered_points_done(&b);
    free(point), free(reversed);
}

static void nearest_neighbours_equal_brute_force(void **state) {
    (void)state;
    enum { N = 500, K = 7 };
    uint64_t seed = 3;
    vec3 point[N];
    for (size_t i = 0; i < N; i++) point[i] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
    struct knn *knn = NULL;
    uint32_t id[N * K];
    double distance_sq[N * K];
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(knn_search(knn, point, N, K, 2, id, distance_sq), STATUS_OK);
    for (size_t p = 0; p < N; p++) {
        assert_int_equal(id[p * K], p);
        unsigned nearer = 0;
        for (size_t q = 0; q < N; q++) nearer += vec3_distance_sq(point[p], point[q]) < distance_sq[p * K + K - 1];
        assert_int_equal(nearer, K - 1);
        for (unsigned i = 1; i < K; i++) {
            assert_true(distance_sq[p * K + i - 1] <= distance_sq[p * K + i]);
            assert_true(fabs(vec3_distance_sq(point[p], point[id[p * K + i]]) - distance_sq[p * K + i]) < 1e-15);
        }
    }
    knn_free(knn);
}

static void fewer_points_than_neighbours_are_padded(void **state) {
    (void)state;
    const vec3 point[] = {{0, 0, 0}, {1, 0, 0}};
    struct knn *knn = NULL;
    uint32_t id[8];
    double distance_sq[8];
    assert_int_equal(knn_new(point, 2, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(knn_search(knn, point, 2, 4, 1, id, distance_sq), STATUS_OK);
    const uint32_t expected[8] = {0, 1, NONE, NONE, 1, 0, NONE, NONE};
    assert_memory_equal(id, expected, sizeof id);
    assert_true(isinf(distance_sq[2]) && distance_sq[1] == 1 && distance_sq[5] == 1);
    knn_free(knn);
}

struct found {
    size_t n;
    vec3 *point, *normal;
    struct knn *knn;
    struct neighbourhood neighbours;
};

static struct found find(vec3 *point, size_t n, double radius, unsigned min, unsigned max) {
    struct found found = {.n = n, .point = point, .normal = malloc(n * sizeof(vec3))};
    struct neighbourhood_options options = {radius, min, max, 2};
    assert_int_equal(knn_new(point, n, 1, &found.knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(found.knn, point, n, &options, &found.neighbours), STATUS_OK);
    normals_fit(point, &found.neighbours, 2, found.normal, NULL);
    return found;
}

static void found_done(struct found *found) {
    knn_free(found->knn);
    neighbourhood_done(&found->neighbours);
    free(found->normal);
    free(found->point);
}

static void a_grid_has_eight_neighbours_within_gopi_s_radius(void **state) {
    (void)state;
    struct found found = find(shape_height_field(21, height_plane), 21 * 21, 1.6, 3, 16);
    size_t middle = 10 * 21 + 10, corner = 0;
    assert_int_equal(found.neighbours.count[middle], 8);
    assert_int_equal(found.neighbours.count[corner], 3);
    for (unsigned i = 0; i < 8; i++) {
        long d = labs((long)found.neighbours.id[middle * 16 + i] - (long)middle);
        assert_true(d == 1 || d == 20 || d == 21 || d == 22);
    }
    found_done(&found);
}

/* Both sides of a wall .7 spacings thick, and as much noise. */
static void both_sides_of_thin_walls_are_told_from_noise(void **state) {
    (void)state;
    enum { SIDE = 40, N = 2 * SIDE * SIDE };
    static const double HIGH = 0.7;
    uint64_t seed = 3;
    for (int noisy = 0; noisy < 2; noisy++) {
        vec3 *point = malloc(N * sizeof *point);
        for (int i = 0; i < N; i++) {
            double z = noisy ? random_unit(&seed) + random_unit(&seed) + random_unit(&seed) : i % 2;
            point[i] = (vec3){i / 2 % SIDE, i / 2 / SIDE, HIGH * z};
        }
        struct found found = find(point, N, 2.5, 6, 10);
        assert_int_equal(found.neighbours.walls, !noisy);
        assert_int_equal(found.neighbours.noisy, noisy);
        found_done(&found);
    }
}

static void any_search_may_fail(void **state) {
    (void)state;
    enum { N = 21 * 21 };
    vec3 *point = shape_height_field(21, height_plane);
    struct neighbourhood_options options = {3, 3, 16, 1};
    struct knn *knn = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        struct neighbourhood neighbours = {0};
        faults_in_new(nth + 1);
        enum status status = neighbourhood_find(knn, point, N, &options, &neighbours);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        neighbourhood_done(&neighbours);
    }
    assert_true(nth > 1);
    knn_free(knn);
    free(point);
}

/* A ball, and dense lines over it whose points have neighbours on both sides, from farther off.  Of both some points
 * are lost, and some that stand off, too. */
static void neighbourhoods_of_what_is_left_are_those_that_are_found(void **state) {
    (void)state;
    enum { N = 6000, LINES = 4, ON_LINE = 500, OFF = 10, FIRST_OFF = N - OFF };
    const struct neighbourhood_options options = {3, 6, 12, 2};
    vec3 *point = shape_sphere(N, 1), *left = malloc(N * sizeof *left);
    static uint8_t lost[N];
    struct neighbourhood kept = {0}, fresh = {0};
    struct knn *knn = NULL;
    size_t m = 0;
    for (int i = 0; i < LINES * ON_LINE; i++)
        point[i] = (vec3){0.002 * (i % ON_LINE), 0.05 * (i / ON_LINE), 1.2 + 1e-5 * (i % 7)};
    for (int i = 0; i < OFF; i++) point[FIRST_OFF + i] = vec3_scale(point[FIRST_OFF + i], 1.1 + 0.1 * i);
    for (size_t p = 0; p < N; p++) {
        lost[p] = p % 397 == 5 || p >= FIRST_OFF;
        if (!lost[p]) left[m++] = point[p];
    }
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find_reach(knn, point, N, &options, &kept), STATUS_OK);
    knn_free(knn);
    assert_int_equal(knn_new(left, m, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_lose(knn, left, &options, point, lost, &kept), STATUS_OK);
    assert_int_equal(neighbourhood_find_as(knn, left, m, &options, kept.noisy, &fresh), STATUS_OK);
    assert_true(kept.n == m && kept.stride == fresh.stride);
    assert_memory_equal(kept.count, fresh.count, m);
    assert_memory_equal(kept.spacing, fresh.spacing, m * sizeof *fresh.spacing);
    for (size_t p = 0; p < m; p++)
        assert_memory_equal(&kept.id[p * kept.stride], &fresh.id[p * fresh.stride], fresh.count[p] * sizeof *fresh.id);
    knn_free(knn);
    neighbourhood_done(&kept), neighbourhood_done(&fresh);
    free(point), free(left);
}

static void an_accidental_close_pair_does_not_shrink_the_ball(void **state) {
    (void)state;
    vec3 *point = shape_height_field(21, height_plane);
    point[10 * 21 + 11] = vec3_lerp(point[10 * 21 + 10], point[10 * 21 + 11], 1e-6);
    struct found found = find(point, 21 * 21, 3, 3, 16);
    assert_true(found.neighbours.count[10 * 21 + 10] >= 6);
    found_done(&found);
}

static void scan_lines_get_neighbours_across(void **state) {
    (void)state;
    enum { LINES = 12, ALONG = 400 };
    vec3 *point = malloc(LINES * ALONG * sizeof *point);
    for (size_t i = 0; i < LINES * ALONG; i++)
        point[i] = (vec3){(double)(i % ALONG) * 0.0025, (double)(i / ALONG) * 0.02, 0};
    struct found found = find(point, LINES * ALONG, 3, 6, 10);
    for (size_t p = 0; p < found.n; p++) assert_true(fabs(fabs(found.normal[p].z) - 1) < 1e-9);
    found_done(&found);
}

static vec3 on_moment_curve(double t) { return (vec3){0.5 * t, 0.5 * t * t, 0.5 * t * t * t}; }

/* Two lines that cross without meeting. */
static vec3 on_skew_lines(double t) {
    double at = 0.5 * fmod(2 * t, 1);
    return t < 0.5 ? (vec3){at, 0, 0} : (vec3){0.2, at, 0.3};
}

/* 5 lines around a pipe, 32 times as dense along as across, and a spiral whose turns are nearer each other. */
static vec3 on_pipe(double t) {
    double line = floor(5 * t), turn = 2 * M_PI * (5 * t - line);
    return (vec3){0.2 * cos(turn), 0.2 * sin(turn), 0.04 * line};
}

static vec3 on_spiral(double t) { return (vec3){0.3 * t * cos(60 * M_PI * t), 0.3 * t * sin(60 * M_PI * t), 0.5 * t}; }

static vec3 on_ball(double t) {
    double z = 1 - 2 * t, turn = 5000 * t * M_PI * (3 - sqrt(5));
    return vec3_scale((vec3){sqrt(1 - z * z) * cos(turn), sqrt(1 - z * z) * sin(turn), z}, 0.3);
}

static void curves_are_no_scan_lines(void **state) {
    (void)state;
    enum { N = 5000 };
    const struct {
        vec3 (*at)(double t);
        bool curves;
    } rows[] = {{on_moment_curve, true}, {on_skew_lines, true}, {on_pipe, false}, {on_spiral, false}, {on_ball, false}};
    for (size_t r = 0; r < sizeof rows / sizeof *rows; r++)
        for (unsigned threads = 1; threads <= 2; threads++) {
            vec3 *point = malloc(N * sizeof *point);
            for (size_t i = 0; i < N; i++) point[i] = rows[r].at((double)i / N);
            struct found found = find(point, N, 3, 6, 10);
            bool curves = !rows[r].curves;
            assert_int_equal(scan_lines_are_curves(&found.neighbours, found.point, threads, &curves), STATUS_OK);
            assert_int_equal(curves, rows[r].curves);
            found_done(&found);
        }
}

/* ------------------------------------------------------------------------------------------------ normals, DSO */

static void normals_of_a_plane_and_a_sphere(void **state) {
    (void)state;
    struct found plane = find(shape_height_field(15, height_plane), 225, 3, 6, 12);
    vec3 expected = vec3_unit((vec3){-0.3, 0.2, 1});
    for (size_t p = 0; p < plane.n; p++) assert_true(fabs(fabs(vec3_dot(plane.normal[p], expected)) - 1) < 1e-12);
    found_done(&plane);
    struct found sphere = find(shape_sphere(4000, 1), 4000, 3, 6, 12);
    for (size_t p = 0; p < sphere.n; p++) assert_true(fabs(vec3_dot(sphere.normal[p], sphere.point[p])) > 0.999);
    found_done(&sphere);
}

static void lonely_and_collinear_points_still_have_a_unit_normal(void **state) {
    (void)state;
    vec3 *one = malloc(sizeof *one);
    *one = (vec3){0, 0, 0};
    struct found lonely = find(one, 1, 3, 6, 12);
    assert_true(vec3_length(lonely.normal[0]) == 1);
    found_done(&lonely);
    vec3 *line = malloc(50 * sizeof *line);
    for (int i = 0; i < 50; i++) line[i] = (vec3){i * 0.02, i * 0.02, 0};
    struct found collinear = find(line, 50, 3, 6, 12);
    for (size_t p = 0; p < 50; p++) {
        assert_true(fabs(vec3_length(collinear.normal[p]) - 1) < 1e-12);
        assert_true(fabs(vec3_dot(collinear.normal[p], vec3_unit((vec3){1, 1, 0}))) < 1e-6);
    }
    found_done(&collinear);
}

/* Mean of the operator over the points that `inside` accepts. */
static double mean_dso(struct found *found, enum dso_form form, int (*inside)(vec3 p)) {
    float *dso = malloc(found->n * sizeof *dso);
    dso_compute(found->point, found->normal, &found->neighbours, form, 2, dso);
    double sum = 0;
    size_t count = 0;
    for (size_t p = 0; p < found->n; p++)
        if (inside(found->point[p])) sum += (double)dso[p], count++;
    free(dso);
    assert_true(count > 0);
    return sum / (double)count;
}

static int anywhere(vec3 p) { return p.x == p.x; }
static int far_from_rims(vec3 p) { return p.z > 0.8 && p.z < 2.2; }
static int near_the_saddle_point(vec3 p) { return hypot(p.x - 0.5, p.y - 0.5) < 0.1; }

static void dso_has_its_exact_values(void **state) {
    (void)state;
    struct found plane = find(shape_height_field(15, height_plane), 225, 3, 6, 12);
    assert_true(mean_dso(&plane, DSO_RMS, anywhere) < 1e-6);
    assert_true(mean_dso(&plane, DSO_SUM, anywhere) < 1e-6);
    assert_true(mean_dso(&plane, DSO_NONE, anywhere) == 1);
    found_done(&plane);
    /* The softened 1 / d takes a few per cent off: d / (d^2 + (d/4)^2) = 0.94 / d where all d are alike. */
    struct found sphere = find(shape_sphere(10000, 1), 10000, 3, 6, 12);
    double soft = 1 / (1 + 1.0 / 16), value = mean_dso(&sphere, DSO_RMS, anywhere);
    assert_true(fabs(value - soft) < 0.03);
    value = mean_dso(&sphere, DSO_SUM, anywhere);
    assert_true(fabs(value - soft) < 0.03);
    found_done(&sphere);
    struct found cylinder = find(shape_cylinder(100, 50), 5000, 1.6, 3, 12);
    value = mean_dso(&cylinder, DSO_RMS, far_from_rims);
    assert_true(fabs(value - sqrt(0.5) * soft) < 0.03); /* |S t|^2 averages to 1/2 */
    found_done(&cylinder);
}

static void the_rms_form_does_not_cancel_on_a_saddle(void **state) {
    (void)state;
    struct found saddle = find(shape_height_field(81, height_saddle), 81 * 81, 1.6, 3, 12);
    assert_true(fabs(mean_dso(&saddle, DSO_RMS, near_the_saddle_point) - 1 / (1 + 1.0 / 16)) < 0.06);
    assert_true(mean_dso(&saddle, DSO_SUM, near_the_saddle_point) < 0.1);
    found_done(&saddle);
}

static void weights_of_a_plane_are_one_and_others_average_around_it(void **state) {
    (void)state;
    const float flat[] = {0, 0, 0}, mixed[] = {0, 1, 2};
    float weight[3];
    dso_weights(flat, 3, dso_average(flat, NULL, 3), 0.5, 1, weight);
    for (int i = 0; i < 3; i++) assert_true(weight[i] == 1);
    dso_weights(mixed, 3, dso_average(mixed, NULL, 3), 1, 2, weight);
    assert_true(weight[0] > 0 && weight[0] < 0.02f && fabsf(weight[1] - 1) < 1e-6f && weight[2] > 1.9f);
    dso_weights(mixed, 3, dso_average(mixed, NULL, 3), 0, 1, weight);
    for (int i = 0; i < 3; i++) assert_true(weight[i] == 1);
}

static void the_operator_is_smoothed_over_a_point_and_its_neighbours(void **state) {
    (void)state;
    uint32_t id[] = {1, 2, 0, 9, 9, 9};
    uint8_t count[] = {2, 1, 0};
    const struct neighbourhood neighbours = {.n = 3, .stride = 2, .id = id, .count = count};
    const float dso[] = {1, 4, 10};
    float smooth[3];
    dso_smooth(dso, &neighbours, 2, smooth);
    assert_true(smooth[0] == 5);
    assert_true(smooth[1] == 2.5f);
    assert_true(smooth[2] == 10);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertices_of_a_volume_are_on_grid_lines),
        cmocka_unit_test(grids_are_even_and_points_at_random_are_not),
        cmocka_unit_test(points_on_both_sides_are_on_a_plate),
        cmocka_unit_test(points_all_around_are_on_bars),
        cmocka_unit_test(duplicates_and_negative_zero_become_one_point),
        cmocka_unit_test(one_point_is_a_frame_of_its_own),
        cmocka_unit_test(huge_and_tiny_coordinates_are_normalised),
        cmocka_unit_test(the_diagonal_is_the_same_on_all_processors),
        cmocka_unit_test(the_order_does_not_depend_on_the_input_s),
        cmocka_unit_test(a_stray_does_not_spoil_the_frame),
        cmocka_unit_test(a_crowd_in_one_cell_is_in_order),
        cmocka_unit_test(a_stray_far_away_leaves_the_others_in_order),
        cmocka_unit_test(nearest_neighbours_equal_brute_force),
        cmocka_unit_test(fewer_points_than_neighbours_are_padded),
        cmocka_unit_test(a_grid_has_eight_neighbours_within_gopi_s_radius),
        cmocka_unit_test(both_sides_of_thin_walls_are_told_from_noise),
        cmocka_unit_test(any_search_may_fail),
        cmocka_unit_test(neighbourhoods_of_what_is_left_are_those_that_are_found),
        cmocka_unit_test(an_accidental_close_pair_does_not_shrink_the_ball),
        cmocka_unit_test(scan_lines_get_neighbours_across),
        cmocka_unit_test(curves_are_no_scan_lines),
        cmocka_unit_test(normals_of_a_plane_and_a_sphere),
        cmocka_unit_test(lonely_and_collinear_points_still_have_a_unit_normal),
        cmocka_unit_test(dso_has_its_exact_values),
        cmocka_unit_test(the_rms_form_does_not_cancel_on_a_saddle),
        cmocka_unit_test(the_operator_is_smoothed_over_a_point_and_its_neighbours),
        cmocka_unit_test(weights_of_a_plane_are_one_and_others_average_around_it),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
