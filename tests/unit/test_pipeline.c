/* The whole pipeline: counts, the prefix property, degenerate clouds and cancelling.
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
#include "core/pipeline/pipeline.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

/* A cloud of positions alone, as float64 x, y, z.  Takes the points. */
static struct cloud cloud_of(vec3 *point, size_t n) {
    struct cloud cloud = {.count = n, .position = point, .property_count = 3, .record_bytes = 24, .xyz = {0, 1, 2}};
    cloud.form = "arrays";
    cloud.property = calloc(3, sizeof *cloud.property);
    cloud.record = malloc(n * 24 + 1);
    for (size_t i = 0; i < 3; i++) {
        cloud.property[i] = (struct property){.type = SCALAR_FLOAT64, .offset_bytes = 8 * i};
        snprintf(cloud.property[i].name, sizeof cloud.property[i].name, "%c", "xyz"[i]);
    }
    memcpy(cloud.record, point, n * 24);
    return cloud;
}

/* Runs with "name value name value ..." on top of the defaults. */
static enum status run(const struct cloud *cloud, const char *settings, struct pipeline_result *result,
                       struct error *error) {
    struct params params;
    char name[64], value[64];
    int used;
    params_defaults(&params);
    for (; sscanf(settings, " %63s %63s%n", name, value, &used) == 2; settings += used)
        assert_int_equal(params_set(&params, name, value, error), STATUS_OK);
    assert_int_equal(params_resolve(&params, error), STATUS_OK);
    return pipeline_run(cloud, &params, NULL, result, error);
}

static struct pipeline_result succeed(const struct cloud *cloud, const char *settings) {
    struct pipeline_result result = {0};
    struct error error = {0};
    enum status status = run(cloud, settings, &result, &error);
    if (status) print_error("%s: %s\n", settings, error.text);
    assert_int_equal(status, STATUS_OK);
    return result;
}

/* ------------------------------------------------------------------------------------------------ counts */

static void goals_are_met_exactly(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_sphere(1234, 7), 1234);
    const struct {
        const char *settings;
        size_t expected;
    } cases[] = {{"ratio 0.1", 123}, {"ratio 1", 1234},     {"ratio 0.0001", 1},
                 {"points 77", 77},  {"points 5000", 1234}, {"ratio 0.5 max_error 1", 617},
                 {"points 1", 1},    {"max_error 1", 1}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct pipeline_result result = succeed(&cloud, cases[i].settings);
        assert_int_equal(result.level[0].kept_count, cases[i].expected);
        assert_int_equal(result.report.level[0].points_out, cases[i].expected);
        pipeline_result_done(&result);
    }
    cloud_done(&cloud);
}

static void kept_points_are_distinct_and_of_the_input(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_sphere(1000, 1), 1000);
    struct pipeline_result result = succeed(&cloud, "ratio 0.3 outputs mesh");
    unsigned char seen[1000] = {0};
    for (size_t i = 0; i < 300; i++) {
        assert_true(result.kept[i] < 1000 && !seen[result.kept[i]]);
        seen[result.kept[i]] = 1;
    }
    const struct mesh *mesh = &result.level[0].mesh;
    for (size_t v = 0; v < mesh->vertex_count; v++)
        assert_memory_equal(&mesh->vertex[v], &cloud.position[mesh->source[v]], sizeof(vec3));
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

static void any_prefix_is_the_smaller_cloud(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_sphere(2000, 1), 2000);
    struct pipeline_result large = succeed(&cloud, "points 900"), small = succeed(&cloud, "points 55");
    struct pipeline_result levels = succeed(&cloud, "levels 0.2,0.45,0.0275 outputs cloud,mesh");
    assert_memory_equal(large.kept, small.kept, 55 * sizeof *small.kept);
    assert_memory_equal(large.kept, levels.kept, 900 * sizeof *large.kept);
    assert_int_equal(levels.report.level_count, 3);
    const size_t expected[] = {900, 400, 55};
    for (size_t i = 0; i < 3; i++) {
        assert_int_equal(levels.report.level[i].points_out, expected[i]);
        assert_true(levels.report.level[i].watertight);
        if (i) assert_true(levels.report.level[i].input_to_mesh.mean > levels.report.level[i - 1].input_to_mesh.mean);
    }
    pipeline_result_done(&large), pipeline_result_done(&small), pipeline_result_done(&levels);
    cloud_done(&cloud);
}

static void a_level_s_mesh_is_that_of_its_own_job(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_sphere(1500, 1), 1500);
    struct pipeline_result levels = succeed(&cloud, "levels 0.4,0.1 outputs mesh");
    struct pipeline_result alone = succeed(&cloud, "ratio 0.1 outputs mesh");
    const struct mesh *a = &levels.level[1].mesh, *b = &alone.level[0].mesh;
    assert_int_equal(a->triangle_count, b->triangle_count);
    assert_memory_equal(a->triangle, b->triangle, a->triangle_count * sizeof *a->triangle);
    assert_memory_equal(a->vertex, b->vertex, a->vertex_count * sizeof *a->vertex);
    pipeline_result_done(&levels), pipeline_result_done(&alone);
    cloud_done(&cloud);
}

