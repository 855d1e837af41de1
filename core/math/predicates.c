/* A determinant in double, and where that is too near to zero to tell, in expansions: sums of doubles of which none
 * overlaps another, the smallest first.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/math/predicates.h"

#include "core/math/exact.h"

enum { TERMS = 24, EACH = 4, MOST = TERMS * EACH };

struct expansion {
    int n;
    double part[MOST];
};

static void add(struct expansion *e, double x) {
    int n = 0;
    if (x == 0) return;
    for (int i = 0; i < e->n; i++) {
        double rest;
        exact_sum(x, e->part[i], &x, &rest);
        if (rest != 0) e->part[n++] = rest;
    }
    if (x != 0) e->part[n++] = x;
    e->n = n;
}

/* Adds the product of three numbers. */
static void add_product(struct expansion *e, double a, double b, double c) {
    double high, low, product, rest;
    exact_product(a, b, &high, &low);
    exact_product(high, c, &product, &rest);
    add(e, rest), add(e, product);
    exact_product(low, c, &product, &rest);
    add(e, rest), add(e, product);
}

/* a - b = *to, exactly; false where that is no double. */
static bool subtract(vec3 a, vec3 b, vec3 *to) {
    vec3 rest;
    exact_sum(a.x, -b.x, &to->x, &rest.x), exact_sum(a.y, -b.y, &to->y, &rest.y), exact_sum(a.z, -b.z, &to->z, &rest.z);
    return rest.x == 0 && rest.y == 0 && rest.z == 0;
}

/* The largest part decides. */
static int sign_of(const struct expansion *e) {
    double largest = e->n > 0 ? e->part[e->n - 1] : 0;
    return (largest > 0) - (largest < 0);
}

/* Adds the determinant of three places, times a sign. */
static void add_determinant(struct expansion *e, vec3 a, vec3 b, vec3 c, double sign) {
    add_product(e, sign * a.x, b.y, c.z), add_product(e, -sign * a.x, b.z, c.y);
    add_product(e, sign * a.y, b.z, c.x), add_product(e, -sign * a.y, b.x, c.z);
    add_product(e, sign * a.z, b.x, c.y), add_product(e, -sign * a.z, b.y, c.x);
}

/* Coordinates that were floats have differences without rounding, and then there is one determinant instead of four. */
static int exact_side(vec3 a, vec3 b, vec3 c, vec3 d) {
    struct expansion e = {.n = 0};
    vec3 p, q, r;
    if (subtract(a, d, &p) && subtract(b, d, &q) && subtract(c, d, &r)) {
        add_determinant(&e, p, q, r, -1);
        return sign_of(&e);
    }
    add_determinant(&e, b, c, d, 1), add_determinant(&e, a, c, d, -1);
    add_determinant(&e, a, b, d, 1), add_determinant(&e, a, b, c, -1);
    return sign_of(&e);
}

/* Whether a coordinate is the same for all: what lies in a plane across an axis has no need of exact numbers. */
static bool share_coordinate(vec3 p, vec3 q, vec3 r) {
    return (p.x == 0 && q.x == 0 && r.x == 0) || (p.y == 0 && q.y == 0 && r.y == 0) ||
           (p.z == 0 && q.z == 0 && r.z == 0);
}

int predicate_side_exactly(vec3 a, vec3 b, vec3 c, vec3 d) {
    if (share_coordinate(vec3_sub(a, d), vec3_sub(b, d), vec3_sub(c, d))) return 0;
    return exact_side(a, b, c, d);
}

int predicate_turn_exactly(vec3 a, vec3 b, vec3 c, int axis) {
    double ax = axis == 0 ? a.y : axis == 1 ? a.z : a.x, ay = axis == 0 ? a.z : axis == 1 ? a.x : a.y;
    double bx = axis == 0 ? b.y : axis == 1 ? b.z : b.x, by = axis == 0 ? b.z : axis == 1 ? b.x : b.y;
    double cx = axis == 0 ? c.y : axis == 1 ? c.z : c.x, cy = axis == 0 ? c.z : axis == 1 ? c.x : c.y;
    if ((ax == cx && bx == cx) || (ay == cy && by == cy)) return 0; /* in a line along an axis */
    if ((ax == cx && ay == cy) || (bx == cx && by == cy) || (ax == bx && ay == by)) return 0;
    struct expansion e = {.n = 0};
    add_product(&e, ax, by, 1), add_product(&e, -ay, bx, 1), add_product(&e, bx, cy, 1);
    add_product(&e, -by, cx, 1), add_product(&e, cx, ay, 1), add_product(&e, -cy, ax, 1);
    return sign_of(&e);
}
