/* Nearest points of triangles and of meshes, against a second way to find them that has nothing in common with the
 * first.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/math/triangle.h"
#include "core/spatial/bvh.h"
#include "tests/unit/shapes.h"

static double uniform(uint64_t *state) { return 2 * random_unit(state) - 1; }

static vec3 random_point(uint64_t *state) {
    double x = uniform(state), y = uniform(state);
    return (vec3){x, y, uniform(state)};
}

/* ------------------------------------------------------------------------------------------------ one triangle */

/* Squared distance to a segment by golden-section search: slow, and right for any convex function. */
static double search_edge_sq(vec3 p, vec3 a, vec3 b) {
    double low = 0, high = 1, ratio = (sqrt(5) - 1) / 2;
    for (int i = 0; i < 100; i++) {
        double left = high - ratio * (high - low), right = low + ratio * (high - low);
        if (vec3_distance_sq(p, vec3_lerp(a, b, left)) < vec3_distance_sq(p, vec3_lerp(a, b, right)))
            high = right;
        else
            low = left;
    }
    return vec3_distance_sq(p, vec3_lerp(a, b, low));
}

/* The same for a triangle, as segments parallel to bc. */
static double search_row_sq(vec3 p, vec3 a, vec3 b, vec3 c, double t) {
    return search_edge_sq(p, vec3_lerp(a, b, t), vec3_lerp(a, c, t));
}

static double search_triangle_sq(vec3 p, vec3 a, vec3 b, vec3 c) {
    double low = 0, high = 1, ratio = (sqrt(5) - 1) / 2;
    for (int i = 0; i < 100; i++) {
        double left = high - ratio * (high - low), right = low + ratio * (high - low);
        if (search_row_sq(p, a, b, c, left) < search_row_sq(p, a, b, c, right))
            high = right;
        else
            low = left;
    }
    return search_row_sq(p, a, b, c, low);
}

/* For every order of the corners. */
static void check_triangle(vec3 p, const vec3 corner[3], double tolerance) {
    static const int order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    double expected = sqrt(search_triangle_sq(p, corner[0], corner[1], corner[2]));
    for (int i = 0; i < 6; i++) {
        const int *o = order[i];
        double got = vec3_distance(p, triangle_closest(p, corner[o[0]], corner[o[1]], corner[o[2]]));
        assert_true(fabs(got - expected) <= tolerance);
    }
}

static void each_region_of_a_triangle_has_its_nearest_point(void **state) {
    (void)state;
    const vec3 a = {0, 0, 0}, b = {4, 0, 0}, c = {0, 4, 0};
    static const struct {
        vec3 p, nearest;
    } cases[] = {{{1, 1, 5}, {1, 1, 0}},  {{-1, -2, 3}, {0, 0, 0}}, {{6, -1, 0}, {4, 0, 0}}, {{-1, 7, 0}, {0, 4, 0}},
                 {{1, -3, 2}, {1, 0, 0}}, {{-2, 3, 1}, {0, 3, 0}},  {{3, 3, -1}, {2, 2, 0}}, {{0, 0, 0}, {0, 0, 0}},
                 {{4, 0, 0}, {4, 0, 0}},  {{0, 4, 0}, {0, 4, 0}},   {{2, 2, 0}, {2, 2, 0}},  {{1, 2, 0}, {1, 2, 0}}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        assert_true(vec3_equal(triangle_closest(cases[i].p, a, b, c), cases[i].nearest));
        assert_true(vec3_equal(triangle_closest_thin(cases[i].p, a, b, c), cases[i].nearest));
    }
}

static void random_triangles_agree_with_a_search(void **state) {
    (void)state;
    uint64_t seed = 1;
    for (int i = 0; i < 300; i++) {
        const vec3 corner[3] = {random_point(&seed), random_point(&seed), random_point(&seed)};
        check_triangle(vec3_scale(random_point(&seed), 2), corner, 1e-7);
    }
}

static void thin_triangles_agree_with_a_search(void **state) {
    (void)state;
    uint64_t seed = 2;
    for (int digits = 1; digits <= 17; digits++)
        for (int i = 0; i < 20; i++) {
            vec3 a = random_point(&seed), b = random_point(&seed);
            vec3 c = vec3_add(vec3_lerp(a, b, 3 * random_unit(&seed) - 1),
                              vec3_scale(random_point(&seed), pow(10, -digits)));
            const vec3 corner[3] = {a, b, c};
            check_triangle(random_point(&seed), corner, 1e-7);
        }
}

