/* Virtual triangles.
 *
 *          q1 --- q0        The neighbours of p in the order of their angle around n_p; consecutive ones span a
 *         /  \  /  \        triangle with p.  Every plane goes through p, so E_p(p) = 0.
 *       q2 -- p -- q5
 *         \  /              Between q2 .. q5 here the gap is wider than 0.9 pi: a boundary or a hole, and no
 *          q3   (gap)       triangle there.
 *
 * A boundary point's gap says that the surface ends; the plane through the gap's edges and the normal keeps the border
 * in place (weight BOUNDARY x squared length, as Garland, Heckbert section 6 do for discontinuities).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/quadric.h"

#include <assert.h>

#include "core/par.h"

enum { GRAIN = 1024 };
static const double WIDEST_COSINE = -0.95105651629515357; /* of 0.9 pi */
static const double BOUNDARY = 1.0;

struct assembly {
    const vec3 *point, *normal;
    const struct neighbourhood *hood;
    const float *weight;
    const struct quadric_options *options;
    struct packed_quadric *quadrics;
};

struct spoke {
    vec3 e;       /* neighbour - p */
    double u, v;  /* the same in the tangent plane */
    double angle; /* around the normal, in quarters of a turn (see quarters_of) */
    uint32_t id;
};

/* A number from -2 to 2 that grows with the angle of (u, v): what an arctangent would sort by, for one division. */
static double quarters_of(double u, double v) {
    double sum = fabs(u) + fabs(v), side = sum > 0 ? v / sum : 0;
    return u >= 0 ? side : (v >= 0 ? 2 : -2) - side;
}

/* Whether the angle from s on to t, turns more than s, is over 0.9 pi. */
static int is_wide(const struct spoke *s, const struct spoke *t, double turns) {
    if (t->angle - s->angle + 4 * turns > 2) return 1;
    double dot = s->u * t->u + s->v * t->v;
    return dot < 0 &&
           dot * dot > WIDEST_COSINE * WIDEST_COSINE * (s->u * s->u + s->v * s->v) * (t->u * t->u + t->v * t->v);
}

static int spoke_before(const struct spoke *a, const struct spoke *b) {
    if (a->angle != b->angle) return a->angle < b->angle;
    double la = vec3_length_sq(a->e), lb = vec3_length_sq(b->e);
    return la != lb ? la < lb : a->id < b->id;
}

/* Insertion sort: there are about ten. */
static unsigned sorted_spokes(const struct assembly *assembly, size_t p, struct spoke *spoke) {
    const struct neighbourhood *hood = assembly->hood;
    vec3 u, v;
    vec3_basis(assembly->normal[p], &u, &v);
    for (unsigned i = 0; i < hood->count[p]; i++) {
        uint32_t id = hood->id[p * hood->stride + i];
        vec3 e = vec3_sub(assembly->point[id], assembly->point[p]);
        struct spoke s = {e, vec3_dot(e, u), vec3_dot(e, v), 0, id};
        s.angle = quarters_of(s.u, s.v);
        unsigned j = i;
        for (; j > 0 && spoke_before(&s, &spoke[j - 1]); j--) spoke[j] = spoke[j - 1];
        spoke[j] = s;
    }
    return hood->count[p];
}

/* Keeps the border where it is: the plane along the edge e and the normal n. */
static void add_boundary(quadric *q, vec3 e, vec3 n, double weight) {
    vec3 across = vec3_cross(e, n);
    double length_sq = vec3_length_sq(across);
    if (length_sq > 0) quadric_add_plane(q, vec3_unit(across), weight * BOUNDARY * length_sq);
}

static void add_sector(const struct assembly *assembly, quadric *q, const struct spoke *s, const struct spoke *t,
                       double *area_sum) {
    vec3 normal = vec3_cross(s->e, t->e);
    double twice_area = vec3_length(normal);
    if (twice_area <= 0) return;
    double area = twice_area / 2;
    *area_sum += area;
    double weight = assembly->options->area_weight == AREA_AREA ? area : 1;
    q->a = sym3_add(q->a, sym3_scale(sym3_outer(normal), weight / (twice_area * twice_area)));
    q->weight += weight;
}

static quadric weighted(quadric q, double w) {
    return (quadric){sym3_scale(q.a, w), vec3_scale(q.b, w), q.c * w, q.weight * w};
}

static void assemble_point(const struct assembly *assembly, size_t p) {
    struct spoke spoke[KNN_MAX_K];
    unsigned count = sorted_spokes(assembly, p, spoke);
    quadric sum = {0}, *q = &sum;
    double area = 0;
    for (unsigned i = 0; i < count; i++) {
        const struct spoke *s = &spoke[i], *t = &spoke[(i + 1) % count];
        if (!is_wide(s, t, i + 1 == count)) {
            add_sector(assembly, q, s, t, &area);
        } else if (count >= 3) {
            add_boundary(q, s->e, assembly->normal[p], 1);
            add_boundary(q, t->e, assembly->normal[p], 1);
        }
    }
    *q = weighted(*q, (double)assembly->weight[p]);
    double scale = assembly->options->area_weight == AREA_AREA ? area : count;
    quadric_add_line(q, assembly->normal[p], assembly->options->line * scale);
    assembly->quadrics[p] = quadric_pack(q);
}

static void assemble_range(void *ctx, size_t begin, size_t end) {
    for (size_t p = begin; p < end; p++) assemble_point(ctx, p);
}

void quadric_assemble(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood,
                      const float *weight, const struct quadric_options *options, struct packed_quadric *quadrics) {
    assert(neighbourhood->stride <= KNN_MAX_K);
    struct assembly assembly = {point, normal, neighbourhood, weight, options, quadrics};
    par_for(options->threads, neighbourhood->n, GRAIN, assemble_range, &assembly);
}
