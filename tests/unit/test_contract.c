/* Quadrics and contraction: exact values on planes, then the properties that every ranking must have.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/measure/tangent.h"
#include "core/simplify/contract.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

/* ------------------------------------------------------------------------------------------------ quadrics */

static void a_plane_s_quadric_is_weight_times_squared_distance(void **state) {
    (void)state;
    quadric q = {0};
    quadric_add_plane(&q, (vec3){0, 0, 1}, 3);
    assert_true(quadric_value(&q, (vec3){5, 7, 2}) == 12);
    quadric moved = quadric_shift(q, (vec3){1, 2, -4}); /* its plane is now z = -4 */
    assert_true(fabs(quadric_value(&moved, (vec3){9, 9, 1}) - 75) < 1e-12);
    quadric sum = quadric_add(q, moved);
    assert_true(fabs(quadric_value(&sum, (vec3){0, 0, -4}) - 48) < 1e-12 && sum.weight == 6);
}

static void a_line_s_quadric_is_the_squared_distance_to_it(void **state) {
    (void)state;
    quadric q = {0};
    quadric_add_line(&q, (vec3){0, 1, 0}, 2);
    assert_true(fabs(quadric_value(&q, (vec3){3, 100, 4}) - 50) < 1e-9);
    assert_true(q.weight == 0);
}

/* How many triangles the quadric of a point has with neighbours at these angles (degrees) around it: all of their
 * planes are z = 0, and those along borders are upright. */
static double triangles_around(const double *degrees, unsigned count) {
    enum { MOST = 16 };
    vec3 point[MOST + 1] = {{0, 0, 0}}, normal[MOST + 1];
    uint32_t id[(MOST + 1) * MOST] = {0};
    uint8_t counts[MOST + 1] = {(uint8_t)count};
    float spacing[MOST + 1], weight[MOST + 1];
    struct packed_quadric packed[MOST + 1];
    for (unsigned i = 0; i <= MOST; i++) {
        double angle = i < count ? degrees[i] * 3.14159265358979 / 180 : 0;
        if (i < MOST) point[i + 1] = (vec3){(1 + 0.1 * i) * cos(angle), (1 + 0.1 * i) * sin(angle), 0};
        if (i < MOST) id[i] = i + 1;
        normal[i] = (vec3){0, 0, 1};
        spacing[i] = weight[i] = 1;
    }
    const struct neighbourhood neighbours = {
        .n = MOST + 1, .stride = MOST, .id = id, .count = counts, .spacing = spacing};
    const struct quadric_options options = {AREA_UNIT, 0, 1};
    quadric_assemble(point, normal, &neighbours, weight, &options, packed);
    return quadric_unpack(&packed[0]).a.zz;
}

/* Between neighbours that are over 0.9 pi (162 degrees) apart there is no triangle. */
static void wide_angles_are_no_triangles(void **state) {
    (void)state;
    static const double half_disc[] = {0, 45, 90, 135, 180}, narrow[] = {0, 60, 120, 199}, wide[] = {0, 60, 120, 197};
    static const double narrow_within[] = {0, 161, 200, 280}, wide_within[] = {0, 163, 200, 280};
    static const double at_the_end[] = {0, 90, 180, 190, 192, 194, 195},
                        at_the_start[] = {-165, 0, 30, 60, 90, 120, 150};
    static const double third[] = {0, 60, 120};
    assert_true(triangles_around(half_disc, 5) == 4 && triangles_around(third, 3) == 2);
    assert_true(triangles_around(narrow, 4) == 4 && triangles_around(wide, 4) == 3);
    assert_true(triangles_around(narrow_within, 4) == 4 && triangles_around(wide_within, 4) == 3);
    assert_true(triangles_around(at_the_end, 7) == 6 && triangles_around(at_the_start, 7) == 6);
}

/* ------------------------------------------------------------------------------------------------ a small pipeline */

struct made {
    size_t n;
    vec3 *point, *normal;
    struct contraction contraction;
};

static struct neighbourhood neighbours_of(const vec3 *point, size_t n) {
    struct knn *knn = NULL;
    struct neighbourhood neighbours = {0};
    struct neighbourhood_options options = {2.5, 6, 10, 1};
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, n, &options, &neighbours), STATUS_OK);
    knn_free(knn);
    return neighbours;
}

