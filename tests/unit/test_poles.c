/* Points on rings around a limb, a ball, and what a failed allocation leaves.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/surface/delaunay_cgal.h"
#include "core/surface/poles.h"
#include "tests/unit/faults.h"

enum { AROUND = 24, RINGS = 7, LIMB = AROUND * RINGS, BALL = 500 };

static const double RADIUS = 0.05, APART = 0.065; /* five times as far as the points of a ring */

struct cloud {
    vec3 point[BALL], normal[BALL], better[BALL];
    struct tets tets;
    size_t n;
};

static void triangulate(struct cloud *c) {
    c->tets = (struct tets){0};
    assert_int_equal(delaunay_build(c->point, c->n, 1, NULL, &c->tets, NULL), STATUS_OK);
    assert_int_equal(c->tets.dimension, 3);
}

static vec3 from_axis(double angle) { return (vec3){cos(angle), sin(angle), 0}; }

/* Rings that are turned against each other, as if the plane of each had been fitted to its points; a bit leans
 * outwards. */
static void make_limb(struct cloud *c, double lean) {
    c->n = LIMB;
    for (size_t i = 0; i < LIMB; i++) {
        vec3 out = from_axis(2 * M_PI * ((double)(i % AROUND) + 0.37 * (double)(i / AROUND)) / AROUND);
        c->point[i] = vec3_add(vec3_scale(out, RADIUS), (vec3){0, 0, APART * (double)(i / AROUND)});
        c->normal[i] = vec3_unit(vec3_add((vec3){0, 0, 1}, vec3_scale(out, lean)));
    }
    triangulate(c);
}

static void planes_of_rings_lie_across_a_limb(void **state) {
    (void)state;
    struct cloud c;
    for (double lean = -0.1; lean < 0.2; lean += 0.2) {
        make_limb(&c, lean);
        assert_int_equal(poles_find_better(&c.tets, c.point, c.n, c.normal, c.better), STATUS_OK);
        for (size_t i = AROUND; i < LIMB - AROUND; i++) {
            vec3 out = vec3_unit((vec3){c.point[i].x, c.point[i].y, 0});
            assert_float_equal(vec3_length(c.better[i]), 1, 1e-9);
            assert_true(lean * vec3_dot(c.better[i], out) > 0.95 * fabs(lean)); /* on the side where it leaned to */
        }
        tets_done(&c.tets);
    }
}

static void make_ball(struct cloud *c) {
    c->n = BALL;
    for (size_t i = 0; i < BALL; i++) {
        double z = 1 - (2 * (double)i + 1) / BALL, angle = M_PI * (1 + sqrt(5)) * (double)i;
        c->normal[i] = vec3_add(vec3_scale(from_axis(angle), sqrt(1 - z * z)), (vec3){0, 0, z});
        c->point[i] = vec3_scale(c->normal[i], 0.4);
    }
    triangulate(c);
}

static void normals_that_cells_reach_along_stay(void **state) {
    (void)state;
    struct cloud c;
    make_ball(&c);
    assert_int_equal(poles_find_better(&c.tets, c.point, c.n, c.normal, c.better), STATUS_OK);
    for (size_t i = 0; i < BALL; i++) assert_true(vec3_length_sq(c.better[i]) == 0);
    tets_done(&c.tets);
}

/* All points of a ball are on the hull, and their cells have no end outwards. */
static void hulls_tell_where_outside_is(void **state) {
    (void)state;
    struct cloud c;
    make_ball(&c);
    vec3 out = c.normal[BALL / 2];
    c.normal[BALL / 2] = vec3_unit(vec3_cross(out, (vec3){0, 0, 1}));
    assert_int_equal(poles_find_better(&c.tets, c.point, c.n, c.normal, c.better), STATUS_OK);
    assert_true(fabs(vec3_dot(c.better[BALL / 2], out)) > 0.99);
    tets_done(&c.tets);
}

static void failures_are_told(void **state) {
    (void)state;
    struct cloud c;
    make_limb(&c, 0.1);
    faults_in_memory(1, false);
    assert_int_equal(poles_find_better(&c.tets, c.point, c.n, c.normal, c.better), STATUS_NO_MEMORY);
    assert_true(faults_stop());
    tets_done(&c.tets);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(planes_of_rings_lie_across_a_limb),
        cmocka_unit_test(normals_that_cells_reach_along_stay),
        cmocka_unit_test(hulls_tell_where_outside_is),
        cmocka_unit_test(failures_are_told),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
