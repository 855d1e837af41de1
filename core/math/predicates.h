/* Exact signs of determinants of coordinates: what is on which side, without rounding.
 *
 * J. R. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates (1997), has the
 * arithmetic (after Dekker 1971, Knuth) and the bound that most signs are known by.  Exact as long as no product of
 * three coordinates is under 1e-290 without being 0, or over 1e300.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_PREDICATES_H
#define WHITTLE_CORE_MATH_PREDICATES_H

#include <float.h>
#include <math.h>

#include "core/math/vec3.h"

#define PREDICATE_UNIT (DBL_EPSILON / 2)
#define PREDICATE_SIDE_BOUND ((7 + 56 * PREDICATE_UNIT) * PREDICATE_UNIT) /* of the sum of absolute values */
#define PREDICATE_TURN_BOUND ((3 + 16 * PREDICATE_UNIT) * PREDICATE_UNIT)

/* What predicate_side and predicate_turn say, by exact numbers where they are needed: for close calls. */
int predicate_side_exactly(vec3 a, vec3 b, vec3 c, vec3 d);
int predicate_turn_exactly(vec3 a, vec3 b, vec3 c, int axis);

/* 1 where d is on the side of the plane abc from which a, b, c are seen counter-clockwise, -1 on the other side, 0 on
 * the plane, as it is where a, b, c are on one line.  Usually some 20 operations; a thousand times that where it is a
 * close call. */
static inline int predicate_side(vec3 a, vec3 b, vec3 c, vec3 d) {
    vec3 p = vec3_sub(a, d), q = vec3_sub(b, d), r = vec3_sub(c, d);
    double yz = q.y * r.z, zy = q.z * r.y, zx = q.z * r.x, xz = q.x * r.z, xy = q.x * r.y, yx = q.y * r.x;
    double value = p.x * (yz - zy) + p.y * (zx - xz) + p.z * (xy - yx);
    double size =
        fabs(p.x) * (fabs(yz) + fabs(zy)) + fabs(p.y) * (fabs(zx) + fabs(xz)) + fabs(p.z) * (fabs(xy) + fabs(yx));
    double bound = PREDICATE_SIDE_BOUND * size;
    if (value > bound) return -1;
    if (-value > bound) return 1;
    return predicate_side_exactly(a, b, c, d);
}

/* The same in a plane: 1 where abc is counter-clockwise, seen along axis 0 (x), 1 or 2 against its direction. */
static inline int predicate_turn(vec3 a, vec3 b, vec3 c, int axis) {
    double ax = axis == 0 ? a.y : axis == 1 ? a.z : a.x, ay = axis == 0 ? a.z : axis == 1 ? a.x : a.y;
    double bx = axis == 0 ? b.y : axis == 1 ? b.z : b.x, by = axis == 0 ? b.z : axis == 1 ? b.x : b.y;
    double cx = axis == 0 ? c.y : axis == 1 ? c.z : c.x, cy = axis == 0 ? c.z : axis == 1 ? c.x : c.y;
    double left = (ax - cx) * (by - cy), right = (ay - cy) * (bx - cx), value = left - right;
    double bound = PREDICATE_TURN_BOUND * (fabs(left) + fabs(right));
    if (value > bound) return 1;
    if (-value > bound) return -1;
    return predicate_turn_exactly(a, b, c, axis);
}

#endif
