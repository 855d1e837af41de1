/* Nearest neighbours: whoever is asked for together with others gets what it would get alone, to the bit.
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
#include "core/spatial/knn.h"
#include "core/spatial/knn_boxes.h"
#include "core/spatial/neighbourhood.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

/* Takes the points, as order_points leaves them. */
static struct ordered_points ordered(vec3 *point, size_t n) {
    struct ordered_points out = {0};
    assert_int_equal(order_points(point, n, 1, &out), STATUS_OK);
    free(point);
    return out;
}

/* The k nearest by distance, then id: no other point comes before the last of them. */
static void assert_exact(const vec3 *point, size_t n, vec3 query, unsigned k, const uint32_t *id,
                         const double *distance_sq) {
    size_t in = 0;
    double last = distance_sq[k - 1];
    for (size_t i = 0; i < n; i++) {
        double d = vec3_distance_sq(query, point[i]);
        in += d < last || (d == last && i <= id[k - 1]);
    }
    assert_int_equal(in, k);
    for (unsigned i = 0; i < k; i++) {
        assert_true(distance_sq[i] == vec3_distance_sq(query, point[id[i]]));
        assert_true(i == 0 || distance_sq[i - 1] < distance_sq[i] ||
                    (distance_sq[i - 1] == distance_sq[i] && id[i - 1] < id[i]));
    }
}

/* Asks for all queries at once, by one thread and by two, and for each alone. */
static void assert_together_as_alone(const vec3 *point, size_t n, const vec3 *query, size_t m, unsigned k) {
    struct knn *knn = NULL;
    uint32_t *id[2], alone_id[KNN_MAX_K];
    double *distance_sq[2], alone_sq[KNN_MAX_K];
    assert_int_equal(knn_new(point, n, 2, &knn, NULL), STATUS_OK);
    for (unsigned t = 0; t < 2; t++) {
        id[t] = malloc(m * k * sizeof *id[t]);
        distance_sq[t] = malloc(m * k * sizeof *distance_sq[t]);
        assert_int_equal(knn_search(knn, query, m, k, t + 1, id[t], distance_sq[t]), STATUS_OK);
    }
    assert_memory_equal(id[0], id[1], m * k * sizeof *id[0]);
    assert_memory_equal(distance_sq[0], distance_sq[1], m * k * sizeof *distance_sq[0]);
    for (size_t q = 0; q < m; q++) {
        assert_int_equal(knn_search(knn, &query[q], 1, k, 1, alone_id, alone_sq), STATUS_OK);
        assert_memory_equal(&id[0][q * k], alone_id, k * sizeof *alone_id);
        assert_memory_equal(&distance_sq[0][q * k], alone_sq, k * sizeof *alone_sq);
        if (q % 50 == 0) assert_exact(point, n, query[q], k, alone_id, alone_sq);
    }
    for (unsigned t = 0; t < 2; t++) free(id[t]), free(distance_sq[t]);
    knn_free(knn);
}

static void assert_each_as_alone(vec3 *point, size_t n) {
    const unsigned counts[] = {1, 2, 11, 31, KNN_MAX_K};
    struct ordered_points all = ordered(point, n);
    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++)
        assert_together_as_alone(all.point, all.count, all.point, all.count, counts[i]);
    ordered_points_done(&all);
}

static void points_of_a_surface(void **state) {
    (void)state;
    assert_each_as_alone(shape_sphere(5000, 1), 5000);
}

/* Nearly all have neighbours that are equally far. */
static void points_of_a_grid(void **state) {
    (void)state;
    assert_each_as_alone(shape_height_field(65, height_plane), 65 * 65);
}