static enum status contract_along(const vec3 *point, const struct neighbourhood *neighbours,
                                  struct packed_quadric *quadrics, const struct contract_options *options,
                                  const struct progress *progress, struct contraction *out) {
    struct adjacency near = {0};
    enum status status = adjacency_from(neighbours, options->threads, &near);
    return status ? status : contract(point, &near, quadrics, options, progress, out);
}

static struct packed_quadric *quadrics_of(const vec3 *point, const vec3 *normal,
                                          const struct neighbourhood *neighbours) {
    size_t n = neighbours->n;
    struct packed_quadric *quadrics = malloc(n * sizeof *quadrics);
    float *dso = malloc(n * sizeof *dso), *weight = malloc(n * sizeof *weight);
    struct quadric_options options = {AREA_AREA, 1e-3, 1};
    dso_compute(point, normal, neighbours, DSO_RMS, 1, dso);
    dso_weights(dso, n, dso_average(dso, NULL, n), 0.5, 1, weight);
    quadric_assemble(point, normal, neighbours, weight, &options, quadrics);
    free(dso), free(weight);
    return quadrics;
}

static struct made make_down_to(size_t least, vec3 *point, size_t n, unsigned threads) {
    struct contract_options options = {threads, least};
    struct made made = {.n = n, .point = point, .normal = malloc(n * sizeof(vec3))};
    struct neighbourhood neighbours = neighbours_of(point, n);
    normals_fit(point, &neighbours, threads, made.normal, NULL);
    struct packed_quadric *quadrics = quadrics_of(point, made.normal, &neighbours);
    assert_int_equal(contract_along(point, &neighbours, quadrics, &options, NULL, &made.contraction), STATUS_OK);
    free(quadrics);
    neighbourhood_done(&neighbours);
    return made;
}

static struct made make(vec3 *point, size_t n, unsigned threads) { return make_down_to(1, point, n, threads); }

static void made_done(struct made *made) {
    contraction_done(&made->contraction);
    free(made->point), free(made->normal);
}

static void check_is_ranking(const struct contraction *c) {
    unsigned char *seen = calloc(c->n, 1);
    size_t *when = malloc(c->n * sizeof *when);
    for (size_t i = 0; i < c->n; i++) {
        assert_true(c->order[i] < c->n && !seen[c->order[i]]);
        seen[c->order[i]] = 1;
        when[c->order[i]] = i;
        if (i > 0) assert_true(c->error[i - 1] <= c->error[i]);
    }
    for (size_t i = 0; i + 1 < c->n; i++) assert_true(when[c->into[c->order[i]]] > i);
    assert_int_equal(c->into[c->order[c->n - 1]], NONE);
    free(seen), free(when);
}

static vec3 *cube_surface(size_t side, size_t *n) {
    vec3 *point = malloc(side * side * side * sizeof *point);
    *n = 0;
    for (size_t i = 0; i < side * side * side; i++) {
        size_t x = i % side, y = i / side % side, z = i / side / side, last = side - 1;
        if (x % last && y % last && z % last) continue;
        point[(*n)++] = vec3_scale((vec3){(double)x, (double)y, (double)z}, 0.5 / (double)last);
    }
    return point;
}

/* ------------------------------------------------------------------------------------------------ adjacency */

static void lists_are_symmetric_and_without_their_owner(void **state) {
    (void)state;
    enum { N = 9000 };
    vec3 *point = shape_sphere(N, 0.5);
    struct neighbourhood neighbours = neighbours_of(point, N);
    struct adjacency near;
    assert_int_equal(adjacency_from(&neighbours, 3, &near), STATUS_OK);
    for (uint32_t p = 0; p < N; p++)
        for (unsigned i = 0; i < near.degree[p]; i++) {
            uint32_t q = near.list[near.start[p] + i], found = 0;
            assert_true(q != p && (i <= neighbours.count[p] || q > near.list[near.start[p] + i - 1]));
            for (unsigned j = 0; j < near.degree[q]; j++) found += near.list[near.start[q] + j] == p;
            assert_int_equal(found, 1);
        }
    adjacency_done(&near);
    neighbourhood_done(&neighbours);
    free(point);
}

