/* Refinement of surfaces with borders: sheets whose true surface is known.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"
#include "core/refine/refine.h"
#include "tests/unit/dense.h"

enum { SIDE = 65, EVERY = 8 }; /* points along an edge of the sheet, and points for each edge of the mesh */

static const double STEP = 1.0 / (SIDE - 1);
static const double PI = 3.14159265358979323846;

struct sheet {
    vec3 (*at)(double x, double y);
    bool (*is_there)(double x, double y);
    bool is_field;
};

static bool everywhere(double x, double y) { return x >= 0 && y >= 0; }
static bool beside_hole(double x, double y) { return fmax(fabs(x - 0.5), fabs(y - 0.5)) > 0.1245; }

static vec3 hills(double x, double y) { return (vec3){x, y, 0.08 * sin(9 * x) * cos(7 * y) + 0.05 * x * y}; }

/* The square's rings become circles of latitude. */
static vec3 half_sphere(double x, double y) {
    double u = 2 * x - 1, v = 2 * y - 1, length = hypot(u, v), angle = fmax(fabs(u), fabs(v)) * PI / 2;
    double out = length > 0 ? sin(angle) / length : 0;
    return (vec3){0.5 * u * out, 0.5 * v * out, 0.5 * cos(angle)};
}

/* Walls, which few points have as slopes. */
static vec3 towers(double x, double y) {
    bool high = fmod(x + 0.09, 0.34) < 0.13 && fmod(y + 0.05, 0.29) < 0.11;
    return (vec3){x, y, high ? 0.4 : 0};
}

static vec3 normal_at(const struct sheet *sheet, double x, double y) {
    double e = 1e-6;
    vec3 along = vec3_sub(sheet->at(x + e, y), sheet->at(x - e, y));
    vec3 across = vec3_sub(sheet->at(x, y + e), sheet->at(x, y - e));
    return vec3_unit(vec3_cross(along, across));
}

static struct dense points_of(const struct sheet *sheet) {
    struct dense dense = dense_new((size_t)SIDE * SIDE);
    size_t n = 0;
    for (size_t i = 0; i < dense.n; i++) {
        double x = (double)(i % SIDE) * STEP, y = (double)(i / SIDE) * STEP;
        if (!sheet->is_there(x, y)) continue;
        dense.point[n] = sheet->at(x, y);
        dense.normal[n] = normal_at(sheet, x, y);
        dense.spacing[n++] = (float)STEP;
    }
    dense.n = n;
    return dense;
}

static uint32_t point_at(const struct dense *dense, vec3 place) {
    for (uint32_t p = 0; p < dense->n; p++)
        if (vec3_distance_sq(dense->point[p], place) < 1e-12) return p;
    return NONE;
}

/* A grid of every EVERY-th point, without so many of the outermost rows. */
static struct mesh grid_of(const struct sheet *sheet, const struct dense *dense, size_t without) {
    size_t from = without, to = (SIDE - 1) / EVERY - without, side = to - from + 1;
    struct mesh mesh = {.vertex_count = side * side};
    mesh.vertex = alloc_array(side * side, sizeof *mesh.vertex);
    mesh.source = alloc_array(side * side, sizeof *mesh.source);
    mesh.triangle = alloc_array(2 * side * side, sizeof *mesh.triangle);
    assert_true(mesh.vertex && mesh.source && mesh.triangle);
    for (uint32_t i = 0; i < side * side; i++) {
        double x = (double)(from + i % side) * EVERY * STEP, y = (double)(from + i / side) * EVERY * STEP;
        mesh.vertex[i] = sheet->at(x, y);
        mesh.source[i] = point_at(dense, mesh.vertex[i]);
        double half = EVERY * STEP / 2;
        if (i % side + 1 == side || i / side + 1 == side || !sheet->is_there(x + half, y + half)) continue;
        uint32_t right = i + 1, up = i + (uint32_t)side, both = up + 1;
        memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[]){i, right, both}, sizeof *mesh.triangle);
        memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[]){i, both, up}, sizeof *mesh.triangle);
    }
    return mesh;
}

static struct mesh_facts facts_of(const struct mesh *mesh) {
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    return facts;
}

