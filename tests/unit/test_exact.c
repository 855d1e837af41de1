/* Contraction in passes against the paper's own order: a heap, and the cheapest pair of all each time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/cloud/cloud.h"
#include "core/measure/tangent.h"
#include "core/simplify/contract.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "core/simplify/reference/contract.h"
#include "tests/unit/shapes.h"

enum { N = 8000 };

/* What both start from. */
struct start {
    vec3 *point, *normal;
    struct neighbourhood neighbours;
    struct packed_quadric *quadrics;
};

static struct start start_from(vec3 *point) {
    struct start s = {.point = point, .normal = malloc(N * sizeof(vec3)), .quadrics = malloc(N * sizeof *s.quadrics)};
    struct knn *knn = NULL;
    struct neighbourhood_options near = {2.5, 6, 10, 1};
    struct quadric_options options = {AREA_AREA, 3e-3, 1};
    float dso[N], weight[N];
    assert_int_equal(knn_new(point, N, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, point, N, &near, &s.neighbours), STATUS_OK);
    knn_free(knn);
    normals_fit(point, &s.neighbours, 1, s.normal, NULL);
    dso_compute(point, s.normal, &s.neighbours, DSO_RMS, 1, dso);
    dso_weights(dso, N, dso_average(dso, NULL, N), 0.5, 1, weight);
    quadric_assemble(point, s.normal, &s.neighbours, weight, &options, s.quadrics);
    return s;
}

static void start_done(struct start *s) {
    neighbourhood_done(&s->neighbours);
    free(s->point), free(s->normal), free(s->quadrics);
}

/* ------------------------------------------------------------------------------------------------ passes */

static double error_of(const struct start *start, const uint32_t *kept, size_t k) {
    struct distance_stats stats;
    assert_int_equal(tangent_error(start->point, start->normal, N, kept, k, 1, &stats, NULL), STATUS_OK);
    return stats.mean;
}

static void passes_are_as_exact_as_the_heap(struct start start) {
    static uint32_t kept[N];
    double heap[2], passes[2];
    const size_t counts[2] = {N / 10, N / 20};
    for (int i = 0; i < 2; i++) {
        assert_int_equal(reference_contract(start.point, &start.neighbours, start.quadrics, counts[i], kept),
                         STATUS_OK);
        heap[i] = error_of(&start, kept, counts[i]);
    }
    struct contraction contraction;
    struct adjacency near;
    assert_int_equal(adjacency_from(&start.neighbours, 1, &near), STATUS_OK);
    assert_int_equal(contract(start.point, &near, start.quadrics, &(struct contract_options){1, 1}, NULL, &contraction),
                     STATUS_OK);
    for (int i = 0; i < 2; i++) passes[i] = error_of(&start, &contraction.order[N - counts[i]], counts[i]);
    print_message("mean tangent error, passes against heap: %.4f at 10 %%, %.4f at 5 %%\n", passes[0] / heap[0],
                  passes[1] / heap[1]);
    assert_true(passes[0] <= 1.02 * heap[0] && passes[1] <= 1.02 * heap[1]);
    contraction_done(&contraction);
    start_done(&start);
}

/* ------------------------------------------------------------------------------------------------ surfaces */

static vec3 bumpy(vec3 u) {
    double bumps = 0.08 * sin(7 * u.x) * sin(6 * u.y + 1) * sin(5 * u.z + 2);
    return vec3_scale(u, 0.4 * (1 + bumps));
}

static void on_a_bumpy_sphere(void **state) {
    (void)state;
    vec3 *point = shape_sphere(N, 1);
    for (size_t i = 0; i < N; i++) point[i] = bumpy(point[i]);
    passes_are_as_exact_as_the_heap(start_from(point));
}

static void on_a_surface_with_an_edge_and_noise(void **state) {
    (void)state;
    vec3 *point = shape_sphere(N, 0.4);
    uint64_t random = 3;
    for (size_t i = 0; i < N; i++) {
        if (point[i].z > 0.3) point[i] = vec3_scale(point[i], 0.3 / point[i].z);
        point[i] = vec3_scale(point[i], 1 + 1e-3 * (random_unit(&random) - 0.5));
    }
    passes_are_as_exact_as_the_heap(start_from(point));
}

/* Waves, ever shorter along x, and points at random. */
static void on_waves_sampled_unevenly(void **state) {
    (void)state;
    vec3 *point = malloc(N * sizeof *point);
    uint64_t random = 5;
    for (size_t i = 0; i < N; i++) {
        double x = sqrt(random_unit(&random)), y = random_unit(&random);
        point[i] = (vec3){0.6 * x, 0.6 * y, 0.03 * sin(20 * x * x) * cos(8 * y)};
    }
    passes_are_as_exact_as_the_heap(start_from(point));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(on_a_bumpy_sphere),
        cmocka_unit_test(on_a_surface_with_an_edge_and_noise),
        cmocka_unit_test(on_waves_sampled_unevenly),
    };
    return cmocka_run_group_tests_name("exact", tests, NULL, NULL);
}