static void check_same_meshes(const struct mesh *a, const struct mesh *b) {
    assert_int_equal(a->vertex_count, b->vertex_count);
    assert_int_equal(a->triangle_count, b->triangle_count);
    if (a->vertex_count) assert_memory_equal(a->vertex, b->vertex, a->vertex_count * sizeof *a->vertex);
    if (a->triangle_count) assert_memory_equal(a->triangle, b->triangle, a->triangle_count * sizeof *a->triangle);
}

static void check_same_results(const struct pipeline_result *a, const struct pipeline_result *b, size_t n) {
    assert_int_equal(a->level_count, b->level_count);
    for (size_t i = 0; i < a->level_count; i++) {
        const struct report_level *x = &a->report.level[i], *y = &b->report.level[i];
        assert_int_equal(a->level[i].kept_count, b->level[i].kept_count);
        check_same_meshes(&a->level[i].mesh, &b->level[i].mesh);
        assert_memory_equal(&x->tangent, &y->tangent, sizeof x->tangent);
        assert_memory_equal(&x->symmetric, &y->symmetric, sizeof x->symmetric);
        assert_true(x->unsupported == y->unsupported);
    }
    assert_memory_equal(a->kept, b->kept, a->level[0].kept_count * sizeof *a->kept);
    assert_true(!a->moved == !b->moved && !a->dso == !b->dso && !a->distance == !b->distance);
    if (a->moved) assert_memory_equal(a->moved, b->moved, n * sizeof *a->moved);
    if (a->dso) assert_memory_equal(a->dso, b->dso, n * sizeof *a->dso);
    if (a->distance) assert_memory_equal(a->distance, b->distance, n * sizeof *a->distance);
}

static void threads_do_not_change_a_bit(void **state) {
    (void)state;
    enum { N = 6000 };
    static const char *const settings[] = {"ratio 0.2 outputs mesh,dso,error",
                                           "ratio 0.2 outputs cloud",
                                           "ratio 0.1 outputs mesh placement optimal",
                                           "ratio 0.2 outputs mesh boundary keep",
                                           "ratio 0.2 outputs mesh reconstruction literal",
                                           "ratio 0.2 outputs mesh refine flips reference reconstruction",
                                           "ratio 0.2 outputs mesh,error denoise full",
                                           "levels 0.4,0.2,0.05 outputs cloud,mesh",
                                           "max_deviation_rel 0.003 outputs mesh refine none"};
    vec3 *point = shape_sphere(N, 1);
    uint64_t random = 3;
    for (size_t i = 0; i < N; i++) point[i].z = fmax(point[i].z, -0.5) + 0.002 * random_unit(&random); /* a flat base */
    struct cloud cloud = cloud_of(point, N);
    for (size_t i = 0; i < sizeof settings / sizeof settings[0]; i++) {
        char text[160];
        snprintf(text, sizeof text, "%s threads 1", settings[i]);
        struct pipeline_result one = succeed(&cloud, text);
        for (int threads = 2; threads < 8; threads += 5) {
            snprintf(text, sizeof text, "%s threads %d", settings[i], threads);
            struct pipeline_result many = succeed(&cloud, text);
            check_same_results(&one, &many, N);
            pipeline_result_done(&many);
        }
        pipeline_result_done(&one);
    }
    cloud_done(&cloud);
}

static void the_input_s_order_does_not_matter(void **state) {
    (void)state;
    vec3 *point = shape_sphere(800, 1), *reversed = malloc(800 * sizeof *reversed);
    for (size_t i = 0; i < 800; i++) reversed[i] = point[799 - i];
    struct cloud a = cloud_of(point, 800), b = cloud_of(reversed, 800);
    struct pipeline_result forth = succeed(&a, "ratio 0.25"), back = succeed(&b, "ratio 0.25");
    for (size_t i = 0; i < 200; i++) assert_int_equal(forth.kept[i], 799 - back.kept[i]);
    pipeline_result_done(&forth), pipeline_result_done(&back);
    cloud_done(&a), cloud_done(&b);
}

/* ------------------------------------------------------------------------------------------------ degenerate */

static void tiny_clouds_pass_through_without_a_mesh(void **state) {
    (void)state;
    for (size_t n = 1; n <= 4; n++) {
        struct cloud cloud = cloud_of(shape_sphere(n, 1), n);
        struct pipeline_result result = succeed(&cloud, "ratio 1");
        assert_int_equal(result.level[0].kept_count, n);
        pipeline_result_done(&result);
        cloud_done(&cloud);
    }
}

static void check_without_mesh(vec3 *point, size_t n, const char *params, const char *part) {
    struct cloud cloud = cloud_of(point, n);
    struct pipeline_result result = {0};
    struct error error = {0};
    assert_int_equal(run(&cloud, params, &result, &error), STATUS_DEGENERATE);
    if (!strstr(error.text, part)) print_error("'%s' lacks '%s'\n", error.text, part);
    assert_non_null(strstr(error.text, part));
    assert_null(result.kept);
    cloud_done(&cloud);
}

static void check_degenerate(vec3 *point, size_t n, const char *part) {
    check_without_mesh(point, n, "ratio 1 outputs mesh", part);
}

