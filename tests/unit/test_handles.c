/* Closing handles, joining shells: solids of unit cubes whose corners are the points to be meshed, with original points
 * all over their true surface, and labels that say that one cube is there, or isn't, contrary to it.
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
#include "core/spatial/knn.h"
#include "core/surface/cocone/handles.h"
#include "core/surface/cocone/surface.h"
#include "core/surface/delaunay_cgal.h"
#include "tests/unit/faults.h"

enum { SIDE = 9, SITES_MOST = (SIDE + 1) * (SIDE + 1) * (SIDE + 1), PER_EDGE = 5, DENSE_MOST = 20000 };

typedef bool solid(int x, int y, int z);

/* A plate of one layer, and the same with a hole through it. */
static bool plate(int x, int y, int z) { return z == 0 && x >= 0 && y >= 0 && x < 7 && y < 7; }
static bool plate_with_hole(int x, int y, int z) { return plate(x, y, z) && !(x == 3 && y == 3); }

/* Two plates with a gap of one layer between them, joined at one end; and the same with a bridge across the gap. */
static bool clamp(int x, int y, int z) { return plate(x, y, 0) && (z == 0 || z == 2 || (z == 1 && x == 0)); }
static bool clamp_with_bridge(int x, int y, int z) { return clamp(x, y, z) || (x == 4 && y == 3 && z == 1); }

/* Two fingers side by side, joined by a palm at one end; and the same with a bridge from one to the other. */
static bool fork(int x, int y, int z) { return plate(x, y, z) && (y < 2 || y > 4 || x < 2); }
static bool fork_that_touches(int x, int y, int z) { return fork(x, y, z) || (plate(x, y, z) && x == 5); }

/* A plate with a knob on a stalk, and without the stalk. */
static bool knob(int x, int y, int z) { return plate(x, y, z) || (x == 3 && y == 3 && z >= 1 && z <= 2); }
static bool knob_in_the_air(int x, int y, int z) { return knob(x, y, z) && z != 1; }

/* A clamp with specks above it. */
static bool specks(int x, int y, int z) { return z == 7 && x % 2 == 0 && y % 2 == 0 && plate(x, y, 0); }
static bool clamp_below_specks(int x, int y, int z) { return clamp(x, y, z) || specks(x, y, z); }
static bool bridge_below_specks(int x, int y, int z) { return clamp_with_bridge(x, y, z) || specks(x, y, z); }

/* A box in a box. */
static bool cube(int x, int y, int z, int from, int to) {
    return x >= from && y >= from && z >= from && x < to && y < to && z < to;
}
static bool box(int x, int y, int z) { return cube(x, y, z, 0, 5) && !cube(x, y, z, 1, 4); }
static bool box_in_box(int x, int y, int z) {
    return (cube(x, y, z, 0, 7) && !cube(x, y, z, 1, 6)) || cube(x, y, z, 3, 4);
}

struct scene {
    vec3 *site, *point, *normal;
    float *spacing;
    uint32_t *of_point;
    size_t sites, points;
    struct knn *knn;
    struct tets tets;
    struct cocone_star star;
    struct reconstruct_dense dense;
    struct cocone_cost cost;
    struct reconstruct_pieces pieces;
    uint8_t *inside;
};

