/* What is said of a mesh against what it is: figures beside those of a sampling that shares no code with them, the
 * largest distance where it is known, and the share of a surface that no point supports.
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
#include "core/cloud/cloud.h"
#include "core/measure/largest.h"
#include "core/measure/metro.h"
#include "core/measure/support.h"
#include "tests/unit/shapes.h"

typedef double (*height)(double x, double y, uint64_t *random);

/* side x side squares over 0 .. width and 0 .. 1, each cut in four around its middle, which is lifted. */
static struct mesh bed(uint32_t side, double width, double base, height rise, height lift) {
    uint32_t corners = (side + 1) * (side + 1);
    struct mesh mesh = {.vertex_count = corners + side * side, .triangle_count = 4 * (size_t)side * side};
    uint64_t random = 7;
    mesh.vertex = malloc(mesh.vertex_count * sizeof *mesh.vertex);
    mesh.triangle = malloc(mesh.triangle_count * sizeof *mesh.triangle);
    for (uint32_t v = 0; v < corners; v++) {
        double x = v % (side + 1) / (double)side, y = v / (side + 1) / (double)side;
        mesh.vertex[v] = (vec3){width * x, y, base + (rise ? rise(x, y, &random) : 0)};
    }
    for (uint32_t i = 0; i < side * side; i++) {
        uint32_t a = i / side * (side + 1) + i % side, corner[5] = {a, a + 1, a + side + 2, a + side + 1, a};
        vec3 middle = vec3_lerp(mesh.vertex[a], mesh.vertex[a + side + 2], 0.5);
        middle.z += lift ? lift(middle.x, middle.y, &random) : 0;
        mesh.vertex[corners + i] = middle;
        for (int k = 0; k < 4; k++) {
            uint32_t *v = mesh.triangle[4 * i + (uint32_t)k];
            v[0] = corner[k], v[1] = corner[k + 1], v[2] = corners + i;
        }
    }
    return mesh;
}

static void free_mesh(struct mesh *mesh) { free(mesh->vertex), free(mesh->triangle); }

static void turn_over(struct mesh *mesh) {
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        uint32_t swap = mesh->triangle[t][0];
        mesh->triangle[t][0] = mesh->triangle[t][1], mesh->triangle[t][1] = swap;
    }
}

static double spikes(double x, double y, uint64_t *random) {
    (void)x, (void)y;
    return 0.02 * random_unit(random) * random_unit(random) * random_unit(random);
}
static double waves(double x, double y, uint64_t *random) {
    (void)random;
    return 0.1 * sin(9 * x) * cos(7 * y);
}
static double rough(double x, double y, uint64_t *random) {
    return waves(x, y, random) + 0.05 * (random_unit(random) - 0.5);
}
static double ridge(double x, double y, uint64_t *random) {
    (void)y, (void)random;
    return 0.5 - fabs(x - 0.5);
}

/* ------------------------------------------------------------------------------------------------ an own sampling */

static double to_segment(vec3 p, vec3 a, vec3 b) {
    vec3 d = vec3_sub(b, a);
    double t = vec3_dot(vec3_sub(p, a), d) / vec3_dot(d, d);
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return vec3_distance(p, vec3_add(a, vec3_scale(d, t)));
}

/* Inside the prism over the triangle the distance is to its plane, else to one of its sides. */
static double to_triangle(vec3 p, vec3 a, vec3 b, vec3 c) {
    vec3 n = vec3_unit(vec3_cross(vec3_sub(b, a), vec3_sub(c, a)));
    bool inside = vec3_dot(vec3_cross(vec3_sub(b, a), vec3_sub(p, a)), n) >= 0 &&
                  vec3_dot(vec3_cross(vec3_sub(c, b), vec3_sub(p, b)), n) >= 0 &&
                  vec3_dot(vec3_cross(vec3_sub(a, c), vec3_sub(p, c)), n) >= 0;
    if (inside) return fabs(vec3_dot(vec3_sub(p, a), n));
    return fmin(to_segment(p, a, b), fmin(to_segment(p, b, c), to_segment(p, c, a)));
}

static double to_mesh(vec3 p, const struct mesh *mesh) {
    double least = INFINITY;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        least = fmin(least, to_triangle(p, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]));
    }
    return least;
}

