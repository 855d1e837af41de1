/* The sheets that meet at the points of a cube, and where there are none.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/simplify/normals.h"
#include "core/spatial/sheets.h"
#include "tests/unit/dense.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { SIDE = 12 };

static struct dense cube(double shift) {
    size_t n;
    vec3 *point = shape_cube(SIDE, shift, &n);
    struct dense dense = dense_new(n);
    memcpy(dense.point, point, n * sizeof *point);
    free(point);
    return dense;
}

static int faces_of(vec3 p) {
    const double most = (double)(SIDE - 1) / SIDE;
    return (p.x <= 0 || p.x >= most) + (p.y <= 0 || p.y >= most) + (p.z <= 0 || p.z >= most);
}

static struct creases creases_of(const struct dense *dense, bool noisy) {
    struct neighbourhood neighbours = dense_neighbourhood(dense);
    struct creases creases = {.of = NULL};
    normals_fit(dense->point, &neighbours, 1, dense->normal, NULL);
    neighbours.noisy = noisy;
    assert_int_equal(creases_find(dense->point, dense->normal, &neighbours, 2, &creases), STATUS_OK);
    neighbourhood_done(&neighbours);
    return creases;
}

/* Of each sheet, whether it is a face of a cube. */
static bool are_faces(const struct sheets *sheets) {
    for (unsigned k = 0; k < sheets->count; k++) {
        vec3 normal = sheets_normal(sheets, k);
        if (fmax(fmax(fabs(normal.x), fabs(normal.y)), fabs(normal.z)) < 0.999) return false;
    }
    return true;
}

/* An edge has two sheets and a corner three; hardly any point has others than the faces that it is on. */
static void edges_of_a_cube_are_creases(void **state) {
    (void)state;
    struct dense dense = cube(0.2);
    struct creases creases = creases_of(&dense, false);
    size_t edges = 0, found = 0, others = 0;
    for (uint32_t p = 0; p < dense.n; p++) {
        const struct sheets *sheets = creases_at(&creases, p);
        int faces = faces_of(dense.point[p]);
        edges += faces > 1;
        if (!sheets) continue;
        assert_true(sheets->count > 0);
        others += (int)sheets->count > faces || !are_faces(sheets);
        found += faces > 1 && (int)sheets->count == faces;
    }
    print_message("    %zu points on edges, %zu found, %zu of %zu others\n", edges, found, others, dense.n);
    assert_true(100 * others < dense.n);
    assert_true(edges == 12 * (SIDE - 2) + 8 && 10 * found > 9 * edges);
    assert_true(creases_matter(&creases, dense.n));
    creases_done(&creases);
    dense_done(&dense);
}

static void a_direction_along_a_sheet_is_held(void **state) {
    (void)state;
    struct sheets sheets = {2, {{1, 0, 0}, {0, 1, 0}}};
    assert_true(sheets_hold(&sheets, (vec3){0, 0.6, 0.8}) && sheets_hold(&sheets, (vec3){0.6, 0, 0.8}));
    assert_false(sheets_hold(&sheets, (vec3){0.6, 0.8, 0}));
    assert_true(fabs(sheets_agreement(&sheets, (vec3){-0.8, 0.6, 0}) - 0.8) < 1e-6);
    assert_true(sheets_agreement(&sheets, (vec3){0, 0, 1}) < 1e-6);
}

static void a_smooth_or_noisy_surface_has_none(void **state) {
    (void)state;
    struct dense dense = dense_new(2000), edged = cube(0);
    vec3 *sphere = shape_sphere(dense.n, 0.3);
    for (size_t i = 0; i < dense.n; i++) dense.point[i] = sphere[i];
    struct creases smooth = creases_of(&dense, false), noisy = creases_of(&edged, true);
    for (uint32_t p = 0; p < dense.n; p++) assert_null(creases_at(&smooth, p));
    for (uint32_t p = 0; p < edged.n; p++) assert_null(creases_at(&noisy, p));
    assert_false(creases_matter(&smooth, dense.n) || creases_matter(&noisy, edged.n) || creases_matter(NULL, 1));
    creases_done(&smooth), creases_done(&noisy);
    free(sphere);
    dense_done(&dense), dense_done(&edged);
}

/* Each failed allocation leaves the creases as they were. */
static void without_memory_nothing_is_found(void **state) {
    (void)state;
    struct dense dense = cube(0);
    struct neighbourhood neighbours = dense_neighbourhood(&dense);
    struct creases creases = {.of = NULL};
    normals_fit(dense.point, &neighbours, 1, dense.normal, NULL);
    long failed = 0;
    for (bool happened = true; happened; failed += happened) {
        faults_in_memory(failed + 1, false);
        enum status status = creases_find(dense.point, dense.normal, &neighbours, 1, &creases);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(!happened == (creases.of != NULL));
    }
    assert_int_equal(failed, 2);
    creases_done(&creases);
    neighbourhood_done(&neighbours);
    dense_done(&dense);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(edges_of_a_cube_are_creases),
        cmocka_unit_test(a_direction_along_a_sheet_is_held),
        cmocka_unit_test(a_smooth_or_noisy_surface_has_none),
        cmocka_unit_test(without_memory_nothing_is_found),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