/* Each step is 1.02 times the one before, then the same again far away: what was usual isn't any more. */
static void points_that_are_dense_and_sparse(void **state) {
    (void)state;
    enum { N = 2000 };
    uint64_t seed = 5;
    vec3 *point = malloc(N * sizeof *point);
    for (size_t i = 0; i < N; i++) {
        double r = pow(1.02, (double)(i % (N / 2))) + (i < N / 2 ? 0 : 1e9);
        point[i] = (vec3){r, r * 0.1 * random_unit(&seed), r * 0.1 * random_unit(&seed)};
    }
    assert_each_as_alone(point, N);
}

/* Balls of a few usual distances hold hundreds of points. */
static void points_in_crowds(void **state) {
    (void)state;
    enum { N = 3000 };
    uint64_t seed = 6;
    vec3 *point = malloc(N * sizeof *point);
    for (size_t i = 0; i < N; i++) {
        double size = i % 2 ? 1e-6 : 1, at = i % 2 ? (double)(i % 7) / 7 : 0;
        point[i] = (vec3){at + size * random_unit(&seed), size * random_unit(&seed), size * random_unit(&seed)};
    }
    assert_each_as_alone(point, N);
}

/* As for the tangent error: many queries, few points, none of which is a query. */
static void queries_that_are_no_points(void **state) {
    (void)state;
    enum { N = 4000, FEW = 90 };
    struct ordered_points all = ordered(shape_sphere(N, 1), N);
    vec3 few[FEW];
    for (size_t i = 0; i < FEW; i++) few[i] = vec3_scale(all.point[i * (N / FEW)], 1.01);
    assert_together_as_alone(few, FEW, all.point, N, 1);
    assert_together_as_alone(few, FEW, all.point, N, 5);
    ordered_points_done(&all);
}

/* Differences whose squares leave what is finite, or what is normal. */
static void huge_and_tiny_distances(void **state) {
    (void)state;
    enum { N = 600 };
    const double scales[] = {1e160, 1e130, 1e-130, 1e-160};
    for (size_t s = 0; s < 4; s++) {
        struct ordered_points all = ordered(shape_sphere(N, 1), N);
        for (size_t i = 0; i < N; i++) all.point[i] = vec3_scale(all.point[i], scales[s]);
        struct knn *knn = NULL;
        uint32_t id[N * 6];
        double distance_sq[N * 6];
        assert_int_equal(knn_new(all.point, N, 1, &knn, NULL), STATUS_OK);
        assert_int_equal(knn_search(knn, all.point, N, 6, 1, id, distance_sq), STATUS_OK);
        for (size_t q = 0; q < N; q++) {
            uint32_t alone_id[6];
            double alone_sq[6];
            assert_int_equal(knn_search(knn, &all.point[q], 1, 6, 1, alone_id, alone_sq), STATUS_OK);
            assert_memory_equal(&id[q * 6], alone_id, sizeof alone_id);
            assert_memory_equal(&distance_sq[q * 6], alone_sq, sizeof alone_sq);
        }
        knn_free(knn);
        ordered_points_done(&all);
    }
}

/* Clouds of more than 16384 points have several trees. */
enum { MANY = 20000 };

/* Every 97th point, and as many places far off. */
static void assert_pieces_exact(vec3 *point, size_t n) {
    enum { STEP = 97 };
    struct ordered_points all = ordered(point, n);
    size_t m = all.count / STEP;
    vec3 *query = malloc(2 * m * sizeof *query);
    for (size_t i = 0; i < m; i++) {
        query[i] = all.point[i * STEP];
        query[m + i] = vec3_scale(query[i], 3);
    }
    assert_together_as_alone(all.point, all.count, query, 2 * m, 1);
    assert_together_as_alone(all.point, all.count, query, 2 * m, 11);
    assert_together_as_alone(all.point, all.count, query, 2 * m, KNN_MAX_K);
    free(query);
    ordered_points_done(&all);
}

static void pieces_of_a_surface(void **state) {
    (void)state;
    assert_pieces_exact(shape_sphere(5 * MANY, 1), 5 * MANY);
}

