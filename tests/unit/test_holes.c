/* Holes of the scan: which triangles span them, and the mesh without those.
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
#include "core/mesh/submesh.h"
#include "core/surface/cocone/holes.h"
#include "tests/unit/dense.h"
#include "tests/unit/faults.h"

enum { CELLS = 6, SITES = (CELLS + 1) * (CELLS + 1), MIDDLE = 2 * (3 * CELLS + 3) };

/* ------------------------------------------------------------------------------------------------ meshes */

/* A square of CELLS x CELLS cells at a height, facing up or down; its vertices are sites 0 .. SITES - 1. */
static void add_sheet(struct mesh *mesh, double z, bool up) {
    uint32_t first = (uint32_t)mesh->vertex_count;
    for (uint32_t v = 0; v < SITES; v++) {
        mesh->vertex[first + v] = (vec3){(double)(v % (CELLS + 1)) / CELLS, (double)(v / (CELLS + 1)) / CELLS, z};
        mesh->source[first + v] = v;
    }
    for (uint32_t cell = 0; cell < CELLS * CELLS; cell++) {
        uint32_t a = first + cell / CELLS * (CELLS + 1) + cell % CELLS, b = a + 1, c = b + CELLS + 1, d = c - 1;
        uint32_t half[2][3] = {{a, b, c}, {a, c, d}};
        for (int k = 0; k < 2; k++) {
            uint32_t *t = mesh->triangle[mesh->triangle_count++];
            t[0] = half[k][0], t[1] = half[k][up ? 1 : 2], t[2] = half[k][up ? 2 : 1];
        }
    }
    mesh->vertex_count += SITES;
}

static struct mesh mesh_new(void) {
    struct mesh mesh = {.vertex = alloc_array(2 * SITES, sizeof(vec3)),
                        .source = alloc_array(2 * SITES, sizeof(uint32_t)),
                        .triangle = alloc_array(4 * CELLS * CELLS, sizeof(uint32_t[3])),
                        .tag = alloc_zeroed(4 * CELLS * CELLS, 1)};
    assert_true(mesh.vertex && mesh.source && mesh.triangle && mesh.tag);
    return mesh;
}

static struct mesh sheet(void) {
    struct mesh mesh = mesh_new();
    add_sheet(&mesh, 0, true);
    return mesh;
}

static double wavy(double x, double y) { return 0.02 * sin(9 * x) * sin(7 * y); }

/* A field of steps x steps points for each cell, without those inside the middle one. */
static struct dense with_hole(size_t steps, double (*f)(double x, double y)) {
    struct dense dense = dense_field(steps * CELLS + 1, f);
    double low = 3.0 / CELLS + 1e-9, high = 4.0 / CELLS - 1e-9;
    size_t n = 0;
    for (size_t i = 0; i < dense.n; i++) {
        vec3 p = dense.point[i];
        if (p.x > low && p.x < high && p.y > low && p.y < high) continue;
        dense.point[n] = p;
        dense.spacing[n++] = dense.spacing[i];
    }
    dense.n = n;
    return dense;
}

/* ------------------------------------------------------------------------------------------------ running */

static enum status find(const struct mesh *mesh, const struct dense *dense, unsigned threads, uint8_t *hole) {
    struct halfedge he = {0};
    struct reconstruct_dense points = {dense->n, dense->point, dense->normal, dense->spacing, NULL, NULL,
                                       NULL,     NULL,         NULL};
    enum status status = halfedge_init(&he, mesh, 2);
    if (!status) status = cocone_holes_find(mesh, &he, &points, SITES, threads, hole);
    halfedge_done(&he);
    return status;
}

static size_t count_holes(const struct mesh *mesh, const struct dense *dense, uint8_t *hole) {
    size_t count = 0;
    assert_int_equal(find(mesh, dense, 1, hole), STATUS_OK);
    for (size_t t = 0; t < mesh->triangle_count; t++) count += hole[t];
    return count;
}

/* ------------------------------------------------------------------------------------------------ tests */

