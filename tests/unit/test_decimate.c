/* Collapsing edges down to a count: topology stays, vertices are a subset, sources follow.
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
#include "core/mesh/decimate.h"
#include "tests/unit/faults.h"

enum { AROUND = 36, TUBE = 18, VERTICES = AROUND * TUBE, TRIANGLES = 2 * VERTICES };

/* A ring whose tube is `thin` times as wide as it is high; sources are other numbers than those of the vertices. */
static struct mesh ring_mesh(double thin) {
    struct mesh mesh = {.vertex_count = VERTICES, .triangle_count = TRIANGLES};
    mesh.vertex = alloc_array(VERTICES, sizeof *mesh.vertex);
    mesh.source = alloc_array(VERTICES, sizeof *mesh.source);
    mesh.triangle = alloc_array(TRIANGLES, sizeof *mesh.triangle);
    mesh.tag = alloc_zeroed(TRIANGLES, 1);
    assert_true(mesh.vertex && mesh.source && mesh.triangle && mesh.tag);
    for (uint32_t v = 0, t = 0; v < VERTICES; v++) {
        uint32_t i = v / TUBE, j = v % TUBE, i1 = (i + 1) % AROUND, j1 = (j + 1) % TUBE;
        double u = 6.283185307 * i / AROUND, w = 6.283185307 * j / TUBE, radius = 0.3 + 0.1 * cos(w);
        mesh.vertex[v] = (vec3){radius * cos(u), radius * sin(u), 0.1 / thin * sin(w)};
        mesh.source[v] = 7 + 3 * v;
        uint32_t a = i * TUBE + j, b = i1 * TUBE + j, c = i1 * TUBE + j1, d = i * TUBE + j1;
        memcpy(mesh.triangle[t++], (uint32_t[3]){a, b, c}, sizeof *mesh.triangle);
        memcpy(mesh.triangle[t++], (uint32_t[3]){a, c, d}, sizeof *mesh.triangle);
    }
    return mesh;
}

static struct mesh_facts facts_of(const struct mesh *mesh) {
    struct mesh_facts facts;
    assert_int_equal(mesh_examine(mesh, &facts), STATUS_OK);
    return facts;
}

/* Down to a fifth a ring stays a ring, with nearly its volume, however thin it is. */
static void test_topology_stays(void **state) {
    (void)state;
    static const double thin[] = {1, 5, 25};
    for (int i = 0; i < 3; i++) {
        struct mesh mesh = ring_mesh(thin[i]), whole = ring_mesh(thin[i]);
        assert_int_equal(mesh_decimate(&mesh, NULL, VERTICES / 5), STATUS_OK);
        struct mesh_facts facts = facts_of(&mesh);
        assert_int_equal(mesh.vertex_count, VERTICES / 5);
        assert_int_equal(mesh.triangle_count, 2 * mesh.vertex_count);
        assert_true(facts.watertight && facts.manifold);
        assert_int_equal(facts.components, 1);
        assert_int_equal(facts.euler, 0);
        assert_int_equal(facts.unused_vertices, 0);
        assert_true(facts.volume > 0.75 * facts_of(&whole).volume && facts.volume < 1.05 * facts_of(&whole).volume);
        mesh_done(&mesh), mesh_done(&whole);
    }
}

static void test_vertices_are_a_subset(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1), whole = ring_mesh(1);
    assert_int_equal(mesh_decimate(&mesh, NULL, 100), STATUS_OK);
    for (size_t v = 0; v < mesh.vertex_count; v++) {
        uint32_t was = (mesh.source[v] - 7) / 3;
        assert_true(vec3_equal(mesh.vertex[v], whole.vertex[was]));
        assert_true(v == 0 || mesh.source[v] > mesh.source[v - 1]);
    }
    mesh_done(&mesh), mesh_done(&whole);
}

/* However few vertices are asked for, as many stay as the topology takes. */
static void test_it_ends_where_nothing_can_go(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1);
    assert_int_equal(mesh_decimate(&mesh, NULL, 1), STATUS_OK);
    struct mesh_facts facts = facts_of(&mesh);
    assert_true(facts.watertight && facts.manifold);
    assert_int_equal(facts.euler, 0);
    assert_true(mesh.vertex_count >= 7 && mesh.vertex_count < VERTICES / 5);
    mesh_done(&mesh);
}

