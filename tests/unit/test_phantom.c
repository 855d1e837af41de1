/* Surface that isn't there, on spheres of a grid of points, with a dent or without an end.
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
#include "core/measure/phantom.h"
#include "tests/unit/faults.h"

enum { ALONG = 60, RINGS = 30, VERTICES = ALONG * RINGS, TRIANGLES = 2 * ALONG * (RINGS - 1) };

/* Rings from near one pole to near the other; those under `floor` lie on the plane at that height. */
static struct mesh sphere_mesh(double floor) {
    struct mesh mesh = {VERTICES,  alloc_array(VERTICES, sizeof *mesh.vertex),    NULL,
                        TRIANGLES, alloc_array(TRIANGLES, sizeof *mesh.triangle), NULL};
    assert_true(mesh.vertex && mesh.triangle);
    for (uint32_t v = 0, t = 0; v < VERTICES; v++) {
        double w = M_PI * (v / ALONG + 0.5) / RINGS, u = 2 * M_PI * (v % ALONG) / ALONG;
        mesh.vertex[v] = (vec3){0.3 * sin(w) * cos(u), 0.3 * sin(w) * sin(u), fmax(floor, 0.3 * cos(w))};
        if (v / ALONG + 1 == RINGS) continue;
        uint32_t next = v / ALONG * ALONG + (v + 1) % ALONG;
        memcpy(mesh.triangle[t++], (uint32_t[3]){v, v + ALONG, next}, sizeof *mesh.triangle);
        memcpy(mesh.triangle[t++], (uint32_t[3]){next, v + ALONG, next + ALONG}, sizeof *mesh.triangle);
    }
    return mesh;
}

/* The points of a sphere's mesh that are over a height. */
struct scan {
    struct metro_reference reference;
    vec3 *point, *normal;
    float *spacing;
    struct knn *knn;
};

static struct scan scan_of(double floor) {
    struct mesh mesh = sphere_mesh(-1);
    struct scan scan = {{0},
                        mesh.vertex,
                        alloc_array(VERTICES, sizeof *scan.normal),
                        alloc_array(VERTICES, sizeof *scan.spacing),
                        NULL};
    size_t n = 0;
    for (size_t v = 0; v < VERTICES; v++)
        if (mesh.vertex[v].z > floor) scan.point[n++] = mesh.vertex[v];
    for (size_t i = 0; i < n; i++) scan.normal[i] = vec3_unit(scan.point[i]), scan.spacing[i] = 0.03f;
    assert_int_equal(knn_new(scan.point, n, 1, &scan.knn, NULL), STATUS_OK);
    scan.reference = (struct metro_reference){n, scan.point, scan.normal, scan.spacing, scan.knn, NULL};
    mesh.vertex = NULL;
    mesh_done(&mesh);
    return scan;
}

static void scan_done(struct scan *scan) {
    knn_free(scan->knn);
    free(scan->point), free(scan->normal), free(scan->spacing);
}

static bool is_more(const struct mesh *mesh, const struct mesh *other, const struct scan *scan) {
    const struct metro_options options = {.seed = 1, .threads = 1};
    bool more = false;
    assert_int_equal(phantom_is_more(mesh, other, &scan->reference, &options, &more), STATUS_OK);
    return more;
}

/* The end is cut off at .2, and the points say that it isn't. */
static void what_neither_points_nor_the_other_have_is_phantom(void **state) {
    (void)state;
    struct mesh whole = sphere_mesh(-1), cut = sphere_mesh(-0.2);
    struct scan scan = scan_of(-1);
    assert_true(is_more(&cut, &whole, &scan));
    assert_false(is_more(&whole, &cut, &scan));
    mesh_done(&whole), mesh_done(&cut), scan_done(&scan);
}

/* What three places have is too little to be sure of. */
static void as_few_places_as_asked_are_looked_at(void **state) {
    (void)state;
    struct mesh whole = sphere_mesh(-1), cut = sphere_mesh(-0.2);
    struct scan scan = scan_of(-1);
    struct metro_options options = {.samples = 3, .seed = 1, .threads = 1};
    bool more = true;
    assert_int_equal(phantom_is_more(&cut, &whole, &scan.reference, &options, &more), STATUS_OK);
    assert_false(more);
    options.samples = 300;
    assert_int_equal(phantom_is_more(&cut, &whole, &scan.reference, &options, &more), STATUS_OK);
    assert_true(more);
    mesh_done(&whole), mesh_done(&cut), scan_done(&scan);
}

