/* Q_p = w_p x (the planes of virtual triangles + those of a boundary) + a line's, which isn't weighted (Lee, Jong
 * section 4.4, step 1).  The paper's w_p is DSO_p; ours is made of it by dso_weights (dso.h).
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
#include "core/simplify/quadric.h"

#include <assert.h>

#include "core/base/par.h"
#include "core/math/simd.h"

enum { FOUR = 4, PARTS = FOUR / F64_LANES }; /* angles that are compared together */
enum { GRAIN = 1024, ROOM = KNN_MAX_K + 2 * FOUR, NOWHERE = KNN_MAX_K };
static const double WIDEST_COSINE = -0.95105651629515357; /* of 0.9 pi */
static const double BOUNDARY = 1.0;

struct assembly {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    const float *weight;
    const struct quadric_options *options;
    struct packed_quadric *quadrics;
};

/* The neighbours of p, by rank of nearness; beyond the last, numbers of no meaning. */
struct spokes {
    unsigned count;
    double x[ROOM], y[ROOM], z[ROOM]; /* neighbour - p */
    double u[ROOM], v[ROOM];          /* the same in the tangent plane */
    double angle[ROOM];               /* around the normal, in quarters of a turn (see quarters_of) */
};

/* What lies between a neighbour and the next one around p; all but the wide ones are triangles. */
struct sectors {
    double wide[ROOM]; /* not 0: no triangle */
    double area[ROOM], weight[ROOM];
    double a[6][ROOM]; /* of the quadric of weight 1 */
};

/* A number from -2 to 2 that grows with the angle of (u, v): what an arctangent would sort by, for one division. */
INLINE f64v quarters_of(f64v u, f64v v) {
    f64v sum = f64_abs(u) + f64_abs(v), side = f64_where(f64_is_positive(sum), v / sum);
    f64v half = f64_pick(f64_at_least(v, f64_all(0)), f64_all(2), f64_all(-2));
    return f64_pick(f64_at_least(u, f64_all(0)), side, half - side);
}

INLINE void find_spokes(const struct assembly *assembly, size_t p, struct spokes *s) {
    const struct neighbourhood *neighbours = assembly->neighbours;
    const uint32_t *id = &neighbours->id[p * neighbours->stride];
    vec3 u, v;
    vec3_basis(assembly->normal[p], &u, &v);
    s->count = neighbours->count[p];
    for (unsigned i = 0; i < s->count; i++) {
        vec3 e = vec3_sub(assembly->point[id[i]], assembly->point[p]);
        s->x[i] = e.x, s->y[i] = e.y, s->z[i] = e.z;
    }
    for (unsigned i = s->count; i % F64_LANES; i++) s->x[i] = s->y[i] = s->z[i] = 0;
    for (unsigned i = 0; i < s->count; i += F64_LANES) {
        f64v x = f64_load(&s->x[i]), y = f64_load(&s->y[i]), z = f64_load(&s->z[i]);
        f64v along_u = x * u.x + y * u.y + z * u.z, along_v = x * v.x + y * v.y + z * v.z;
        f64_store(&s->u[i], along_u);
        f64_store(&s->v[i], along_v);
        f64_store(&s->angle[i], quarters_of(along_u, along_v));
    }
}

/* By angle, then length, then id. */
static int is_before(const struct spokes *s, const uint32_t *id, unsigned i, unsigned j) {
    if (s->angle[i] != s->angle[j]) return s->angle[i] < s->angle[j];
    double li = s->x[i] * s->x[i] + s->y[i] * s->y[i] + s->z[i] * s->z[i];
    double lj = s->x[j] * s->x[j] + s->y[j] * s->y[j] + s->z[j] * s->z[j];
    return li != lj ? li < lj : id[i] < id[j];
}

/* Around the normal: each one's place is how many are before it. */
INLINE void find_order(const struct spokes *s, const uint32_t *id, unsigned order[ROOM]) {
    unsigned filled = 0;
    order[0] = 0; /* put_in_order copies the first one, where there are none too */
    for (unsigned i = 0; i < s->count; i++) order[i] = NOWHERE;
    for (unsigned i = 0; i < s->count; i += FOUR) {
        f64v angle[PARTS];
        i64v place[PARTS];
        for (unsigned k = 0; k < PARTS; k++) {
            angle[k] = f64_load(&s->angle[i + k * F64_LANES]);
            place[k] = i64_all(0);
        }
        for (unsigned j = 0; j < s->count; j++)
            for (unsigned k = 0; k < PARTS; k++) place[k] -= f64_less(f64_all(s->angle[j]), angle[k]);
        for (unsigned k = 0; k < FOUR && i + k < s->count; k++)
            order[SIMD_LANE(place[k / F64_LANES], k % F64_LANES)] = i + k;
    }
    for (unsigned i = 0; i < s->count; i++) filled += order[i] != NOWHERE;
    if (filled == s->count) return;
    for (unsigned i = 0; i < s->count; i++) { /* there are equal angles */
        unsigned j = i;
        for (; j > 0 && is_before(s, id, i, order[j - 1]); j--) order[j] = order[j - 1];
        order[j] = i;
    }
}

/* The spokes in order, and the first one once more. */
static void put_in_order(const struct spokes *s, const unsigned order[ROOM], struct spokes *to) {
    to->count = s->count;
    for (unsigned i = 0; i < s->count + F64_LANES; i++) {
        unsigned from = order[i < s->count ? i : 0];
        to->x[i] = s->x[from], to->y[i] = s->y[from], to->z[i] = s->z[from];
        to->u[i] = s->u[from], to->v[i] = s->v[from], to->angle[i] = s->angle[from];
    }
}