static void test_enough_is_left_alone(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1), whole = ring_mesh(1);
    assert_int_equal(mesh_decimate(&mesh, NULL, VERTICES), STATUS_OK);
    assert_int_equal(mesh.vertex_count, VERTICES);
    assert_memory_equal(mesh.triangle, whole.triangle, TRIANGLES * sizeof *mesh.triangle);
    mesh_done(&mesh), mesh_done(&whole);
}

/* Vertices of a border stay where they are. */
static void test_border_stays(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1), whole = ring_mesh(1);
    mesh.triangle_count -= (size_t)2 * TUBE; /* cut through */
    struct mesh_facts before = facts_of(&mesh);
    assert_int_equal(mesh_decimate(&mesh, NULL, 150), STATUS_OK);
    struct mesh_facts after = facts_of(&mesh);
    assert_int_equal(before.boundary_edges, after.boundary_edges);
    assert_true(fabs(before.border_length - after.border_length) < 1e-12);
    assert_true(after.manifold && after.euler == before.euler);
    assert_int_equal(mesh.vertex_count, 150);
    mesh_done(&mesh), mesh_done(&whole);
}

static const struct decimate_rules given = {.borders = true, .slivers = true};

/* A border is merged along itself where the rules say so, and keeps its course. */
static void test_border_is_merged_along_itself(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1);
    mesh.triangle_count -= (size_t)2 * TUBE;
    struct mesh_facts before = facts_of(&mesh);
    assert_int_equal(mesh_decimate(&mesh, &given, 150), STATUS_OK);
    struct mesh_facts after = facts_of(&mesh);
    assert_true(after.boundary_edges < before.boundary_edges && after.borders == before.borders);
    assert_true(fabs(before.border_length - after.border_length) < 0.1 * before.border_length);
    assert_true(after.manifold && after.euler == before.euler);
    assert_int_equal(mesh.vertex_count, 150);
    mesh_done(&mesh);
}

/* Corners on either side of a seam have records of their own, also where it is merged along itself; where a seam ends a
 * vertex stays. */
static void test_seam_stays_between_its_sides(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1);
    uint32_t(*record)[3] = alloc_array(TRIANGLES, sizeof *record);
    assert_non_null(record);
    for (uint32_t t = 0; t < TRIANGLES; t++)
        for (int k = 0; k < 3; k++) { /* half of the ring has another picture */
            bool half = t / (2 * TUBE) < AROUND / 2;
            record[t][k] = mesh.triangle[t][k] + (half ? 1000 : 0);
        }
    struct decimate_rules rules = given;
    rules.record = record;
    assert_int_equal(mesh_decimate(&mesh, &rules, 120), STATUS_OK);
    assert_int_equal(mesh.vertex_count, 120);
    size_t on_seams = 0;
    for (size_t v = 0; v < mesh.vertex_count; v++) {
        uint32_t was = (mesh.source[v] - 7) / 3, column = was / TUBE;
        on_seams += column == 0 || column == AROUND / 2;
    }
    assert_true(on_seams > 6 && on_seams < (size_t)2 * TUBE);
    for (size_t t = 0; t < mesh.triangle_count; t++)
        for (int k = 0; k < 3; k++) {
            uint32_t was = (mesh.source[mesh.triangle[t][k]] - 7) / 3, column = was / TUBE;
            assert_int_equal(record[t][k] % 1000, was);
            assert_int_equal(record[t][k] >= 1000, record[t][0] >= 1000);
            if (column > 0 && column < AROUND / 2) assert_true(record[t][k] >= 1000);
            if (column > AROUND / 2) assert_true(record[t][k] < 1000);
        }
    assert_true(facts_of(&mesh).watertight);
    free(record);
    mesh_done(&mesh);
}

/* Where vertices may move, a ring keeps its volume: what went inside of it here is outside of it there. */
static void test_what_moves_keeps_the_volume(void **state) {
    (void)state;
    struct decimate_rules rules = given;
    rules.moves = true;
    for (size_t count = 200; count > 50; count = 2 * count / 3) {
        struct mesh mesh = ring_mesh(1), whole = ring_mesh(1);
        assert_int_equal(mesh_decimate(&mesh, &rules, count), STATUS_OK);
        assert_int_equal(mesh.vertex_count, count);
        assert_true(facts_of(&mesh).watertight && facts_of(&mesh).euler == 0);
        assert_true(fabs(facts_of(&mesh).volume / facts_of(&whole).volume - 1) < 0.005);
        mesh_done(&mesh), mesh_done(&whole);
    }
}

