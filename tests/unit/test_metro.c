/* Errors and samples, on shapes whose answers are known.
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
#include "core/measure/metro.h"
#include "core/measure/sampler.h"
#include "tests/unit/shapes.h"

static const struct metro_options defaults = {.threads = 2};

static void check_stats(struct distance_stats stats, double mean, double rms, double max, double tolerance) {
    assert_true(stats.count > 0);
    assert_true(fabs(stats.mean - mean) <= tolerance);
    assert_true(fabs(stats.rms - rms) <= tolerance);
    assert_true(fabs(stats.max - max) <= tolerance);
}

/* side x side squares over 0 .. 1, cut along one diagonal or the other, at the height z = tilt * x + height. */
static struct mesh grid(uint32_t side, bool other_diagonal, double tilt, double height) {
    struct mesh mesh = {.vertex_count = (size_t)(side + 1) * (side + 1), .triangle_count = 2 * (size_t)side * side};
    mesh.vertex = malloc(mesh.vertex_count * sizeof *mesh.vertex);
    mesh.triangle = malloc(mesh.triangle_count * sizeof *mesh.triangle);
    for (uint32_t v = 0; v < mesh.vertex_count; v++) {
        double x = v % (side + 1) / (double)side, y = v / (side + 1) / (double)side;
        mesh.vertex[v] = (vec3){x, y, tilt * x + height};
    }
    for (uint32_t i = 0; i < side * side; i++) {
        uint32_t a = i / side * (side + 1) + i % side, b = a + 1, c = b + side + 1, d = c - 1;
        const uint32_t two[2][2][3] = {{{a, b, c}, {a, c, d}}, {{a, b, d}, {b, c, d}}};
        memcpy(mesh.triangle[2 * i], two[other_diagonal], sizeof two[0]);
    }
    return mesh;
}

/* An octahedron, its triangles cut in four `levels` times, blown up to a sphere. */
static struct mesh sphere(int levels, double radius) {
    size_t n = (size_t)8 << (2 * levels), done = 8;
    struct mesh mesh = {.vertex_count = 3 * n, .triangle_count = n};
    mesh.vertex = malloc(3 * n * sizeof *mesh.vertex);
    mesh.triangle = malloc(n * sizeof *mesh.triangle);
    for (size_t i = 0; i < 8; i++) {
        double x = i & 1 ? -1 : 1, y = i & 2 ? -1 : 1, z = i & 4 ? -1 : 1;
        mesh.vertex[3 * i] = (vec3){x, 0, 0}, mesh.vertex[3 * i + 1] = (vec3){0, y, 0};
        mesh.vertex[3 * i + 2] = (vec3){0, 0, z};
    }
    for (; done < n; done *= 4)
        for (size_t t = 0; t < done; t++) {
            vec3 *v = mesh.vertex, a = v[3 * t], b = v[3 * t + 1], c = v[3 * t + 2];
            vec3 ab = vec3_lerp(a, b, 0.5), bc = vec3_lerp(b, c, 0.5), ca = vec3_lerp(c, a, 0.5);
            const vec3 cut[9] = {a, ab, ca, ab, b, bc, ca, bc, c};
            v[3 * t] = ab, v[3 * t + 1] = bc, v[3 * t + 2] = ca;
            memcpy(&v[3 * (done + 3 * t)], cut, sizeof cut);
        }
    for (uint32_t v = 0; v < 3 * n; v++) {
        mesh.vertex[v] = vec3_scale(vec3_unit(mesh.vertex[v]), radius);
        mesh.triangle[v / 3][v % 3] = v;
    }
    return mesh;
}

static void free_mesh(struct mesh *mesh) { free(mesh->vertex), free(mesh->triangle); }

static struct metro_reference surface_reference(const struct mesh *mesh) {
    return (struct metro_reference){.point = mesh->vertex, .point_count = mesh->vertex_count, .surface = mesh};
}

/* ------------------------------------------------------------------------------------------------ samples */