static void add_face(struct scene *s, vec3 corner, int axis, int side) {
    static const vec3 unit[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    vec3 u = unit[(axis + 1) % 3], v = unit[(axis + 2) % 3];
    if (side) corner = vec3_add(corner, unit[axis]);
    for (int i = 0; i < PER_EDGE * PER_EDGE; i++) {
        vec3 p = vec3_add(corner, vec3_scale(u, (i / PER_EDGE + 0.5) / PER_EDGE));
        s->point[s->points] = vec3_add(p, vec3_scale(v, (i % PER_EDGE + 0.5) / PER_EDGE));
        s->normal[s->points] = unit[axis];
        s->spacing[s->points++] = 1.0f / PER_EDGE;
    }
}

static void add_points(struct scene *s, solid *is_in) {
    for (int i = 0; i < SIDE * SIDE * SIDE; i++) {
        int at[3] = {i / (SIDE * SIDE), i / SIDE % SIDE, i % SIDE};
        for (int face = 0; face < 6 && is_in(at[0], at[1], at[2]); face++) {
            int next[3] = {at[0], at[1], at[2]};
            next[face / 2] += face % 2 ? 1 : -1;
            if (!is_in(next[0], next[1], next[2])) add_face(s, (vec3){at[0], at[1], at[2]}, face / 2, face % 2);
        }
    }
}

static bool is_corner(solid *is_in, int x, int y, int z) {
    bool any = false;
    for (int k = 0; k < 8; k++) any = any || is_in(x - (k & 1), y - (k >> 1 & 1), z - (k >> 2));
    return any;
}

static void add_sites(struct scene *s, solid *is_in) {
    for (int i = 0; i < SITES_MOST; i++) {
        int x = i / ((SIDE + 1) * (SIDE + 1)), y = i / (SIDE + 1) % (SIDE + 1), z = i % (SIDE + 1);
        if (is_corner(is_in, x, y, z)) s->site[s->sites++] = (vec3){x, y, z};
    }
}

static uint32_t nearest_site(const struct scene *s, vec3 p) {
    uint32_t best = 0;
    for (uint32_t i = 1; i < s->sites; i++)
        if (vec3_distance_sq(p, s->site[i]) < vec3_distance_sq(p, s->site[best])) best = i;
    return best;
}

static void label(struct scene *s, solid *is_in) {
    for (uint32_t c = 0; c < s->tets.finite_count; c++) {
        vec3 sum = {0, 0, 0};
        for (int k = 0; k < 4; k++) sum = vec3_add(sum, s->site[s->tets.vertex[c][k]]);
        s->inside[c] = is_in((int)floor(sum.x / 4), (int)floor(sum.y / 4), (int)floor(sum.z / 4));
    }
}

/* Labels as of one solid, original points of another; the scene stays where it is. */
static void set_up(struct scene *s, solid *labelled, solid *is_true) {
    *s = (struct scene){.site = alloc_array(SITES_MOST, sizeof *s->site),
                        .point = alloc_array(DENSE_MOST, sizeof *s->point),
                        .normal = alloc_array(DENSE_MOST, sizeof *s->normal),
                        .spacing = alloc_array(DENSE_MOST, sizeof *s->spacing),
                        .of_point = alloc_array(DENSE_MOST, sizeof *s->of_point)};
    add_sites(s, labelled);
    add_points(s, is_true);
    for (size_t i = 0; i < s->points; i++) s->of_point[i] = nearest_site(s, s->point[i]);
    assert_int_equal(knn_new(s->point, s->points, 1, &s->knn, NULL), STATUS_OK);
    assert_int_equal(delaunay_build(s->site, s->sites, 1, NULL, &s->tets, NULL), STATUS_OK);
    assert_int_equal(cocone_star_build(&s->tets, s->site, s->sites, 1, &s->star), STATUS_OK);
    s->dense =
        (struct reconstruct_dense){s->points, s->point, s->normal, s->spacing, s->of_point, s->knn, NULL, NULL, NULL};
    s->cost.price = alloc_zeroed(s->tets.cell_count, sizeof *s->cost.price);
    s->cost.vote = alloc_zeroed(s->tets.cell_count, sizeof *s->cost.vote);
    s->inside = alloc_zeroed(s->tets.cell_count, 1);
    label(s, labelled);
}

static void tear_down(struct scene *s) {
    cocone_star_done(&s->star);
    cocone_cost_done(&s->cost);
    tets_done(&s->tets);
    knn_free(s->knn);
    free(s->site), free(s->point), free(s->normal), free(s->spacing), free(s->of_point), free(s->inside);
}

/* Handles, and shells beyond the first one, of the surface, which has all points. */
static int excess_of(const struct scene *s) {
    struct mesh mesh;
    struct mesh_facts facts;
    assert_int_equal(cocone_surface_extract(&s->star, NULL, 1, s->inside, &mesh), STATUS_OK);
    assert_int_equal(mesh_examine(&mesh, &facts), STATUS_OK);
    assert_true(facts.watertight && facts.manifold);
    assert_int_equal(mesh.vertex_count, s->sites);
    mesh_done(&mesh);
    return (int)facts.components - 1 + (int)((long)facts.components - facts.euler / 2);
}

static enum status close_handles(struct scene *s, unsigned threads, size_t *closed) {
    struct cocone_handles_input input = {&s->star, &s->cost, &s->dense, NULL, s->pieces, false, threads};
    bool too_many;
    enum status status = cocone_handles_close(&input, s->inside, closed, &too_many);
    assert_false(too_many);
    return status;
}

static void expect(solid *labelled, solid *is_true, int before, int after) {
    size_t closed;
    struct scene s;
    set_up(&s, labelled, is_true);
    assert_int_equal(excess_of(&s), before);
    assert_int_equal(close_handles(&s, 1, &closed), STATUS_OK);
    assert_int_equal(excess_of(&s), after);
    assert_int_equal(closed, before - after);
    tear_down(&s);
}

static void what_has_no_handles_is_left_alone(void **state) {
    (void)state;
    expect(plate, plate, 0, 0);
    expect(clamp, clamp, 0, 0);
    expect(fork, fork, 0, 0);
}

static void a_hole_through_a_plate_that_has_none_is_filled(void **state) {
    (void)state;
    expect(plate_with_hole, plate, 1, 0);
}

static void a_true_hole_stays(void **state) {
    (void)state;
    expect(plate_with_hole, plate_with_hole, 1, 1);
}

static void a_bridge_between_two_sheets_is_cut(void **state) {
    (void)state;
    expect(clamp_with_bridge, clamp, 1, 0);
}

static void a_true_bridge_stays(void **state) {
    (void)state;
    expect(clamp_with_bridge, clamp_with_bridge, 1, 1);
}

static void fingers_that_touch_are_parted(void **state) {
    (void)state;
    expect(fork_that_touches, fork, 1, 0);
}

static void fingers_that_have_grown_together_stay(void **state) {
    (void)state;
    expect(fork_that_touches, fork_that_touches, 1, 1);
}

static void a_piece_that_has_come_off_is_joined(void **state) {
    (void)state;
    expect(knob_in_the_air, knob, 1, 0);
}

static void a_true_gap_stays(void **state) {
    (void)state;
    expect(knob_in_the_air, knob_in_the_air, 1, 1);
}

/* A handle, and sixteen pieces beyond the first one. */
static void what_has_too_many_pieces_in_any_case_stays(void **state) {
    (void)state;
    static const struct reconstruct_pieces too_few = {1, 0.01}, enough[] = {{0}, {16, 0.01}, {1, 0.5}};
    enum { BEYOND = 17 };
    struct scene s;
    size_t closed;
    bool too_many;
    set_up(&s, bridge_below_specks, clamp_below_specks);
    struct cocone_handles_input input = {&s.star, &s.cost, &s.dense, NULL, too_few, false, 1};
    assert_int_equal(cocone_handles_close(&input, s.inside, &closed, &too_many), STATUS_OK);
    assert_true(too_many);
    assert_int_equal(closed, 0);
    assert_int_equal(excess_of(&s), BEYOND);
    for (size_t i = 0; i < sizeof enough / sizeof *enough; i++) {
        label(&s, bridge_below_specks);
        s.pieces = enough[i];
        assert_int_equal(close_handles(&s, 1, &closed), STATUS_OK);
        assert_int_equal(excess_of(&s), BEYOND - 1);
    }
    tear_down(&s);
}

static void true_cavities_and_what_is_in_them_stay(void **state) {
    (void)state;
    expect(box, box, 1, 1);
    expect(box_in_box, box_in_box, 2, 2);
}

static void threads_change_nothing(void **state) {
    (void)state;
    struct scene one, three;
    size_t closed[2];
    set_up(&one, clamp_with_bridge, clamp), set_up(&three, clamp_with_bridge, clamp);
    assert_int_equal(close_handles(&one, 1, &closed[0]), STATUS_OK);
    assert_int_equal(close_handles(&three, 3, &closed[1]), STATUS_OK);
    assert_int_equal(closed[0], closed[1]);
    assert_memory_equal(one.inside, three.inside, one.tets.cell_count);
    tear_down(&one), tear_down(&three);
}

static void a_failing_allocation_is_told(void **state) {
    (void)state;
    struct scene s;
    set_up(&s, clamp_with_bridge, clamp);
    s.pieces = (struct reconstruct_pieces){1, 0.01};
    bool happened = true;
    int nth = 0;
    for (; happened; nth++) {
        size_t closed;
        label(&s, clamp_with_bridge);
        faults_in_memory(nth + 1, false);
        enum status status = close_handles(&s, 1, &closed);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
    }
    assert_int_equal(excess_of(&s), 0);
    assert_true(nth > 20);
    tear_down(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_has_no_handles_is_left_alone),
        cmocka_unit_test(a_hole_through_a_plate_that_has_none_is_filled),
        cmocka_unit_test(a_true_hole_stays),
        cmocka_unit_test(a_bridge_between_two_sheets_is_cut),
        cmocka_unit_test(a_true_bridge_stays),
        cmocka_unit_test(fingers_that_touch_are_parted),
        cmocka_unit_test(fingers_that_have_grown_together_stay),
        cmocka_unit_test(a_piece_that_has_come_off_is_joined),
        cmocka_unit_test(a_true_gap_stays),
        cmocka_unit_test(what_has_too_many_pieces_in_any_case_stays),
        cmocka_unit_test(true_cavities_and_what_is_in_them_stay),
        cmocka_unit_test(threads_change_nothing),
        cmocka_unit_test(a_failing_allocation_is_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