/* All name point 0, which names the highest three. */
static void a_crowd_s_centre_keeps_its_own_and_the_lowest_of_the_others(void **state) {
    (void)state;
    enum { N = 20000 };
    static uint32_t id[3 * N];
    static uint8_t count[N];
    struct neighbourhood neighbours = {.n = N, .stride = 3, .id = id, .count = count};
    for (uint32_t p = 1; p < N; p++) count[p] = 1;
    count[0] = 3;
    for (uint32_t i = 0; i < 3; i++) id[i] = N - 3 + i;
    struct adjacency near;
    assert_int_equal(adjacency_from(&neighbours, 4, &near), STATUS_OK);
    assert_int_equal(near.degree[0], 255);
    for (uint32_t i = 0; i < 3; i++) assert_int_equal(near.list[near.start[0] + i], N - 3 + i);
    for (uint32_t i = 0; i < 252; i++) assert_int_equal(near.list[near.start[0] + 3 + i], i + 1);
    adjacency_done(&near);
}

static bool names(const struct neighbourhood *neighbours, uint32_t p, uint32_t q) {
    bool found = false;
    for (unsigned i = 0; i < neighbours->count[p]; i++) found |= neighbours->id[p * neighbours->stride + i] == q;
    return found;
}

static unsigned times_joined(const struct adjacency *near, uint32_t p, uint32_t q) {
    unsigned times = 0;
    for (unsigned i = 0; i < near->degree[p]; i++) times += near->list[near->start[p] + i] == q;
    return times;
}

/* Beyond its count a row holds everybody: none of them counts. */
static void rows_of_any_length_are_searched(void **state) {
    (void)state;
    enum { N = 40, LONGEST = 13 };
    uint64_t seed = 3;
    for (unsigned stride = 3; stride <= LONGEST; stride++) {
        uint32_t id[N * LONGEST];
        uint8_t count[N];
        struct neighbourhood neighbours = {.n = N, .stride = stride, .id = id, .count = count};
        struct adjacency near;
        for (uint32_t p = 0; p < N; p++) {
            count[p] = (uint8_t)(random_unit(&seed) * (stride + 1));
            uint32_t step = 1 + (uint32_t)(random_unit(&seed) * 2);
            for (uint32_t i = 0; i < stride; i++) id[p * stride + i] = (p + 1 + i * step) % N;
        }
        assert_int_equal(adjacency_from(&neighbours, 2, &near), STATUS_OK);
        for (uint32_t p = 0; p < N; p++)
            for (uint32_t q = 0; q < N; q++)
                assert_int_equal(times_joined(&near, p, q), names(&neighbours, p, q) || names(&neighbours, q, p));
        adjacency_done(&near);
    }
}

/* ------------------------------------------------------------------------------------------------ contraction */

static void every_point_is_ranked_once_and_goes_into_a_later_one(void **state) {
    (void)state;
    struct made made = make(shape_sphere(3000, 0.5), 3000, 2);
    check_is_ranking(&made.contraction);
    made_done(&made);
}

static void tiny_clouds_are_ranked_too(void **state) {
    (void)state;
    for (size_t n = 1; n < 12; n++) {
        struct made made = make(shape_sphere(n, 0.5), n, 1);
        check_is_ranking(&made.contraction);
        made_done(&made);
    }
}

static void far_components_are_joined_in_the_end(void **state) {
    (void)state;
    vec3 *point = shape_sphere(600, 0.01);
    for (size_t i = 0; i < 600; i++) point[i].x += 0.4 * (double)(i % 3);
    struct made made = make(point, 600, 1);
    check_is_ranking(&made.contraction);
    int left[3] = {0}; /* of the last 30 each sphere has its share */
    for (size_t i = 570; i < 600; i++) left[made.contraction.order[i] % 3]++;
    for (int i = 0; i < 3; i++) assert_true(left[i] >= 5);
    made_done(&made);
}

