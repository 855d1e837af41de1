/* Edges of a grid on a folded sheet: along the fold, across it, and where the fold has no points.
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
#include "core/refine/follow_creases.h"
#include "tests/unit/faults.h"

enum { SIDE = 41, MIDDLE = SIDE / 2, POINTS = SIDE * SIDE, TRIANGLES = 2 * (SIDE - 1) * (SIDE - 1) };

/* Points of a grid, a roof of two planes that meet in the middle column, and its sheets. */
struct roof {
    struct mesh mesh;
    struct creases creases;
    vec3 *normal;
};

static const vec3 slope[2] = {{-0.6, 0, 0.8}, {0.6, 0, 0.8}};

static struct roof roof_new(void) {
    struct roof roof = {{POINTS, alloc_array(POINTS, sizeof(vec3)), alloc_array(POINTS, sizeof(uint32_t)), TRIANGLES,
                         alloc_array(TRIANGLES, sizeof *roof.mesh.triangle), NULL},
                        {alloc_array(POINTS, sizeof(uint32_t)), alloc_zeroed(1, sizeof(struct sheets)), SIDE, SIDE},
                        alloc_array(POINTS, sizeof(vec3))};
    for (uint32_t v = 0, t = 0; v < POINTS; v++) {
        uint32_t x = v % SIDE, y = v / SIDE;
        roof.mesh.vertex[v] = (vec3){x, y, -0.75 * abs((int)x - MIDDLE)};
        roof.mesh.source[v] = v;
        roof.normal[v] = x == MIDDLE ? (vec3){0, 0, 1} : slope[x > MIDDLE];
        roof.creases.of[v] = x == MIDDLE ? 0 : UINT32_MAX;
        if (x + 1 == SIDE || y + 1 == SIDE) continue;
        memcpy(roof.mesh.triangle[t++], (uint32_t[3]){v, v + 1, v + SIDE + 1}, sizeof *roof.mesh.triangle);
        memcpy(roof.mesh.triangle[t++], (uint32_t[3]){v, v + SIDE + 1, v + SIDE}, sizeof *roof.mesh.triangle);
    }
    roof.creases.at[0].count = 2;
    for (int k = 0; k < 2; k++) {
        roof.creases.at[0].normal[k][0] = (float)slope[k].x;
        roof.creases.at[0].normal[k][2] = (float)slope[k].z;
    }
    return roof;
}

static void roof_done(struct roof *roof) {
    mesh_done(&roof->mesh), creases_done(&roof->creases);
    free(roof->normal);
}

/* Turns the edge of the fold from row y to the next across it: the triangles beside it share what joins their tips. */
static void turn_across(struct roof *roof, uint32_t y) {
    uint32_t a = y * SIDE + MIDDLE, b = a + SIDE, left = a - 1, right = b + 1;
    uint32_t *west = NULL, *east = NULL;
    for (size_t t = 0; t < TRIANGLES; t++) {
        uint32_t *corner = roof->mesh.triangle[t];
        bool has[4] = {false};
        for (int k = 0; k < 3; k++)
            has[0] |= corner[k] == a, has[1] |= corner[k] == b, has[2] |= corner[k] == left,
                has[3] |= corner[k] == right;
        if (has[0] && has[1] && has[2]) west = corner;
        if (has[0] && has[1] && has[3]) east = corner;
    }
    assert_true(west && east);
    memcpy(west, (uint32_t[3]){a, right, left}, sizeof *roof->mesh.triangle);
    memcpy(east, (uint32_t[3]){right, b, left}, sizeof *roof->mesh.triangle);
}

static double area_of(const struct mesh *mesh) {
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    assert_true(facts.manifold);
    return facts.area;
}

static void what_runs_across_a_fold_is_flipped(void **state) {
    (void)state;
    struct roof roof = roof_new(), right = roof_new();
    size_t flips = 0;
    turn_across(&roof, 5), turn_across(&roof, 20);
    assert_true(area_of(&roof.mesh) > area_of(&right.mesh) + 1);
    assert_int_equal(follow_creases(&roof.mesh, &roof.creases, roof.normal, &flips), STATUS_OK);
    assert_int_equal(flips, 2);
    assert_true(fabs(area_of(&roof.mesh) - area_of(&right.mesh)) < 1e-9);
    roof_done(&roof), roof_done(&right);
}

static void what_follows_the_sheets_stays(void **state) {
    (void)state;
    struct roof roof = roof_new(), right = roof_new();
    size_t flips = 1;
    assert_int_equal(follow_creases(&roof.mesh, &roof.creases, roof.normal, &flips), STATUS_OK);
    assert_int_equal(flips, 0);
    assert_memory_equal(roof.mesh.triangle, right.mesh.triangle, TRIANGLES * sizeof *roof.mesh.triangle);
    roof_done(&roof), roof_done(&right);
}

/* Of forty-one points on the crease three edges are too many to be mistakes. */
static void many_edges_across_are_no_mistake(void **state) {
    (void)state;
    struct roof roof = roof_new();
    size_t flips = 1;
    for (uint32_t y = 4; y < 36; y += 8) turn_across(&roof, y);
    double area = area_of(&roof.mesh);
    assert_int_equal(follow_creases(&roof.mesh, &roof.creases, roof.normal, &flips), STATUS_OK);
    assert_int_equal(flips, 0);
    assert_true(area_of(&roof.mesh) == area);
    roof_done(&roof);
}

static void failures_leave_the_mesh_as_it_was(void **state) {
    (void)state;
    struct roof roof = roof_new();
    turn_across(&roof, 5);
    double area = area_of(&roof.mesh);
    enum status status = STATUS_NO_MEMORY;
    size_t failures = 0;
    while (status) {
        faults_in_memory((long)failures + 1, false);
        status = follow_creases(&roof.mesh, &roof.creases, roof.normal, NULL);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true((area_of(&roof.mesh) == area) == failed);
        failures += failed;
    }
    assert_true(failures > 4);
    roof_done(&roof);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_runs_across_a_fold_is_flipped),
        cmocka_unit_test(what_follows_the_sheets_stays),
        cmocka_unit_test(many_edges_across_are_no_mistake),
        cmocka_unit_test(failures_leave_the_mesh_as_it_was),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