static void a_level_without_a_mesh_is_named(void **state) {
    (void)state;
    check_without_mesh(shape_sphere(100, 1), 100, "levels 0.5,0.02 outputs mesh", "level 0.02: a closed mesh needs");
}

static void what_has_no_volume_has_no_mesh(void **state) {
    (void)state;
    vec3 *line = malloc(50 * sizeof *line), *same = malloc(9 * sizeof *same);
    for (int i = 0; i < 50; i++) line[i] = (vec3){i, 2.0 * i, 0};
    for (int i = 0; i < 9; i++) same[i] = (vec3){1, 2, 3};
    check_degenerate(line, 50, "line");
    check_degenerate(same, 9, "distinct: 1");
    check_degenerate(shape_sphere(2, 1), 2, "4 distinct points");
    check_degenerate(shape_sphere(3, 1), 3, "4 distinct points");
    check_without_mesh(shape_height_field(12, height_plane), 144, "ratio 1 outputs mesh surface closed", "plane");
    struct cloud empty = cloud_of(malloc(1), 0);
    struct pipeline_result result = {0};
    assert_int_equal(run(&empty, "ratio 1", &result, NULL), STATUS_DEGENERATE);
    cloud_done(&empty);
}

static void flat_clouds_are_simplified_all_the_same(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_height_field(30, height_plane), 900);
    struct pipeline_result result = succeed(&cloud, "ratio 0.1");
    assert_int_equal(result.level[0].kept_count, 90);
    assert_true(result.report.level[0].tangent.max < 1e-9);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

