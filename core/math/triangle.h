/* The point of a triangle that is nearest to a point, by value.
 *
 * The plain path is Ericson's: the six dot products say in which Voronoi region of the triangle (three corners, three
 * edges, the face) the point lies, and the nearest point follows.  Its face weights are differences of products, whose
 * rounding grows with (length / height)^2 of the triangle.  So a triangle that is thinner than about 1e-4 is measured
 * again, as three segments and a face whose weights come from the normal, where rounding grows with length / height
 * only.  Triangles without area are segments or points, and need no care from callers.
 *
 * Source: Christer Ericson, Real-Time Collision Detection (2005), section 5.1.5.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_TRIANGLE_H
#define WHITTLE_CORE_MATH_TRIANGLE_H

#include "core/math/vec3.h"

/* Of squared areas to squared products of edges: below, the face is measured with care. */
#define TRIANGLE_THIN_SQ 1e-8

/* The point of the segment ab that is nearest to p; a where a = b. */
static inline vec3 triangle_closest_on_edge(vec3 p, vec3 a, vec3 b) {
    vec3 ab = vec3_sub(b, a);
    double along = vec3_dot(ab, vec3_sub(p, a)), length_sq = vec3_length_sq(ab);
    if (!(along > 0)) return a;
    return along >= length_sq ? b : vec3_add(a, vec3_scale(ab, along / length_sq));
}

static inline vec3 triangle_nearer(vec3 p, vec3 x, vec3 y) {
    return vec3_distance_sq(p, y) < vec3_distance_sq(p, x) ? y : x;
}

/* triangle_closest for any triangle, however thin, at three times the cost. */
static inline vec3 triangle_closest_thin(vec3 p, vec3 a, vec3 b, vec3 c) {
    vec3 best = triangle_closest_on_edge(p, a, b);
    best = triangle_nearer(p, best, triangle_closest_on_edge(p, b, c));
    best = triangle_nearer(p, best, triangle_closest_on_edge(p, c, a));
    vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a), ap = vec3_sub(p, a), n = vec3_cross(ab, ac);
    double nn = vec3_length_sq(n);
    double v = vec3_dot(n, vec3_cross(ap, ac)), w = vec3_dot(n, vec3_cross(ab, ap));
    if (!(nn > 0 && v > 0 && w > 0 && v + w < nn)) return best;
    vec3 face = vec3_add(a, vec3_add(vec3_scale(ab, v / nn), vec3_scale(ac, w / nn)));
    return triangle_nearer(p, best, face);
}

/* The point of the triangle abc (any orientation, may be degenerate) that is nearest to p; finite for finite input
 * whose fourth powers don't overflow.  Lies in the triangle up to rounding; a corner is returned bit for bit.  About 20
 * ns. */
static inline vec3 triangle_closest(vec3 p, vec3 a, vec3 b, vec3 c) {
    vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a), ap = vec3_sub(p, a);
    double d1 = vec3_dot(ab, ap), d2 = vec3_dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return a;
    vec3 bp = vec3_sub(p, b);
    double d3 = vec3_dot(ab, bp), d4 = vec3_dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return b;
    vec3 cp = vec3_sub(p, c);
    double d5 = vec3_dot(ab, cp), d6 = vec3_dot(ac, cp);
    if (d6 >= 0 && d5 <= d6) return c;
    double vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
    if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return vec3_add(a, vec3_scale(ab, d1 / (d1 - d3)));
    if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 > d6) return vec3_add(a, vec3_scale(ac, d2 / (d2 - d6)));
    double to_c = d4 - d3, to_b = d5 - d6;
    if (va <= 0 && to_c >= 0 && to_b >= 0 && to_c + to_b > 0)
        return vec3_add(b, vec3_scale(vec3_sub(c, b), to_c / (to_c + to_b)));
    double sum = va + vb + vc;
    if (!(sum > TRIANGLE_THIN_SQ * vec3_length_sq(ab) * vec3_length_sq(ac))) return triangle_closest_thin(p, a, b, c);
    return vec3_add(a, vec3_add(vec3_scale(ab, vb / sum), vec3_scale(ac, vc / sum)));
}

#endif
