/* Creases of roofs and corners whose points are beside them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/refine/sharpen.h"
#include "tests/unit/faults.h"

enum { SIDE = 30, POINTS = SIDE * SIDE, TRIANGLES = 2 * (SIDE - 1) * (SIDE - 1) };
static const double SHIFT = 0.45; /* of the grid, so that none of its points is on a crease */

typedef double height_of(double x, double y);

static double roof(double x, double y) {
    (void)y;
    return -fabs(x);
}

static double valley(double x, double y) {
    (void)y;
    return fabs(x);
}

/* Askew to the rows of the grid, so that points are as often far from it as near. */
static double skew_roof(double x, double y) { return -0.5 * fabs(x * cos(0.5) + y * sin(0.5)); }

/* Three faces that meet in the middle. */
static double summit(double x, double y) {
    static const double half = 0.5, sine = 0.8660254037844386;
    return -1.4 * fmax(x, fmax(-half * x + sine * y, -half * x - sine * y));
}

static double barrel(double x, double y) {
    (void)y;
    return sqrt(20.0 * 20 - x * x);
}

/* Fine as it is, every face turns: much coarser than the barrel. */
static double drum(double x, double y) {
    (void)y;
    return sqrt(fmax(0, 15.0 * 15 - x * x));
}

/* A ridge that is as round as its points are far apart. */
static double round_ridge(double x, double y) {
    double across = x * cos(0.3) + y * sin(0.3);
    return -2 * sqrt(across * across + 1);
}

static const double NOISE = 0.05;

static double rough_roof(double x, double y) {
    return skew_roof(x, y) + sqrt(2) * NOISE * sin(1e4 * x + 3e4 * y); /* its mean square is 1/2 */
}

/* Through points up to this far off a grid, which are on the surface. */
static struct mesh shaken_mesh_of(height_of *height, double shake) {
    struct mesh mesh = {POINTS,
                        alloc_array(POINTS, sizeof(vec3)),
                        alloc_array(POINTS, sizeof(uint32_t)),
                        TRIANGLES,
                        alloc_array(TRIANGLES, sizeof *mesh.triangle),
                        alloc_array(TRIANGLES, 1)};
    memset(mesh.tag, MESH_SUPPORTED, TRIANGLES);
    for (uint32_t v = 0, t = 0; v < POINTS; v++) {
        uint32_t column = v % SIDE, row = v / SIDE;
        double x = (double)column + SHIFT + shake * sin(7.0 * v) - SIDE / 2.0;
        double y = (double)row + SHIFT + shake * cos(5.0 * v) - SIDE / 2.0;
        mesh.vertex[v] = (vec3){x, y, height(x, y)};
        mesh.source[v] = POINTS - v;
        if (column + 1 == SIDE || row + 1 == SIDE) continue;
        memcpy(mesh.triangle[t++], (uint32_t[3]){v, v + 1, v + SIDE + 1}, sizeof *mesh.triangle);
        memcpy(mesh.triangle[t++], (uint32_t[3]){v, v + SIDE + 1, v + SIDE}, sizeof *mesh.triangle);
    }
    return mesh;
}

static struct mesh mesh_of(height_of *height) { return shaken_mesh_of(height, 0.25); }

/* How far the middles of the triangles are from the surface, up or down, at most; the border's aside. */
static double farthest(const struct mesh *mesh, height_of *height) {
    double most = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 middle = {0};
        for (int k = 0; k < 3; k++) middle = vec3_add(middle, vec3_scale(mesh->vertex[mesh->triangle[t][k]], 1.0 / 3));
        if (fmax(fabs(middle.x), fabs(middle.y)) > SIDE / 2 - 4) continue;
        most = fmax(most, fabs(middle.z - height(middle.x, middle.y)));
    }
    return most;
}

static void check_new_vertices(const struct mesh *mesh, size_t added, height_of *height) {
    assert_int_equal(mesh->vertex_count, POINTS + added);
    for (size_t v = 0; v < POINTS; v++) assert_int_equal(mesh->source[v], POINTS - v);
    for (size_t v = POINTS; v < mesh->vertex_count; v++) {
        vec3 at = mesh->vertex[v];
        assert_int_equal(mesh->source[v], NONE);
        assert_true(fabs(at.z - height(at.x, at.y)) < 0.01);
    }
}

