/* Distances to triangles, by value: the innermost loop of everything that fits a mesh to points.
 *
 * A triangle is measured often once it is made, so it is first brought into its own frame (struct triangle_frame):
 * the corner a is the origin, u runs along ab, n is the normal, v = n x u.  There it lies in the plane, and a distance
 * is a height and a distance in two dimensions.
 *
 * Source: the regions are Ericson's (Real-Time Collision Detection, section 5.1.5), the frame is the usual one.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TRIANGLE_FRAME_H
#define WHITTLE_CORE_TRIANGLE_FRAME_H

#include "core/vec3.h"

struct triangle_frame {
    vec3 a, u, v, n;       /* corner and unit axes */
    double bx, cx, cy;     /* corners b = (bx, 0) and c = (cx, cy), cy >= 0 */
    double inv_bc, inv_ca; /* 1 / squared length of the edges bc and ca; 0 for an edge without length */
};

static inline double triangle_frame_inverse(double x) { return x > 0 ? 1 / x : 0; }

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
    double ex = f.cx - f.bx;
    f.inv_bc = triangle_frame_inverse(ex * ex + f.cy * f.cy);
    f.inv_ca = triangle_frame_inverse(f.cx * f.cx + f.cy * f.cy);
    return f;
}

/* Height over longest edge, from 0 (without area) to 0.87 (equilateral). */
static inline double triangle_frame_shape(const struct triangle_frame *f) {
    double ex = f->cx - f->bx;
    double longest_sq = fmax(f->bx * f->bx, fmax(ex * ex + f->cy * f->cy, f->cx * f->cx + f->cy * f->cy));
    return longest_sq > 0 ? f->bx * f->cy / longest_sq : 0;
}

static inline vec3 triangle_frame_middle(const struct triangle_frame *f) {
    return vec3_add(f->a, vec3_add(vec3_scale(f->u, (f->bx + f->cx) / 3), vec3_scale(f->v, f->cy / 3)));
}

/* Squared distance in the plane from (x, y) to the segment from (ax, ay) along (ex, ey). */
static inline double triangle_frame_edge_sq(double x, double y, double ex, double ey, double inverse) {
    double t = (x * ex + y * ey) * inverse;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    double dx = x - t * ex, dy = y - t * ey;
    return dx * dx + dy * dy;
}

/* The smaller of best_sq and the squared distance from p to the triangle. */
static inline double triangle_frame_nearer_sq(const struct triangle_frame *f, vec3 p, double best_sq) {
    vec3 r = vec3_sub(p, f->a);
    double height = vec3_dot(r, f->n), result_sq = height * height;
    if (result_sq >= best_sq) return best_sq;
    double x = vec3_dot(r, f->u), y = vec3_dot(r, f->v);
    double ex = f->cx - f->bx, plane_sq = -1;
    if (y < 0) {
        double dx = x < 0 ? x : x > f->bx ? x - f->bx : 0;
        plane_sq = dx * dx + y * y;
    }
    if (ex * y - f->cy * (x - f->bx) < 0) {
        double d_sq = triangle_frame_edge_sq(x - f->bx, y, ex, f->cy, f->inv_bc);
        if (plane_sq < 0 || d_sq < plane_sq) plane_sq = d_sq;
    }
    if (f->cy * x - f->cx * y < 0) {
        double d_sq = triangle_frame_edge_sq(x, y, f->cx, f->cy, f->inv_ca);
        if (plane_sq < 0 || d_sq < plane_sq) plane_sq = d_sq;
    }
    if (plane_sq > 0) result_sq += plane_sq;
    return result_sq < best_sq ? result_sq : best_sq;
}

/* Barycentric coordinates (of a, b, c; each >= 0, sum 1) of the point of the triangle that is nearest to p. */
static inline vec3 triangle_frame_foot(vec3 a, vec3 b, vec3 c, vec3 p) {
    vec3 ab = vec3_sub(b, a), ac = vec3_sub(c, a), ap = vec3_sub(p, a);
    double d1 = vec3_dot(ab, ap), d2 = vec3_dot(ac, ap);
    if (d1 <= 0 && d2 <= 0) return (vec3){1, 0, 0};
    vec3 bp = vec3_sub(p, b), cp = vec3_sub(p, c);
    double d3 = vec3_dot(ab, bp), d4 = vec3_dot(ac, bp);
    if (d3 >= 0 && d4 <= d3) return (vec3){0, 1, 0};
    double d5 = vec3_dot(ab, cp), d6 = vec3_dot(ac, cp);
    if (d6 >= 0 && d5 <= d6) return (vec3){0, 0, 1};
    double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        double t = d1 > d3 ? d1 / (d1 - d3) : 0;
        return (vec3){1 - t, t, 0};
    }
    if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        double t = d2 > d6 ? d2 / (d2 - d6) : 0;
        return (vec3){1 - t, 0, t};
    }
    if (va <= 0 && d4 >= d3 && d5 >= d6) {
        double sum = (d4 - d3) + (d5 - d6), t = sum > 0 ? (d4 - d3) / sum : 0;
        return (vec3){0, 1 - t, t};
    }
    double inverse = 1 / (va + vb + vc);
    return (vec3){va * inverse, vb * inverse, vc * inverse};
}

#endif
