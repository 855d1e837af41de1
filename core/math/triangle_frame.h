/* Distances to triangles, by value: the innermost loop of everything that fits a mesh to points.
 *
 * A triangle is measured often once it is made, so it is first brought into its own frame (struct triangle_frame):
 * the corner a is the origin, u runs along ab, n is the normal, v = n x u.  There it lies in the plane, and a distance
 * is a height and a distance in two dimensions: none over the triangle, else that to the nearest of its edges.
 *
 * This is the scalar form.  triangle_sides.h measures the three edges side by side, to the same bits;
 * refine/kernels/sample_batch.c many points, in float and from the middles of the edges.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_TRIANGLE_FRAME_H
#define WHITTLE_CORE_MATH_TRIANGLE_FRAME_H

#include <stdint.h>

#include "core/math/vec3.h"

/* An edge in the plane. */
struct triangle_edge {
    double x, y, length; /* unit direction; any where the edge has no length */
};

struct triangle_frame {
    vec3 a, u, v, n;             /* corner and unit axes */
    double bx, cx, cy;           /* corners b = (bx, 0) and c = (cx, cy), cy >= 0 */
    struct triangle_edge bc, ac; /* from b and from a */
};

static inline struct triangle_edge triangle_edge_along(double x, double y) {
    double length = sqrt(x * x + y * y), inverse = length > 0 ? 1 / length : 0;
    return (struct triangle_edge){length > 0 ? x * inverse : 1, y * inverse, length};
}

static inline struct triangle_frame triangle_frame_of(vec3 a, vec3 b, vec3 c) {
    struct triangle_frame f = {.a = a};
    vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a), normal = vec3_cross(ab, ac);
    double length = vec3_length(ab), area = vec3_length(normal);
    f.u = length > 0 ? vec3_scale(ab, 1 / length) : (vec3){1, 0, 0};
    if (area > 0) {
        f.n = vec3_scale(normal, 1 / area);
        f.v = vec3_cross(f.n, f.u);
    } else {
        vec3_basis(f.u, &f.n, &f.v);
    }
    f.bx = length;
    f.cx = vec3_dot(ac, f.u);
    f.cy = vec3_dot(ac, f.v);
    f.bc = triangle_edge_along(f.cx - f.bx, f.cy);
    f.ac = triangle_edge_along(f.cx, f.cy);
    return f;
}

static inline double triangle_frame_larger(double x, double y) { return x > y ? x : y; }

/* Height over longest edge, from 0 (without area) to 0.87 (equilateral). */
static inline double triangle_frame_shape(const struct triangle_frame *f) {
    double longest = triangle_frame_larger(f->bx, triangle_frame_larger(f->bc.length, f->ac.length));
    return longest > 0 ? f->bx * f->cy / (longest * longest) : 0;
}

static inline vec3 triangle_frame_middle(const struct triangle_frame *f) {
    return vec3_add(f->a, vec3_add(vec3_scale(f->u, (f->bx + f->cx) / 3), vec3_scale(f->v, f->cy / 3)));
}

static inline double triangle_frame_smaller(double x, double y) { return x < y ? x : y; }

enum triangle_feature { TRIANGLE_INSIDE, TRIANGLE_EDGE, TRIANGLE_CORNER };

/* Where on a triangle the nearest place is: inside, on the edge from this corner to the next, or on this corner. */
struct triangle_hit {
    double distance_sq;
    enum triangle_feature feature;
    uint8_t corner;
};

/* The part of it that lies in the plane of (x, y), seen from the start of the edge. */
static inline struct triangle_hit triangle_edge_hit(const struct triangle_edge *e, uint8_t start, double x, double y) {
    double along = x * e->x + y * e->y, off = x * e->y - y * e->x;
    double past = along - e->length;
    uint8_t corner = past < 0 ? start : start == 2 ? 0 : start + 1;
    if (along <= 0) return (struct triangle_hit){x * x + y * y, TRIANGLE_CORNER, corner};
    if (past < 0) return (struct triangle_hit){off * off, TRIANGLE_EDGE, corner};
    return (struct triangle_hit){off * off + past * past, TRIANGLE_CORNER, corner};
}

static inline struct triangle_hit triangle_frame_hit(const struct triangle_frame *f, vec3 p) {
    vec3 r = vec3_sub(p, f->a);
    double height = vec3_dot(r, f->n), x = vec3_dot(r, f->u), y = vec3_dot(r, f->v), beyond = x - f->bx;
    if (y > 0 && f->bc.x * y > f->bc.y * beyond && f->ac.y * x > f->ac.x * y)
        return (struct triangle_hit){height * height, TRIANGLE_INSIDE, 0};
    const struct triangle_edge ab = {1, 0, f->bx}, ca = {-f->ac.x, -f->ac.y, f->ac.length};
    struct triangle_hit best = triangle_edge_hit(&ab, 0, x, y);
    struct triangle_hit other = triangle_edge_hit(&f->bc, 1, beyond, y);
    if (other.distance_sq < best.distance_sq) best = other;
    other = triangle_edge_hit(&ca, 2, x - f->cx, y - f->cy);
    if (other.distance_sq < best.distance_sq) best = other;
    best.distance_sq += height * height;
    return best;
}

#endif