static void check_sound(const struct mesh *mesh, long euler) {
    struct mesh_facts facts = facts_of(mesh);
    assert_true(facts.manifold);
    assert_int_equal(facts.nonmanifold_edges + facts.misoriented_edges + facts.nonmanifold_vertices, 0);
    assert_int_equal(facts.euler, euler);
}

static void check_upwards(const struct mesh *mesh) {
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        assert_true(vec3_triangle_normal(mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]]).z > 0);
    }
}

static void check_subset(const struct mesh *mesh, const struct dense *dense) {
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3; k++) assert_int_not_equal(mesh->source[mesh->triangle[t][k]], NONE);
    for (size_t v = 0; v < mesh->vertex_count; v++) {
        if (mesh->source[v] == NONE) continue;
        assert_true(vec3_equal(mesh->vertex[v], dense->point[mesh->source[v]]));
        for (size_t w = 0; w < v; w++) assert_int_not_equal(mesh->source[v], mesh->source[w]);
    }
}

static struct refine_facts refine_points(struct mesh *mesh, const struct sheet *sheet, const struct dense *dense,
                                         bool smoothed, enum placement placement, unsigned threads) {
    struct refine_input input = dense_input(dense);
    struct neighbourhood neighbours = dense_neighbourhood(dense);
    struct refine_options options = {REFINE_FULL, placement, threads};
    struct refine_facts facts;
    input.neighbours = &neighbours;
    input.smoothed = smoothed;
    if (sheet->is_field) input.up = (vec3){0, 0, 1};
    assert_int_equal(refine_mesh(mesh, &input, &options, NULL, &facts), STATUS_OK);
    neighbourhood_done(&neighbours);
    return facts;
}

static struct refine_facts refine(struct mesh *mesh, const struct sheet *sheet, const struct dense *dense,
                                  enum placement placement, unsigned threads) {
    return refine_points(mesh, sheet, dense, false, placement, threads);
}

/* Refines the grid, sees that it is as sound as before and the error a part of what it was; the mesh. */
static struct mesh fit(const struct sheet *sheet, const struct dense *dense, size_t without, enum placement placement,
                       double part) {
    struct mesh mesh = grid_of(sheet, dense, without);
    long euler = facts_of(&mesh).euler;
    struct refine_facts facts = refine(&mesh, sheet, dense, placement, 2);
    assert_true(facts.mean_after < part * facts.mean_before);
    check_sound(&mesh, euler);
    if (sheet->is_field) check_upwards(&mesh);
    if (placement == PLACEMENT_SUBSET) check_subset(&mesh, dense);
    return mesh;
}

/* How far inside the sheet's edge a place is. */
static double edge_distance(vec3 v) { return fmin(fmin(v.x, 1 - v.x), fmin(v.y, 1 - v.y)); }

/* Looks at each vertex that is on a border. */
static void for_border(const struct mesh *mesh, void (*look)(vec3 place)) {
    struct halfedge he;
    assert_int_equal(halfedge_init(&he, mesh, 1), STATUS_OK);
    for (size_t h = 0; h < 3 * mesh->triangle_count; h++)
        if (he.twin[h] == NONE) look(mesh->vertex[halfedge_from(&he, (uint32_t)h)]);
    halfedge_done(&he);
}

static void is_at_edge(vec3 v) { assert_true(fabs(edge_distance(v)) < 1.5 * STEP); }
static void is_at_equator(vec3 v) { assert_true(v.z < 0.06); }
static void is_at_edge_or_hole(vec3 v) {
    double hole = fabs(fmax(fabs(v.x - 0.5), fabs(v.y - 0.5)) - 0.125);
    assert_true(fmin(fabs(edge_distance(v)), hole) < 1.5 * STEP);
}

static void try_both(const struct sheet *sheet, double subset, double optimal, void (*look)(vec3 place)) {
    struct dense dense = points_of(sheet);
    for (enum placement placement = PLACEMENT_SUBSET; placement <= PLACEMENT_OPTIMAL; placement++) {
        struct mesh mesh = fit(sheet, &dense, 0, placement, placement == PLACEMENT_SUBSET ? subset : optimal);
        for_border(&mesh, look);
        mesh_done(&mesh);
    }
    dense_done(&dense);
}

static void test_terrain(void **state) {
    (void)state;
    try_both(&(struct sheet){hills, everywhere, true}, 0.7, 0.6, is_at_edge);
}