/* Equals lie on both sides of the cuts. */
static void pieces_of_a_grid(void **state) {
    (void)state;
    assert_pieces_exact(shape_height_field(151, height_plane), 151 * 151);
}

static void pieces_of_a_line(void **state) {
    (void)state;
    vec3 *point = malloc(MANY * sizeof *point);
    for (size_t i = 0; i < MANY; i++) point[i] = (vec3){0.25 * (double)i, 0.5 * (double)i, 0};
    assert_pieces_exact(point, MANY);
}

/* The middle of the sample is where nearly all points are: one piece has seven, and k is more. */
/* Queries between strays and the others, and points in the crowd that strays make of these. */
static void pieces_beside_strays(void **state) {
    (void)state;
    vec3 *point = shape_sphere(MANY, 1);
    for (int i = 0; i < 20; i++) point[i * 100] = vec3_scale(point[i * 100 + 1], 1e4 * (1 + i));
    assert_pieces_exact(point, MANY);
}

/* Many points are about as near as the nearest, as those of a curve are from its hollow, or exactly as near, as those
 * of a circle are from its axis: the trees give up and the boxes are asked. */
static void far_from_curves(void **state) {
    (void)state;
    uint64_t seed = 7;
    vec3 *curve = malloc(MANY * sizeof *curve), *circle = malloc(MANY * sizeof *circle), query[200];
    for (size_t i = 0; i < MANY; i++) {
        double t = (double)i / MANY;
        curve[i] = (vec3){t, t * t, t * t * t};
        circle[i] = (vec3){cos(2 * M_PI * t), sin(2 * M_PI * t), 0};
    }
    struct ordered_points all[] = {ordered(curve, MANY), ordered(circle, MANY)};
    for (size_t q = 0; q < 200; q++) query[q] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
    for (size_t q = 0; q < 20; q++) query[q] = (vec3){0, 0, (double)q / 40};
    for (int i = 0; i < 2; i++) {
        for (size_t k = 1; k <= KNN_MAX_K; k = 4 * k)
            assert_together_as_alone(all[i].point, MANY, query, 200, (unsigned)k);
        ordered_points_done(&all[i]);
    }
}

