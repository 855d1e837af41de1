/* Whether a mesh is of a room or of a solid, by what can be seen of it from where.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/surface/sheet/gallery.h"
#include "tests/unit/faults.h"

enum { SQUARES = 12 /* along each edge */, BOXES = 4, MOST = BOXES * 6 * SQUARES * SQUARES };

/* Boxes of squares, each a component by itself, whatever touches. */
struct boxes {
    struct mesh mesh;
    vec3 vertex[4 * MOST];
    uint32_t triangle[2 * MOST][3], component[2 * MOST];
    uint32_t first[BOXES + 1], count; /* component of each */
};

static struct boxes *boxes_new(void) {
    struct boxes *b = calloc(1, sizeof *b);
    assert_non_null(b);
    b->mesh.vertex = b->vertex, b->mesh.triangle = b->triangle;
    return b;
}

/* A square of a face: its corner, and its sides along u and v, whose cross product it faces. */
static void add_square(struct boxes *b, vec3 corner, vec3 u, vec3 v) {
    uint32_t first = (uint32_t)b->mesh.vertex_count;
    const vec3 at[] = {corner, vec3_add(corner, u), vec3_add(vec3_add(corner, u), v), vec3_add(corner, v)};
    for (int k = 0; k < 4; k++) b->vertex[b->mesh.vertex_count++] = at[k];
    for (uint32_t k = 0; k < 2; k++) {
        size_t t = b->mesh.triangle_count++;
        b->triangle[t][0] = first, b->triangle[t][1] = first + 1 + k, b->triangle[t][2] = first + 2 + k;
        b->component[t] = b->first[b->count];
    }
}

/* A box that faces outwards, or inwards; its bottom is left out where it has none. */
static void add_box(struct boxes *b, vec3 low, vec3 high, bool outwards, bool bottom) {
    vec3 size = vec3_sub(high, low), side[] = {{size.x, 0, 0}, {0, size.y, 0}, {0, 0, size.z}};
    b->first[b->count] = (uint32_t)b->mesh.triangle_count;
    for (int face = bottom ? 0 : 1; face < 6; face++) {
        int axis = (face + 4) / 2 % 3; /* the bottom is the first */
        vec3 u = side[(axis + 1) % 3], v = side[(axis + 2) % 3];
        vec3 origin = face % 2 ? vec3_add(low, side[axis]) : low;
        if ((face % 2 == 1) != outwards) {
            vec3 swapped = u;
            u = v, v = swapped;
        }
        vec3 du = vec3_scale(u, 1.0 / SQUARES), dv = vec3_scale(v, 1.0 / SQUARES);
        for (int i = 0; i < SQUARES * SQUARES; i++) {
            vec3 over = vec3_add(vec3_scale(du, i % SQUARES), vec3_scale(dv, i / SQUARES));
            add_square(b, vec3_add(origin, over), du, dv);
        }
    }
    b->count++;
}

static struct gallery look_at(const struct boxes *b, unsigned threads, double *facing) {
    struct gallery gallery;
    assert_int_equal(gallery_find(&b->mesh, b->component, threads, &gallery, facing), STATUS_OK);
    return gallery;
}

/* Walls of a room, a chest without bottom and a lamp in it: whichever way they face. */
static void a_room_is_seen_from_within(void **state) {
    (void)state;
    for (int outwards = 0; outwards < 2; outwards++) {
        struct boxes *b = boxes_new();
        double *facing = calloc(2 * MOST, sizeof *facing), *same = calloc(2 * MOST, sizeof *same);
        assert_true(facing && same);
        add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, outwards, true);
        add_box(b, (vec3){1, 1, 0}, (vec3){2.5, 2, 1.2}, true, false);
        add_box(b, (vec3){3.5, 2, 1.4}, (vec3){4.5, 3, 2}, true, true);
        struct gallery gallery = look_at(b, 1, facing), again = look_at(b, 3, same);
        assert_true(gallery.room && gallery.within > 0.95 && gallery.outside < 0.95);
        assert_true(facing[b->first[0]] * (outwards ? -1 : 1) > 0.99);
        assert_true(facing[b->first[1]] > 0.85 && facing[b->first[2]] > 0.99);
        assert_true(gallery.within == again.within && gallery.outside == again.outside);
        assert_memory_equal(facing, same, 2 * MOST * sizeof *facing);
        free(facing), free(same), free(b);
    }
}

/* One of whose six sides nobody has looked at, as the ceiling: a third of what is seen from within stands in it. */
static void a_room_may_lack_a_side(void **state) {
    (void)state;
    struct boxes *b = boxes_new();
    add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, true, false);
    add_box(b, (vec3){1, 1, 1.2}, (vec3){2.5, 2.5, 2.6}, true, true);
    add_box(b, (vec3){3.5, 1.5, 0.8}, (vec3){5, 3, 2}, true, true);
    struct gallery gallery = look_at(b, 1, NULL);
    assert_true(gallery.within > 0.95 && gallery.outside < gallery.within - 0.12);
    assert_true(gallery.room);
    free(b);
}

/* Boxes side by side; one without a bottom, of which more is seen from within than of others; and one alone, which is
 * as empty as a room may be. */
static void solids_are_seen_from_outside(void **state) {
    (void)state;
    for (int k = 0; k < 3; k++) {
        struct boxes *b = boxes_new();
        add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, true, k != 1);
        if (k < 2) add_box(b, (vec3){1, 1, 3}, (vec3){2.5, 2, 4.2}, true, true);
        if (k < 2) add_box(b, (vec3){-2, 0, 0}, (vec3){-1, 4, 4}, true, true);
        assert_false(look_at(b, 1, NULL).room);
        free(b);
    }
}