/* Whether the angle from each spoke on to the next is over 0.9 pi. */
INLINE i64v are_wide(const struct spokes *s, unsigned i) {
    f64v u = f64_load(&s->u[i]), v = f64_load(&s->v[i]), from = f64_load(&s->angle[i]);
    f64v next_u = f64_load(&s->u[i + 1]), next_v = f64_load(&s->v[i + 1]), to = f64_load(&s->angle[i + 1]);
    static const double turn[8] = {0, 0, 0, 4, 0, 0, 0, 0}; /* where the last spoke is, a turn is over */
    unsigned last = s->count - 1 - i;
    f64v turns = f64_load(&turn[last < F64_LANES ? 3 - last : 4]);
    f64v dot = u * next_u + v * next_v;
    f64v least = WIDEST_COSINE * WIDEST_COSINE * (u * u + v * v) * (next_u * next_u + next_v * next_v);
    return f64_less(f64_all(2), to - from + turns) | (f64_less(dot, f64_all(0)) & f64_less(least, dot * dot));
}

INLINE void find_sectors(const struct spokes *s, bool by_area, struct sectors *to) {
    for (unsigned i = 0; i < s->count; i += F64_LANES) {
        f64v x = f64_load(&s->x[i]), y = f64_load(&s->y[i]), z = f64_load(&s->z[i]);
        f64v next_x = f64_load(&s->x[i + 1]), next_y = f64_load(&s->y[i + 1]), next_z = f64_load(&s->z[i + 1]);
        f64v nx = y * next_z - z * next_y, ny = z * next_x - x * next_z, nz = x * next_y - y * next_x;
        f64v twice_area = f64_sqrt(nx * nx + ny * ny + nz * nz), area = twice_area / 2;
        i64v is_triangle = f64_is_positive(twice_area);
        f64v weight = f64_where(is_triangle, by_area ? area : f64_all(1));
        f64v each = f64_where(is_triangle, weight / (twice_area * twice_area));
        f64_store(&to->wide[i], f64_where(are_wide(s, i), f64_all(1)));
        f64_store(&to->area[i], f64_where(is_triangle, area));
        f64_store(&to->weight[i], weight);
        f64_store(&to->a[0][i], nx * nx * each);
        f64_store(&to->a[1][i], nx * ny * each);
        f64_store(&to->a[2][i], nx * nz * each);
        f64_store(&to->a[3][i], ny * ny * each);
        f64_store(&to->a[4][i], ny * nz * each);
        f64_store(&to->a[5][i], nz * nz * each);
    }
}

/* Keeps the border where it is: the plane along the edge e and the normal n. */
static void add_boundary(quadric *q, vec3 e, vec3 n, double weight) {
    vec3 across = vec3_cross(e, n);
    double length_sq = vec3_length_sq(across);
    if (length_sq > 0) quadric_add_plane(q, vec3_unit(across), weight * BOUNDARY * length_sq);
}

static void add_sector(const struct sectors *sectors, unsigned i, quadric *q, double *area) {
    *area += sectors->area[i];
    q->a = sym3_add(q->a, (sym3){sectors->a[0][i], sectors->a[1][i], sectors->a[2][i], sectors->a[3][i],
                                 sectors->a[4][i], sectors->a[5][i]});
    q->weight += sectors->weight[i];
}

static vec3 spoke_at(const struct spokes *s, unsigned i) { return (vec3){s->x[i], s->y[i], s->z[i]}; }

INLINE void assemble_point(const struct assembly *assembly, size_t p) {
    struct spokes found, spokes;
    struct sectors sectors;
    unsigned order[ROOM];
    bool by_area = assembly->options->area_weight == AREA_AREA;
    quadric q = {0};
    double area = 0;
    find_spokes(assembly, p, &found);
    find_order(&found, &assembly->neighbours->id[p * assembly->neighbours->stride], order);
    put_in_order(&found, order, &spokes);
    find_sectors(&spokes, by_area, &sectors);
    for (unsigned i = 0; i < spokes.count; i++) {
        if (sectors.wide[i] == 0) {
            add_sector(&sectors, i, &q, &area);
        } else if (spokes.count >= 3) {
            add_boundary(&q, spoke_at(&spokes, i), assembly->normal[p], 1);
            add_boundary(&q, spoke_at(&spokes, i + 1), assembly->normal[p], 1);
        }
    }
    double weight = (double)assembly->weight[p];
    q = (quadric){sym3_scale(q.a, weight), vec3_scale(q.b, weight), q.c * weight, q.weight * weight};
    quadric_add_line(&q, assembly->normal[p], assembly->options->line * (by_area ? area : spokes.count));
    assembly->quadrics[p] = quadric_pack(&q);
}

static void assemble_range(void *ctx, size_t begin, size_t end) {
    for (size_t p = begin; p < end; p++) assemble_point(ctx, p);
}

FOR_EACH_PROCESSOR(void, quadric_assemble)
(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood, const float *weight,
 const struct quadric_options *options, struct packed_quadric *quadrics) {
    assert(neighbourhood->stride <= KNN_MAX_K);
    struct assembly assembly = {point, normal, neighbourhood, weight, options, quadrics};
    par_for(options->threads, neighbourhood->n, GRAIN, assemble_range, &assembly);
}
