/* Exact signs of determinants of coordinates: what is on which side, without rounding.
 *
 * J. R. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric predicates (1997), has the
 * arithmetic (after Dekker 1971, Knuth) and the bound that most signs are known by.  Exact as long as no product of
 * three coordinates is under 1e-290 without being 0, or over 1e300.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_PREDICATES_H
#define WHITTLE_CORE_MATH_PREDICATES_H

#include "core/math/vec3.h"

/* 1 where d is on the side of the plane abc from which a, b, c are seen counter-clockwise, -1 on the other side, 0 on
 * the plane, as it is where a, b, c are on one line.  Usually some 20 operations; a thousand times that where it is a
 * close call. */
int predicate_side(vec3 a, vec3 b, vec3 c, vec3 d);

/* The same in a plane: 1 where abc is counter-clockwise, seen along axis 0 (x), 1 or 2 against its direction. */
int predicate_turn(vec3 a, vec3 b, vec3 c, int axis);

#endif