/* Posts at two corners of a wide box around a room: parts of it make a vessel of it; else they are seen through its
 * windows. */
static void a_room_fills_its_box(void **state) {
    (void)state;
    for (int parts = 0; parts < 2; parts++) {
        struct boxes *b = boxes_new();
        add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, false, true);
        add_box(b, (vec3){-5, -5, -3}, (vec3){-4.98, -4.98, 6}, false, true);
        add_box(b, (vec3){10.98, 8.98, -3}, (vec3){11, 9, 6}, false, true);
        for (size_t t = 0; parts && t < b->mesh.triangle_count; t++) b->component[t] = 0;
        add_box(b, (vec3){2, 1.5, 1.2}, (vec3){4, 2.5, 2}, true, true);
        assert_true(look_at(b, 1, NULL).room == !parts);
        free(b);
    }
}

/* Where walls were joined so that some of them face outwards, as a whole the room follows the larger part; those within
 * see which part of it is turned.  Of what stands free, or of a solid, nothing is told. */
static void those_within_see_which_walls_are_turned(void **state) {
    (void)state;
    for (int k = 0; k < 3; k++) {
        struct boxes *b = boxes_new();
        double *side = calloc(2 * MOST, sizeof *side), *same = calloc(2 * MOST, sizeof *same), turned, again;
        assert_true(side && same);
        add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, k == 2, true);
        if (k < 2) add_box(b, (vec3){3.5, 2, 1.4}, (vec3){4.5, 3, 2}, true, true);
        size_t wall = 2 * SQUARES * SQUARES, first = 2 * wall, last = k == 1 ? 4 * wall : first;
        for (size_t t = first; t < last; t++) {
            uint32_t *v = b->triangle[t], second = v[1];
            v[1] = v[2], v[2] = second;
        }
        assert_int_equal(gallery_sides(&b->mesh, b->component, 1, side, &turned), STATUS_OK);
        assert_int_equal(gallery_sides(&b->mesh, b->component, 3, same, &again), STATUS_OK);
        assert_true(turned == again);
        assert_memory_equal(side, same, 2 * MOST * sizeof *side);
        assert_true(k == 1 ? turned > 0.15 && turned < 0.5 : turned == 0);
        size_t wrong = 0, unseen = 0;
        for (size_t t = 0; k == 1 && t < b->mesh.triangle_count; t++) {
            unseen += side[t] == 0;
            wrong += side[t] != 0 && (side[t] < 0) != (t >= first && t < last);
        }
        assert_true(wrong == 0 && unseen * 10 < b->mesh.triangle_count);
        free(side), free(same), free(b);
    }
}

/* A box with another one on it: those who look along the axes see enough, so there is no grid for rays.  Of a room
 * there is one. */
static void of_solids_no_grid_is_made(void **state) {
    (void)state;
    for (int room = 0; room < 2; room++) {
        struct boxes *b = boxes_new();
        struct gallery gallery;
        add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, true, true);
        vec3 low = {2, 1, room ? 1 : 2.6}, high = {4, 2, room ? 2 : 3.6};
        add_box(b, low, high, true, true);
        faults_in_memory(5, true); /* after those of pieces, areas, a plane across an axis, and vertices in it */
        enum status status = gallery_find(&b->mesh, b->component, 1, &gallery, NULL);
        faults_stop();
        assert_int_equal(status, room ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(gallery.outside > 0.97 || room);
        free(b);
    }
}

/* What has no extent, or nothing at all. */
static void nothing_is_no_room(void **state) {
    (void)state;
    struct boxes *b = boxes_new();
    assert_false(look_at(b, 1, NULL).room);
    add_box(b, (vec3){1, 1, 1}, (vec3){1, 1, 1}, true, true);
    assert_false(look_at(b, 1, NULL).room);
    free(b);
}

static void without_memory_it_says_so(void **state) {
    (void)state;
    struct boxes *b = boxes_new();
    struct gallery gallery;
    add_box(b, (vec3){0, 0, 0}, (vec3){6, 4, 2.6}, false, true);
    add_box(b, (vec3){3.5, 2, 1.4}, (vec3){4.5, 3, 2}, true, true);
    bool happened = true;
    for (int failed = 0; happened; failed++) {
        faults_in_memory(failed + 1, false);
        enum status status = gallery_find(&b->mesh, b->component, 1, &gallery, NULL);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened || failed >= 4);
    }
    double *side = calloc(2 * MOST, sizeof *side), turned;
    assert_non_null(side);
    happened = true;
    for (int failed = 0; happened; failed++) {
        faults_in_memory(failed + 1, false);
        enum status status = gallery_sides(&b->mesh, b->component, 1, side, &turned);
        happened = faults_stop();
        assert_int_equal(status, happened ? STATUS_NO_MEMORY : STATUS_OK);
        assert_true(happened || failed >= 4);
    }
    free(side), free(b);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_room_is_seen_from_within),
        cmocka_unit_test(a_room_may_lack_a_side),
        cmocka_unit_test(solids_are_seen_from_outside),
        cmocka_unit_test(a_room_fills_its_box),
        cmocka_unit_test(of_solids_no_grid_is_made),
        cmocka_unit_test(nothing_is_no_room),
        cmocka_unit_test(those_within_see_which_walls_are_turned),
        cmocka_unit_test(without_memory_it_says_so),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
