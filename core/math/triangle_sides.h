/* Distance to a triangle with its three edges measured side by side, without a branch: which part of a triangle is
 * nearest is hard to foresee.  The vector form of triangle_frame_hit (triangle_frame.h), bit for bit; at a width of one
 * it is that.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_TRIANGLE_SIDES_H
#define WHITTLE_CORE_MATH_TRIANGLE_SIDES_H

#include "core/math/simd.h"
#include "core/math/triangle_frame.h"

enum { SIDE_BC, SIDE_CA, SIDE_AB, SIDES };
enum { ALONG_X = 0, ALONG_Y = 3, LENGTH = 6, BEGINS = LENGTH + SIDE_AB, BEGINS_C = BEGINS + 1, HEIGHT_C = 11 };

/* A triangle in its frame.  Number ALONG_X + i, ALONG_Y + i, LENGTH + i: of side i.  BEGINS + i: where it begins, x; of
 * them only c lies off the axis, at y = HEIGHT_C.  Vectors run over into the next numbers. */
struct triangle_sides {
    double number[12];
    vec3 a, u, v, n;
};

static inline struct triangle_sides triangle_sides_of(const struct triangle_frame *f) {
    return (struct triangle_sides){
        .number = {f->bc.x, -f->ac.x, 1, f->bc.y, -f->ac.y, 0, f->bc.length, f->ac.length, f->bx, f->cx, 0, f->cy},
        .a = f->a,
        .u = f->u,
        .v = f->v,
        .n = f->n};
}

#if SIMD_WIDTH == 1
INLINE struct triangle_hit triangle_sides_hit(const struct triangle_sides *s, vec3 p) {
    const double *of = s->number;
    struct triangle_frame frame = {.a = s->a, .u = s->u, .v = s->v, .n = s->n};
    frame.bx = of[BEGINS], frame.cx = of[BEGINS_C], frame.cy = of[HEIGHT_C];
    frame.bc = (struct triangle_edge){of[ALONG_X + SIDE_BC], of[ALONG_Y + SIDE_BC], of[LENGTH + SIDE_BC]};
    frame.ac = (struct triangle_edge){-of[ALONG_X + SIDE_CA], -of[ALONG_Y + SIDE_CA], of[LENGTH + SIDE_CA]};
    return triangle_frame_hit(&frame, p);
}
#else
INLINE double side_number(const f64v of[F64_PARTS], unsigned side) {
    return SIMD_LANE(of[side / F64_LANES], side % F64_LANES);
}

/* Which of the sides from number k on begins at c. */
INLINE i64v sides_from_c(unsigned k) {
    static const int64_t from_c[] = {0, -1, 0, 0};
    i64v mask;
    memcpy(&mask, &from_c[k], sizeof mask);
    return mask;
}

INLINE struct triangle_hit triangle_sides_hit(const struct triangle_sides *s, vec3 p) {
    static const uint8_t start[] = {[SIDE_BC] = 1, [SIDE_CA] = 2, [SIDE_AB] = 0};
    const double *of = s->number;
    vec3 r = vec3_sub(p, s->a);
    double height = vec3_dot(r, s->n), x = vec3_dot(r, s->u), y = vec3_dot(r, s->v);
    f64v side_sq[F64_PARTS], along[F64_PARTS], off[F64_PARTS];
    for (unsigned k = 0, part = 0; k < SIDES; k += F64_LANES, part++) {
        f64v dx = x - f64_load(&of[BEGINS + k]), dy = y - f64_where(sides_from_c(k), f64_all(of[HEIGHT_C]));
        f64v ex = f64_load(&of[ALONG_X + k]), ey = f64_load(&of[ALONG_Y + k]);
        along[part] = dx * ex + dy * ey, off[part] = dx * ey - dy * ex;
        f64v past = f64_positive(along[part] - f64_load(&of[LENGTH + k])), off_sq = off[part] * off[part];
        side_sq[part] = f64_pick(f64_at_least(f64_all(0), along[part]), dx * dx + dy * dy, off_sq + past * past);
    }
    if ((y > 0) & (side_number(off, SIDE_BC) < 0) & (of[ALONG_Y + SIDE_CA] * x < of[ALONG_X + SIDE_CA] * y))
        return (struct triangle_hit){height * height, TRIANGLE_INSIDE, 0};
    unsigned side = side_number(side_sq, SIDE_BC) < side_number(side_sq, SIDE_AB) ? SIDE_BC : SIDE_AB;
    side = side_number(side_sq, SIDE_CA) < side_number(side_sq, side) ? SIDE_CA : side;
    double at = side_number(along, side);
    bool before = at <= 0, past = at >= of[LENGTH + side];
    unsigned corner = (start[side] + (unsigned)past) % 3;
    return (struct triangle_hit){side_number(side_sq, side) + height * height,
                                 (before || past) ? TRIANGLE_CORNER : TRIANGLE_EDGE, (uint8_t)corner};
}
#endif

#endif