/* A ball of few triangles with a thin horn of many: a surface of revolution about z, from z = -0.3 to 0.7. */
static struct mesh horn_mesh(void) {
    enum { SIDES = 12, BALL = 8, HORN = 24, RINGS = BALL + HORN };
    struct mesh mesh = {.vertex_count = RINGS * SIDES + 2, .triangle_count = 2 * RINGS * SIDES};
    mesh.vertex = alloc_array(mesh.vertex_count, sizeof *mesh.vertex);
    mesh.triangle = alloc_array(mesh.triangle_count, sizeof *mesh.triangle);
    assert_true(mesh.vertex && mesh.triangle);
    uint32_t bottom = RINGS * SIDES, tip = bottom + 1;
    size_t t = 0;
    mesh.vertex[bottom] = (vec3){0, 0, -0.3}, mesh.vertex[tip] = (vec3){0, 0, 0.7};
    for (uint32_t i = 0; i < RINGS; i++) {
        double along = i < BALL ? 3.0 * (i + 1) / BALL : (double)(i - BALL) / HORN;
        double radius = i < BALL ? 0.3 * sin(along) : 0.042 - 0.03 * along;
        double height = i < BALL ? -0.3 * cos(along) : 0.3 + 0.4 * along;
        for (uint32_t j = 0; j < SIDES; j++) {
            double u = 6.283185307 * j / SIDES;
            uint32_t a = i * SIDES + j, b = i * SIDES + (j + 1) % SIDES;
            mesh.vertex[a] = (vec3){radius * cos(u), radius * sin(u), height};
            uint32_t below = i ? a - SIDES : bottom, above = i + 1 < RINGS ? b + SIDES : tip;
            memcpy(mesh.triangle[t++], (uint32_t[3]){a, below, b}, sizeof *mesh.triangle);
            memcpy(mesh.triangle[t++], (uint32_t[3]){a, b, above}, sizeof *mesh.triangle);
        }
    }
    return mesh;
}

/* What is thin weighs little beside what isn't, but keeps its length. */
static void test_a_horn_keeps_its_length(void **state) {
    (void)state;
    struct decimate_rules rules = given;
    rules.moves = true;
    for (size_t count = 120; count >= 24; count -= 12) {
        struct mesh mesh = horn_mesh();
        double highest = 0;
        assert_true(facts_of(&mesh).watertight && facts_of(&mesh).volume > 0);
        assert_int_equal(mesh_decimate(&mesh, &rules, count), STATUS_OK);
        for (size_t v = 0; v < mesh.vertex_count; v++) highest = fmax(highest, mesh.vertex[v].z);
        assert_true(highest > 0.68 && highest < 0.74);
        mesh_done(&mesh);
    }
}

enum { SIDE = 180 };

/* Hills with ridges between them; points follow rows of squares of 16, so that those of a part are near each other. */
static struct mesh hills_mesh(void) {
    enum { BLOCK = 16, BLOCKS = (SIDE + BLOCK - 1) / BLOCK };
    struct mesh mesh = {.vertex_count = 0, .triangle_count = 0};
    mesh.vertex = alloc_array(SIDE * SIDE, sizeof *mesh.vertex);
    mesh.source = alloc_array(SIDE * SIDE, sizeof *mesh.source);
    mesh.triangle = alloc_array((size_t)2 * (SIDE - 1) * (SIDE - 1), sizeof *mesh.triangle);
    uint32_t *number = alloc_array(SIDE * SIDE, sizeof *number);
    assert_true(mesh.vertex && mesh.source && mesh.triangle && number);
    for (uint32_t k = 0; k < BLOCKS * BLOCKS * BLOCK * BLOCK; k++) {
        uint32_t block = k / (BLOCK * BLOCK), inner = k % (BLOCK * BLOCK);
        uint32_t x = block % BLOCKS * BLOCK + inner % BLOCK, y = block / BLOCKS * BLOCK + inner / BLOCK;
        if (x >= SIDE || y >= SIDE) continue;
        double u = (double)x / SIDE, w = (double)y / SIDE;
        number[y * SIDE + x] = mesh.source[mesh.vertex_count] = (uint32_t)mesh.vertex_count;
        mesh.vertex[mesh.vertex_count++] = (vec3){u, w, 0.05 * fabs(sin(17 * u)) + 0.04 * cos(11 * w + 3 * u)};
    }
    for (uint32_t y = 0; y + 1 < SIDE; y++)
        for (uint32_t x = 0; x + 1 < SIDE; x++) {
            uint32_t a = number[y * SIDE + x], b = number[y * SIDE + x + 1];
            uint32_t c = number[(y + 1) * SIDE + x + 1], d = number[(y + 1) * SIDE + x];
            memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[3]){a, b, c}, sizeof *mesh.triangle);
            memcpy(mesh.triangle[mesh.triangle_count++], (uint32_t[3]){a, c, d}, sizeof *mesh.triangle);
        }
    free(number);
    return mesh;
}