static vec3 at(const struct mesh *mesh, size_t t, double u, double v) {
    const uint32_t *id = mesh->triangle[t];
    vec3 a = mesh->vertex[id[0]];
    return vec3_add(
        a, vec3_add(vec3_scale(vec3_sub(mesh->vertex[id[1]], a), u), vec3_scale(vec3_sub(mesh->vertex[id[2]], a), v)));
}

/* Each triangle in k * k equal ones: the mean over their middles, weighted by area, the largest over their corners. */
static struct distance_stats own_sampling(const struct mesh *from, const struct mesh *to, int k) {
    struct distance_stats stats = {0};
    double area = 0, step = 1.0 / k;
    for (size_t t = 0; t < from->triangle_count; t++) {
        vec3 a = at(from, t, 0, 0), b = at(from, t, 1, 0), c = at(from, t, 0, 1);
        double weight = vec3_length(vec3_cross(vec3_sub(b, a), vec3_sub(c, a)));
        for (int i = 0; i <= k; i++)
            for (int j = 0; i + j <= k; j++) {
                stats.max = fmax(stats.max, to_mesh(at(from, t, i * step, j * step), to));
                for (int half = 1; half <= 2 && i + j + half <= k; half++) {
                    double d = to_mesh(at(from, t, (i + half / 3.0) * step, (j + half / 3.0) * step), to);
                    stats.mean += weight * d, stats.rms += weight * d * d, area += weight;
                }
            }
    }
    stats.mean /= area;
    stats.rms = sqrt(stats.rms / area);
    return stats;
}

static void check_near(const char *what, struct distance_stats told, struct distance_stats own) {
    bool good = fabs(told.mean / own.mean - 1) < 0.01 && fabs(told.rms / own.rms - 1) < 0.01 &&
                told.max > 0.98 * own.max && told.max < 1.02 * own.max;
    if (!good)
        print_error("%s: mean %g, own %g; rms %g, own %g; max %g, own %g\n", what, told.mean, own.mean, told.rms,
                    own.rms, told.max, own.max);
    assert_true(good);
}

static void figures_are_those_of_an_own_dense_sampling(void **state) {
    (void)state;
    const struct {
        const char *name;
        struct mesh a, b;
    } pairs[] = {{"waves", bed(2, 1, 0, waves, NULL), bed(8, 1, 0, waves, NULL)},
                 {"rough", bed(3, 1, 0.02, rough, NULL), bed(7, 1, 0, waves, spikes)},
                 {"ridge", bed(3, 1, 0, ridge, NULL), bed(4, 1, 0, NULL, NULL)},
                 {"beside", bed(2, 1, 0.3, NULL, spikes), bed(4, 0.6, 0, waves, NULL)}};
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        struct mesh a = pairs[i].a, b = pairs[i].b;
        struct metro_reference reference = {.point = b.vertex, .point_count = b.vertex_count, .surface = &b};
        struct metro_options options = {.samples = 20000};
        struct metro_errors errors;
        assert_int_equal(metro_measure(&a, &reference, &options, &errors), STATUS_OK);
        check_near(pairs[i].name, errors.backward, own_sampling(&a, &b, 48));
        check_near(pairs[i].name, errors.surface, own_sampling(&b, &a, 24));
        free_mesh(&a), free_mesh(&b);
    }
}

/* ------------------------------------------------------------------------------------------------ largest */

static double tallest(const struct mesh *mesh) {
    double most = 0;
    for (size_t v = 0; v < mesh->vertex_count; v++) most = fmax(most, mesh->vertex[v].z);
    return most;
}

/* Ten samples on each of 40 000 sides of pyramids, of which one reaches highest, above a floor or points of it. */
static void the_tip_of_one_spike_of_many_is_found(void **state) {
    (void)state;
    enum { SIDE = 60, N = (SIDE + 1) * (SIDE + 1) };
    struct mesh spiky = bed(100, 1, 0, NULL, spikes), grid = bed(SIDE, 1, 0, NULL, NULL),
                floor = bed(1, 1, 0, NULL, NULL);
    vec3 *normal = malloc(N * sizeof *normal);
    float *spacing = malloc(N * sizeof *spacing);
    struct knn *knn = NULL;
    for (int i = 0; i < N; i++) normal[i] = (vec3){0, 0, 1}, spacing[i] = 1;
    assert_int_equal(knn_new(grid.vertex, N, 1, &knn, NULL), STATUS_OK);
    struct metro_reference to_surface = {.surface = &floor}, to_points = {N, grid.vertex, normal, spacing, knn, NULL};
    struct metro_options options = {.samples = 100000};
    struct metro_errors errors;
    double highest = tallest(&spiky);
    assert_int_equal(metro_measure(&spiky, &to_surface, &options, &errors), STATUS_OK);
    assert_true(errors.backward.max <= highest * (1 + 1e-12) && errors.backward.max >= highest / (1 + LARGEST_SLACK));
    assert_int_equal(metro_measure(&spiky, &to_points, &options, &errors), STATUS_OK);
    assert_true(errors.backward.max <= highest * (1 + 1e-12) && errors.backward.max >= 0.95 * highest);
    knn_free(knn);
    free(normal), free(spacing);
    free_mesh(&spiky), free_mesh(&grid), free_mesh(&floor);
}

