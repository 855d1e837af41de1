/* Handles that are cut, and pieces that are left out: the small ones first, no more than asked for.
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
#include "core/mesh/cut.h"
#include "core/mesh/intersect.h"
#include "core/pipeline/topology.h"
#include "tests/unit/faults.h"

enum { AROUND = 6, ALONG = 40, RING = AROUND * ALONG, SHELL = 4 };

/* How wide the tube is: narrow at its first circle alone, as a bridge between sheets that touch is. */
static double width_at(uint32_t i, uint32_t along) {
    uint32_t off = i < along - i ? i : along - i;
    return fmin(1, 0.3 * pow(1.5, off));
}

/* A ring, `around` points about its tube, and so many tetrahedra beside it. */
static struct mesh ring_mesh(uint32_t around, uint32_t along, uint32_t shells) {
    uint32_t vertices = around * along + SHELL * shells, triangles = 2 * around * along + SHELL * shells;
    struct mesh mesh = {.vertex = alloc_array(vertices, sizeof *mesh.vertex),
                        .source = alloc_array(vertices, sizeof *mesh.source),
                        .triangle = alloc_array(triangles, sizeof *mesh.triangle),
                        .tag = alloc_zeroed(triangles, 1)};
    assert_true(mesh.vertex && mesh.source && mesh.triangle && mesh.tag);
    for (uint32_t i = 0; i < along; i++)
        for (uint32_t j = 0; j < around; j++) {
            double u = 2 * M_PI * i / along, w = 2 * M_PI * j / around, width = width_at(i, along);
            double r = 3 + width * cos(w);
            uint32_t a = i * around + j, b = (i + 1) % along * around + j, j1 = (j + 1) % around;
            uint32_t c = (i + 1) % along * around + j1, d = i * around + j1;
            mesh.vertex[mesh.vertex_count++] = (vec3){r * cos(u), r * sin(u), width * sin(w)};
            memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[3]){a, b, c}, sizeof *mesh.triangle);
            memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[3]){a, c, d}, sizeof *mesh.triangle);
        }
    static const uint32_t side[SHELL][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    for (uint32_t s = 0; s < shells; s++) {
        uint32_t first = (uint32_t)mesh.vertex_count;
        for (uint32_t k = 0; k < SHELL; k++)
            mesh.vertex[mesh.vertex_count++] = (vec3){6 + s + 0.5 * (k == 1), 0.5 * (k == 2), 0.5 * (k == 3)};
        for (uint32_t t = 0; t < SHELL; t++, mesh.triangle_count++)
            for (int k = 0; k < 3; k++) mesh.triangle[mesh.triangle_count][k] = first + side[t][k];
    }
    for (uint32_t v = 0; v < vertices; v++) mesh.source[v] = 10 + v;
    return mesh;
}

static struct topology topology_of(const struct mesh *mesh) {
    struct topology topology;
    struct mesh_facts facts;
    assert_int_equal(topology_find(mesh, &topology), STATUS_OK);
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    assert_true(facts.watertight && facts.manifold && facts.volume > 0);
    assert_int_equal(facts.unused_vertices, 0);
    return topology;
}

static struct topology simplify_with(struct mesh *mesh, size_t components, long handles, bool bars) {
    const struct topology than = {.components = components, .handles = handles};
    struct topology topology = topology_of(mesh), found;
    assert_int_equal(topology_simplify(mesh, &than, bars, 1, &topology), STATUS_OK);
    found = topology_of(mesh);
    assert_int_equal(found.components, topology.components);
    assert_int_equal(found.handles, topology.handles);
    return topology;
}

static struct topology simplify(struct mesh *mesh, size_t components, long handles) {
    return simplify_with(mesh, components, handles, false);
}

/* Around the tube: the path is there twice, with a middle each. */
static void a_cut_tube_has_a_disc_on_both_sides(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(AROUND, ALONG, 0);
    struct halfedge he;
    uint32_t vertex[AROUND];
    for (uint32_t j = 0; j < AROUND; j++) vertex[j] = 3 * AROUND + j;
    const struct mesh_path path = {vertex, AROUND};
    size_t pairs = 1;
    assert_int_equal(halfedge_init(&he, &mesh, 1), STATUS_OK);
    assert_int_equal(mesh_cut(&mesh, &he, &path, 1), STATUS_OK);
    assert_int_equal(mesh.vertex_count, RING + AROUND + 2);
    assert_int_equal(mesh.triangle_count, 2 * RING + 2 * AROUND);
    struct topology topology = topology_of(&mesh);
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.handles, 0);
    for (size_t t = 0; t < mesh.triangle_count; t++) {
        assert_int_equal(mesh.tag[t], t < 2 * RING ? MESH_SUPPORTED : MESH_HOLE_FILL);
        if (t >= 2 * RING) assert_int_equal(mesh.source[mesh.triangle[t][2]], NONE);
    }
    assert_int_equal(mesh_count_intersections(&mesh, 1, &pairs), STATUS_OK);
    assert_int_equal(pairs, 0);
    halfedge_done(&he), mesh_done(&mesh);
}

static void small_handles_and_shells_go(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(AROUND, ALONG, 0);
    struct topology topology = simplify_with(&mesh, 1, 0, true);
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.handles, 0);
    mesh_done(&mesh);
    mesh = ring_mesh(2 * AROUND, 4 * ALONG, 3);
    topology = simplify(&mesh, 1, 0);
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.handles, 0);
    assert_int_equal(mesh.vertex_count, 4 * 2 * RING + 2 * AROUND + 2);
    mesh_done(&mesh);
}