static void creases_become_sharp(void **state) {
    (void)state;
    static height_of *const of[] = {roof, valley};
    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        struct mesh mesh = mesh_of(of[i]);
        struct mesh_facts facts;
        size_t added = 0;
        assert_true(farthest(&mesh, of[i]) > 0.15);
        assert_int_equal(sharpen_creases(&mesh, 0, &added), STATUS_OK);
        assert_true(added > SIDE);
        check_new_vertices(&mesh, added, of[i]);
        assert_true(farthest(&mesh, of[i]) < 0.03);
        assert_int_equal(mesh_examine(&mesh, &facts), STATUS_OK);
        assert_int_equal(facts.euler, 1);
        assert_int_equal(facts.manifold, 1);
        mesh_done(&mesh);
    }
}

static void three_creases_meet_in_a_corner(void **state) {
    (void)state;
    struct mesh mesh = mesh_of(summit);
    size_t added = 0;
    double nearest = INFINITY;
    assert_int_equal(sharpen_creases(&mesh, 0, &added), STATUS_OK);
    assert_true(added > SIDE);
    check_new_vertices(&mesh, added, summit);
    for (size_t v = POINTS; v < mesh.vertex_count; v++) nearest = fmin(nearest, vec3_length(mesh.vertex[v]));
    assert_true(nearest < 0.01);
    mesh_done(&mesh);
}

static void what_is_round_stays(void **state) {
    (void)state;
    static height_of *const of[] = {barrel, drum, round_ridge};
    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        struct mesh mesh = mesh_of(of[i]);
        size_t added = 1;
        assert_int_equal(sharpen_creases(&mesh, 0, &added), STATUS_OK);
        assert_int_equal(added, 0);
        assert_int_equal(mesh.vertex_count, POINTS);
        mesh_done(&mesh);
    }
}

static void noise_makes_no_edge_round(void **state) {
    (void)state;
    struct mesh mesh = mesh_of(rough_roof);
    size_t added = 1;
    assert_int_equal(sharpen_creases(&mesh, 0, &added), STATUS_OK);
    assert_int_equal(added, 0);
    assert_int_equal(sharpen_creases(&mesh, NOISE, &added), STATUS_OK);
    assert_true(added > SIDE);
    mesh_done(&mesh);
}

static void even_points_tell_of_creases_that_they_were_not_put_by(void **state) {
    (void)state;
    static const struct {
        height_of *height;
        double shake;
        bool due;
    } of[] = {{skew_roof, 0.25, true},
              {roof, 0.1, false} /* in rows beside it */,
              {barrel, 0.25, false},
              {skew_roof, 0.45, false} /* unevenly */,
              {skew_roof, 0, false} /* as densely as can be */};
    for (size_t i = 0; i < sizeof of / sizeof *of; i++) {
        struct mesh mesh = shaken_mesh_of(of[i].height, of[i].shake);
        bool due = !of[i].due;
        assert_int_equal(sharpen_is_due(&mesh, &due), STATUS_OK);
        assert_int_equal(due, of[i].due);
        mesh_done(&mesh);
    }
}

static void telling_of_creases_may_fail(void **state) {
    (void)state;
    struct mesh mesh = mesh_of(skew_roof);
    size_t failures = 0;
    enum status status = STATUS_NO_MEMORY;
    bool due;
    while (status) {
        faults_in_memory((long)failures + 1, false);
        status = sharpen_is_due(&mesh, &due);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        failures += failed;
    }
    assert_true(due && failures > 6);
    mesh_done(&mesh);
}

static void failures_leave_the_roof_as_it_was(void **state) {
    (void)state;
    struct mesh mesh = mesh_of(roof);
    size_t failures = 0;
    enum status status = STATUS_NO_MEMORY;
    while (status) {
        faults_in_memory((long)failures + 1, false);
        status = sharpen_creases(&mesh, 0, NULL);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true((mesh.vertex_count == POINTS) == failed);
        failures += failed;
    }
    assert_true(failures > 4);
    mesh_done(&mesh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(creases_become_sharp),
        cmocka_unit_test(three_creases_meet_in_a_corner),
        cmocka_unit_test(what_is_round_stays),
        cmocka_unit_test(noise_makes_no_edge_round),
        cmocka_unit_test(even_points_tell_of_creases_that_they_were_not_put_by),
        cmocka_unit_test(telling_of_creases_may_fail),
        cmocka_unit_test(failures_leave_the_roof_as_it_was),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