static void long_triangles_over_points_are_no_holes(void **state) {
    (void)state;
    uint8_t hole[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    for (size_t steps = 1; steps < 12; steps++) {
        struct dense flat = dense_field(steps * CELLS + 1, dense_flat), bent = dense_field(steps * CELLS + 1, wavy);
        assert_int_equal(count_holes(&mesh, &flat, hole), 0);
        assert_int_equal(count_holes(&mesh, &bent, hole), 0);
        dense_done(&flat), dense_done(&bent);
    }
    mesh_done(&mesh);
}

static void a_cell_without_points_is_a_hole(void **state) {
    (void)state;
    uint8_t hole[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    struct dense flat = with_hole(6, dense_flat), bent = with_hole(6, wavy);
    assert_int_equal(count_holes(&mesh, &flat, hole), 2);
    assert_true(hole[MIDDLE] && hole[MIDDLE + 1]);
    assert_int_equal(count_holes(&mesh, &bent, hole), 2);
    assert_true(hole[MIDDLE] && hole[MIDDLE + 1]);
    dense_done(&flat), dense_done(&bent), mesh_done(&mesh);
}

static void a_chance_void_is_none(void **state) {
    (void)state;
    uint8_t hole[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    struct dense dense = with_hole(3, dense_flat);
    assert_int_equal(count_holes(&mesh, &dense, hole), 0);
    dense_done(&dense), mesh_done(&mesh);
}

/* The lid has the same points in its corners, and is nearer to all others than they are to each other. */
static void a_lid_that_faces_the_other_way_is_a_hole(void **state) {
    (void)state;
    uint8_t hole[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    add_sheet(&mesh, -0.001, false);
    struct dense dense = dense_field(11 * CELLS + 1, dense_flat);
    assert_int_equal(count_holes(&mesh, &dense, hole), 2 * CELLS * CELLS);
    for (size_t t = 0; t < mesh.triangle_count; t++) assert_int_equal(hole[t], t >= 2 * CELLS * CELLS);
    dense_done(&dense), mesh_done(&mesh);
}

/* Points of one cell alone, and the corners of all others. */
static void no_point_loses_all_its_triangles(void **state) {
    (void)state;
    uint8_t hole[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    struct dense dense = dense_field(12 * CELLS + 1, dense_flat);
    size_t n = 0;
    for (size_t i = 0; i < dense.n; i++)
        if (dense.point[i].x < 4.0 / CELLS) dense.point[n++] = dense.point[i];
    dense.n = n;
    assert_true(count_holes(&mesh, &dense, hole) >= CELLS);
    bool has[SITES] = {false};
    for (size_t t = 0; t < mesh.triangle_count; t++)
        for (int k = 0; k < 3; k++) has[mesh.triangle[t][k]] |= !hole[t];
    for (size_t i = 0; i < SITES; i++) assert_true(has[i]);
    dense_done(&dense), mesh_done(&mesh);
}

static void threads_find_the_same(void **state) {
    (void)state;
    uint8_t one[4 * CELLS * CELLS], many[4 * CELLS * CELLS];
    struct mesh mesh = sheet();
    struct dense dense = with_hole(12, wavy);
    assert_true(count_holes(&mesh, &dense, one) > 0);
    assert_int_equal(find(&mesh, &dense, 4, many), STATUS_OK);
    assert_memory_equal(one, many, mesh.triangle_count);
    dense_done(&dense), mesh_done(&mesh);
}

/* ------------------------------------------------------------------------------------------------ without */

static struct mesh left_of(bool (*is_out)(uint32_t cell)) {
    struct mesh mesh = sheet();
    struct halfedge he;
    uint8_t out[2 * CELLS * CELLS];
    for (uint32_t t = 0; t < mesh.triangle_count; t++) out[t] = is_out(t / 2), mesh.tag[t] = t % 2;
    assert_int_equal(halfedge_init(&he, &mesh, 2), STATUS_OK);
    assert_int_equal(submesh_without(&mesh, &he, out), STATUS_OK);
    halfedge_done(&he);
    return mesh;
}

static bool middle_cell(uint32_t cell) { return cell == MIDDLE / 2; }
static bool all_but_two_that_touch(uint32_t cell) { return cell != 0 && cell != CELLS + 1; }
static bool any_cell(uint32_t cell) { return cell < UINT32_MAX; }

static void a_mesh_without_a_cell_has_a_border_around_it(void **state) {
    (void)state;
    struct mesh mesh = left_of(middle_cell);
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(&mesh, &facts), STATUS_OK);
    assert_true(facts.manifold && facts.euler == 0);
    assert_int_equal(mesh.triangle_count, 2 * CELLS * CELLS - 2);
    assert_int_equal(mesh.vertex_count, SITES);
    assert_int_equal(facts.boundary_edges, 4 * CELLS + 4);
    assert_int_equal(facts.unused_vertices, 0);
    for (size_t t = 0; t < mesh.triangle_count; t++) assert_int_equal(mesh.tag[t], t % 2);
    mesh_done(&mesh);
}

static void fans_that_part_get_a_vertex_each(void **state) {
    (void)state;
    struct mesh mesh = left_of(all_but_two_that_touch);
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(&mesh, &facts), STATUS_OK);
    assert_true(facts.manifold);
    assert_int_equal(facts.components, 2);
    assert_int_equal(mesh.vertex_count, 8);
    size_t touching = 0;
    for (size_t v = 0; v < mesh.vertex_count; v++) touching += mesh.source[v] == CELLS + 2;
    assert_int_equal(touching, 2);
    mesh_done(&mesh);
}

static void nothing_may_be_left(void **state) {
    (void)state;
    struct mesh mesh = left_of(any_cell);
    assert_int_equal(mesh.triangle_count + mesh.vertex_count, 0);
    mesh_done(&mesh);
}

/* ------------------------------------------------------------------------------------------------ failures */

/* Whether the nth allocation was there to fail. */
static bool fails_at(struct mesh *mesh, const struct dense *dense, int nth) {
    uint8_t hole[4 * CELLS * CELLS];
    struct halfedge he = {0};
    faults_in_memory(nth, false);
    enum status status = find(mesh, dense, 1, hole);
    if (!status) status = halfedge_init(&he, mesh, 2);
    if (!status) status = submesh_without(mesh, &he, hole);
    bool happened = faults_stop();
    assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    halfedge_done(&he);
    return happened;
}

static void a_failing_allocation_is_told(void **state) {
    (void)state;
    struct mesh mesh = sheet();
    struct dense dense = with_hole(6, dense_flat);
    int nth = 1;
    for (; fails_at(&mesh, &dense, nth); nth++) assert_int_equal(mesh.triangle_count, 2 * CELLS * CELLS);
    assert_int_equal(mesh.triangle_count, 2 * CELLS * CELLS - 2);
    assert_true(nth > 20);
    dense_done(&dense), mesh_done(&mesh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(long_triangles_over_points_are_no_holes),
        cmocka_unit_test(a_cell_without_points_is_a_hole),
        cmocka_unit_test(a_chance_void_is_none),
        cmocka_unit_test(a_lid_that_faces_the_other_way_is_a_hole),
        cmocka_unit_test(no_point_loses_all_its_triangles),
        cmocka_unit_test(threads_find_the_same),
        cmocka_unit_test(a_mesh_without_a_cell_has_a_border_around_it),
        cmocka_unit_test(fans_that_part_get_a_vertex_each),
        cmocka_unit_test(nothing_may_be_left),
        cmocka_unit_test(a_failing_allocation_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
