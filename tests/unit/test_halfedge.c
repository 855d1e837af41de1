/* Half-edges: twins, flips, collapses and splits on the smallest meshes that have them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/mesh/halfedge.h"
#include "tests/unit/faults.h"

static const uint32_t octahedron[8][3] = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                          {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};

struct fixture {
    uint32_t triangle[8][3];
    struct mesh mesh;
    struct halfedge he;
};

static void build(struct fixture *f, const uint32_t (*triangle)[3], size_t triangles, size_t vertices) {
    memset(f, 0, sizeof *f);
    memcpy(f->triangle, triangle, triangles * sizeof *triangle);
    f->mesh = (struct mesh){.vertex_count = vertices, .triangle_count = triangles, .triangle = f->triangle};
    assert_int_equal(halfedge_init(&f->he, &f->mesh, 2), STATUS_OK);
}

/* Every twin is mutual and runs the other way round; every vertex in use has a half-edge that starts there. */
static void check(const struct halfedge *he) {
    for (uint32_t h = 0; h < 3 * he->triangle_count; h++) {
        uint32_t g = he->twin[h];
        if (g == NONE) continue;
        assert_int_equal(he->twin[g], h);
        assert_int_equal(halfedge_from(he, g), halfedge_to(he, h));
        assert_int_equal(halfedge_to(he, g), halfedge_from(he, h));
    }
    for (uint32_t v = 0; v < he->vertex_count; v++)
        if (he->out[v] != NONE) assert_int_equal(halfedge_from(he, he->out[v]), v);
}

static uint32_t find(const struct halfedge *he, uint32_t from, uint32_t to) {
    for (uint32_t h = 0; h < 3 * he->triangle_count; h++)
        if (halfedge_from(he, h) == from && halfedge_to(he, h) == to) return h;
    return NONE;
}

static size_t valence(const struct halfedge *he, uint32_t v) {
    uint32_t ring[16];
    return halfedge_ring(he, v, ring, 16);
}

static void test_closed_has_all_twins(void **state) {
    (void)state;
    struct fixture f;
    build(&f, octahedron, 8, 6);
    check(&f.he);
    for (uint32_t h = 0; h < 24; h++) assert_int_not_equal(f.he.twin[h], NONE);
    for (uint32_t v = 0; v < 6; v++) {
        assert_int_equal(f.he.locked[v], 0);
        assert_int_equal(valence(&f.he, v), 4);
    }
    uint32_t ring[3];
    assert_int_equal(halfedge_ring(&f.he, 0, ring, 3), 0); /* too many for the room */
    assert_true(halfedge_joined(&f.he, 0, 2));
    assert_false(halfedge_joined(&f.he, 0, 1));
    halfedge_done(&f.he);
}

static void test_boundary_is_locked(void **state) {
    (void)state;
    static const uint32_t fan[4][3] = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4}};
    struct fixture f;
    build(&f, fan, 4, 5);
    check(&f.he);
    for (uint32_t v = 0; v < 4; v++) assert_int_equal(f.he.locked[v], HALFEDGE_BORDER);
    assert_true(halfedge_joined(&f.he, 0, 3) && halfedge_joined(&f.he, 0, 1) && halfedge_joined(&f.he, 0, 4));
    assert_false(halfedge_joined(&f.he, 0, 2));
    assert_int_equal(f.he.locked[4], 0);
    assert_int_equal(valence(&f.he, 4), 4);
    halfedge_done(&f.he);
}

static void test_three_triangles_at_an_edge_have_no_twins(void **state) {
    (void)state;
    static const uint32_t book[3][3] = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}};
    struct fixture f;
    build(&f, book, 3, 5);
    for (uint32_t h = 0; h < 9; h++) assert_int_equal(f.he.twin[h], NONE);
    assert_int_equal(f.he.locked[0], HALFEDGE_KNOTTED);
    assert_int_equal(f.he.locked[1], HALFEDGE_KNOTTED);
    assert_int_equal(f.he.locked[4], HALFEDGE_BORDER);
    halfedge_done(&f.he);
}

