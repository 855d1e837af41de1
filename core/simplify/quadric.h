/* Weighted quadric error functions, by value.
 *
 * E(x) = (x - o)^T A (x - o) + 2 b . (x - o) + c, relative to an origin o that the owner keeps (the point that the
 * quadric stands on), so that nothing cancels far from the frame's origin.  Garland, Heckbert: Surface simplification
 * using quadric error metrics (1997).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_QUADRIC_H
#define WHITTLE_CORE_SIMPLIFY_QUADRIC_H

#include "core/math/sym3.h"
#include "core/math/vec3.h"
#include "core/params.h"
#include "core/spatial/neighbourhood.h"

typedef struct quadric {
    sym3 a;
    vec3 b;
    double c;
    double weight; /* sum of the weights: sqrt(E / weight) is a length */
} quadric;

/* E at offset x from the quadric's origin; never negative. */
static inline double quadric_value(const quadric *q, vec3 x) {
    double e = vec3_dot(x, vec3_add(sym3_mul(q->a, x), vec3_scale(q->b, 2))) + q->c;
    return e > 0 ? e : 0;
}

/* The same function about another origin: shift = old origin - new origin. */
static inline quadric quadric_shift(quadric q, vec3 shift) {
    vec3 as = sym3_mul(q.a, shift);
    q.c += vec3_dot(shift, as) - 2 * vec3_dot(q.b, shift);
    q.b = vec3_sub(q.b, as);
    return q;
}

static inline quadric quadric_add(quadric p, quadric q) {
    return (quadric){sym3_add(p.a, q.a), vec3_add(p.b, q.b), p.c + q.c, p.weight + q.weight};
}

/* weight x squared distance to the plane through the origin with unit normal n. */
static inline void quadric_add_plane(quadric *q, vec3 n, double weight) {
    q->a = sym3_add(q->a, sym3_scale(sym3_outer(n), weight));
    q->weight += weight;
}

/* weight x squared distance to the line through the origin with unit direction n; doesn't count to the weight. */
static inline void quadric_add_line(quadric *q, vec3 n, double weight) {
    sym3 across = sym3_outer(n);
    q->a = sym3_add(q->a, (sym3){weight * (1 - across.xx), -weight * across.xy, -weight * across.xz,
                                 weight * (1 - across.yy), -weight * across.yz, weight * (1 - across.zz)});
}

/* A quadric in half the memory, for arrays of them: contraction is bound by how many it can touch.  Rounding adds about
 * 1e-7 x weight x |x|^2 to E, far below what the line quadric adds. */
struct packed_quadric {
    float a[6], b[3], c, weight;
};

static inline struct packed_quadric quadric_pack(const quadric *q) {
    return (struct packed_quadric){
        {(float)q->a.xx, (float)q->a.xy, (float)q->a.xz, (float)q->a.yy, (float)q->a.yz, (float)q->a.zz},
        {(float)q->b.x, (float)q->b.y, (float)q->b.z},
        (float)q->c,
        (float)q->weight};
}

static inline quadric quadric_unpack(const struct packed_quadric *p) {
    return (quadric){
        {(double)p->a[0], (double)p->a[1], (double)p->a[2], (double)p->a[3], (double)p->a[4], (double)p->a[5]},
        {(double)p->b[0], (double)p->b[1], (double)p->b[2]},
        (double)p->c,
        (double)p->weight};
}

struct quadric_options {
    enum area_weight area_weight;
    double line; /* lambda of the line quadric, a fraction of the point's area */
    unsigned threads;
};

/* quadrics[p], n of them, each about its own point: the planes of the virtual triangles (p, q_j, q_j+1) of the
 * neighbours sorted by angle in the tangent plane (Lee, Jong section 4.4), times weight[p], plus the line quadric.  No
 * triangle spans a gap wider than 0.9 pi.  O(n k log k). */
void quadric_assemble(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood,
                      const float *weight, const struct quadric_options *options, struct packed_quadric *quadrics);

#endif