static void triangles_without_area_are_segments_or_points(void **state) {
    (void)state;
    uint64_t seed = 3;
    for (int i = 0; i < 100; i++) {
        vec3 a = {1, 2, 3}, b = {3, 2, 1}, p = vec3_scale(random_point(&seed), 4);
        check_triangle(p, (const vec3[3]){a, a, a}, 1e-7);
        check_triangle(p, (const vec3[3]){a, a, b}, 1e-7);
        check_triangle(p, (const vec3[3]){a, b, {2, 2, 2}}, 1e-7);
        check_triangle(p, (const vec3[3]){a, b, {1 + 1e-17, 2, 3 + 4e-16}}, 1e-7);
        check_triangle(p, (const vec3[3]){{0, 0, 0}, {1e-170, 0, 0}, {0, 1, 0}}, 1e-7);
    }
}

/* ------------------------------------------------------------------------------------------------ meshes */

/* n triangles of a given size with corners of their own. */
static struct mesh random_mesh(size_t n, double size, uint64_t seed) {
    struct mesh mesh = {.vertex_count = 3 * n, .triangle_count = n};
    mesh.vertex = malloc(3 * n * sizeof *mesh.vertex);
    mesh.triangle = malloc((n + 1) * sizeof *mesh.triangle);
    for (size_t t = 0; t < n; t++) {
        vec3 place = random_point(&seed);
        for (uint32_t i = 0; i < 3; i++) {
            mesh.triangle[t][i] = (uint32_t)(3 * t) + i;
            mesh.vertex[3 * t + i] = vec3_add(place, vec3_scale(random_point(&seed), size));
        }
    }
    return mesh;
}

static void free_mesh(struct mesh *mesh) { free(mesh->vertex), free(mesh->triangle); }

static struct bvh *bvh_of(const struct mesh *mesh) {
    struct bvh *bvh = NULL;
    assert_int_equal(bvh_new(mesh, 2, &bvh), STATUS_OK);
    return bvh;
}

static double brute_force_sq(const struct mesh *mesh, vec3 p, uint32_t *triangle) {
    double best = INFINITY;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        vec3 q = triangle_closest_thin(p, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]);
        if (vec3_distance_sq(p, q) < best) best = vec3_distance_sq(p, q), *triangle = (uint32_t)t;
    }
    return best;
}

static void check_hit(const struct mesh *mesh, vec3 p, struct bvh_hit hit, double size) {
    uint32_t triangle = NONE;
    double expected = sqrt(brute_force_sq(mesh, p, &triangle)), got = sqrt(hit.distance_sq);
    assert_true(hit.triangle < mesh->triangle_count);
    assert_true(fabs(got - expected) <= 1e-13 * size);
    assert_true(fabs(vec3_distance(p, hit.point) - got) <= 1e-13 * size);
    const uint32_t *v = mesh->triangle[hit.triangle];
    vec3 on = triangle_closest(hit.point, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]);
    assert_true(vec3_distance(hit.point, on) <= 1e-13 * size);
}

static void meshes_of_any_length_agree_with_brute_force(void **state) {
    (void)state;
    static const size_t lengths[] = {1, 2, 3, 4, 5, 7, 12, 13, 50, 1000, 3000};
    uint64_t seed = 4;
    for (size_t i = 0; i < sizeof lengths / sizeof lengths[0]; i++) {
        struct mesh mesh = random_mesh(lengths[i], i % 2 ? 1 : 0.05, i);
        struct bvh *bvh = bvh_of(&mesh);
        for (int q = 0; q < 200; q++) {
            vec3 p = vec3_scale(random_point(&seed), q % 3 + 1);
            check_hit(&mesh, p, bvh_closest(bvh, p, NONE), 10);
        }
        bvh_free(bvh), free_mesh(&mesh);
    }
}