/* It stood on a table: both have the flat end, where no points are, one with wrinkles and so more area. */
static void what_both_have_is_none(void **state) {
    (void)state;
    struct mesh mesh = sphere_mesh(-0.2), other = sphere_mesh(-0.2);
    struct scan scan = scan_of(-0.2);
    for (size_t v = 0; v < VERTICES; v++)
        if (mesh.vertex[v].z <= -0.2) mesh.vertex[v].z += v / ALONG % 2 ? 0.012 : -0.012;
    assert_false(is_more(&mesh, &other, &scan));
    assert_false(is_more(&other, &mesh, &scan));
    mesh_done(&mesh), mesh_done(&other), scan_done(&scan);
}

/* Far from the points, but the other mesh is as far from them in as many places. */
static void as_much_as_the_other_has_is_not_more(void **state) {
    (void)state;
    struct mesh mesh = sphere_mesh(-0.2), other = sphere_mesh(-0.2);
    struct scan scan = scan_of(-1);
    for (size_t v = 0; v < VERTICES; v++) other.vertex[v].z *= -1;
    for (size_t t = 0; t < TRIANGLES; t++) {
        uint32_t first = other.triangle[t][0];
        other.triangle[t][0] = other.triangle[t][1], other.triangle[t][1] = first;
    }
    assert_false(is_more(&mesh, &other, &scan));
    assert_false(is_more(&other, &mesh, &scan));
    mesh_done(&mesh), mesh_done(&other), scan_done(&scan);
}

static double depth_of(const struct mesh *mesh, const struct mesh *other, const struct scan *scan) {
    const struct metro_options options = {.seed = 1, .threads = 1};
    struct phantom_depth depth = {NAN, NAN};
    assert_int_equal(phantom_depth(mesh, other, &scan->reference, &options, &depth), STATUS_OK);
    assert_true(depth.mean >= 0 && depth.mean <= depth.rms);
    return depth.rms;
}

/* Where the end is cut off, the cut is far from the points and the other mesh; where it stood on a table, both have the
 * flat end that no points are on. */
static void depth_is_of_what_the_other_does_not_have(void **state) {
    (void)state;
    struct mesh whole = sphere_mesh(-1), cut = sphere_mesh(-0.2), same = sphere_mesh(-0.2);
    struct scan all = scan_of(-1), upper = scan_of(-0.2);
    double alone = depth_of(&cut, &whole, &all), shared = depth_of(&cut, &same, &upper);
    assert_true(alone > 0.01 && alone < 0.1);
    assert_true(shared < 1e-9);
    assert_true(depth_of(&whole, &cut, &all) < 0.1 * alone);
    mesh_done(&whole), mesh_done(&cut), mesh_done(&same), scan_done(&all), scan_done(&upper);
}

/* One vertex of 1 800 stands out by a tenth of the diagonal. */
static void a_spike_counts_by_its_length(void **state) {
    (void)state;
    struct mesh whole = sphere_mesh(-1), spike = sphere_mesh(-1);
    struct scan scan = scan_of(-1);
    double plain = depth_of(&whole, &spike, &scan), last = plain;
    for (int i = 1; i <= 2; i++) {
        vec3 *tip = &spike.vertex[VERTICES / 2];
        *tip = vec3_add(*tip, vec3_scale(vec3_unit(*tip), 0.1));
        double depth = depth_of(&spike, &whole, &scan);
        assert_true(depth > last + 0.5 * plain);
        last = depth;
    }
    mesh_done(&whole), mesh_done(&spike), scan_done(&scan);
}

static void failures_are_told(void **state) {
    (void)state;
    struct mesh whole = sphere_mesh(-1), cut = sphere_mesh(-0.2);
    struct scan scan = scan_of(-1);
    const struct metro_options options = {.seed = 1, .threads = 1};
    enum status status = STATUS_NO_MEMORY;
    size_t failures = 0;
    while (status) {
        bool more = false;
        faults_in_memory((long)failures + 1, false);
        status = phantom_is_more(&cut, &whole, &scan.reference, &options, &more);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(more == !failed);
        failures += failed;
    }
    assert_true(failures > 10);
    mesh_done(&whole), mesh_done(&cut), scan_done(&scan);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_neither_points_nor_the_other_have_is_phantom),
        cmocka_unit_test(as_few_places_as_asked_are_looked_at),
        cmocka_unit_test(what_both_have_is_none),
        cmocka_unit_test(as_much_as_the_other_has_is_not_more),
        cmocka_unit_test(depth_is_of_what_the_other_does_not_have),
        cmocka_unit_test(a_spike_counts_by_its_length),
        cmocka_unit_test(failures_are_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
