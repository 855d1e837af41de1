/* Loops that don't bound, on tori of so and so many points around and along.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/surface/handle_loops.h"
#include "tests/unit/faults.h"

enum { PLENTY = 1 << 24 /* steps */ };

/* A torus of around x along vertices; the first number is that of the tube. */
static struct mesh torus(uint32_t around, uint32_t along) {
    struct mesh mesh = {.vertex_count = around * along, .triangle_count = 2 * around * along};
    mesh.vertex = alloc_array(mesh.vertex_count, sizeof *mesh.vertex);
    mesh.triangle = alloc_array(mesh.triangle_count, sizeof *mesh.triangle);
    for (uint32_t i = 0; i < along; i++) {
        for (uint32_t j = 0; j < around; j++) {
            double u = 2 * M_PI * i / along, v = 2 * M_PI * j / around, r = 3 + cos(v);
            uint32_t a = i * around + j, b = i * around + (j + 1) % around;
            uint32_t c = (i + 1) % along * around + j, d = (i + 1) % along * around + (j + 1) % around;
            mesh.vertex[a] = (vec3){r * cos(u), r * sin(u), sin(v)};
            const uint32_t triangle[2][3] = {{a, c, b}, {b, c, d}};
            for (int k = 0; k < 6; k++) mesh.triangle[2 * a + (uint32_t)k / 3][k % 3] = triangle[k / 3][k % 3];
        }
    }
    return mesh;
}

static struct loops found(const struct mesh *mesh) {
    struct loops loops = {0};
    size_t steps = PLENTY;
    assert_int_equal(loops_find(mesh, LOOPS_MOST_EDGES, &steps, &loops), STATUS_OK);
    assert_true(steps > 0);
    return loops;
}

static void a_sphere_has_none(void **state) {
    (void)state;
    vec3 vertex[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    uint32_t triangle[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct mesh mesh = {.vertex_count = 4, .vertex = vertex, .triangle_count = 4, .triangle = triangle};
    struct loops loops = found(&mesh);
    assert_int_equal(loops.count, 0);
    loops_done(&loops);
}

/* The other way around takes 30 edges. */
static void a_thin_tube_has_one_around_it(void **state) {
    (void)state;
    struct mesh mesh = torus(5, 30);
    struct loops loops = found(&mesh);
    assert_int_equal(loops.count, 1);
    assert_int_equal(loops.loop[0].count, 5);
    for (uint32_t k = 0; k < 5; k++) assert_int_equal(loops.loop[0].vertex[k] / 5, loops.loop[0].vertex[0] / 5);
    loops_done(&loops), mesh_done(&mesh);
}

static void a_short_torus_has_one_each_way_and_both_at_once(void **state) {
    (void)state;
    struct mesh mesh = torus(4, 7);
    struct loops loops = found(&mesh);
    assert_int_equal(loops.count, 3);
    assert_int_equal(loops.loop[0].count, 4);
    assert_int_equal(loops.loop[1].count, 7);
    loops_done(&loops), mesh_done(&mesh);
}

static void long_loops_are_not_looked_for(void **state) {
    (void)state;
    struct mesh mesh = torus(LOOPS_MOST_EDGES + 1, LOOPS_MOST_EDGES + 2);
    struct loops loops = found(&mesh);
    assert_int_equal(loops.count, 0);
    loops_done(&loops), mesh_done(&mesh);
}

static void the_search_ends_with_its_steps(void **state) {
    (void)state;
    struct mesh mesh = torus(4, 7);
    struct loops loops = {0};
    size_t steps = 0;
    assert_int_equal(loops_find(&mesh, LOOPS_MOST_EDGES, &steps, &loops), STATUS_OK);
    assert_int_equal(loops.count, 0);
    steps = PLENTY;
    assert_int_equal(loops_find(&mesh, 4, &steps, &loops), STATUS_OK);
    assert_int_equal(loops.count, 1);
    assert_true(steps < PLENTY);
    loops_done(&loops), mesh_done(&mesh);
}

/* Neighbours on a loop are joined by an edge, and no vertex comes twice. */
static void loops_are_closed_paths_along_edges(void **state) {
    (void)state;
    struct mesh mesh = torus(6, 9);
    struct loops loops = found(&mesh);
    assert_true(loops.count > 0);
    for (size_t i = 0; i < loops.count; i++) {
        const struct loop *loop = &loops.loop[i];
        size_t joined = 0;
        for (uint32_t k = 0; k < loop->count; k++) {
            uint32_t a = loop->vertex[k], b = loop->vertex[(k + 1) % loop->count];
            for (size_t h = 0; h < 3 * mesh.triangle_count; h++) {
                uint32_t from = mesh.triangle[h / 3][h % 3], to = mesh.triangle[h / 3][(h + 1) % 3];
                joined += from == a && to == b;
            }
            for (uint32_t m = 0; m < k; m++) assert_int_not_equal(loop->vertex[m], a);
        }
        assert_int_equal(joined, loop->count);
    }
    loops_done(&loops), mesh_done(&mesh);
}

static void a_failing_allocation_is_told(void **state) {
    (void)state;
    struct mesh mesh = torus(4, 7);
    struct loops loops = {0};
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        size_t steps = PLENTY;
        faults_in_memory(nth + 1, false);
        enum status status = loops_find(&mesh, LOOPS_MOST_EDGES, &steps, &loops);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened == !loops.loop);
    }
    assert_true(nth > 8);
    loops_done(&loops), mesh_done(&mesh);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_sphere_has_none),
        cmocka_unit_test(a_thin_tube_has_one_around_it),
        cmocka_unit_test(a_short_torus_has_one_each_way_and_both_at_once),
        cmocka_unit_test(long_loops_are_not_looked_for),
        cmocka_unit_test(the_search_ends_with_its_steps),
        cmocka_unit_test(loops_are_closed_paths_along_edges),
        cmocka_unit_test(a_failing_allocation_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