static void test_misoriented_edge_has_no_twins(void **state) {
    (void)state;
    static const uint32_t pair[2][3] = {{0, 1, 2}, {0, 1, 3}};
    struct fixture f;
    build(&f, pair, 2, 4);
    for (uint32_t h = 0; h < 6; h++) assert_int_equal(f.he.twin[h], NONE);
    halfedge_done(&f.he);
}

/* Two tetrahedra that touch in a vertex: every edge is regular, the vertex isn't. */
static void test_two_fans_are_locked(void **state) {
    (void)state;
    static const uint32_t pair[8][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3},
                                        {0, 5, 4}, {0, 4, 6}, {0, 6, 5}, {4, 5, 6}};
    struct fixture f;
    build(&f, pair, 8, 7);
    check(&f.he);
    assert_int_equal(f.he.locked[0], HALFEDGE_KNOTTED);
    for (uint32_t v = 1; v < 7; v++) assert_int_equal(f.he.locked[v], 0);
    halfedge_done(&f.he);
}

static void test_flip_there_and_back(void **state) {
    (void)state;
    struct fixture f;
    build(&f, octahedron, 8, 6);
    uint32_t h = find(&f.he, 2, 4); /* between 0 and 1 */
    assert_false(halfedge_joined(&f.he, 0, 1));
    halfedge_flip(&f.he, h);
    check(&f.he);
    assert_true(halfedge_joined(&f.he, 0, 1));
    assert_false(halfedge_joined(&f.he, 2, 4));
    assert_int_equal(valence(&f.he, 0), 5);
    assert_int_equal(valence(&f.he, 4), 3);
    halfedge_flip(&f.he, find(&f.he, 0, 1));
    check(&f.he);
    assert_true(halfedge_joined(&f.he, 2, 4));
    for (uint32_t v = 0; v < 6; v++) assert_int_equal(valence(&f.he, v), 4);
    halfedge_done(&f.he);
}