static void every_triangle_gets_its_share_of_samples(void **state) {
    (void)state;
    struct mesh mesh = grid(7, false, 0, 0);
    for (size_t v = 0; v < mesh.vertex_count; v++) mesh.vertex[v].x = pow(mesh.vertex[v].x, 3);
    static const size_t counts[] = {1, 10, 98, 1000, 12345};
    for (size_t i = 0; i < 5; i++) {
        struct sampler s = {0};
        assert_int_equal(sampler_uniform(&mesh, counts[i], i, &s), STATUS_OK);
        assert_int_equal(s.count, counts[i]);
        for (size_t t = 0; t < mesh.triangle_count; t++) {
            const uint32_t *v = mesh.triangle[t];
            double area =
                vec3_length(vec3_triangle_normal(mesh.vertex[v[0]], mesh.vertex[v[1]], mesh.vertex[v[2]])) / 2;
            assert_true(fabs((double)(s.first[t + 1] - s.first[t]) - area * (double)counts[i]) < 1 + 1e-9);
        }
        sampler_done(&s);
    }
    free_mesh(&mesh);
}

/* Over the triangle (0,0) (1,0) (0,1): E x = 1/3, E x^2 = 1/6, E xy = 1/12. */
static void uniform_samples_have_the_moments_of_the_triangle(void **state) {
    (void)state;
    enum { N = 10000 };
    vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, *out = malloc(N * sizeof *out);
    uint32_t triangle[][3] = {{0, 1, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    struct sampler s = {0};
    assert_int_equal(sampler_uniform(&mesh, N, 7, &s), STATUS_OK);
    sampler_fill(&s, 0, N, out);
    double x = 0, y = 0, xx = 0, xy = 0;
    for (int i = 0; i < N; i++) {
        assert_true(out[i].x >= 0 && out[i].y >= 0 && out[i].x + out[i].y <= 1 + 1e-15);
        x += out[i].x, y += out[i].y, xx += out[i].x * out[i].x, xy += out[i].x * out[i].y;
    }
    assert_true(fabs(x / N - 1. / 3) < 1e-3 && fabs(y / N - 1. / 3) < 1e-3);
    assert_true(fabs(xx / N - 1. / 6) < 1e-3 && fabs(xy / N - 1. / 12) < 1e-3);
    sampler_done(&s);
    free(out);
}

/* One sample in each of many triangles: the starts have to be as uniform as the sequence. */
static void single_samples_are_uniform_over_their_triangles(void **state) {
    (void)state;
    struct mesh mesh = grid(100, false, 0, 0);
    vec3 *out = malloc(mesh.triangle_count * sizeof *out);
    struct sampler s = {0};
    assert_int_equal(sampler_uniform(&mesh, mesh.triangle_count, 1, &s), STATUS_OK);
    sampler_fill(&s, 0, s.count, out);
    int low_x = 0, low_y = 0;
    for (size_t i = 0; i < s.count; i++) {
        low_x += fmod(out[i].x * 100, 1) < 0.5;
        low_y += fmod(out[i].y * 100, 1) < 0.5;
    }
    assert_true(abs(low_x - 10000) < 300 && abs(low_y - 10000) < 300);
    sampler_done(&s);
    free(out), free_mesh(&mesh);
}

static void the_seed_decides_where_samples_lie(void **state) {
    (void)state;
    struct mesh mesh = grid(3, false, 0, 0);
    vec3 out[3][100];
    for (uint64_t i = 0; i < 3; i++) {
        struct sampler s = {0};
        assert_int_equal(sampler_uniform(&mesh, 100, i / 2, &s), STATUS_OK);
        sampler_fill(&s, 0, 100, out[i]);
        sampler_done(&s);
    }
    assert_memory_equal(out[0], out[1], sizeof out[0]);
    for (int i = 0; i < 100; i++) assert_false(vec3_equal(out[0][i], out[2][i]));
    free_mesh(&mesh);
}

static void a_range_of_samples_is_a_part_of_the_whole(void **state) {
    (void)state;
    struct mesh mesh = grid(5, true, 1, 0);
    struct sampler s[4] = {0};
    assert_int_equal(sampler_uniform(&mesh, 1000, 3, &s[0]), STATUS_OK);
    assert_int_equal(sampler_metro(&mesh, 1000, &s[1]), STATUS_OK);
    for (int i = 0; i < 4; i++) {
        vec3 *whole = malloc((s[i].count + 1) * sizeof *whole), *part = malloc(7 * sizeof *part);
        sampler_fill(&s[i], 0, s[i].count, whole);
        for (size_t begin = 0; begin < s[i].count; begin++) {
            size_t end = begin + 7 < s[i].count ? begin + 7 : s[i].count;
            sampler_fill(&s[i], begin, end, part);
            assert_memory_equal(part, &whole[begin], (end - begin) * sizeof *part);
        }
        free(whole), free(part);
        sampler_done(&s[i]);
    }
    free_mesh(&mesh);
}

/* Edges 3, 4, 5 and area 6, 100 samples: 3 vertices; 97 / 6 for each unit of area, so 4.0208 for each of length, which
 * makes 12 + 16 + 20 on the edges; 49 are left, of which 9 + 8 + ... + 1 = 45 fit into rows. */
static void metro_s_samples_are_vertices_edges_and_rows(void **state) {
    (void)state;
    vec3 vertex[] = {{9, 9, 9}, {0, 0, 0}, {3, 0, 0}, {0, 4, 0}}, out[100];
    uint32_t triangle[][3] = {{1, 2, 3}};
    struct mesh mesh = {.vertex_count = 4, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    struct sampler s[3];
    assert_int_equal(sampler_metro(&mesh, 100, s), STATUS_OK);
    assert_int_equal(s[0].count, 3);
    assert_int_equal(s[1].count, 48);
    assert_int_equal(s[2].count, 45);
    sampler_fill(&s[0], 0, 3, out);
    for (int i = 0; i < 3; i++) assert_true(vec3_equal(out[i], vertex[i + 1]));
    sampler_fill(&s[1], 0, 48, out);
    for (int i = 0; i < 12; i++) assert_true(fabs(out[i].x - 3 * (i + 1) / 13.) < 1e-15 && out[i].y == 0);
    sampler_fill(&s[2], 0, 45, out);
    for (int i = 0; i < 45; i++) {
        assert_true(out[i].x / 3 > 0.08 && out[i].y / 4 > 0.08 && out[i].x / 3 + out[i].y / 4 < 0.92);
        for (int j = 0; j < i; j++) assert_true(vec3_distance(out[i], out[j]) > 0.1);
    }
    for (int i = 0; i < 3; i++) sampler_done(&s[i]);
}

static void a_mesh_without_area_is_still_sampled(void **state) {
    (void)state;
    vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, out[10];
    uint32_t triangle[][3] = {{0, 1, 2}, {2, 2, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 2, .triangle = triangle};
    struct sampler s[4];
    assert_int_equal(sampler_uniform(&mesh, 10, 0, &s[0]), STATUS_OK);
    assert_int_equal(s[0].count, 10);
    assert_int_equal(s[0].first[1], 5);
    sampler_fill(&s[0], 0, 10, out);
    for (int i = 0; i < 10; i++) assert_true(out[i].y == 0 && out[i].z == 0 && out[i].x >= 0 && out[i].x <= 2);
    assert_int_equal(sampler_metro(&mesh, 10, &s[1]), STATUS_OK);
    assert_int_equal(s[1].count, 3);
    assert_int_equal(s[2].count + s[3].count, 0);
    for (int i = 0; i < 4; i++) sampler_done(&s[i]);
}

/* ------------------------------------------------------------------------------------------------ errors */

static void parallel_planes_are_their_offset_apart(void **state) {
    (void)state;
    struct mesh a = grid(3, false, 0, 0.25), b = grid(180, true, 0, 0);
    struct metro_reference reference = surface_reference(&b);
    struct metro_errors errors;
    assert_int_equal(metro_measure(&a, &reference, &defaults, &errors), STATUS_OK);
    assert_int_equal(errors.forward.count, 181 * 181);
    assert_int_equal(errors.backward.count, METRO_MIN_SAMPLES);
    assert_int_equal(errors.surface.count, 4 * b.triangle_count);
    check_stats(errors.forward, 0.25, 0.25, 0.25, 1e-15);
    check_stats(errors.backward, 0.25, 0.25, 0.25, 1e-15);
    check_stats(errors.surface, 0.25, 0.25, 0.25, 1e-15);
    assert_true(fabs(errors.hausdorff - 0.25) < 1e-15);
    free_mesh(&a), free_mesh(&b);
}

/* z = x / 2 over the unit square, against z = 0: the distance is z, uniform in 0 .. 1/2. */
static void a_tilted_plane_has_the_integral_s_mean(void **state) {
    (void)state;
    struct mesh a = grid(4, false, 0.5, 0), b = grid(1, false, 0, 0);
    struct metro_reference reference = surface_reference(&b);
    struct metro_errors errors;
    assert_int_equal(metro_measure(&a, &reference, &defaults, &errors), STATUS_OK);
    assert_true(fabs(errors.backward.mean - 0.25) < 1e-4);
    assert_true(fabs(errors.backward.rms - 0.5 / sqrt(3)) < 1e-4);
    assert_true(errors.backward.max <= 0.5 && errors.backward.max > 0.499);
    check_stats(errors.forward, 1 / sqrt(20), sqrt(0.1), 1 / sqrt(5), 1e-15); /* corners: 0, 0, sin, sin of the tilt */
    assert_true(errors.hausdorff == errors.backward.max);
    free_mesh(&a), free_mesh(&b);
}

static void concentric_spheres_are_their_radii_apart(void **state) {
    (void)state;
    struct mesh a = sphere(5, 1.1), b = sphere(5, 1);
    struct metro_reference reference = surface_reference(&b);
    struct metro_errors errors;
    assert_int_equal(metro_measure(&a, &reference, &defaults, &errors), STATUS_OK);
    check_stats(errors.forward, 0.1, 0.1, 0.1, 1e-3);
    check_stats(errors.backward, 0.1, 0.1, 0.1, 1e-3);
    check_stats(errors.surface, 0.1, 0.1, 0.1, 1e-3);
    double diagonal;
    struct metro_errors metro;
    assert_int_equal(metro_compatible(&a, &b, &defaults, &metro, &diagonal), STATUS_OK);
    check_stats(metro.forward, 0.1, 0.1, 0.1, 1e-3);
    check_stats(metro.backward, 0.1, 0.1, 0.1, 1e-3);
    assert_int_equal(metro.surface.count, 0);
    assert_true(fabs(diagonal - (2.2 + 0.04 * 2.2 * sqrt(3)) * sqrt(3)) < 1e-12);
    free_mesh(&a), free_mesh(&b);
}

static void points_at_known_distances_from_one_triangle(void **state) {
    (void)state;
    vec3 vertex[] = {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}};
    uint32_t triangle[][3] = {{0, 1, 2}};
    struct mesh mesh = {.vertex_count = 3, .vertex = vertex, .triangle_count = 1, .triangle = triangle};
    const vec3 point[] = {{1, 1, 2}, {-3, -4, 0}, {1, 1, 0}, {1, -2, 0}, {4, 0, 1}};
    struct distance_stats stats;
    assert_int_equal(metro_points(point, 5, &mesh, &defaults, &stats), STATUS_OK);
    assert_int_equal(stats.count, 5);
    check_stats(stats, 2, sqrt(34. / 5), 5, 1e-15);
    assert_int_equal(metro_points(point, 0, &mesh, &defaults, &stats), STATUS_OK);
    assert_true(stats.count == 0 && stats.mean == 0 && stats.rms == 0 && stats.max == 0);
}

/* Points of a plane know the plane around them, so a mesh that is 0.01 off it is 0.01 off, wherever samples lie between
 * the points; what reaches out of the plane's border is as far as the nearest point. */
static void tangent_disks_stand_for_the_surface(void **state) {
    (void)state;
    enum { SIDE = 11, N = SIDE * SIDE };
    struct mesh plane = grid(SIDE - 1, false, 0, 0), near = grid(2, false, 0, 0.01), far = grid(1, false, 0, 3);
    vec3 normal[N];
    float spacing[N];
    for (int i = 0; i < N; i++) normal[i] = (vec3){0, 0, i % 2 ? 1 : -1}, spacing[i] = 0.1F;
    struct knn *knn = NULL;
    assert_int_equal(knn_new(plane.vertex, N, 1, &knn, NULL), STATUS_OK);
    struct metro_reference reference = {
        .point = plane.vertex, .point_count = N, .normal = normal, .spacing = spacing, .knn = knn};
    struct metro_errors errors;
    assert_int_equal(metro_measure(&near, &reference, &defaults, &errors), STATUS_OK);
    check_stats(errors.forward, 0.01, 0.01, 0.01, 1e-15);
    check_stats(errors.backward, 0.01, 0.01, 0.01, 1e-15);
    assert_int_equal(errors.surface.count, 0);
    assert_int_equal(metro_measure(&far, &reference, &defaults, &errors), STATUS_OK);
    assert_true(errors.backward.mean > 3 && errors.backward.max < sqrt(9 + 0.005));
    vec3 beside[3] = {{1.29, 0.5, 0}, {1.31, 0.5, 0}, {1.3, 0.51, 0}}; /* in the plane, three spacings from its end */
    struct mesh off = {
        .vertex_count = 3, .vertex = beside, .triangle_count = 1, .triangle = (uint32_t[1][3]){{0, 1, 2}}};
    assert_int_equal(metro_measure(&off, &reference, &defaults, &errors), STATUS_OK);
    assert_true(errors.backward.mean > 0.29 && errors.backward.max < 0.32);
    knn_free(knn);
    free_mesh(&plane), free_mesh(&near), free_mesh(&far);
}

static void points_without_normals_give_one_direction(void **state) {
    (void)state;
    struct mesh a = grid(1, false, 0, 0.5);
    const vec3 point[] = {{0.5, 0.5, 0}};
    struct metro_reference reference = {.point = point, .point_count = 1};
    struct metro_errors errors;
    assert_int_equal(metro_measure(&a, &reference, &defaults, &errors), STATUS_OK);
    check_stats(errors.forward, 0.5, 0.5, 0.5, 0);
    assert_int_equal(errors.backward.count + errors.surface.count, 0);
    assert_true(errors.hausdorff == 0.5);
    free_mesh(&a);
}

static void surfaces_without_triangles_are_degenerate(void **state) {
    (void)state;
    struct mesh empty = {0}, full = grid(1, false, 0, 0);
    struct metro_reference to_full = surface_reference(&full), to_empty = {.surface = &empty};
    struct metro_errors errors = {.hausdorff = 42};
    double diagonal = 43;
    assert_int_equal(metro_measure(&empty, &to_full, &defaults, &errors), STATUS_DEGENERATE);
    assert_int_equal(metro_measure(&full, &to_empty, &defaults, &errors), STATUS_DEGENERATE);
    assert_int_equal(metro_compatible(&full, &empty, &defaults, &errors, &diagonal), STATUS_DEGENERATE);
    assert_int_equal(metro_compatible(&empty, &full, &defaults, &errors, &diagonal), STATUS_DEGENERATE);
    assert_true(errors.hausdorff == 42 && diagonal == 43);
    free_mesh(&full);
}

/* Triangles without area get no samples but count as what they are: here a spike that reaches up to the points. */
static void triangles_without_area_are_surface_too(void **state) {
    (void)state;
    vec3 vertex[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 5}};
    uint32_t triangle[][3] = {{0, 3, 0}, {0, 1, 2}, {3, 3, 3}};
    struct mesh mesh = {.vertex_count = 4, .vertex = vertex, .triangle_count = 3, .triangle = triangle};
    const vec3 point[] = {{0, 0, 4}, {0.25, 0.25, 0}};
    struct metro_reference reference = {.point = point, .point_count = 2, .surface = &mesh};
    struct metro_errors errors;
    assert_int_equal(metro_measure(&mesh, &reference, &defaults, &errors), STATUS_OK);
    assert_true(errors.forward.max == 0);
    assert_true(errors.backward.max < 1e-15 && errors.surface.max < 1e-15);
}

static void any_number_of_threads_measures_the_same_bits(void **state) {
    (void)state;
    struct mesh a = sphere(3, 1.05), b = sphere(4, 1);
    struct metro_reference reference = surface_reference(&b);
    struct metro_errors one = {0}, many = {0}, metro_one = {0}, metro_many = {0};
    double diagonal;
    struct metro_options options = {.samples = 200001, .seed = 5, .threads = 1};
    assert_int_equal(metro_measure(&a, &reference, &options, &one), STATUS_OK);
    assert_int_equal(metro_compatible(&a, &b, &options, &metro_one, &diagonal), STATUS_OK);
    assert_int_equal(one.backward.count, 200001);
    for (options.threads = 2; options.threads < 8; options.threads += 3) {
        assert_int_equal(metro_measure(&a, &reference, &options, &many), STATUS_OK);
        assert_int_equal(metro_compatible(&a, &b, &options, &metro_many, &diagonal), STATUS_OK);
        assert_memory_equal(&one, &many, sizeof one);
        assert_memory_equal(&metro_one, &metro_many, sizeof one);
    }
    options.seed = 6;
    assert_int_equal(metro_measure(&a, &reference, &options, &many), STATUS_OK);
    assert_true(many.backward.mean != one.backward.mean && many.forward.mean == one.forward.mean);
    free_mesh(&a), free_mesh(&b);
}

static int stop_at_half(void *ctx, const char *stage, double fraction) {
    assert_string_equal(stage, "measure");
    assert_true(fraction >= *(double *)ctx && fraction <= 1);
    *(double *)ctx = fraction;
    return fraction >= 0.5;
}

/* A sphere with a hundred triangles from one side to the other, against itself. */
static void where_samples_cost_much_there_are_fewer(void **state) {
    (void)state;
    enum { ACROSS = 100 };
    struct mesh a = sphere(5, 1), b = sphere(5, 1);
    size_t n = b.triangle_count, vertices = b.vertex_count;
    b.triangle = realloc(b.triangle, (n + ACROSS) * sizeof *b.triangle);
    for (uint32_t i = 0; i < ACROSS; i++, b.triangle_count++) {
        uint32_t from = (uint32_t)(i * (vertices / ACROSS));
        b.triangle[n + i][0] = from;
        b.triangle[n + i][1] = (uint32_t)((from + vertices / 2 + 7 * i) % vertices);
        b.triangle[n + i][2] = (uint32_t)((from + vertices / 3 + 11 * i) % vertices);
    }
    struct metro_reference reference = surface_reference(&b);
    struct metro_options options = {.threads = 2};
    struct metro_errors all, fewer;
    assert_int_equal(metro_measure(&a, &reference, &options, &all), STATUS_OK);
    options.most_visits = 1000;
    assert_int_equal(metro_measure(&a, &reference, &options, &fewer), STATUS_OK);
    assert_int_equal(all.forward.count, fewer.forward.count);
    assert_in_range(fewer.surface.count, 1000, all.surface.count / 3);
    assert_true(fabs(fewer.surface.mean - all.surface.mean) < 0.02 * all.surface.mean);
    assert_true(fabs(fewer.hausdorff - all.hausdorff) < 0.05 * all.hausdorff);
    options.samples = 20000; /* so many were asked for */
    assert_int_equal(metro_measure(&a, &reference, &options, &fewer), STATUS_OK);
    assert_int_equal(fewer.surface.count, 20000);
    options.most_visits = 20;
    assert_int_equal(metro_measure(&a, &reference, &options, &fewer), STATUS_LIMIT);
    free_mesh(&a), free_mesh(&b);
}

static void a_tick_can_stop_it(void **state) {
    (void)state;
    struct mesh a = grid(1, false, 0, 1), b = grid(1, false, 0, 0);
    struct metro_reference reference = surface_reference(&b);
    double fraction = 0;
    struct progress progress = {stop_at_half, &fraction};
    struct metro_options options = {.samples = 300000, .progress = &progress};
    struct metro_errors errors = {.hausdorff = 42};
    assert_int_equal(metro_measure(&a, &reference, &options, &errors), STATUS_CANCELLED);
    assert_true(errors.hausdorff == 42 && fraction >= 0.5 && fraction < 0.8);
    free_mesh(&a), free_mesh(&b);
}

static bool fails_at_zero(void *ctx) { return (*(int *)ctx)-- == 0; }

static void any_allocation_that_fails_is_reported(void **state) {
    (void)state;
    struct mesh a = grid(2, false, 0, 1), b = grid(2, false, 0, 0);
    struct metro_reference reference = surface_reference(&b);
    struct metro_options options = {.samples = 100, .threads = 1};
    const vec3 *const point[2] = {a.vertex, b.vertex};
    const size_t points[2] = {a.vertex_count, b.vertex_count};
    int refused[3] = {0};
    for (int nth = 0; nth < 60; nth++)
        for (int way = 0; way < 3; way++) {
            struct metro_errors errors = {.hausdorff = 42};
            double diagonal = 43;
            int countdown = nth;
            alloc_fail_ctx = &countdown, alloc_fail = fails_at_zero;
            enum status status = way == 2   ? metro_clouds(point, points, &options, &errors)
                                 : way == 1 ? metro_compatible(&a, &b, &options, &errors, &diagonal)
                                            : metro_measure(&a, &reference, &options, &errors);
            alloc_fail = NULL;
            assert_true(status == STATUS_OK || status == STATUS_NO_MEMORY);
            assert_true(errors.hausdorff == (status ? 42 : 1));
            refused[way] += status != STATUS_OK;
        }
    assert_int_equal(refused[0], 2 * 8 + 2 + 3 + 2 * 7); /* two hierarchies, two samplers, the batch, two searches */
    assert_int_equal(refused[1], 2 * 8 + 2 * 5 + 3);
    assert_int_equal(refused[2], 2 * 6 + 3); /* two indices, the batch */
    free_mesh(&a), free_mesh(&b);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_triangle_gets_its_share_of_samples),
        cmocka_unit_test(uniform_samples_have_the_moments_of_the_triangle),
        cmocka_unit_test(single_samples_are_uniform_over_their_triangles),
        cmocka_unit_test(the_seed_decides_where_samples_lie),
        cmocka_unit_test(a_range_of_samples_is_a_part_of_the_whole),
        cmocka_unit_test(metro_s_samples_are_vertices_edges_and_rows),
        cmocka_unit_test(a_mesh_without_area_is_still_sampled),
        cmocka_unit_test(parallel_planes_are_their_offset_apart),
        cmocka_unit_test(a_tilted_plane_has_the_integral_s_mean),
        cmocka_unit_test(concentric_spheres_are_their_radii_apart),
        cmocka_unit_test(points_at_known_distances_from_one_triangle),
        cmocka_unit_test(tangent_disks_stand_for_the_surface),
        cmocka_unit_test(points_without_normals_give_one_direction),
        cmocka_unit_test(surfaces_without_triangles_are_degenerate),
        cmocka_unit_test(triangles_without_area_are_surface_too),
        cmocka_unit_test(any_number_of_threads_measures_the_same_bits),
        cmocka_unit_test(where_samples_cost_much_there_are_fewer),
        cmocka_unit_test(a_tick_can_stop_it),
        cmocka_unit_test(any_allocation_that_fails_is_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