/* ------------------------------------------------------------------------------------------------ support */

/* Points of a grid of side x side over 0 .. 1. */
static double missing(const struct mesh *mesh, size_t side, unsigned threads) {
    size_t n = side * side;
    vec3 *point = shape_height_field(side, height_plane);
    float *spacing = malloc(n * sizeof *spacing);
    uint32_t *nearest = malloc(n * sizeof *nearest);
    struct knn *knn = NULL;
    double share = -1;
    for (size_t i = 0; i < n; i++) point[i].z = 0, spacing[i] = 1 / (float)(side - 1);
    struct metro_options options = {.nearest = nearest};
    struct distance_stats stats;
    assert_int_equal(metro_points(point, n, mesh, &options, &stats), STATUS_OK);
    assert_int_equal(knn_new(point, n, 1, &knn, NULL), STATUS_OK);
    struct support_points points = {point, spacing, knn, nearest};
    assert_int_equal(support_missing(mesh, &points, 0, threads, &share), STATUS_OK);
    knn_free(knn);
    free(point), free(spacing), free(nearest);
    return share;
}

static struct mesh joined(struct mesh *a, struct mesh *b) {
    struct mesh both = {.vertex_count = a->vertex_count + b->vertex_count,
                        .triangle_count = a->triangle_count + b->triangle_count};
    both.vertex = malloc(both.vertex_count * sizeof *both.vertex);
    both.triangle = malloc(both.triangle_count * sizeof *both.triangle);
    for (size_t v = 0; v < both.vertex_count; v++)
        both.vertex[v] = v < a->vertex_count ? a->vertex[v] : b->vertex[v - a->vertex_count];
    for (size_t t = 0; t < both.triangle_count; t++)
        for (int k = 0; k < 3; k++)
            both.triangle[t][k] = t < a->triangle_count
                                      ? a->triangle[t][k]
                                      : b->triangle[t - a->triangle_count][k] + (uint32_t)a->vertex_count;
    free_mesh(a), free_mesh(b);
    return both;
}

static void a_place_is_supported_where_points_are_about_it(void **state) {
    (void)state;
    struct mesh covered = bed(5, 1, 0, NULL, NULL), coarse = bed(2, 1, 0.3, NULL, NULL),
                wide = bed(20, 2, 0, NULL, NULL);
    assert_true(missing(&covered, 41, 1) == 0);
    assert_true(missing(&coarse, 41, 1) == 0); /* twelve spacings from the points, all of which stand below it */
    double beyond = (1 - SUPPORT_REACH * 0.025) / 2, found = missing(&wide, 41, 1);
    assert_true(fabs(found - beyond) < 0.005);
    assert_true(missing(&wide, 41, 7) == found);
    free_mesh(&covered), free_mesh(&coarse), free_mesh(&wide);
}

/* A lid half a spacing under the sheet: points are near, but stand on the sheet. */
static void the_back_of_a_sheet_is_unsupported(void **state) {
    (void)state;
    struct mesh sheet = bed(5, 1, 0, NULL, NULL), back = bed(5, 1, -0.0125, NULL, NULL);
    turn_over(&back);
    struct mesh both = joined(&sheet, &back);
    assert_true(fabs(missing(&both, 41, 2) - 0.5) < 0.005);
    free_mesh(&both);
}

/* ------------------------------------------------------------------------------------------------ warnings */