static void a_plane_costs_nothing(void **state) {
    (void)state;
    struct made made = make(shape_height_field(30, height_plane), 900, 2);
    struct distance_stats stats;
    assert_int_equal(tangent_error(made.point, made.normal, 900, &made.contraction.order[800], 100, 2, &stats, NULL),
                     STATUS_OK);
    assert_int_equal(stats.count, 900);
    assert_true(stats.max < 1e-12);
    made_done(&made);
}

static void the_corners_of_a_cube_survive(void **state) {
    (void)state;
    size_t n, corners = 0;
    vec3 *point = cube_surface(17, &n);
    struct made made = make(point, n, 2);
    for (size_t i = n - n / 20; i < n; i++) {
        vec3 p = made.point[made.contraction.order[i]];
        corners += (p.x == 0 || p.x == 0.5) && (p.y == 0 || p.y == 0.5) && (p.z == 0 || p.z == 0.5);
    }
    assert_int_equal(corners, 8);
    made_done(&made);
}

/* Whatever costs much more than what is due waits for another round, in which its neighbours' costs are new: of a grid
 * that is flat but for its rough middle, hardly a rough point goes while there are flat pairs left. */
static void what_costs_far_more_waits(void **state) {
    (void)state;
    enum { SIDE = 120, N = SIDE * SIDE };
    vec3 *point = malloc(N * sizeof *point);
    uint64_t random = 3;
    size_t flat = 0, before = 0;
    for (size_t i = 0; i < N; i++) {
        double x = (double)(i % SIDE) / SIDE, y = (double)(i / SIDE) / SIDE;
        point[i] = (vec3){x + 1e-3 * random_unit(&random), y + 1e-3 * random_unit(&random), 0};
        if (y > 0.3) point[i].z = 0.006 * random_unit(&random);
        flat += y <= 0.3;
    }
    struct made made = make(point, N, 1);
    while (before < N && point[made.contraction.order[before]].z == 0) before++;
    assert_true(20 * before > 9 * flat); /* 2417 of 4440; without a limit 1584 */
    made_done(&made);
}

static void threads_do_not_change_a_bit(void **state) {
    (void)state;
    enum { N = 20000 };
    struct made one = make(shape_sphere(N, 0.5), N, 1), many = make(shape_sphere(N, 0.5), N, 5);
    assert_memory_equal(one.contraction.order, many.contraction.order, N * sizeof(uint32_t));
    assert_memory_equal(one.contraction.into, many.contraction.into, N * sizeof(uint32_t));
    assert_memory_equal(one.contraction.error, many.contraction.error, N * sizeof(float));
    made_done(&one), made_done(&many);
}

static void representatives_are_survivors(void **state) {
    (void)state;
    enum { N = 2000, K = 100 };
    struct made made = make(shape_sphere(N, 0.5), N, 1);
    uint32_t representative[N];
    unsigned char survives[N] = {0};
    for (size_t i = N - K; i < N; i++) survives[made.contraction.order[i]] = 1;
    contraction_representatives(&made.contraction, K, representative);
    for (size_t p = 0; p < N; p++) {
        assert_true(survives[representative[p]]);
        if (survives[p]) assert_int_equal(representative[p], p);
        assert_true(vec3_distance(made.point[p], made.point[representative[p]]) < 0.3);
    }
    made_done(&made);
}

static void a_ranking_may_end_early_with_the_same_points(void **state) {
    (void)state;
    enum { N = 2000, K = 300 };
    struct made whole = make(shape_sphere(N, 0.5), N, 1), part = make_down_to(K, shape_sphere(N, 0.5), N, 2);
    uint32_t there[N], here[N];
    size_t left = 0;
    for (size_t i = 0; i < N; i++) left += part.contraction.into[i] == NONE;
    assert_true(left <= K && left > K / 2);
    assert_memory_equal(whole.contraction.order, part.contraction.order, (N - left) * sizeof(uint32_t));
    assert_memory_equal(whole.contraction.error, part.contraction.error, (N - left) * sizeof(float));
    for (size_t i = N - left; i + 1 < N; i++) assert_true(part.contraction.order[i] < part.contraction.order[i + 1]);
    contraction_representatives(&whole.contraction, K, there);
    contraction_representatives(&part.contraction, K, here);
    assert_memory_equal(there, here, sizeof there);
    made_done(&whole), made_done(&part);
}

