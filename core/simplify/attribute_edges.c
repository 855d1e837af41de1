/* A linear function over the tangent plane of each point, by least squares, and what it leaves over.
 *
 * Garland, Heckbert: Simplifying surfaces with color and texture using quadric error metrics (1998) have the attributes
 * as further dimensions of the quadrics.  Here a vertex's attributes are those of its point, and the quadrics stay as
 * small as they are.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/attribute_edges.h"

#include "core/base/par.h"

static const double ALONG = 0.5; /* of the cost, in all directions: points on both sides are to be as dense as there */
enum { GRAIN = 2048, LEAST = 3 /* neighbours that a function is fitted to */ };

struct edges {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    const float *value;
    double weight;
    const struct quadric_options *options;
    struct packed_quadric *quadrics;
};

/* Sums over the neighbours, of their places (u, v) in the tangent plane and their values less the point's. */
struct sums {
    double n, u, v, a, uu, uv, vv, ua, va, aa;
};

static struct sums sums_of(const struct edges *e, size_t p, vec3 u_axis, vec3 v_axis) {
    struct sums s = {.n = 1}; /* the point itself, at 0 */
    for (unsigned i = 0; i < e->neighbours->count[p]; i++) {
        uint32_t q = e->neighbours->id[p * e->neighbours->stride + i];
        double a = (double)e->value[q] - (double)e->value[p];
        if (!(fabs(a) <= 1e30)) continue;
        vec3 d = vec3_sub(e->point[q], e->point[p]);
        double u = vec3_dot(d, u_axis), v = vec3_dot(d, v_axis);
        s.n += 1, s.u += u, s.v += v, s.a += a;
        s.uu += u * u, s.uv += u * v, s.vv += v * v, s.ua += u * a, s.va += v * a, s.aa += a * a;
    }
    return s;
}

/* The gradient (gu, gv) of the function that fits, and the rms that is left; false: there is none. */
static bool fit(const struct sums *s, double *gu, double *gv, double *left) {
    double uu = s->uu - s->u * s->u / s->n, uv = s->uv - s->u * s->v / s->n, vv = s->vv - s->v * s->v / s->n;
    double ua = s->ua - s->u * s->a / s->n, va = s->va - s->v * s->a / s->n, aa = s->aa - s->a * s->a / s->n;
    double determinant = uu * vv - uv * uv;
    if (s->n < 1 + LEAST || !(determinant > 1e-9 * (uu + vv) * (uu + vv))) return false;
    *gu = (ua * vv - va * uv) / determinant;
    *gv = (va * uu - ua * uv) / determinant;
    double rest = aa - *gu * ua - *gv * va;
    *left = rest > 0 ? sqrt(rest / s->n) : 0;
    return true;
}

static void add_point(const struct edges *e, size_t p) {
    vec3 u_axis, v_axis;
    double gu, gv, left, spacing = (double)e->neighbours->spacing[p];
    if (!isfinite(e->value[p]) || !(spacing > 0)) return;
    vec3_basis(e->normal[p], &u_axis, &v_axis);
    struct sums s = sums_of(e, p, u_axis, v_axis);
    if (!fit(&s, &gu, &gv, &left) || left == 0) return;
    double area = e->options->area_weight == AREA_AREA ? spacing * spacing : 1;
    double height = e->weight * ATTRIBUTE_EDGE_HEIGHT * left / spacing, size = sqrt(gu * gu + gv * gv);
    quadric q = quadric_unpack(&e->quadrics[p]);
    double own = q.weight, cost = area * height * height;
    quadric_add_line(&q, e->normal[p], ALONG * cost);
    if (size * spacing > left / 4) { /* across the edge alone */
        vec3 across = vec3_add(vec3_scale(u_axis, gu / size), vec3_scale(v_axis, gv / size));
        quadric_add_plane(&q, across, (1 - ALONG) * cost);
    } else { /* a corner, a spot, or noise: in all directions */
        quadric_add_line(&q, e->normal[p], (1 - ALONG) * cost);
    }
    q.weight = own;
    e->quadrics[p] = quadric_pack(&q);
}

static void add_range(void *ctx, size_t begin, size_t end) {
    for (size_t p = begin; p < end; p++) add_point(ctx, p);
}

void attribute_edges_add(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood,
                         const float *value, double weight, const struct quadric_options *options,
                         struct packed_quadric *quadrics) {
    struct edges edges = {point, normal, neighbourhood, value, weight, options, quadrics};
    par_for(options->threads, neighbourhood->n, GRAIN, add_range, &edges);
}