/* Rings of the tube are near each other but for the last and the first, which is the narrowest: there it is cut, and
 * the wall from the one to the other goes, with no point lost. */
static void a_wall_without_points_goes_with_the_handle(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(AROUND, ALONG, 0);
    for (uint32_t v = 0; v < RING; v++) {
        double u = 0.75 * 2 * M_PI * (v / AROUND) / ALONG, w = 2 * M_PI * (v % AROUND) / AROUND;
        double width = v < AROUND ? 0.8 : 1, r = 3 + width * cos(w);
        mesh.vertex[v] = (vec3){r * cos(u), r * sin(u), width * sin(w)};
    }
    struct topology topology = simplify(&mesh, 1, 0);
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.handles, 0);
    assert_int_equal(mesh.vertex_count, RING + 1);
    for (size_t t = 0; t < mesh.triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            const uint32_t *v = mesh.triangle[t];
            assert_true(vec3_distance(mesh.vertex[v[k]], mesh.vertex[v[(k + 1) % 3]]) < 2.1);
        }
    mesh_done(&mesh);
}

/* The same tube as wide everywhere, as a bar is. */
static void bars_stay(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(AROUND, ALONG, 0);
    for (uint32_t v = 0; v < RING; v++) {
        double u = 2 * M_PI * (v / AROUND) / ALONG, w = 2 * M_PI * (v % AROUND) / AROUND, r = 3 + 0.4 * cos(w);
        mesh.vertex[v] = (vec3){r * cos(u), r * sin(u), 0.4 * sin(w)};
    }
    struct topology topology = simplify_with(&mesh, 1, 0, true), counted = topology_of(&mesh);
    const struct topology ball = {.components = 1};
    assert_int_equal(topology.components, 1);
    assert_int_equal(topology.handles, 1);
    assert_int_equal(topology.tubes, 1);
    assert_true(topology_is_simpler(&topology, &ball));
    assert_int_equal(topology_count_tubes(&mesh, &counted), STATUS_OK);
    assert_int_equal(counted.tubes, 1);
    mesh_done(&mesh);
    mesh = ring_mesh(AROUND, ALONG, 0);
    counted = topology_of(&mesh);
    assert_int_equal(topology_count_tubes(&mesh, &counted), STATUS_OK);
    assert_int_equal(counted.tubes, 0);
    mesh_done(&mesh);
}

static void no_more_go_than_asked_for(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(2 * AROUND, 4 * ALONG, 3);
    size_t vertices = mesh.vertex_count;
    struct topology topology = simplify(&mesh, 3, 1);
    assert_int_equal(topology.components, 3);
    assert_int_equal(topology.handles, 1);
    assert_int_equal(mesh.vertex_count, vertices - SHELL);
    mesh_done(&mesh);
}

/* However many pieces there may be, hollows of four corners aren't told by points; pieces beside the body are. */
static void crumbs_of_air_go(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(2 * AROUND, 4 * ALONG, 3);
    size_t vertices = mesh.vertex_count;
    for (size_t t = mesh.triangle_count - 2 * SHELL; t < mesh.triangle_count; t++) {
        uint32_t *corner = mesh.triangle[t], first = corner[0];
        corner[0] = corner[1], corner[1] = first;
    }
    struct topology topology = simplify(&mesh, 4, 1);
    assert_int_equal(topology.components, 2);
    assert_int_equal(topology.handles, 1);
    assert_int_equal(mesh.vertex_count, vertices - 2 * SHELL);
    mesh_done(&mesh);
}

/* A handle that takes more than twelve edges to go around, and pieces that hold much of the vertices. */
static void what_is_large_stays(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(3 * AROUND, ALONG, 5);
    const struct topology ball = {.components = 1};
    struct topology topology = simplify(&mesh, 1, 0);
    assert_int_equal(topology.handles, 1);
    assert_int_equal(topology.components, 5);
    assert_false(topology_is_simpler(&topology, &ball));
    assert_true(topology_may_be_right(&topology, &ball));
    mesh_done(&mesh);
}

/* A mesh as it was found, with handles that nobody has tried to take away. */
static void what_is_not_known_to_be_wide_may_not_be_right(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(AROUND, ALONG, 0);
    const struct topology topology = topology_of(&mesh), ball = {.components = 1};
    assert_false(topology_may_be_right(&topology, &ball));
    mesh_done(&mesh);
}

static void failures_leave_a_sound_mesh(void **state) {
    (void)state;
    const struct topology than = {.components = 1};
    enum status status = STATUS_NO_MEMORY;
    size_t failures = 0;
    for (size_t nth = 0; status; nth++) {
        struct mesh mesh = ring_mesh(2 * AROUND, 4 * ALONG, 2);
        struct topology topology = topology_of(&mesh);
        faults_in_memory((long)nth + 1, false);
        status = topology_simplify(&mesh, &than, true, 1, &topology);
        bool failed = faults_stop();
        assert_int_equal(status, failed ? STATUS_NO_MEMORY : STATUS_OK);
        failures += failed;
        topology_of(&mesh);
        mesh_done(&mesh);
    }
    assert_true(failures > 10);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_cut_tube_has_a_disc_on_both_sides),
        cmocka_unit_test(small_handles_and_shells_go),
        cmocka_unit_test(a_wall_without_points_goes_with_the_handle),
        cmocka_unit_test(bars_stay),
        cmocka_unit_test(no_more_go_than_asked_for),
        cmocka_unit_test(crumbs_of_air_go),
        cmocka_unit_test(what_is_large_stays),
        cmocka_unit_test(what_is_not_known_to_be_wide_may_not_be_right),
        cmocka_unit_test(failures_leave_a_sound_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