static void duplicates_count_as_points_but_are_kept_once(void **state) {
    (void)state;
    vec3 *sphere = shape_sphere(400, 1), *point = malloc(1200 * sizeof *point);
    for (size_t i = 0; i < 1200; i++) point[i] = sphere[i % 400];
    free(sphere);
    struct cloud cloud = cloud_of(point, 1200);
    struct pipeline_result result = succeed(&cloud, "ratio 0.25 outputs mesh,dso");
    assert_int_equal(result.report.points_in, 1200);
    assert_int_equal(result.report.points_distinct, 400);
    assert_int_equal(result.level[0].kept_count, 300);
    for (size_t i = 0; i < 300; i++) assert_true(result.kept[i] < 400);
    for (size_t i = 0; i < 400; i++) assert_true(result.dso[i] == result.dso[i + 800]);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ warnings */

static bool warns(const struct report *report, const char *part) {
    for (size_t i = 0; i < report->left_out.count; i++)
        if (strstr(report->left_out.loss[i].what, part)) return true;
    return false;
}

static struct cloud cloud_with_faces(vec3 *point, size_t n, size_t faces) {
    struct cloud cloud = cloud_of(point, n);
    cloud.triangle_count = faces;
    cloud.triangle = malloc(faces * sizeof *cloud.triangle);
    return cloud;
}

static void set_face(struct cloud *cloud, size_t t, uint32_t a, uint32_t b, uint32_t c) {
    memcpy(cloud->triangle[t], (uint32_t[3]){a, b, c}, sizeof *cloud->triangle);
}

static void faces_that_are_no_surface_are_told(void **state) {
    (void)state;
    struct cloud cloud = cloud_with_faces(shape_sphere(300, 1), 300, 6);
    set_face(&cloud, 0, 1, 2, 3), set_face(&cloud, 1, 4, 4, 4), set_face(&cloud, 2, 3, 1, 2);
    set_face(&cloud, 3, 5, 5, 6), set_face(&cloud, 4, 7, 8, 9), set_face(&cloud, 5, 3, 2, 1);
    struct pipeline_result result = succeed(&cloud, "ratio 0.3 outputs mesh");
    assert_true(warns(&result.report, "2 faces without area are no part of the surface"));
    assert_true(warns(&result.report, "2 faces are there already, and count once"));
    assert_string_equal(result.report.level[0].reference, "faces");
    assert_true(result.report.level[0].surface_to_mesh.count > 0);
    set_face(&cloud, 1, 7, 8, 9), cloud.triangle_count = 2; /* the same without those that don't count */
    struct pipeline_result bare = succeed(&cloud, "ratio 0.3 outputs mesh");
    assert_int_equal(bare.report.left_out.count + 2, result.report.left_out.count);
    assert_memory_equal(&bare.report.level[0].surface_to_mesh, &result.report.level[0].surface_to_mesh,
                        sizeof bare.report.level[0].surface_to_mesh);
    pipeline_result_done(&bare);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

static void faces_without_any_area_are_no_reference(void **state) {
    (void)state;
    struct cloud cloud = cloud_with_faces(shape_sphere(300, 1), 300, 2);
    set_face(&cloud, 0, 1, 1, 3), set_face(&cloud, 1, 4, 4, 4);
    struct pipeline_result result = succeed(&cloud, "ratio 0.3 outputs mesh");
    assert_string_equal(result.report.level[0].reference, "points");
    assert_true(warns(&result.report, "no face of the input has an area: errors are measured against its points"));
    pipeline_result_done(&result);
    struct error error = {0};
    assert_int_equal(run(&cloud, "ratio 0.3 outputs mesh reference faces", &result, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.text, "no face of the input has an area: take reference=points");
    cloud_done(&cloud);
}

/* Each from one side of a ball to the other: all of them are as near to its middle. */
static void faces_that_lie_all_across_are_no_reference(void **state) {
    (void)state;
    enum { N = 6000 };
    struct cloud cloud = cloud_with_faces(shape_sphere(N, 1), N, N);
    for (uint32_t t = 0; t < N; t++) set_face(&cloud, t, t, (t + N / 2) % N, (t + N / 3) % N);
    struct pipeline_result result = succeed(&cloud, "ratio 0.1 outputs mesh");
    assert_string_equal(result.report.level[0].reference, "points");
    assert_int_equal(result.report.level[0].surface_to_mesh.count, 0);
    assert_true(warns(&result.report, "faces are equally near"));
    assert_true(warns(&result.report, "errors are measured against its points"));
    pipeline_result_done(&result);
    struct error error = {0};
    assert_int_equal(run(&cloud, "ratio 0.1 outputs mesh reference faces", &result, &error), STATUS_BAD_PARAMETER);
    assert_non_null(strstr(error.text, "take reference=points"));
    cloud_done(&cloud);
}

/* The surface alone is what a whole run says of it; of points on a line nothing is said. */
static void the_surface_can_be_asked_for_alone(void **state) {
    (void)state;
    enum { N = 3600, SIDE = 60 };
    vec3 *hill = malloc(N * sizeof *hill), *line = malloc(N * sizeof *line);
    for (int i = 0; i < N; i++) {
        hill[i] = (vec3){i % SIDE, i / SIDE, 3 * sin(i % SIDE / 9.0)};
        line[i] = (vec3){i, 0, 0};
    }
    struct cloud clouds[3] = {cloud_of(shape_sphere(N, 7), N), cloud_of(hill, N), cloud_of(line, N)};
    static const char *const kinds[2] = {"closed", "heightfield"};
    struct report report = {.surface.kind = "some"};
    struct params params;
    struct error error;
    params_defaults(&params);
    params.outputs = OUTPUT_MESH;
    params.points = N / 2;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    assert_int_equal(pipeline_find_surface(&clouds[2], &params, &report, &error), STATUS_DEGENERATE);
    assert_string_equal(report.surface.kind, "");
    assert_int_equal(report.points_distinct, N);
    for (int i = 0; i < 2; i++) {
        struct pipeline_result result = {0};
        assert_int_equal(pipeline_run(&clouds[i], &params, NULL, &result, &error), STATUS_OK);
        assert_int_equal(pipeline_find_surface(&clouds[i], &params, &report, &error), STATUS_OK);
        assert_string_equal(report.surface.kind, kinds[i]);
        assert_string_equal(report.surface.reason, result.report.surface.reason);
        assert_string_equal(report.surface.orientation, result.report.surface.orientation);
        assert_true(report.noise_level == result.report.noise_level);
        pipeline_result_done(&result);
    }
    for (int i = 0; i < 3; i++) cloud_done(&clouds[i]);
}

static void strays_are_told(void **state) {
    (void)state;
    const double far[] = {1e5, 1e12, 1e100};
    for (size_t i = 0; i < sizeof far / sizeof *far; i++) {
        vec3 *point = shape_sphere(1000, 1);
        point[10] = point[700] = (vec3){far[i], 0, 0};
        struct cloud cloud = cloud_of(point, 1000);
        struct pipeline_result result = succeed(&cloud, "ratio 0.3");
        assert_true(warns(&result.report, "2 points lie hundreds of times as far off"));
        pipeline_result_done(&result);
        result = succeed(&cloud, "ratio 0.3 denoise outliers");
        assert_int_equal(result.report.left_out.count, 0);
        pipeline_result_done(&result);
        cloud_done(&cloud);
    }
    vec3 *point = shape_sphere(1000, 1);
    point[3] = (vec3){1e5, 0, 0};
    struct cloud stray = cloud_of(point, 1000);
    struct pipeline_result told = succeed(&stray, "ratio 0.3");
    assert_true(warns(&told.report, "1 point lies hundreds of times as far off"));
    pipeline_result_done(&told);
    told = succeed(&stray, "ratio 0.3 outputs mesh"); /* of which it is dropped */
    assert_int_equal(told.report.points_outliers, 1);
    assert_false(warns(&told.report, "hundreds of times"));
    pipeline_result_done(&told);
    cloud_done(&stray);
    struct cloud cloud = cloud_of(shape_sphere(1000, 1), 1000);
    cloud.position[3] = (vec3){100, 0, 0};
    struct pipeline_result result = succeed(&cloud, "ratio 0.3");
    assert_int_equal(result.report.left_out.count, 0);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ creases */

/* Anywhere on the faces of a unit cube, and none on its edges. */
static vec3 *random_cube(size_t n) {
    vec3 *point = alloc_array(n, sizeof *point);
    uint64_t seed = 5;
    for (size_t i = 0; i < n; i++) {
        double x = random_unit(&seed), y = random_unit(&seed), z = (double)(i % 2);
        point[i] = i % 6 < 2 ? (vec3){x, y, z} : i % 6 < 4 ? (vec3){y, z, x} : (vec3){z, x, y};
    }
    return point;
}

/* Leaves the points that are no nearer than that to one before; *n becomes how many. */
static vec3 *spaced(vec3 *point, size_t *n, double apart) {
    size_t left = 0;
    for (size_t i = 0; i < *n; i++) {
        size_t k = 0;
        while (k < left && vec3_distance(point[k], point[i]) > apart) k++;
        if (k == left) point[left++] = point[i];
    }
    *n = left;
    return point;
}

static void check_that_edges_are_found(vec3 *point, size_t n) {
    struct cloud cloud = cloud_of(point, n);
    struct pipeline_result subset = succeed(&cloud, "ratio 0.1 outputs mesh surface closed placement subset");
    struct pipeline_result optimal = succeed(&cloud, "ratio 0.1 outputs mesh surface closed placement optimal");
    assert_true(subset.report.level[0].volume < 0.997);
    assert_true(fabs(optimal.report.level[0].volume - 1) < 0.0012);
    pipeline_result_done(&subset), pipeline_result_done(&optimal);
    cloud_done(&cloud);
}

static void free_vertices_find_edges_that_no_point_is_on(void **state) {
    (void)state;
    size_t n = 30000;
    check_that_edges_are_found(random_cube(1500), 1500);
    vec3 *even = spaced(random_cube(n), &n, 0.05);
    check_that_edges_are_found(even, n);
}

/* Of a ball of radius 1 with a wall this thick, anywhere on either side. */
static vec3 *random_shell(size_t n, double thickness) {
    vec3 *point = alloc_array(n, sizeof *point);
    uint64_t seed = 6;
    for (size_t i = 0; i < n; i++) {
        double z = 2 * random_unit(&seed) - 1, angle = 2 * M_PI * random_unit(&seed), flat = sqrt(1 - z * z);
        double radius = i % 2 ? 1 : 1 - thickness;
        point[i] = vec3_scale((vec3){flat * cos(angle), flat * sin(angle), z}, radius);
    }
    return point;
}

/* Points of both sides are as near to each other as those of one, so that hardly a normal is right. */
static void thin_walls_of_points_at_random_stay(void **state) {
    (void)state;
    static const double THICKNESS = 0.1;
    struct cloud cloud = cloud_of(random_shell(5000, THICKNESS), 5000);
    struct pipeline_result result = succeed(&cloud, "ratio 0.05 outputs mesh surface closed placement subset");
    double inner = 1 - THICKNESS, volume = 4 * M_PI / 3 * (1 - inner * inner * inner);
    assert_true(fabs(result.report.level[0].volume / volume - 1) < 0.1);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* Anywhere on a tray without a lid, 1.3 by 1 by .5 with walls of .04, evenly in the mean. */
static vec3 *random_tray(size_t n) {
    static const double LOW[2][3] = {{0, 0, 0}, {0.04, 0.04, 0.04}}, HIGH[2][3] = {{1.3, 1, 0.5}, {1.26, 0.96, 0.5}};
    static const double FARTHEST = 1.3;
    vec3 *point = alloc_array(n, sizeof *point);
    uint64_t seed = 7;
    for (size_t i = 0; i < n;) {
        size_t inner = random_next(&seed) % 2, axis = random_next(&seed) % 3, end = random_next(&seed) % 2;
        double at[3];
        bool on = true, above_hollow = true;
        for (size_t k = 0; k < 3; k++) {
            at[k] = k == axis ? (end ? HIGH : LOW)[inner][k] : FARTHEST * random_unit(&seed);
            on = on && at[k] >= LOW[inner][k] && at[k] <= HIGH[inner][k];
            above_hollow = above_hollow && (k == 2 || (at[k] > LOW[1][k] && at[k] < HIGH[1][k]));
        }
        bool lid = axis == 2 && end;
        if (on && !(lid && (above_hollow || inner))) point[i++] = (vec3){at[0], at[1], at[2]};
    }
    return point;
}

/* All of the inner side is lost with so few points, so that no edge runs to it, but half of the points are far off. */
static void a_wall_of_which_nothing_is_left_is_found(void **state) {
    (void)state;
    static const char *const settings[] = {"ratio 0.03 outputs mesh surface closed placement subset",
                                           "ratio 0.02 outputs mesh surface closed placement subset"};
    static const double VOLUME = 1.3 * 1 * 0.5 - 1.22 * 0.92 * 0.46;
    size_t n = 40000;
    vec3 *even = spaced(random_tray(n), &n, 0.036);
    struct cloud cloud = cloud_of(even, n);
    for (int i = 0; i < 2; i++) {
        struct pipeline_result result = succeed(&cloud, settings[i]);
        assert_true(fabs(result.report.level[0].volume / VOLUME - 1) < 0.05);
        pipeline_result_done(&result);
    }
    cloud_done(&cloud);
}

enum { FINS = 7, BOXES = FINS + 1 };

/* Of a plate of 1.2 by 1 by .12 with fins of .04 on it up to .6: lowest and highest corners. */
static void make_boxes(double box[BOXES][2][3]) {
    static const double PLATE[2][3] = {{0, 0, 0}, {1.2, 1, 0.12}};
    memcpy(box[FINS], PLATE, sizeof PLATE);
    for (int i = 0; i < FINS; i++) {
        const double fin[2][3] = {{0.05 + 0.18 * i, 0.01, 0.1}, {0.09 + 0.18 * i, 0.99, 0.6}};
        memcpy(box[i], fin, sizeof fin);
    }
}

static bool is_in_a_box(double (*box)[2][3], const double at[3]) {
    bool in = false;
    for (int b = 0; b < BOXES; b++) {
        bool all = true;
        for (int k = 0; k < 3; k++) all = all && at[k] > box[b][0][k] && at[k] < box[b][1][k];
        in = in || all;
    }
    return in;
}

/* Anywhere on that, evenly in the mean. */
static vec3 *random_fins(size_t n) {
    static const double FARTHEST = 1.2;
    vec3 *point = alloc_array(n, sizeof *point);
    double box[BOXES][2][3];
    uint64_t seed = 8;
    make_boxes(box);
    for (size_t i = 0; i < n;) {
        size_t b = random_next(&seed) % BOXES, axis = random_next(&seed) % 3, end = random_next(&seed) % 2;
        double at[3];
        bool on = true;
        for (size_t k = 0; k < 3; k++) {
            at[k] = k == axis ? box[b][end][k] : FARTHEST * random_unit(&seed);
            on = on && at[k] >= box[b][0][k] && at[k] <= box[b][1][k];
        }
        if (on && !is_in_a_box(box, at)) point[i++] = (vec3){at[0], at[1], at[2]};
    }
    return point;
}

/* With each surface of more points the mesh is nearer, but only that of eight times the kept ones has all of the fins.
 */
static void fins_of_points_at_random_stay(void **state) {
    (void)state;
    static const double VOLUME = 1.2 * 0.12 + FINS * 0.04 * 0.98 * 0.48;
    struct cloud cloud = cloud_of(random_fins(6000), 6000);
    struct pipeline_result result = succeed(&cloud, "ratio 0.05 outputs mesh surface closed placement subset");
    assert_true(fabs(result.report.level[0].volume / VOLUME - 1) < 0.1);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* A bracket: a plate of 1 by .6 by .1 with a bore, and one that stands on its end. */
static const double PLATES[2][2][3] = {{{0, 0, 0}, {1, 0.6, 0.1}}, {{0, 0.001, 0.05}, {0.1, 0.599, 0.8}}};
static const double BORE = 0.15, BORE_X = 0.6, BORE_Y = 0.3;

/* How far inside of a plate a place is; below 0: outside. */
static double depth_in_plate(int plate, vec3 at) {
    const double place[3] = {at.x, at.y, at.z};
    double depth = INFINITY;
    for (int k = 0; k < 3; k++)
        depth = fmin(depth, fmin(place[k] - PLATES[plate][0][k], PLATES[plate][1][k] - place[k]));
    return depth;
}

static double out_of_bore(vec3 at) { return hypot(at.x - BORE_X, at.y - BORE_Y) - BORE; }

static vec3 *random_bracket(size_t n) {
    static const double WALL = 2 * 0.0157 / 3; /* share of the points that are on the bore's */
    vec3 *point = alloc_array(n, sizeof *point);
    uint64_t seed = 100;
    for (size_t i = 0; i < n;) {
        if (random_unit(&seed) < WALL) {
            double angle = 2 * M_PI * random_unit(&seed), z = 0.1 * random_unit(&seed);
            point[i++] = (vec3){BORE_X + BORE * cos(angle), BORE_Y + BORE * sin(angle), z};
            continue;
        }
        int plate = (int)(random_next(&seed) % 2);
        size_t axis = random_next(&seed) % 3, end = random_next(&seed) % 2;
        double at[3];
        for (size_t k = 0; k < 3; k++) at[k] = k == axis ? PLATES[plate][end][k] : random_unit(&seed);
        vec3 place = {at[0], at[1], at[2]};
        if (depth_in_plate(plate, place) >= 0 && depth_in_plate(1 - plate, place) <= 0 && out_of_bore(place) >= 0)
            point[i++] = place;
    }
    return point;
}

/* The mesh of twice as many points is nearer to all of them, but one of its triangles goes through the plate. */
static void a_mesh_with_spikes_is_not_taken_for_being_nearer(void **state) {
    (void)state;
    static const double DEEP = 0.03;
    struct cloud cloud = cloud_of(random_bracket(1500), 1500);
    struct pipeline_result result = succeed(&cloud, "ratio 0.5 outputs mesh surface closed placement subset");
    const struct mesh *mesh = &result.level[0].mesh;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 middle = {0};
        for (int k = 0; k < 3; k++) middle = vec3_add(middle, vec3_scale(mesh->vertex[mesh->triangle[t][k]], 1.0 / 3));
        double depth = fmax(depth_in_plate(0, middle), depth_in_plate(1, middle));
        assert_true(fmin(depth, out_of_bore(middle)) < DEEP);
    }
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* Two thin rings that lean the same way and pass through each other. */
static const double RING = 0.25, RING_THICK = 0.032, RING_APART = 0.42, RING_LEANS = 0.5;

/* From the surface of a ring; below 0: inside. */
static double out_of_ring(int ring, vec3 at) {
    double x = at.x - RING_APART * ring, c = cos(RING_LEANS), s = sin(RING_LEANS);
    return hypot(hypot(x, c * at.y + s * at.z) - RING, c * at.z - s * at.y) - RING_THICK;
}

static vec3 *random_rings(size_t n, uint64_t seed) {
    vec3 *point = alloc_array(n, sizeof *point);
    for (size_t i = 0; i < n;) {
        int ring = (int)(random_next(&seed) % 2);
        double around = 2 * M_PI * random_unit(&seed), across = 2 * M_PI * random_unit(&seed);
        double radius = RING + RING_THICK * cos(across), height = RING_THICK * sin(across);
        if (random_unit(&seed) > radius / (RING + RING_THICK)) continue;
        double c = cos(RING_LEANS), s = sin(RING_LEANS), y = radius * sin(around);
        vec3 at = {RING_APART * ring + radius * cos(around), c * y - s * height, s * y + c * height};
        if (out_of_ring(1 - ring, at) >= 0) point[i++] = at;
    }
    return point;
}

/* Where triangles crossed a vertex was put at a place where faces meet, and came out at some point instead. */
static void vertices_where_faces_meet_are_no_points(void **state) {
    (void)state;
    enum { N = 2000 };
    static const double FAR = 0.02;
    static const uint64_t SEEDS[] = {73, 82, 118};
    for (size_t i = 0; i < sizeof SEEDS / sizeof *SEEDS; i++) {
        struct cloud cloud = cloud_of(random_rings(N, SEEDS[i]), N);
        struct pipeline_result result = succeed(&cloud, "ratio 0.1 outputs mesh surface closed placement optimal");
        const struct mesh *mesh = &result.level[0].mesh;
        for (size_t v = 0; v < mesh->vertex_count; v++) {
            vec3 at = mesh->vertex[v];
            assert_true(mesh->source[v] == NONE || mesh->source[v] < N);
            assert_true(fmin(out_of_ring(0, at), out_of_ring(1, at)) < FAR);
        }
        for (size_t t = 0; t < mesh->triangle_count; t++) {
            vec3 sum = {0};
            for (int k = 0; k < 3; k++) sum = vec3_add(sum, mesh->vertex[mesh->triangle[t][k]]);
            vec3 middle = vec3_scale(sum, 1.0 / 3);
            assert_true(fmin(out_of_ring(0, middle), out_of_ring(1, middle)) < FAR);
        }
        pipeline_result_done(&result);
        cloud_done(&cloud);
    }
}

/* The mesh of the few points that are kept has but one side of the walls, and nothing where the other one was. */
static void thin_walls_are_not_taken_for_an_open_surface(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(random_tray(8000), 8000);
    struct pipeline_result result = succeed(&cloud, "ratio 0.05 outputs mesh");
    assert_string_equal(result.report.surface.kind, "closed");
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* On six rings around three quarters of a pipe, anywhere on each. */
static vec3 *rings(size_t n) {
    enum { RINGS = 6 };
    vec3 *point = alloc_array(n, sizeof *point);
    uint64_t seed = 8;
    for (size_t i = 0; i < n; i++) {
        double angle = 1.5 * M_PI * random_unit(&seed);
        point[i] = (vec3){cos(angle), sin(angle), (double)(i * RINGS / n) / (RINGS - 1)};
    }
    return point;
}

/* More tetrahedra than there is memory for: of more points there is no mesh, but there is one of those that are kept,
 * which wasn't made at first. */
static void kept_points_have_a_mesh_where_there_is_no_other(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(rings(20000), 20000);
    struct pipeline_result result = {0};
    struct params params;
    params_defaults(&params);
    assert_int_equal(params_set(&params, "ratio", "0.2", NULL), STATUS_OK);
    assert_int_equal(params_set(&params, "outputs", "mesh", NULL), STATUS_OK);
    assert_int_equal(params_set(&params, "surface", "open", NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    params.memory_bytes = (uint64_t)30 << 20;
    assert_int_equal(pipeline_run(&cloud, &params, NULL, &result, NULL), STATUS_OK);
    assert_true(result.level[0].mesh.triangle_count > 5000);
    assert_int_equal(result.report.level[0].reconstructed_from, 4000);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* How often a triangulation began that got far enough to tell of it; those of few points don't. */
struct begun {
    int count;
    double last;
};

static int count_begun(void *ctx, const char *stage, double fraction) {
    struct begun *begun = ctx;
    if (strcmp(stage, "delaunay") != 0) return 0;
    begun->count += fraction < begun->last;
    begun->last = fraction;
    return 0;
}

/* Four times as many points as are kept have too many tetrahedra, which is found out once. */
static void a_surface_of_more_points_is_not_tried_twice(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(rings(20000), 20000);
    struct pipeline_result result = {0};
    struct params params;
    struct begun begun = {0, INFINITY};
    const struct progress progress = {count_begun, &begun};
    params_defaults(&params);
    assert_int_equal(params_set(&params, "ratio", "0.05", NULL), STATUS_OK);
    params.outputs = OUTPUT_MESH, params.surface = SURFACE_OPEN;
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    params.memory_bytes = (uint64_t)24 << 20;
    assert_int_equal(pipeline_run(&cloud, &params, &progress, &result, NULL), STATUS_OK);
    assert_int_equal(begun.count, 1);
    assert_int_equal(result.report.level[0].reconstructed_from, 1000);
    pipeline_result_done(&result);
    cloud_done(&cloud);
}

/* Each seventeenth of its allocations. */
static void finding_edges_may_fail(void **state) {
    (void)state;
    enum { STEP = 17 };
    struct cloud cloud = cloud_of(random_cube(300), 300);
    bool happened = true;
    int nth = 0;
    for (; happened; nth += STEP) {
        struct pipeline_result result = {0};
        struct error error = {0};
        faults_in_memory(nth + 1, false);
        enum status status =
            run(&cloud, "ratio 0.2 outputs mesh surface closed placement optimal threads 1", &result, &error);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        pipeline_result_done(&result);
    }
    assert_true(nth > 50);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ stopping */

static int stop_at(void *ctx, const char *stage, double fraction) {
    assert_true(fraction >= 0 && fraction <= 1);
    return strcmp(stage, ctx) == 0;
}

static void every_stage_can_be_cancelled(void **state) {
    (void)state;
    static const char *const stages[] = {"order", "neighbours", "normals",     "dso",     "quadrics", "contract",
                                         "keep",  "delaunay",   "reconstruct", "measure", "examine",  "distances"};
    struct cloud cloud = cloud_of(shape_sphere(3000, 1), 3000);
    struct params params;
    params_defaults(&params);
    params.outputs = OUTPUT_MESH | OUTPUT_ERROR;
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    for (size_t i = 0; i < sizeof stages / sizeof stages[0]; i++) {
        struct progress progress = {stop_at, (void *)(uintptr_t)stages[i]};
        struct pipeline_result result = {0};
        struct error error = {0};
        assert_int_equal(pipeline_run(&cloud, &params, &progress, &result, &error), STATUS_CANCELLED);
        assert_null(result.kept);
    }
    cloud_done(&cloud);
}

/* Where a mesh of all points has its edges flipped, before any of it is known to be taken. */
static void flips_of_all_points_can_be_cancelled(void **state) {
    (void)state;
    size_t n;
    vec3 *point = shape_cube(20, 0.2, &n);
    struct cloud cloud = cloud_of(point, n);
    struct params params;
    params_defaults(&params);
    params.outputs = OUTPUT_MESH, params.placement = PLACEMENT_OPTIMAL, params.surface = SURFACE_CLOSED;
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    char stage[] = "flips";
    struct progress progress = {stop_at, stage};
    struct pipeline_result result = {0};
    struct error error = {0};
    assert_int_equal(pipeline_run(&cloud, &params, &progress, &result, &error), STATUS_CANCELLED);
    assert_null(result.kept);
    cloud_done(&cloud);
}

static void every_allocation_may_fail(void **state) {
    (void)state;
    struct cloud cloud = cloud_of(shape_sphere(300, 1), 300);
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        struct pipeline_result result = {0};
        struct error error = {0};
        faults_in_memory(nth + 1, false);
        enum status status = run(&cloud, "ratio 0.3 outputs mesh,dso,error threads 1", &result, &error);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened == (error.text[0] != 0));
        pipeline_result_done(&result);
    }
    assert_true(nth > 50);
    cloud_done(&cloud);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(goals_are_met_exactly),
        cmocka_unit_test(kept_points_are_distinct_and_of_the_input),
        cmocka_unit_test(any_prefix_is_the_smaller_cloud),
        cmocka_unit_test(a_level_s_mesh_is_that_of_its_own_job),
        cmocka_unit_test(threads_do_not_change_a_bit),
        cmocka_unit_test(the_input_s_order_does_not_matter),
        cmocka_unit_test(tiny_clouds_pass_through_without_a_mesh),
        cmocka_unit_test(what_has_no_volume_has_no_mesh),
        cmocka_unit_test(a_level_without_a_mesh_is_named),
        cmocka_unit_test(flat_clouds_are_simplified_all_the_same),
        cmocka_unit_test(duplicates_count_as_points_but_are_kept_once),
        cmocka_unit_test(faces_that_are_no_surface_are_told),
        cmocka_unit_test(faces_without_any_area_are_no_reference),
        cmocka_unit_test(faces_that_lie_all_across_are_no_reference),
        cmocka_unit_test(the_surface_can_be_asked_for_alone),
        cmocka_unit_test(strays_are_told),
        cmocka_unit_test(free_vertices_find_edges_that_no_point_is_on),
        cmocka_unit_test(thin_walls_of_points_at_random_stay),
        cmocka_unit_test(a_wall_of_which_nothing_is_left_is_found),
        cmocka_unit_test(a_mesh_with_spikes_is_not_taken_for_being_nearer),
        cmocka_unit_test(fins_of_points_at_random_stay),
        cmocka_unit_test(vertices_where_faces_meet_are_no_points),
        cmocka_unit_test(thin_walls_are_not_taken_for_an_open_surface),
        cmocka_unit_test(kept_points_have_a_mesh_where_there_is_no_other),
        cmocka_unit_test(a_surface_of_more_points_is_not_tried_twice),
        cmocka_unit_test(finding_edges_may_fail),
        cmocka_unit_test(every_stage_can_be_cancelled),
        cmocka_unit_test(flips_of_all_points_can_be_cancelled),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