/* How far the middles of triangles are from the hills, in the mean by area. */
static double height_off(const struct mesh *mesh) {
    double sum = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        vec3 a = mesh->vertex[v[0]], b = mesh->vertex[v[1]], c = mesh->vertex[v[2]];
        vec3 middle = vec3_scale(vec3_add(a, vec3_add(b, c)), 1.0 / 3), n = vec3_triangle_normal(a, b, c);
        double u = middle.x, w = middle.y;
        sum += fabs(n.z) / 2 * fabs(middle.z - (0.05 * fabs(sin(17 * u)) + 0.04 * cos(11 * w + 3 * u)));
    }
    return sum;
}

/* A large mesh is collapsed in parts: the same ones for any number of threads.  What lies between them is no denser in
 * the end than the rest, and the heights are as near as they are where one queue has all. */
static void test_threads_do_not_matter(void **state) {
    (void)state;
    enum { LEFT = SIDE * SIDE / 10 };
    struct mesh whole = hills_mesh(), first = {0};
    for (unsigned threads = 1; threads <= 3; threads++) {
        struct mesh mesh = hills_mesh();
        struct decimate_rules rules = {.borders = true, .threads = threads};
        assert_int_equal(mesh_decimate(&mesh, &rules, LEFT), STATUS_OK);
        assert_int_equal(mesh.vertex_count, LEFT);
        struct mesh_facts facts = facts_of(&mesh);
        assert_true(facts.manifold && facts.components == 1 && facts.euler == 1 && facts.borders == 1);
        assert_true(fabs(facts.border_length - facts_of(&whole).border_length) < 0.01);
        assert_true(height_off(&mesh) < 3.1e-4);
        if (threads == 1) {
            first = mesh;
            continue;
        }
        assert_int_equal(mesh.triangle_count, first.triangle_count);
        assert_memory_equal(mesh.triangle, first.triangle, first.triangle_count * sizeof *first.triangle);
        assert_memory_equal(mesh.source, first.source, first.vertex_count * sizeof *first.source);
        mesh_done(&mesh);
    }
    mesh_done(&first), mesh_done(&whole);
}

/* What is asked for is all there is room for: parts stop before. */
static void test_flat_parts_leave_enough(void **state) {
    (void)state;
    struct mesh mesh = hills_mesh();
    struct decimate_rules rules = {.borders = true, .threads = 2};
    for (size_t v = 0; v < mesh.vertex_count; v++) mesh.vertex[v].z = 0;
    assert_int_equal(mesh_decimate(&mesh, &rules, SIDE * SIDE / 3), STATUS_OK);
    assert_int_equal(mesh.vertex_count, SIDE * SIDE / 3);
    mesh_done(&mesh);
}

static void test_failure_leaves_the_mesh(void **state) {
    (void)state;
    struct mesh mesh = ring_mesh(1), whole = ring_mesh(1);
    int failures = 0;
    for (;;) {
        faults_in_memory(failures + 1, false);
        enum status status = mesh_decimate(&mesh, NULL, 100);
        bool happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        if (!happened) break;
        failures++;
        assert_int_equal(mesh.vertex_count, VERTICES);
        assert_memory_equal(mesh.triangle, whole.triangle, TRIANGLES * sizeof *mesh.triangle);
    }
    assert_true(failures > 4);
    mesh_done(&mesh), mesh_done(&whole);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_topology_stays),
        cmocka_unit_test(test_vertices_are_a_subset),
        cmocka_unit_test(test_it_ends_where_nothing_can_go),
        cmocka_unit_test(test_enough_is_left_alone),
        cmocka_unit_test(test_border_stays),
        cmocka_unit_test(test_border_is_merged_along_itself),
        cmocka_unit_test(test_seam_stays_between_its_sides),
        cmocka_unit_test(test_what_moves_keeps_the_volume),
        cmocka_unit_test(test_a_horn_keeps_its_length),
        cmocka_unit_test(test_threads_do_not_matter),
        cmocka_unit_test(test_flat_parts_leave_enough),
        cmocka_unit_test(test_failure_leaves_the_mesh),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
