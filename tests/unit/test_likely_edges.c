/* Edges of grids that are sheared, folded along a diagonal, or flat.
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
#include "core/refine/likely_edges.h"
#include "tests/unit/faults.h"

enum { SIDE = 21, POINTS = SIDE * SIDE, CELLS = (SIDE - 1) * (SIDE - 1), TRIANGLES = 2 * CELLS };

/* A grid with the diagonals (x, y) (x + 1, y + 1): sheared along x for each y, falling by fold on both sides of them.
 */
static struct mesh grid_new(double shear, double fold) {
    struct mesh mesh = {POINTS,
                        alloc_array(POINTS, sizeof(vec3)),
                        NULL,
                        TRIANGLES,
                        alloc_array(TRIANGLES, sizeof *mesh.triangle),
                        alloc_array(TRIANGLES, 1)};
    memset(mesh.tag, MESH_SUPPORTED, TRIANGLES);
    for (uint32_t v = 0, t = 0; v < POINTS; v++) {
        uint32_t x = v % SIDE, y = v / SIDE;
        mesh.vertex[v] = (vec3){x + shear * y, y, -fold * abs((int)x - (int)y)};
        if (x + 1 == SIDE || y + 1 == SIDE) continue;
        memcpy(mesh.triangle[t++], (uint32_t[3]){v, v + 1, v + SIDE + 1}, sizeof *mesh.triangle);
        memcpy(mesh.triangle[t++], (uint32_t[3]){v, v + SIDE + 1, v + SIDE}, sizeof *mesh.triangle);
    }
    return mesh;
}

/* Gives a cell the other diagonal. */
static void turn_cell(struct mesh *mesh, uint32_t x, uint32_t y) {
    uint32_t v = y * SIDE + x, t = 2 * (y * (SIDE - 1) + x);
    memcpy(mesh->triangle[t], (uint32_t[3]){v, v + 1, v + SIDE}, sizeof *mesh->triangle);
    memcpy(mesh->triangle[t + 1], (uint32_t[3]){v + 1, v + SIDE + 1, v + SIDE}, sizeof *mesh->triangle);
}

static bool mesh_has_edge(const struct mesh *mesh, uint32_t a, uint32_t b) {
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++)
            if (mesh->triangle[t][k] == a && mesh->triangle[t][(k + 1) % 3] == b) return true;
    return false;
}

/* Of cells without a corner on the border, which stay. */
static size_t count_diagonals(const struct mesh *mesh) {
    size_t count = 0;
    for (uint32_t y = 1; y + 2 < SIDE; y++)
        for (uint32_t x = 1; x + 2 < SIDE; x++) count += mesh_has_edge(mesh, y * SIDE + x, (y + 1) * SIDE + x + 1);
    return count;
}

static void wide_angles_are_cut(void **state) {
    (void)state;
    struct mesh slanting = grid_new(0.6, 0), upright = grid_new(-0.6, 0);
    size_t flips = 0, stay = 1;
    assert_int_equal(take_likely_edges(&slanting, &flips), STATUS_OK);
    assert_int_equal(take_likely_edges(&upright, &stay), STATUS_OK);
    assert_int_equal(flips, (SIDE - 3) * (SIDE - 3));
    assert_int_equal(count_diagonals(&slanting), 0);
    assert_int_equal(stay, 0);
    mesh_done(&slanting), mesh_done(&upright);
}

/* Both diagonals of a cell are as long and have the same angles across. */
static void what_runs_across_a_bend_is_flipped(void **state) {
    (void)state;
    struct mesh mesh = grid_new(0, 0.3);
    size_t flips = 0;
    turn_cell(&mesh, 5, 5), turn_cell(&mesh, 9, 9);
    mesh.tag[2 * (5 * (SIDE - 1) + 5)] = MESH_HOLE_FILL;
    assert_int_equal(take_likely_edges(&mesh, &flips), STATUS_OK);
    assert_int_equal(flips, 2);
    assert_int_equal(count_diagonals(&mesh), (SIDE - 3) * (SIDE - 3));
    for (size_t t = 0; t < TRIANGLES; t++) assert_int_equal(mesh.tag[t], MESH_SUPPORTED);
    mesh_done(&mesh);
}

/* Pleats along the diagonals: what wide angles tell makes it rougher, and as regular as it was. */
static void what_would_get_rougher_alone_stays(void **state) {
    (void)state;
    struct mesh mesh = grid_new(0.6, 0);
    size_t flips = 1;
    for (uint32_t v = 0; v < POINTS; v++) mesh.vertex[v].z = 0.2 * abs((int)(v % SIDE + 2 * SIDE - v / SIDE) % 4 - 2);
    assert_int_equal(take_likely_edges(&mesh, &flips), STATUS_OK);
    assert_int_equal(flips, 0);
    assert_int_equal(count_diagonals(&mesh), (SIDE - 3) * (SIDE - 3));
    mesh_done(&mesh);
}

