/* Attributes of vertices, edges of attributes as features, holes of sheets.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/read.h"
#include "core/pipeline/attributes.h"
#include "core/pipeline/pipeline.h"
#include "core/surface/sheet/holes.h"
#include "tests/unit/faults.h"
#include "tests/unit/property.h"
#include "tests/unit/shapes.h"

enum { SIDE = 60 };

/* ------------------------------------------------------------------------------------------------ attributes */

/* Points of a line at 0, 1 .. 9, of types that are averaged and others. */
static struct cloud make_line(void) {
    char text[1200];
    size_t used = (size_t)snprintf(
        text, sizeof text,
        "ply\nformat ascii 1.0\nelement vertex 10\nproperty short y\nproperty uchar red\nproperty list uchar int a\n"
        "property short x\nproperty short z\nproperty uchar class\nproperty float heat\nproperty float nx\n"
        "property float ny\nproperty float nz\nend_header\n");
    for (int i = 0; i < 10; i++)
        used += (size_t)snprintf(text + used, sizeof text - used, "0 %d 1 7 %d 0 %d %s %d %d 0\n", 10 * i, i, i % 4,
                                 i == 3  ? "nan"
                                 : i % 2 ? "1"
                                         : "2",
                                 i % 2, (i + 1) % 2);
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(text, used, NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

static void a_moved_vertex_has_what_the_nearest_point_has(void **state) {
    (void)state;
    struct cloud cloud = make_line(), out = {0};
    const vec3 place[] = {{2.4, 0, 0}, {7, 0, 0}, {5.1, 0.25, 0}};
    const uint32_t source[] = {NONE, 7, 1 /* not the nearest: it is known to stand for this one */};
    assert_int_equal(attributes_at(&cloud, place, source, 3, false, 1, &out, NULL), STATUS_OK);
    static const double red[] = {20, 70, 10}, class[] = {2, 3, 1};
    for (size_t i = 0; i < 3; i++) {
        assert_true(property_value(&out, i, "red") == red[i] && property_value(&out, i, "class") == class[i]);
        assert_true(property_value(&out, i, "x") == place[i].x && property_value(&out, i, "y") == place[i].y);
        assert_true(vec3_equal(out.position[i], place[i]));
    }
    assert_int_equal(out.property_count, cloud.property_count);
    cloud_done(&out);
    cloud_done(&cloud);
}

static void means_are_of_the_points_around(void **state) {
    (void)state;
    struct cloud cloud = make_line(), out = {0};
    const vec3 place[] = {{1.2, 0, 0}, {6.1, 0, 0}, {400, 0, 0}}; /* 0 .. 3, 4 .. 9, and nobody's */
    assert_int_equal(attributes_at(&cloud, place, NULL, 3, true, 1, &out, NULL), STATUS_OK);
    assert_true(property_value(&out, 0, "red") == 15 && property_value(&out, 1, "red") == 65 &&
                property_value(&out, 2, "red") == 90);
    assert_true(property_value(&out, 0, "class") == 1 && property_value(&out, 1, "class") == 2);
    assert_true(fabs(property_value(&out, 0, "heat") - 5.0 / 3) < 1e-6); /* without nan */
    assert_true(property_value(&out, 1, "heat") == 1.5 && property_value(&out, 2, "heat") == 1);
    for (size_t i = 0; i < 2; i++) { /* half of them along x, half along y */
        assert_true(fabs(property_value(&out, i, "nx") - sqrt(0.5)) < 1e-6);
        assert_true(fabs(property_value(&out, i, "ny") - sqrt(0.5)) < 1e-6);
    }
    assert_true(property_value(&out, 0, "x") == 1.2);
    cloud_done(&out);
    cloud_done(&cloud);
}

/* ------------------------------------------------------------------------------------------------ weights */

/* A plane somewhat off a grid, light inside of a circle, dark outside, and with a ramp of heat. */
static struct cloud make_disc(void) {
    char *text = NULL;
    size_t bytes;
    uint64_t seed = 11;
    FILE *out = open_memstream(&text, &bytes);
    fprintf(out, "x y z intensity heat\n");
    for (int i = 0; i < SIDE * SIDE; i++) {
        double x = (i % SIDE + 0.6 * random_unit(&seed)) / SIDE, y = (i / SIDE + 0.6 * random_unit(&seed)) / SIDE;
        fprintf(out, "%.6f %.6f 0 %d %.6f\n", x, y, hypot(x - 0.5, y - 0.5) < 0.3 ? 200 : 20, x);
    }
    fclose(out);
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(text, bytes, NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    free(text);
    return cloud;
}

static struct pipeline_result simplify(const struct cloud *cloud, const char *weights) {
    struct params params;
    struct pipeline_result result = {0};
    struct error error = {0};
    params_defaults(&params);
    assert_int_equal(params_set(&params, "ratio", "0.1", NULL), STATUS_OK);
    if (weights) assert_int_equal(params_set(&params, "weights", weights, NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    if (pipeline_run(cloud, &params, NULL, &result, &error)) fail_msg("%s", error.text);
    return result;
}

/* Share of the points whose colour the nearest kept one doesn't have. */
static double wrong_share(const struct cloud *cloud, const struct pipeline_result *result) {
    size_t wrong = 0;
    for (size_t i = 0; i < cloud->count; i++) {
        double least = INFINITY;
        uint32_t nearest = 0;
        for (size_t k = 0; k < result->level[0].kept_count; k++) {
            double d = vec3_distance_sq(cloud->position[i], cloud->position[result->kept[k]]);
            if (d < least) least = d, nearest = result->kept[k];
        }
        wrong += property_value(cloud, i, "intensity") != property_value(cloud, nearest, "intensity");
    }
    return (double)wrong / (double)cloud->count;
}

static void edges_of_attributes_are_features(void **state) {
    (void)state;
    struct cloud cloud = make_disc();
    struct pipeline_result plain = simplify(&cloud, NULL), weighted = simplify(&cloud, "intensity:0.5");
    struct pipeline_result ramp = simplify(&cloud, "heat:0.5");
    double before = wrong_share(&cloud, &plain), after = wrong_share(&cloud, &weighted);
    if (!(after < 0.75 * before)) fail_msg("%g of the points have another colour, %g without weights", after, before);
    size_t same = 0, n = plain.level[0].kept_count; /* a ramp is no edge: hardly anything changes */
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < n; k++) same += plain.kept[i] == ramp.kept[k];
    assert_true(same > n / 2);
    pipeline_result_done(&plain), pipeline_result_done(&weighted), pipeline_result_done(&ramp);
    struct params params;
    struct error error = {0};
    params_defaults(&params);
    assert_int_equal(params_set(&params, "weights", "rgb:1", NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    assert_int_equal(pipeline_run(&cloud, &params, NULL, &plain, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "weights");
    assert_non_null(strstr(error.text, "no property 'red'; it has x, y, z, intensity, heat"));
    cloud_done(&cloud);
}

static void lists_that_are_none_are_refused(void **state) {
    (void)state;
    static const char *const bad[] = {"",      "rgb",    "rgb:",        "rgb:0",  "rgb:-1",  "rgb:101", ":1",
                                      "rgb:x", "rgb:1,", "rgb:1,rgb:2", "r gb:1", "rgb:1:2", "rgb:1 "};
    static const char *const good[] = {"rgb:1", "rgb:0.2,intensity:0.1", "a:1e-3,b:100"};
    struct params params;
    char text[PARAMS_TEXT_BYTES];
    params_defaults(&params);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        if (!params_set(&params, "weights", bad[i], NULL)) fail_msg("%s", bad[i]);
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        assert_int_equal(params_set(&params, "weights", good[i], NULL), STATUS_OK);
        params_format(&params, params_find("weights"), text, sizeof text);
        assert_string_equal(text, good[i]);
    }
}

/* ------------------------------------------------------------------------------------------------ holes */

/* A grid of unit squares in two triangles each, less those that out says; folded into a tube where it is round. */
static struct mesh make_grid(int columns, int rows, bool round, bool (*out)(int i, int j)) {
    struct mesh mesh = {.vertex = calloc((size_t)((columns + 1) * (rows + 1)), sizeof *mesh.vertex),
                        .triangle = calloc((size_t)(2 * columns * rows), sizeof *mesh.triangle)};
    int wide = round ? columns : columns + 1;
    mesh.vertex_count = (size_t)(wide * (rows + 1));
    for (int i = 0; i < wide; i++)
        for (int j = 0; j <= rows; j++) {
            double angle = 2 * M_PI * i / columns, radius = columns / (2 * M_PI);
            mesh.vertex[i + j * wide] =
                round ? (vec3){radius * cos(angle), radius * sin(angle), j} : (vec3){i, j, 0.1 * sin(i + j)};
        }
    for (int i = 0; i < columns; i++)
        for (int j = 0; j < rows; j++) {
            if (out(i, j)) continue;
            uint32_t a = (uint32_t)(i + j * wide), b = (uint32_t)((i + 1) % wide + j * wide);
            uint32_t c = b + (uint32_t)wide, d = a + (uint32_t)wide;
            const uint32_t two[2][3] = {{a, b, c}, {a, c, d}};
            memcpy(mesh.triangle[mesh.triangle_count], two, sizeof two);
            mesh.triangle_count += 2;
        }
    return mesh;
}

static bool none_out(int i, int j) { return i < 0 || j < 0; }
static bool two_out(int i, int j) { return (i == 2 && j == 2) || (i >= 5 && i < 8 && j >= 3 && j < 7); }

static struct mesh_facts examine(const struct mesh *mesh) {
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    assert_true(facts.manifold && facts.misoriented_edges == 0);
    return facts;
}

static size_t close_up_to(struct mesh *mesh, double longest) {
    size_t closed = 99;
    assert_int_equal(sheet_close_holes(mesh, longest, 1, &closed), STATUS_OK);
    return closed;
}

static void holes_are_closed_by_their_size(void **state) {
    (void)state;
    static const struct {
        double longest;
        size_t closed, borders, triangles;
    } cases[] = {{3.9, 0, 3, 0}, {4.2, 1, 2, 2}, {14.5, 2, 1, 14}, {1e9, 2, 1, 14} /* the outer one is no hole */};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct mesh mesh = make_grid(12, 10, false, two_out);
        size_t before = mesh.triangle_count;
        double area = examine(&mesh).area;
        assert_int_equal(close_up_to(&mesh, cases[i].longest), cases[i].closed);
        struct mesh_facts facts = examine(&mesh);
        assert_int_equal(facts.borders, cases[i].borders);
        assert_int_equal(mesh.triangle_count, before + cases[i].triangles);
        for (size_t t = 0; mesh.tag && t < mesh.triangle_count; t++)
            assert_int_equal(mesh.tag[t], t < before ? MESH_SUPPORTED : MESH_HOLE_FILL);
        if (cases[i].closed == 2) assert_true(fabs(facts.area - area - 13) < 0.3);
        mesh_done(&mesh);
    }
}

static void ends_of_a_tube_and_what_is_nearly_closed(void **state) {
    (void)state;
    struct mesh tube = make_grid(12, 40, true, none_out);
    assert_int_equal(close_up_to(&tube, 12.5), 2); /* long, so that its ends are small against it */
    assert_int_equal(examine(&tube).borders, 0);
    mesh_done(&tube);
    struct mesh ring = make_grid(12, 1, true, none_out);
    assert_int_equal(close_up_to(&ring, 12.5), 1); /* one of the two is where it ends */
    assert_int_equal(examine(&ring).borders, 1);
    mesh_done(&ring);
}

static void what_is_no_hole_stays_and_small_ends_close(void **state) {
    (void)state;
    /* The upper half of an octahedron: its border is where it ends. */
    static const vec3 vertex[] = {{1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}, {0, 0, 1}};
    static const uint32_t triangle[][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
    struct mesh mesh = {.vertex = calloc(5, sizeof(vec3)), .triangle = calloc(6, sizeof *triangle)};
    memcpy(mesh.vertex, vertex, sizeof vertex);
    memcpy(mesh.triangle, triangle, sizeof triangle);
    mesh.vertex_count = 5, mesh.triangle_count = 4;
    assert_int_equal(close_up_to(&mesh, 5), 0);
    assert_int_equal(close_up_to(&mesh, 6), 0);
    mesh_done(&mesh);
    mesh = make_grid(4, 12, true, none_out); /* a square tube, whose ends have two triangles each */
    assert_int_equal(close_up_to(&mesh, 4.1), 2);
    assert_int_equal(examine(&mesh).borders, 0);
    assert_int_equal(mesh.triangle_count, 2 * 4 * 12 + 4);
    assert_int_equal(close_up_to(&mesh, 4.1), 0);
    mesh_done(&mesh);
}

static void every_allocation_may_fail(void **state) {
    (void)state;
    const vec3 place[] = {{1.2, 0, 0}, {6.1, 0, 0}};
    bool happened = true;
    for (int nth = 1; happened; nth++) {
        struct cloud cloud = make_line(), out = {0};
        struct mesh mesh = make_grid(12, 10, false, two_out);
        size_t before = mesh.triangle_count, closed = 0;
        faults_in_memory(nth, false);
        enum status status = attributes_at(&cloud, place, NULL, 2, true, 1, &out, NULL);
        if (!status) status = sheet_close_holes(&mesh, 20, 1, &closed);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        if (happened) assert_int_equal(mesh.triangle_count, before);
        cloud_done(&out), cloud_done(&cloud), mesh_done(&mesh);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_moved_vertex_has_what_the_nearest_point_has),
        cmocka_unit_test(means_are_of_the_points_around),
        cmocka_unit_test(edges_of_attributes_are_features),
        cmocka_unit_test(lists_that_are_none_are_refused),
        cmocka_unit_test(holes_are_closed_by_their_size),
        cmocka_unit_test(ends_of_a_tube_and_what_is_nearly_closed),
        cmocka_unit_test(what_is_no_hole_stays_and_small_ends_close),
        cmocka_unit_test(every_allocation_may_fail),
    };
    return cmocka_run_group_tests_name("attributes", tests, NULL, NULL);
}