static void test_half_sphere(void **state) {
    (void)state;
    try_both(&(struct sheet){half_sphere, everywhere, false}, 0.95, 0.7, is_at_equator);
}

static void test_hole_stays(void **state) {
    (void)state;
    try_both(&(struct sheet){hills, beside_hole, true}, 0.7, 0.6, is_at_edge_or_hole);
}

/* Triangles of a height field may be as steep as they like, so long as they face up. */
static void test_walls_get_steep(void **state) {
    (void)state;
    const struct sheet sheet = {towers, everywhere, true};
    struct dense dense = points_of(&sheet);
    struct mesh mesh = fit(&sheet, &dense, 0, PLACEMENT_SUBSET, 0.4);
    mesh_done(&mesh);
    dense_done(&dense);
}

static double area_of(const struct mesh *mesh) { return facts_of(mesh).area; }

/* The outermost row isn't in the mesh, but the points are: it comes to reach for them, and no farther. */
static void test_surface_grows_to_the_points(void **state) {
    (void)state;
    const struct sheet sheet = {hills, everywhere, true};
    struct dense dense = points_of(&sheet);
    struct mesh whole = grid_of(&sheet, &dense, 0), before = grid_of(&sheet, &dense, 1);
    struct mesh after = fit(&sheet, &dense, 1, PLACEMENT_SUBSET, 0.2);
    assert_true(area_of(&before) < 0.7 * area_of(&whole));
    assert_true(area_of(&after) > 0.95 * area_of(&whole));
    for (size_t v = 0; v < after.vertex_count; v++) assert_true(edge_distance(after.vertex[v]) >= 0);
    mesh_done(&whole), mesh_done(&before), mesh_done(&after);
    dense_done(&dense);
}

/* At points that were smoothed the last sweeps would fit what is left of their noise. */
static void test_smoothed_points_get_fewer_sweeps(void **state) {
    (void)state;
    const struct sheet sheet = {hills, everywhere, true};
    struct dense dense = points_of(&sheet);
    for (int placement = 0; placement < 2; placement++) {
        struct mesh usual = grid_of(&sheet, &dense, 0), fewer = grid_of(&sheet, &dense, 0);
        enum placement of = placement ? PLACEMENT_OPTIMAL : PLACEMENT_SUBSET;
        struct refine_facts without = refine_points(&usual, &sheet, &dense, false, of, 2);
        struct refine_facts with = refine_points(&fewer, &sheet, &dense, true, of, 2);
        if (of == PLACEMENT_SUBSET)
            assert_in_range(with.reallocations, 1, without.reallocations - 1);
        else
            assert_int_equal(with.reallocations, without.reallocations);
        assert_true(with.mean_after < 0.5 * with.mean_before);
        mesh_done(&usual), mesh_done(&fewer);
    }
    dense_done(&dense);
}

static void test_threads_change_nothing(void **state) {
    (void)state;
    const struct sheet sheet = {hills, beside_hole, true};
    struct dense dense = points_of(&sheet);
    struct mesh one = grid_of(&sheet, &dense, 1), three = grid_of(&sheet, &dense, 1);
    struct refine_facts facts = refine(&one, &sheet, &dense, PLACEMENT_SUBSET, 1);
    refine(&three, &sheet, &dense, PLACEMENT_SUBSET, 3);
    assert_true(facts.reallocations > 0 && facts.moves > 0 && facts.flips > 0);
    assert_int_equal(one.triangle_count, three.triangle_count);
    assert_memory_equal(one.triangle, three.triangle, one.triangle_count * sizeof *one.triangle);
    assert_memory_equal(one.vertex, three.vertex, one.vertex_count * sizeof *one.vertex);
    assert_memory_equal(one.source, three.source, one.vertex_count * sizeof *one.source);
    mesh_done(&one), mesh_done(&three);
    dense_done(&dense);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_terrain),
        cmocka_unit_test(test_half_sphere),
        cmocka_unit_test(test_hole_stays),
        cmocka_unit_test(test_walls_get_steep),
        cmocka_unit_test(test_surface_grows_to_the_points),
        cmocka_unit_test(test_smoothed_points_get_fewer_sweeps),
        cmocka_unit_test(test_threads_change_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