/* A ridge along the longer diagonals of a sheared grid, all cells of which have the shorter ones: teeth. */
static void teeth_along_a_ridge_go(void **state) {
    (void)state;
    struct mesh mesh = grid_new(0.3, 0.6), even = grid_new(0.3, 0);
    size_t likely = 1, flips = 0, none = 1;
    for (uint32_t y = 0; y + 1 < SIDE; y++)
        for (uint32_t x = 0; x + 1 < SIDE; x++) turn_cell(&mesh, x, y), turn_cell(&even, x, y);
    assert_int_equal(take_likely_edges(&mesh, &likely), STATUS_OK);
    assert_int_equal(take_smooth_edges(&mesh, &flips), STATUS_OK);
    assert_int_equal(take_smooth_edges(&even, &none), STATUS_OK);
    assert_int_equal(likely, 0);
    assert_int_equal(none, 0);
    assert_int_equal(flips, SIDE - 3);
    assert_int_equal(count_diagonals(&mesh), SIDE - 3);
    for (uint32_t x = 1; x + 2 < SIDE; x++)
        assert_true(mesh_has_edge(&mesh, x * SIDE + x, (x + 1) * SIDE + x + 1) ||
                    mesh_has_edge(&mesh, (x + 1) * SIDE + x + 1, x * SIDE + x));
    mesh_done(&mesh), mesh_done(&even);
}

/* As above, but points are said to be so near to each other that each cell is a gap, or some are. */
static void across_gaps_wide_angles_are_cut_anyway(void **state) {
    (void)state;
    enum { ACROSS = SIDE / 2 };
    static const float NEAR = 0.2F, FAR = 0.6F;
    static const double ALL = 1, FEW = 0.05;
    struct mesh mesh = grid_new(0.6, 0);
    float spacing[POINTS];
    size_t flips = 1;
    mesh.source = alloc_array(POINTS, sizeof *mesh.source);
    for (uint32_t v = 0; v < POINTS; v++) {
        mesh.vertex[v].z = 0.2 * abs((int)(v % SIDE + 2 * SIDE - v / SIDE) % 4 - 2);
        mesh.source[v] = v;
        spacing[v] = v % SIDE < ACROSS ? NEAR : FAR;
    }
    assert_int_equal(take_likely_edges_across_gaps(&mesh, spacing, FEW, &flips), STATUS_OK);
    assert_int_equal(flips, 0);
    assert_int_equal(take_likely_edges_across_gaps(&mesh, spacing, ALL, &flips), STATUS_OK);
    assert_true(flips > 0);
    for (uint32_t y = 1; y + 2 < SIDE; y++)
        for (uint32_t x = ACROSS; x + 2 < SIDE; x++)
            assert_true(mesh_has_edge(&mesh, y * SIDE + x, (y + 1) * SIDE + x + 1));
    mesh_done(&mesh);
}

/* One edge too many at either end is no evidence to speak of, two are. */
static void vertices_have_about_six_edges(void **state) {
    (void)state;
    struct mesh mesh = grid_new(0, 0);
    size_t flips = 1;
    turn_cell(&mesh, 5, 7), turn_cell(&mesh, 7, 5);
    assert_int_equal(take_likely_edges(&mesh, &flips), STATUS_OK);
    assert_int_equal(flips, 0);
    turn_cell(&mesh, 6, 6);
    assert_int_equal(take_likely_edges(&mesh, &flips), STATUS_OK);
    assert_int_equal(flips, 1);
    assert_true(mesh_has_edge(&mesh, 6 * SIDE + 6, 7 * SIDE + 7));
    mesh_done(&mesh);
}

static void failures_leave_the_grid_as_it_was(void **state) {
    (void)state;
    struct mesh mesh = grid_new(0.6, 0);
    size_t diagonals = count_diagonals(&mesh), failures = 0;
    enum status status = STATUS_NO_MEMORY;
    while (status) {
        faults_in_memory((long)failures + 1, false);
        status = take_likely_edges(&mesh, NULL);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true((count_diagonals(&mesh) == diagonals) == failed);
        failures += failed;
    }
    assert_true(failures > 4);
    mesh_done(&mesh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wide_angles_are_cut),
        cmocka_unit_test(what_runs_across_a_bend_is_flipped),
        cmocka_unit_test(what_would_get_rougher_alone_stays),
        cmocka_unit_test(teeth_along_a_ridge_go),
        cmocka_unit_test(across_gaps_wide_angles_are_cut_anyway),
        cmocka_unit_test(vertices_have_about_six_edges),
        cmocka_unit_test(failures_leave_the_grid_as_it_was),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