static void a_hint_never_changes_the_answer(void **state) {
    (void)state;
    struct mesh mesh = random_mesh(60, 0.3, 5);
    struct bvh *bvh = bvh_of(&mesh);
    uint64_t seed = 5;
    for (int q = 0; q < 50; q++) {
        vec3 p = random_point(&seed);
        struct bvh_hit plain = bvh_closest(bvh, p, NONE);
        for (uint32_t hint = 0; hint < 60; hint++) {
            struct bvh_hit hit = bvh_closest(bvh, p, hint);
            assert_int_equal(hit.triangle, plain.triangle);
            assert_true(hit.distance_sq == plain.distance_sq && vec3_equal(hit.point, plain.point));
        }
    }
    bvh_free(bvh), free_mesh(&mesh);
}

/* A fan of 12 triangles around the origin: everything over the origin is at the same distance from all of them. */
static void among_equals_the_lowest_id_wins(void **state) {
    (void)state;
    vec3 vertex[13] = {{0, 0, 0}};
    uint32_t triangle[24][3];
    for (uint32_t i = 0; i < 12; i++) {
        vertex[i + 1] = (vec3){cos(i * acos(-1) / 6), sin(i * acos(-1) / 6), 0};
        for (int copy = 0; copy < 2; copy++) {
            uint32_t *t = triangle[copy * 12 + (int)i];
            t[0] = 0, t[1] = i + 1, t[2] = (i + 1) % 12 + 1;
        }
    }
    struct mesh mesh = {.vertex_count = 13, .vertex = vertex, .triangle_count = 24, .triangle = triangle};
    struct bvh *bvh = bvh_of(&mesh);
    for (uint32_t hint = 0; hint < 24; hint++) {
        struct bvh_hit hit = bvh_closest(bvh, (vec3){0, 0, 0.25}, hint);
        assert_int_equal(hit.triangle, 0);
        assert_true(hit.distance_sq == 0.0625);
        hit = bvh_closest(bvh, vec3_scale(vec3_add(vertex[8], vertex[9]), 0.25), hint);
        assert_int_equal(hit.triangle, 7);
    }
    bvh_free(bvh);
}