static void test_collapse_of_a_tetrahedron_is_refused(void **state) {
    (void)state;
    static const uint32_t tetrahedron[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct fixture f;
    build(&f, tetrahedron, 4, 4);
    for (uint32_t h = 0; h < 12; h++) assert_false(halfedge_may_collapse(&f.he, h, halfedge_from(&f.he, h)));
    halfedge_done(&f.he);
}

/* On a torus of 3 x 3 vertices every edge lies on a ring of three that bounds nothing. */
static void test_collapse_that_would_pinch_is_refused(void **state) {
    (void)state;
    uint32_t torus[18][3];
    for (uint32_t i = 0; i < 9; i++) {
        uint32_t x = i % 3, y = i / 3, right = (x + 1) % 3 + 3 * y, up = x + 3 * ((y + 1) % 3);
        uint32_t both = (x + 1) % 3 + 3 * ((y + 1) % 3);
        torus[2 * i][0] = i, torus[2 * i][1] = right, torus[2 * i][2] = both;
        torus[2 * i + 1][0] = i, torus[2 * i + 1][1] = both, torus[2 * i + 1][2] = up;
    }
    struct mesh mesh = {.vertex_count = 9, .triangle_count = 18, .triangle = torus};
    struct halfedge he;
    assert_int_equal(halfedge_init(&he, &mesh, 2), STATUS_OK);
    check(&he);
    for (uint32_t h = 0; h < 54; h++) {
        assert_int_not_equal(he.twin[h], NONE);
        assert_false(halfedge_may_collapse(&he, h, halfedge_from(&he, h)));
    }
    halfedge_done(&he);
}

static void test_collapse_and_split_keep_the_counts(void **state) {
    (void)state;
    struct fixture f;
    build(&f, octahedron, 8, 6);
    uint32_t h = find(&f.he, 4, 0);
    assert_true(halfedge_may_collapse(&f.he, h, 4));
    struct halfedge_spare spare = halfedge_collapse(&f.he, h, 4);
    assert_int_equal(spare.vertex, 4);
    assert_int_equal(f.he.out[4], NONE);
    uint32_t edge = find(&f.he, 1, 5);
    assert_int_not_equal(edge / 3, spare.triangle[0]);
    assert_int_not_equal(edge / 3, spare.triangle[1]);
    halfedge_split(&f.he, edge, spare);
    check(&f.he);
    struct mesh_facts facts;
    vec3 nowhere[6] = {{0, 0, 0}};
    f.mesh.vertex = nowhere;
    assert_int_equal(mesh_examine(&f.mesh, &facts), STATUS_OK);
    assert_true(facts.watertight && facts.manifold);
    assert_int_equal(facts.euler, 2);
    assert_int_equal(facts.unused_vertices, 0);
    assert_int_equal(valence(&f.he, 4), 4);
    halfedge_done(&f.he);
}

/*   6 - 7 - 8
 *   | / | / |
 *   3 - 4 - 5
 *   | / | / |
 *   0 - 1 - 2   */
static const uint32_t grid[8][3] = {{0, 1, 4}, {0, 4, 3}, {1, 2, 5}, {1, 5, 4},
                                    {3, 4, 7}, {3, 7, 6}, {4, 5, 8}, {4, 8, 7}};

static size_t count_borders(const struct halfedge *he) {
    size_t count = 0;
    for (uint32_t h = 0; h < 3 * he->triangle_count; h++) count += he->twin[h] == NONE;
    return count;
}

static void test_border_is_met_from_end_to_end(void **state) {
    (void)state;
    struct fixture f;
    uint32_t ring[8];
    build(&f, grid, 8, 9);
    assert_int_equal(halfedge_ring(&f.he, 1, ring, 8), 3);
    assert_int_equal(halfedge_to(&f.he, ring[0]), 2);
    assert_int_equal(f.he.twin[ring[0]], NONE);
    assert_int_equal(halfedge_apex(&f.he, ring[2]), 0);
    assert_int_equal(halfedge_ring(&f.he, 1, ring, 2), 0);
    halfedge_done(&f.he);
}

/* Towards the border, along it at either end of its only half-edge, but not away from it; and no triangle vanishes. */
static void test_border_collapses_along_itself(void **state) {
    (void)state;
    struct fixture f;
    build(&f, grid, 8, 9);
    assert_true(halfedge_may_collapse(&f.he, find(&f.he, 4, 1), 4));
    assert_false(halfedge_may_collapse(&f.he, find(&f.he, 4, 1), 1));
    assert_true(halfedge_may_collapse(&f.he, find(&f.he, 0, 1), 1));
    assert_true(halfedge_may_collapse(&f.he, find(&f.he, 0, 1), 0));
    halfedge_done(&f.he);
    build(&f, grid, 1, 5);
    for (uint32_t h = 0; h < 3; h++) assert_false(halfedge_may_collapse(&f.he, h, halfedge_from(&f.he, h)));
    halfedge_done(&f.he);
}

static void collapse_and_split_border(uint32_t gone) {
    struct fixture f;
    struct mesh_facts facts;
    vec3 nowhere[9] = {{0, 0, 0}};
    build(&f, grid, 8, 9);
    f.mesh.vertex = nowhere;
    struct halfedge_spare spare = halfedge_collapse(&f.he, find(&f.he, 0, 1), gone);
    assert_int_equal(spare.vertex, gone);
    assert_int_equal(spare.triangle[1], NONE);
    assert_int_equal(f.he.out[gone], NONE);
    uint32_t edge = find(&f.he, 8, 7);
    halfedge_split(&f.he, edge, spare);
    check(&f.he);
    assert_int_equal(f.he.locked[gone], HALFEDGE_BORDER);
    assert_int_equal(count_borders(&f.he), 8);
    assert_int_equal(mesh_examine(&f.mesh, &facts), STATUS_OK);
    assert_true(facts.manifold);
    assert_int_equal(facts.euler, 1);
    assert_int_equal(facts.boundary_edges, 8);
    halfedge_done(&f.he);
}

static void test_border_collapse_and_split_keep_the_counts(void **state) {
    (void)state;
    collapse_and_split_border(0);
    collapse_and_split_border(1);
}

static void test_renumbered_triangle_keeps_its_neighbours(void **state) {
    (void)state;
    struct fixture f;
    build(&f, grid, 8, 9);
    struct halfedge_spare spare = halfedge_collapse(&f.he, find(&f.he, 0, 1), 1);
    if (spare.triangle[0] != 7) halfedge_renumber(&f.he, 7, spare.triangle[0]);
    f.he.triangle_count = 7;
    check(&f.he);
    assert_int_equal(count_borders(&f.he), 7);
    assert_true(halfedge_joined(&f.he, 4, 8) && halfedge_joined(&f.he, 7, 8));
    halfedge_done(&f.he);
}

/* By the definition: the only one that comes back, of the only one that goes. */
static uint32_t twin_of(const struct halfedge *he, uint32_t h) {
    uint32_t back = NONE, there = 0, backs = 0;
    for (uint32_t g = 0; g < 3 * he->triangle_count; g++) {
        there += halfedge_from(he, g) == halfedge_from(he, h) && halfedge_to(he, g) == halfedge_to(he, h);
        if (halfedge_from(he, g) != halfedge_to(he, h) || halfedge_to(he, g) != halfedge_from(he, h)) continue;
        back = g, backs++;
    }
    return there == 1 && backs == 1 && back != h ? back : NONE;
}

/* Hubs of hundreds of triangles, beside edges that aren't regular in all ways there are, for any number of threads. */
static void test_twins_are_found_in_any_heap_of_triangles(void **state) {
    (void)state;
    enum { VERTICES = 60, TRIANGLES = 500 };
    static uint32_t triangle[TRIANGLES][3];
    struct mesh mesh = {.vertex_count = VERTICES, .triangle_count = TRIANGLES, .triangle = triangle};
    size_t paired = 0, alone = 0;
    for (uint32_t t = 0, x = 1; t < TRIANGLES; t++)
        for (uint32_t k = 0; k < 3; k++) {
            x = x * 1664525 + 1013904223;
            triangle[t][k] = t % 2 && k == 0 ? 3 : (x >> 16) % VERTICES;
        }
    for (unsigned threads = 1; threads <= 3; threads++) {
        struct halfedge he;
        assert_int_equal(halfedge_init(&he, &mesh, threads), STATUS_OK);
        check(&he);
        for (uint32_t h = 0; h < 3 * TRIANGLES; h++) {
            assert_int_equal(he.twin[h], twin_of(&he, h));
            *(he.twin[h] == NONE ? &alone : &paired) += 1;
        }
        halfedge_done(&he);
    }
    assert_true(paired > 300 && alone > 300);
}

static void test_every_allocation_may_fail(void **state) {
    (void)state;
    struct fixture f;
    memcpy(f.triangle, octahedron, sizeof octahedron);
    f.mesh = (struct mesh){.vertex_count = 6, .triangle_count = 8, .triangle = f.triangle};
    int failures = 0;
    for (;;) {
        faults_in_memory(failures + 1, false);
        enum status status = halfedge_init(&f.he, &f.mesh, 2);
        bool happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        if (!happened) break;
        failures++;
    }
    assert_true(failures >= 5);
    halfedge_done(&f.he);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_closed_has_all_twins),
        cmocka_unit_test(test_boundary_is_locked),
        cmocka_unit_test(test_three_triangles_at_an_edge_have_no_twins),
        cmocka_unit_test(test_misoriented_edge_has_no_twins),
        cmocka_unit_test(test_two_fans_are_locked),
        cmocka_unit_test(test_flip_there_and_back),
        cmocka_unit_test(test_collapse_of_a_tetrahedron_is_refused),
        cmocka_unit_test(test_collapse_that_would_pinch_is_refused),
        cmocka_unit_test(test_collapse_and_split_keep_the_counts),
        cmocka_unit_test(test_border_is_met_from_end_to_end),
        cmocka_unit_test(test_border_collapses_along_itself),
        cmocka_unit_test(test_border_collapse_and_split_keep_the_counts),
        cmocka_unit_test(test_renumbered_triangle_keeps_its_neighbours),
        cmocka_unit_test(test_twins_are_found_in_any_heap_of_triangles),
        cmocka_unit_test(test_every_allocation_may_fail),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