static void a_closed_mesh_over_nothing_is_warned_of(void **state) {
    (void)state;
    const struct report report = {.surface = {.kind = "closed", .sure = true}};
    struct report_level level = {.has_mesh = true, .watertight = true, .unsupported = 0.47};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_string_equal(text, "the mesh is watertight, but no input point supports 47 % of its area (warned of from 5 "
                              "%): it spans what was not scanned; boundary=keep leaves that open");
    assert_false(report_warning(&report, &level, 1, text, sizeof text));
    level.unsupported = REPORT_UNSUPPORTED_MOST;
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
    level.unsupported = 0.47, level.watertight = false;
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
}

static void noise_that_is_left_is_told_where_a_mesh_spans_nothing(void **state) {
    (void)state;
    const struct report report = {.surface = {.kind = "closed", .sure = true}, .denoised = "full"};
    struct report_level level = {.has_mesh = true, .watertight = true, .unsupported = 0.18};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_non_null(strstr(text, "or noise was more than smoothing takes off"));
}

static void webs_are_warned_of(void **state) {
    (void)state;
    struct report report = {.surface = {.kind = "open", .sure = true}};
    struct report_level level = {.has_mesh = true, .unsupported = 0.9};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_string_equal(text,
                        "no input point supports 90 % of the mesh's area (warned of from 50 %): the points may be "
                        "of curves, between which there is no surface, or too few of them are kept");
    level.unsupported = REPORT_WEBS_MOST;
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
    level.unsupported = 0.9;
    snprintf(report.surface.kind, sizeof report.surface.kind, "given");
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
}

static void a_mesh_of_noise_is_warned_of(void **state) {
    (void)state;
    struct report report = {.surface = {.kind = "open", .sure = false, .reason = "why"}, .noise_share = 0.214};
    struct report_level level = {.has_mesh = true};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_non_null(strstr(text, "not sure"));
    assert_true(report_warning(&report, &level, 1, text, sizeof text));
    assert_string_equal(text, "noise is at least 0.21 of the distance between points (warned of from 0.125): the mesh "
                              "follows it; denoise=auto smooths such points");
    assert_false(report_warning(&report, &level, 2, text, sizeof text));
    report.noise_share = REPORT_LARGE_NOISE;
    assert_false(report_warning(&report, &level, 1, text, sizeof text));
    report.noise_share = 0.214, level.has_mesh = false;
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
}

static void degrees_below_metres_are_warned_of(void **state) {
    (void)state;
    struct report report = {.box_min = {8.51, 47.35, 400}, .box_max = {8.53, 47.36, 440}};
    const struct report_level level = {0};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_string_equal(text,
                        "the cloud is 2000 times as high as wide: if x and y are degrees and z is metres, distances "
                        "are wrong; put it into a coordinate system of metres first");
    assert_false(report_warning(&report, &level, 1, text, sizeof text));
    report.box_max[2] = 403; /* a mast, in metres */
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
    report.box_max[2] = 440, report.box_max[1] = 91; /* no latitude */
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
    report = (struct report){.box_max = {0, 0, 5}}; /* a line */
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
}

static void coarse_steps_of_coordinates_are_warned_of(void **state) {
    (void)state;
    struct report report = {.rounding_step = 0.5, .rounding_share = 0.62};
    const struct report_level level = {0};
    char text[REPORT_WARNING_BYTES];
    assert_true(report_warning(&report, &level, 0, text, sizeof text));
    assert_string_equal(text,
                        "coordinates are so large that float32 holds them in steps of 0.5, 0.62 of the distance "
                        "between points (warned of from 0.2): if they were rounded to these, take them as double, "
                        "or less an offset, from where they come from");
    report.rounding_share = 0.19;
    assert_false(report_warning(&report, &level, 0, text, sizeof text));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(degrees_below_metres_are_warned_of),
        cmocka_unit_test(coarse_steps_of_coordinates_are_warned_of),
        cmocka_unit_test(a_mesh_of_noise_is_warned_of),
        cmocka_unit_test(figures_are_those_of_an_own_dense_sampling),
        cmocka_unit_test(the_tip_of_one_spike_of_many_is_found),
        cmocka_unit_test(a_place_is_supported_where_points_are_about_it),
        cmocka_unit_test(the_back_of_a_sheet_is_unsupported),
        cmocka_unit_test(a_closed_mesh_over_nothing_is_warned_of),
        cmocka_unit_test(noise_that_is_left_is_told_where_a_mesh_spans_nothing),
        cmocka_unit_test(webs_are_warned_of),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