static void nothing_is_found_beyond_the_bound(void **state) {
    (void)state;
    vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    uint32_t triangle[][3] = {{0, 1, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    struct bvh *bvh = bvh_of(&mesh);
    const vec3 p = {0.25, 0.25, 2};
    struct bvh_hit hit = bvh_closest_within(bvh, p, NONE, 3.99);
    assert_true(hit.triangle == NONE && hit.distance_sq == INFINITY);
    assert_int_equal(bvh_closest_within(bvh, p, 0, 3.99).triangle, NONE);
    hit = bvh_closest_within(bvh, p, NONE, 4);
    assert_true(hit.triangle == 0 && hit.distance_sq == 4 && hit.point.z == 0);
    bvh_free(bvh);
}

static void a_mesh_without_triangles_has_no_nearest_point(void **state) {
    (void)state;
    struct mesh mesh = {0};
    struct bvh *bvh = bvh_of(&mesh);
    struct bvh_hit hit = bvh_closest(bvh, (vec3){1, 2, 3}, NONE);
    assert_true(hit.triangle == NONE && hit.distance_sq == INFINITY);
    bvh_free(bvh);
    bvh_free(NULL);
}

static void place_and_scale_cost_no_accuracy(void **state) {
    (void)state;
    static const struct {
        double scale, offset;
    } frames[] = {{1e-100, 0}, {1e100, 0}, {1, 1e6}, {1e-3, 5e5}, {1e-140, 1e-140}};
    for (size_t f = 0; f < sizeof frames / sizeof frames[0]; f++) {
        struct mesh mesh = random_mesh(200, 0.1, 6), plain = random_mesh(200, 0.1, 6);
        double scale = frames[f].scale, offset = frames[f].offset, size = offset + scale;
        const vec3 move = {offset, -offset, offset};
        for (size_t v = 0; v < mesh.vertex_count; v++)
            mesh.vertex[v] = vec3_add(vec3_scale(mesh.vertex[v], scale), move);
        struct bvh *bvh = bvh_of(&mesh), *plain_bvh = bvh_of(&plain);
        uint64_t seed = 6;
        for (int q = 0; q < 100; q++) {
            vec3 p = random_point(&seed);
            double expected = scale * sqrt(bvh_closest(plain_bvh, p, NONE).distance_sq);
            double got = sqrt(bvh_closest(bvh, vec3_add(vec3_scale(p, scale), move), NONE).distance_sq);
            assert_true(fabs(got - expected) <= 1e-14 * size);
        }
        bvh_free(bvh), bvh_free(plain_bvh), free_mesh(&mesh), free_mesh(&plain);
    }
}

static void far_queries_still_find_the_mesh(void **state) {
    (void)state;
    struct mesh mesh = random_mesh(100, 0.1, 7);
    struct bvh *bvh = bvh_of(&mesh);
    for (int digits = 0; digits < 100; digits += 3) {
        vec3 p = vec3_scale((vec3){1, 0.5, -0.25}, pow(10, digits));
        struct bvh_hit hit = bvh_closest(bvh, p, NONE);
        uint32_t triangle = NONE;
        double expected = brute_force_sq(&mesh, p, &triangle);
        assert_int_not_equal(hit.triangle, NONE);
        assert_true(fabs(hit.distance_sq / expected - 1) < (digits < 3 ? 1e-13 : 2e-5));
    }
    bvh_free(bvh), free_mesh(&mesh);
}

/* A face that goes a million extents away is sampled there: each sample would look at all of the mesh. */
static void far_queries_cost_no_more_than_near_ones(void **state) {
    (void)state;
    enum { N = 20000, QUERIES = 200 };
    struct mesh mesh = random_mesh(N, 0.01, 13);
    struct bvh *bvh = bvh_of(&mesh);
    uint64_t seed = 13;
    vec3 near[QUERIES], far[QUERIES];
    for (size_t q = 0; q < QUERIES; q++) {
        near[q] = random_point(&seed);
        far[q] = vec3_scale((vec3){1, 0.3, 0.2}, 1e6 * (1 + (double)q / QUERIES));
        assert_int_equal(bvh_closest(bvh, far[q], NONE).triangle, bvh_closest(bvh, far[q], (uint32_t)q).triangle);
    }
    size_t most = 4 * bvh_visits(bvh, near, QUERIES, SIZE_MAX);
    assert_true(bvh_visits(bvh, far, QUERIES, SIZE_MAX) <= most);
    bvh_free(bvh), free_mesh(&mesh);
}

/* Thousands of equal triangles, sizes that shrink to nothing, and triangles without area: what splits badly. */
static void meshes_that_split_badly_are_still_exact(void **state) {
    (void)state;
    enum { N = 3000 };
    for (int kind = 0; kind < 4; kind++) {
        struct mesh mesh = random_mesh(N, 0.1, 8);
        for (size_t t = 0; t < N; t++)
            for (size_t i = 0; i < 3; i++) {
                vec3 *v = &mesh.vertex[3 * t + i];
                if (kind == 0) *v = mesh.vertex[i];
                if (kind == 1) *v = vec3_scale(*v, pow(0.5, (double)t / 3));
                if (kind == 2) *v = mesh.vertex[3 * t];
                if (kind == 3) v->y = v->z = 0;
            }
        struct bvh *bvh = bvh_of(&mesh);
        uint64_t seed = 8;
        for (int q = 0; q < 50; q++) {
            vec3 p = vec3_scale(random_point(&seed), pow(0.5, q));
            struct bvh_hit hit = bvh_closest(bvh, p, NONE);
            check_hit(&mesh, p, hit, 1);
            if (kind == 0) assert_int_equal(hit.triangle, 0);
        }
        bvh_free(bvh), free_mesh(&mesh);
    }
}

/* Heaps of triangles in a billionth of the box, heaps within heaps, and a stray that the box is about. */
static void heaps_of_all_sizes_agree_with_a_search(void **state) {
    (void)state;
    enum { N = 3000, HEAPS = 5 };
    for (int kind = 0; kind < 3; kind++) {
        struct mesh mesh = random_mesh(N, 0.05, 12);
        for (size_t v = 0; v < 3 * N; v++) {
            double size = kind == 0 ? 1e-9 : pow(1e-3, (double)(v / (3 * N / HEAPS)));
            vec3 corner = {kind == 2 ? 0 : 0.3, kind == 2 ? 0 : size, 0.1 * size};
            mesh.vertex[v] = vec3_add(vec3_scale(mesh.vertex[v], size), corner);
        }
        if (kind < 2) mesh.vertex[5] = (vec3){1e3, -1e3, 1e3};
        struct bvh *bvh = bvh_of(&mesh);
        uint64_t seed = 12;
        for (int q = 0; q < 200; q++) {
            size_t t = (size_t)q * (N / 200);
            double size = vec3_distance(mesh.vertex[3 * t], mesh.vertex[3 * t + 1]);
            vec3 p = vec3_add(mesh.vertex[3 * t], vec3_scale(random_point(&seed), size));
            uint32_t triangle = NONE;
            double expected_sq = brute_force_sq(&mesh, p, &triangle);
            struct bvh_hit hit = bvh_closest(bvh, p, NONE);
            assert_true(fabs(sqrt(hit.distance_sq) - sqrt(expected_sq)) <= 1e-12 * (kind == 0 ? 1 : size + 0.3));
        }
        bvh_free(bvh), free_mesh(&mesh);
    }
}

static void any_number_of_threads_gives_the_same_bits(void **state) {
    (void)state;
    enum { N = 20000 };
    struct mesh mesh = random_mesh(2000, 0.05, 9);
    struct bvh *bvh;
    vec3 *p = malloc(N * sizeof *p);
    struct bvh_hit *one = malloc(N * sizeof *one), *many = malloc(N * sizeof *many);
    uint64_t seed = 9;
    for (size_t i = 0; i < N; i++) p[i] = random_point(&seed);
    assert_int_equal(bvh_new(&mesh, 1, &bvh), STATUS_OK);
    bvh_closest_all(bvh, p, N, 1, one);
    bvh_free(bvh);
    for (size_t i = 0; i < N; i += 200) check_hit(&mesh, p[i], one[i], 1);
    for (unsigned threads = 2; threads < 9; threads += 3) {
        assert_int_equal(bvh_new(&mesh, threads, &bvh), STATUS_OK);
        bvh_closest_all(bvh, p, N, threads, many);
        bvh_free(bvh);
        for (size_t i = 0; i < N; i++) {
            assert_true(one[i].distance_sq == many[i].distance_sq && one[i].triangle == many[i].triangle);
            assert_true(vec3_equal(one[i].point, many[i].point));
        }
    }
    free(p), free(one), free(many);
    free_mesh(&mesh);
}

/* Of triangles in no order at all, and any number of them. */
static void a_rough_one_gives_the_same_bits(void **state) {
    (void)state;
    static const size_t counts[] = {0, 1, 3, 4, 12, 13, 49, 3000};
    uint64_t seed = 21;
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (unsigned threads = 1; threads < 4; threads++) {
            struct mesh mesh = random_mesh(counts[c], 0.05, 21 + c);
            struct bvh *well = bvh_of(&mesh), *rough = NULL;
            assert_int_equal(bvh_new_rough(&mesh, threads, &rough), STATUS_OK);
            for (size_t i = 0; i < 300; i++) {
                vec3 p = random_point(&seed);
                uint32_t hint = counts[c] ? (uint32_t)(i % counts[c]) : NONE;
                struct bvh_hit a = bvh_closest(well, p, NONE), b = bvh_closest(rough, p, i % 2 ? hint : NONE);
                assert_true(a.distance_sq == b.distance_sq && a.triangle == b.triangle);
                assert_true(a.triangle == NONE || vec3_equal(a.point, b.point));
            }
            bvh_free(well), bvh_free(rough), free_mesh(&mesh);
        }
}

/* From the middle of a sphere all of it is as near, from anywhere on it little. */
static void visits_tell_how_much_is_equally_near(void **state) {
    (void)state;
    enum { SIDE = 40, N = SIDE * SIDE };
    struct mesh mesh = random_mesh(N, 0.01, 5);
    for (size_t i = 0; i < mesh.vertex_count; i++)
        mesh.vertex[i] = vec3_unit(vec3_sub(mesh.vertex[i], (vec3){0.5, 0.5, 0.5}));
    struct bvh *bvh = bvh_of(&mesh);
    const vec3 middle = {0, 0, 0}, near = mesh.vertex[7];
    assert_true(bvh_visits(bvh, &middle, 1, SIZE_MAX) > N / 3);
    assert_true(bvh_visits(bvh, &near, 1, SIZE_MAX) < 60);
    const vec3 both[] = {middle, near};
    assert_int_equal(bvh_visits(bvh, both, 2, 1), bvh_visits(bvh, &middle, 1, SIZE_MAX));
    assert_int_equal(bvh_visits(bvh, both, 2, SIZE_MAX),
                     bvh_visits(bvh, &middle, 1, SIZE_MAX) + bvh_visits(bvh, &near, 1, SIZE_MAX));
    bvh_free(bvh), free_mesh(&mesh);
}

/* Two heaps, each a millionth of the way between them: boxes of float would all be alike. */
static void heaps_far_apart_cost_no_more_than_one(void **state) {
    (void)state;
    enum { N = 4000, TRIED = 200 };
    struct mesh mesh = random_mesh(N, 0.01, 6);
    vec3 p[TRIED];
    for (size_t v = 0; v < mesh.vertex_count; v++) {
        vec3 corner = {v < mesh.vertex_count / 2 ? 1e7 : -1e7, 3e6, 1e6};
        mesh.vertex[v] = vec3_add(mesh.vertex[v], corner);
    }
    for (size_t i = 0; i < TRIED; i++) p[i] = mesh.vertex[i * (mesh.vertex_count / TRIED)];
    struct bvh *bvh = bvh_of(&mesh);
    assert_true(bvh_visits(bvh, p, TRIED, SIZE_MAX) < 30 * TRIED);
    bvh_free(bvh), free_mesh(&mesh);
}

static bool fails_at_zero(void *ctx) { return (*(int *)ctx)-- == 0; }

static int refusals(const struct mesh *mesh,
                    enum status (*make)(const struct mesh *mesh, unsigned threads, struct bvh **bvh)) {
    enum status status = STATUS_NO_MEMORY;
    int nth = 0, refused = 0;
    for (; status || nth < 10; nth++) {
        struct bvh *bvh = NULL;
        int countdown = nth;
        alloc_fail_ctx = &countdown, alloc_fail = fails_at_zero;
        status = make(mesh, 2, &bvh);
        alloc_fail = NULL;
        assert_true(status == (bvh ? STATUS_OK : STATUS_NO_MEMORY));
        if (status) refused++;
        if (bvh) check_hit(mesh, (vec3){0, 0, 0}, bvh_closest(bvh, (vec3){0, 0, 0}, NONE), 1);
        bvh_free(bvh);
    }
    return refused;
}

static void any_allocation_that_fails_is_reported(void **state) {
    (void)state;
    struct mesh mesh = random_mesh(100, 0.1, 10);
    assert_int_equal(refusals(&mesh, bvh_new), 8);
    assert_int_equal(refusals(&mesh, bvh_new_rough), 7);
    free_mesh(&mesh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_region_of_a_triangle_has_its_nearest_point),
        cmocka_unit_test(random_triangles_agree_with_a_search),
        cmocka_unit_test(thin_triangles_agree_with_a_search),
        cmocka_unit_test(triangles_without_area_are_segments_or_points),
        cmocka_unit_test(meshes_of_any_length_agree_with_brute_force),
        cmocka_unit_test(a_hint_never_changes_the_answer),
        cmocka_unit_test(among_equals_the_lowest_id_wins),
        cmocka_unit_test(nothing_is_found_beyond_the_bound),
        cmocka_unit_test(a_mesh_without_triangles_has_no_nearest_point),
        cmocka_unit_test(place_and_scale_cost_no_accuracy),
        cmocka_unit_test(far_queries_still_find_the_mesh),
        cmocka_unit_test(far_queries_cost_no_more_than_near_ones),
        cmocka_unit_test(meshes_that_split_badly_are_still_exact),
        cmocka_unit_test(heaps_of_all_sizes_agree_with_a_search),
        cmocka_unit_test(any_number_of_threads_gives_the_same_bits),
        cmocka_unit_test(a_rough_one_gives_the_same_bits),
        cmocka_unit_test(visits_tell_how_much_is_equally_near),
        cmocka_unit_test(heaps_far_apart_cost_no_more_than_one),
        cmocka_unit_test(any_allocation_that_fails_is_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