/* With spacings, what is near is exact; what is thousands of them away is nearly the nearest. */
static void what_is_far_is_nearly_the_nearest(void **state) {
    (void)state;
    enum { N = 5000 };
    struct ordered_points all = ordered(shape_sphere(N, 1), N);
    struct knn *knn = NULL;
    float *spacing = malloc(N * sizeof *spacing);
    vec3 query[2 * N];
    uint32_t id[2][2 * N];
    double distance_sq[2][2 * N];
    for (size_t i = 0; i < N; i++) {
        spacing[i] = 0.02f;
        query[i] = vec3_scale(all.point[i], 1.1);
        query[N + i] = vec3_scale(all.point[i], 1e4);
    }
    assert_int_equal(knn_new(all.point, all.count, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(knn_search(knn, query, 2 * N, 1, 1, id[0], distance_sq[0]), STATUS_OK);
    struct knn_slack slack = {spacing, 4096, 0x1p-11};
    assert_int_equal(knn_search_nearly(knn, &slack, query, 2 * N, 1, 2, id[1], distance_sq[1]), STATUS_OK);
    assert_memory_equal(id[0], id[1], N * sizeof *id[0]);
    for (size_t i = 0; i < 2 * N; i++) {
        assert_true(distance_sq[1][i] == vec3_distance_sq(query[i], all.point[id[1][i]]));
        assert_true(distance_sq[1][i] <= distance_sq[0][i] * (1 + 0x1p-9));
    }
    knn_free(knn);
    ordered_points_done(&all);
    free(spacing);
}

/* As a ball has them, in the order of their ids; false where its boxes don't tell. */
static bool is_ball_exact(const struct knn_boxes *boxes, const vec3 *point, size_t n, vec3 centre, double radius) {
    enum { MOST = 300 };
    double x[MOST + KNN_BOXES_ROOM], y[MOST + KNN_BOXES_ROOM], z[MOST + KNN_BOXES_ROOM];
    uint32_t id[MOST + KNN_BOXES_ROOM];
    struct knn_gathered gathered = {x, y, z, id, 0};
    size_t in = 0;
    if (!knn_boxes_within(boxes, centre, radius, MOST, &gathered)) return false;
    for (size_t i = 0; i < n; i++) in += vec3_distance_sq(centre, point[i]) < radius * radius;
    assert_true(in > MOST ? gathered.count > MOST : gathered.count == in);
    if (in > MOST) return true;
    for (size_t i = 0; i < in; i++) {
        assert_true(vec3_equal(point[id[i]], (vec3){x[i], y[i], z[i]}));
        assert_true(vec3_distance_sq(centre, point[id[i]]) < radius * radius);
        for (size_t j = 0; j < i; j++) assert_true(id[j] != id[i]);
    }
    return true;
}

/* How many of so many balls of about 3, 30 and 3000 points around points, and beside all, the boxes tell of. */
static size_t balls_that_are_told(const vec3 *point, size_t n) {
    enum { STEP = 500 };
    struct knn_boxes *boxes = NULL;
    size_t told = 0;
    assert_int_equal(knn_boxes_new(point, n, &boxes), STATUS_OK);
    for (size_t p = 0; p < n; p += STEP)
        for (double many = 3; many < 4000; many *= many == 3 ? 10 : 100)
            told += is_ball_exact(boxes, point, n, point[p], 2 * sqrt(many / (double)n));
    assert_true(is_ball_exact(boxes, point, n, (vec3){9, 9, 9}, 1));
    knn_boxes_free(boxes);
    return told;
}

/* All balls of points that follow each other, on a surface or in a volume, where boxes are loose, and hardly one of
 * points in no order: those would look at all boxes. */
static void balls_of_points_in_an_order(void **state) {
    (void)state;
    enum { FEW = 37 };
    vec3 *volume = malloc(MANY * sizeof *volume);
    struct ordered_points all = ordered(shape_sphere(MANY, 1), MANY);
    assert_int_equal(balls_that_are_told(all.point, MANY), 3 * MANY / 500);
    assert_int_equal(balls_that_are_told(all.point, FEW), 3);
    uint64_t seed = 8;
    for (size_t i = MANY - 1; i > 0; i--) {
        size_t j = (size_t)(random_unit(&seed) * (double)i);
        vec3 p = all.point[i];
        all.point[i] = all.point[j], all.point[j] = p;
    }
    for (size_t i = 0; i < MANY; i++) volume[i] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
    struct ordered_points filled = ordered(volume, MANY);
    assert_int_equal(balls_that_are_told(filled.point, MANY), 3 * MANY / 500);
    ordered_points_done(&filled);
    assert_true(balls_that_are_told(all.point, MANY) < MANY / 500 + 2);
    ordered_points_done(&all);
}

static void a_piece_of_fewer_than_k(void **state) {
    (void)state;
    vec3 *point = malloc(MANY * sizeof *point);
    for (size_t i = 0; i < MANY; i++)
        point[i] = (vec3){i % (MANY / 7) == 5 ? -2 : 0, (double)(i % 141) / 141, (double)i / 141 / 141};
    assert_pieces_exact(point, MANY);
}

/* All of a sample are at one place, and some more: a cut there leaves one side empty. */
static void pieces_without_points(void **state) {
    (void)state;
    vec3 *point = malloc(MANY * sizeof *point);
    struct knn *knn = NULL;
    uint32_t id[KNN_MAX_K];
    double distance_sq[KNN_MAX_K];
    for (size_t i = 0; i < MANY; i++) point[i] = (vec3){i == MANY - 1 ? 1 : 0, 0, 0};
    assert_int_equal(knn_new(point, MANY, 2, &knn, NULL), STATUS_OK);
    for (int side = -1; side <= 1; side++) {
        vec3 query = {side, 0, 0};
        assert_int_equal(knn_search(knn, &query, 1, KNN_MAX_K, 1, id, distance_sq), STATUS_OK);
        assert_exact(point, MANY, query, KNN_MAX_K, id, distance_sq);
    }
    knn_free(knn);
    free(point);
}

/* Pieces are found whatever the order of the points is. */
static void pieces_of_points_in_no_order(void **state) {
    (void)state;
    vec3 *point = shape_sphere(MANY, 1);
    uint64_t seed = 7;
    for (size_t i = MANY - 1; i > 0; i--) {
        size_t j = (size_t)(random_unit(&seed) * (double)i);
        vec3 p = point[i];
        point[i] = point[j], point[j] = p;
    }
    assert_together_as_alone(point, MANY, point, 500, 12);
    free(point);
}

/* FLANN's own pool would go on with a null pointer. */
static void an_index_without_memory_is_told(void **state) {
    (void)state;
    enum { N = 17000 };
    vec3 *point = shape_sphere(N, 1);
    bool failed = true;
    long nth = 0;
    while (failed) {
        struct knn *knn = NULL;
        struct error error = {0};
        faults_in_memory(++nth, false);
        enum status status = knn_new(point, N, 1, &knn, &error);
        failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(failed == !knn);
        knn_free(knn);
    }
    assert_true(nth > 3);
    free(point);
}

/* A heap of branches for each query is what a search allocates, in FLANN: the loops end where none is left to fail. */
static void a_search_without_memory_is_told(void **state) {
    (void)state;
    enum { N = 40, K = 5 };
    vec3 *point = shape_sphere(N, 1);
    struct knn *knn = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    uint32_t id[N * K];
    double distance_sq[N * K];
    long nth = 0;
    for (bool happened = true; happened; nth++) {
        faults_in_new(nth + 1);
        enum status status = knn_search(knn, point, N, K, 1, id, distance_sq);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_true(nth > 1);
    knn_free(knn);
    free(point);
}

static void neighbourhoods_without_memory_are_told(void **state) {
    (void)state;
    enum { N = 400 };
    vec3 *point = shape_sphere(N, 1);
    struct knn *knn = NULL;
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    long nth = 0;
    for (bool happened = true; happened; nth++) {
        struct neighbourhood neighbours = {0};
        faults_in_new(nth + 1);
        enum status status =
            neighbourhood_find(knn, point, N, &(struct neighbourhood_options){3, 6, 12, 1}, &neighbours);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened == !neighbours.id);
        neighbourhood_done(&neighbours);
    }
    assert_true(nth > 1);
    knn_free(knn);
    free(point);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(points_of_a_surface),
        cmocka_unit_test(points_of_a_grid),
        cmocka_unit_test(points_that_are_dense_and_sparse),
        cmocka_unit_test(points_in_crowds),
        cmocka_unit_test(queries_that_are_no_points),
        cmocka_unit_test(huge_and_tiny_distances),
        cmocka_unit_test(pieces_of_a_surface),
        cmocka_unit_test(pieces_of_a_grid),
        cmocka_unit_test(pieces_of_a_line),
        cmocka_unit_test(pieces_beside_strays),
        cmocka_unit_test(far_from_curves),
        cmocka_unit_test(what_is_far_is_nearly_the_nearest),
        cmocka_unit_test(balls_of_points_in_an_order),
        cmocka_unit_test(a_piece_of_fewer_than_k),
        cmocka_unit_test(pieces_without_points),
        cmocka_unit_test(pieces_of_points_in_no_order),
        cmocka_unit_test(an_index_without_memory_is_told),
        cmocka_unit_test(a_search_without_memory_is_told),
        cmocka_unit_test(neighbourhoods_without_memory_are_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