static void an_error_bound_leaves_the_fewest_points_that_keep_it(void **state) {
    (void)state;
    enum { N = 2000 };
    struct made made = make(shape_sphere(N, 0.5), N, 1);
    const struct contraction *c = &made.contraction;
    const double bounds[] = {0, 1e-5, 1e-4, 1e-3, 1e-2, 1};
    for (int i = 0; i < 6; i++) {
        size_t k = contraction_count_for_error(c, bounds[i]);
        assert_true(k >= 1 && k <= N);
        if (k < N) assert_true((double)c->error[N - k - 1] <= bounds[i]);
        if (k > 1) assert_true((double)c->error[N - k] > bounds[i]);
    }
    made_done(&made);
}

static int stop_at_once(void *ctx, const char *stage, double fraction) {
    (void)ctx, (void)stage;
    return fraction > 0.3;
}

static void cancelling_stops_it(void **state) {
    (void)state;
    vec3 *point = shape_sphere(1000, 0.5), *normal = malloc(1000 * sizeof *normal);
    struct neighbourhood neighbours = neighbours_of(point, 1000);
    normals_fit(point, &neighbours, 1, normal, NULL);
    struct packed_quadric *quadrics = quadrics_of(point, normal, &neighbours);
    struct contraction out = {0};
    struct progress progress = {stop_at_once, NULL};
    assert_int_equal(contract_along(point, &neighbours, quadrics, &(struct contract_options){1, 1}, &progress, &out),
                     STATUS_CANCELLED);
    assert_null(out.order);
    free(quadrics), free(normal), free(point);
    neighbourhood_done(&neighbours);
}

/* begin_faults lets the nth of its kind fail.  Returns after how many the ranking gets through. */
static int fail_each(void (*begin_faults)(long nth)) {
    vec3 *point = shape_sphere(300, 0.5), *normal = malloc(300 * sizeof *normal);
    for (size_t i = 0; i < 150; i++) point[i].x += 100; /* two components: relinking allocates too */
    struct neighbourhood neighbours = neighbours_of(point, 300);
    normals_fit(point, &neighbours, 1, normal, NULL);
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        struct packed_quadric *quadrics = quadrics_of(point, normal, &neighbours);
        struct contraction out = {0};
        begin_faults(nth + 1);
        enum status status = contract_along(point, &neighbours, quadrics, &(struct contract_options){1, 1}, NULL, &out);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened == !out.order);
        contraction_done(&out);
        free(quadrics);
    }
    free(normal), free(point);
    neighbourhood_done(&neighbours);
    return nth;
}

static void fail_once(long nth) { faults_in_memory(nth, false); }

static void every_allocation_may_fail(void **state) {
    (void)state;
    assert_true(fail_each(fail_once) > 15);
}

static void every_search_may_fail(void **state) {
    (void)state;
    assert_true(fail_each(faults_in_new) > 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_plane_s_quadric_is_weight_times_squared_distance),
        cmocka_unit_test(a_line_s_quadric_is_the_squared_distance_to_it),
        cmocka_unit_test(wide_angles_are_no_triangles),
        cmocka_unit_test(lists_are_symmetric_and_without_their_owner),
        cmocka_unit_test(rows_of_any_length_are_searched),
        cmocka_unit_test(a_crowd_s_centre_keeps_its_own_and_the_lowest_of_the_others),
        cmocka_unit_test(every_point_is_ranked_once_and_goes_into_a_later_one),
        cmocka_unit_test(tiny_clouds_are_ranked_too),
        cmocka_unit_test(far_components_are_joined_in_the_end),
        cmocka_unit_test(a_plane_costs_nothing),
        cmocka_unit_test(the_corners_of_a_cube_survive),
        cmocka_unit_test(what_costs_far_more_waits),
        cmocka_unit_test(threads_do_not_change_a_bit),
        cmocka_unit_test(representatives_are_survivors),
        cmocka_unit_test(a_ranking_may_end_early_with_the_same_points),
        cmocka_unit_test(an_error_bound_leaves_the_fewest_points_that_keep_it),
        cmocka_unit_test(cancelling_stops_it),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(every_search_may_fail),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
