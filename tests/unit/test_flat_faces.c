/* Flat faces that have points along their edges alone, on bodies whose faces are known.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/cloud/morton.h"
#include "core/spatial/flat_faces.h"
#include "tests/unit/faults.h"
#include "tests/unit/shapes.h"

enum { MOST = 12000, BOLTS = 6 };

struct body {
    size_t n;
    vec3 point[MOST];
};

/* Tilted, so that no plane is along an axis. */
static vec3 tilted(double x, double y, double z) {
    const vec3 u = vec3_unit((vec3){1, 0.3, -0.2});
    const vec3 w = vec3_unit(vec3_cross(u, (vec3){0.1, 1, 0.4})), v = vec3_cross(w, u);
    return vec3_add(vec3_add(vec3_scale(u, x), vec3_scale(v, y)), vec3_scale(w, z));
}

static void add_ring(struct body *body, double x, double y, double z, double radius, size_t around) {
    for (size_t i = 0; i < around && body->n < MOST; i++) {
        double angle = 2 * acos(-1) * (double)i / (double)around;
        body->point[body->n++] = tilted(x + radius * cos(angle), y + radius * sin(angle), z);
    }
}

/* A tube of rings that are as far apart as the points in them. */
static void add_tube(struct body *body, double radius, double length, size_t around) {
    size_t rings = (size_t)(length * (double)around / (2 * acos(-1) * radius)) + 1;
    for (size_t i = 0; i < rings; i++) add_ring(body, 0, 0, length * (double)i / (double)(rings - 1), radius, around);
}

/* *ordered: its points, to be done with. */
static struct flat_faces faces_of(const struct body *body, struct ordered_points *ordered) {
    const struct neighbourhood_options options = {.radius = 2, .min = 8, .max = 16, .threads = 1};
    struct knn *knn = NULL;
    struct neighbourhood neighbours = {0};
    struct flat_faces faces = {0};
    assert_int_equal(order_points(body->point, body->n, 1, ordered), STATUS_OK);
    assert_int_equal(knn_new(ordered->point, ordered->count, 1, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, ordered->point, ordered->count, &options, &neighbours), STATUS_OK);
    assert_int_equal(flat_faces_find(knn, &neighbours, ordered->point, ordered->count, 1, &faces), STATUS_OK);
    neighbourhood_done(&neighbours);
    knn_free(knn);
    return faces;
}

/* A flange around a tube, with holes: both of its faces get places, and none is in a hole or off the faces and walls.
 */
static void a_flange_with_holes_has_two_faces(void **state) {
    (void)state;
    static struct body body;
    static const double OUTER = 1.5, INNER = 0.8, THICK = 0.25, HOLE = 0.12, AT = 1.15;
    struct ordered_points ordered;
    size_t below = 0, above = 0, on_walls = 0;
    body.n = 0;
    add_tube(&body, INNER, 2, 100);
    add_tube(&body, INNER - 0.1, 2, 90);
    for (int side = 0; side < 2; side++) {
        double z = 0.5 + side * THICK;
        add_ring(&body, 0, 0, z, OUTER, 120);
        add_ring(&body, 0, 0, z, INNER + 0.02, 100);
        for (int i = 0; i < BOLTS; i++) {
            double angle = 2 * acos(-1) * i / BOLTS;
            add_ring(&body, AT * cos(angle), AT * sin(angle), z, HOLE, 20);
        }
    }
    struct flat_faces faces = faces_of(&body, &ordered);
    assert_true(faces.count > 100);
    assert_true(faces.count <= ordered.count / 2);
    assert_true(faces.holes >= BOLTS);
    const vec3 first = ordered.point[0], u = tilted(1, 0, 0), v = tilted(0, 1, 0), w = tilted(0, 0, 1);
    vec3 origin = vec3_sub(vec3_scale(body.point[ordered.original[0]], 1 / ordered.scale), first);
    for (size_t i = 0; i < faces.count; i++) {
        vec3 at = vec3_scale(vec3_add(faces.point[i], origin), ordered.scale);
        double x = vec3_dot(at, u), y = vec3_dot(at, v), z = vec3_dot(at, w), r = hypot(x, y), from_hole = INFINITY;
        for (int k = 0; k < BOLTS; k++) {
            double angle = 2 * acos(-1) * k / BOLTS;
            from_hole = fmin(from_hole, hypot(x - AT * cos(angle), y - AT * sin(angle)));
        }
        bool is_below = fabs(z - 0.5) < 1e-5, is_above = fabs(z - 0.5 - THICK) < 1e-5;
        bool on_face = r > INNER && r < OUTER && from_hole > HOLE - 1e-6;
        bool on_wall = fabs(r - OUTER) < 1e-3 || fabs(from_hole - HOLE) < 1e-3 || fabs(r - INNER - 0.02) < 1e-3;
        bool on_end = (fabs(z) < 1e-5 || fabs(z - 2) < 1e-5) && r > INNER - 0.1 && r < INNER;
        assert_true((is_below || is_above) ? on_face : on_wall || on_end);
        assert_true(fabs(vec3_length(faces.normal[i]) - 1) < 1e-9);
        below += is_below, above += is_above, on_walls += on_wall;
    }
    assert_true(below > 40 && above > 40 && on_walls >= 20);
    flat_faces_done(&faces);
    ordered_points_done(&ordered);
}

/* Rings around a pipe's outside and inside lie on one plane each, but only at its ends there is a face. */
static void a_pipe_has_none_between_its_ends(void **state) {
    (void)state;
    static struct body body;
    struct ordered_points ordered;
    body.n = 0;
    for (int i = 0; i < 20; i++) {
        add_ring(&body, 0, 0, 0.1 * i, 1, 100);
        add_ring(&body, 0, 0, 0.1 * i, 0.6, 60);
    }
    struct flat_faces faces = faces_of(&body, &ordered);
    const vec3 w = tilted(0, 0, 1);
    double low = INFINITY, high = -INFINITY;
    for (size_t i = 0; i < ordered.count; i++) {
        low = fmin(low, vec3_dot(ordered.point[i], w)), high = fmax(high, vec3_dot(ordered.point[i], w));
    }
    for (size_t i = 0; i < faces.count; i++) {
        double z = vec3_dot(faces.point[i], w);
        assert_true(z < low + 1e-5 || z > high - 1e-5);
    }
    assert_true(faces.count > 0);
    flat_faces_done(&faces);
    ordered_points_done(&ordered);
}

static void points_of_a_sphere_have_none(void **state) {
    (void)state;
    static struct body body;
    struct ordered_points ordered;
    vec3 *point = shape_sphere(MOST, 1);
    for (body.n = 0; body.n < MOST; body.n++) body.point[body.n] = point[body.n];
    struct flat_faces faces = faces_of(&body, &ordered);
    assert_int_equal(faces.count, 0);
    flat_faces_done(&faces);
    ordered_points_done(&ordered);
    free(point);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_flange_with_holes_has_two_faces),
        cmocka_unit_test(a_pipe_has_none_between_its_ends),
        cmocka_unit_test(points_of_a_sphere_have_none),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
