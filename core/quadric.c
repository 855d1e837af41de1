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

#include "core/lanes.h"
#include "core/par.h"

enum { GRAIN = 1024, ROOM = KNN_MAX_K + 2 * LANES, NOWHERE = KNN_MAX_K };
static const double WIDEST_COSINE = -0.95105651629515357; /* of 0.9 pi */
static const double BOUNDARY = 1.0;

struct assembly {
    const vec3 *point, *normal;
    const struct neighbourhood *hood;
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
INLINE lanes quarters_of(lanes u, lanes v) {
    lanes sum = lanes_magnitude(u) + lanes_magnitude(v), side = lanes_where(sum > 0, v / sum);
    lanes half = lanes_pick(v >= 0, lanes_all(2), lanes_all(-2));
    return lanes_pick(u >= 0, side, half - side);
}

INLINE void find_spokes(const struct assembly *assembly, size_t p, struct spokes *s) {
    const struct neighbourhood *hood = assembly->hood;
    const uint32_t *id = &hood->id[p * hood->stride];
    vec3 u, v;
    vec3_basis(assembly->normal[p], &u, &v);
    s->count = hood->count[p];
    for (unsigned i = 0; i < s->count; i++) {
        vec3 e = vec3_sub(assembly->point[id[i]], assembly->point[p]);
        s->x[i] = e.x, s->y[i] = e.y, s->z[i] = e.z;
    }
    for (unsigned i = s->count; i % LANES; i++) s->x[i] = s->y[i] = s->z[i] = 0;
    for (unsigned i = 0; i < s->count; i += LANES) {
        lanes x = lanes_load(&s->x[i]), y = lanes_load(&s->y[i]), z = lanes_load(&s->z[i]);
        lanes along_u = x * u.x + y * u.y + z * u.z, along_v = x * v.x + y * v.y + z * v.z;
        lanes_store(&s->u[i], along_u);
        lanes_store(&s->v[i], along_v);
        lanes_store(&s->angle[i], quarters_of(along_u, along_v));
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
    for (unsigned i = 0; i < s->count; i++) order[i] = NOWHERE;
    for (unsigned i = 0; i < s->count; i += LANES) {
        lanes angle = lanes_load(&s->angle[i]);
        lanes_mask place = {0};
        for (unsigned j = 0; j < s->count; j++) place -= lanes_all(s->angle[j]) < angle;
        for (unsigned lane = 0; lane < LANES && i + lane < s->count; lane++) order[place[lane]] = i + lane;
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
    for (unsigned i = 0; i < s->count + LANES; i++) {
        unsigned from = order[i < s->count ? i : 0];
        to->x[i] = s->x[from], to->y[i] = s->y[from], to->z[i] = s->z[from];
        to->u[i] = s->u[from], to->v[i] = s->v[from], to->angle[i] = s->angle[from];
    }
}

/* Whether the angle from each spoke on to the next is over 0.9 pi. */
INLINE lanes_mask are_wide(const struct spokes *s, unsigned i) {
    lanes u = lanes_load(&s->u[i]), v = lanes_load(&s->v[i]), from = lanes_load(&s->angle[i]);
    lanes next_u = lanes_load(&s->u[i + 1]), next_v = lanes_load(&s->v[i + 1]), to = lanes_load(&s->angle[i + 1]);
    lanes turns = {0};
    if (i + LANES >= s->count) turns[(s->count - 1) % LANES] = 4;
    lanes dot = u * next_u + v * next_v;
    lanes least = WIDEST_COSINE * WIDEST_COSINE * (u * u + v * v) * (next_u * next_u + next_v * next_v);
    return (to - from + turns > 2) | ((dot < 0) & (dot * dot > least));
}

INLINE void find_sectors(const struct spokes *s, bool by_area, struct sectors *to) {
    for (unsigned i = 0; i < s->count; i += LANES) {
        lanes x = lanes_load(&s->x[i]), y = lanes_load(&s->y[i]), z = lanes_load(&s->z[i]);
        lanes next_x = lanes_load(&s->x[i + 1]), next_y = lanes_load(&s->y[i + 1]), next_z = lanes_load(&s->z[i + 1]);
        lanes nx = y * next_z - z * next_y, ny = z * next_x - x * next_z, nz = x * next_y - y * next_x;
        lanes twice_area = lanes_root(nx * nx + ny * ny + nz * nz), area = twice_area / 2;
        lanes_mask is_triangle = twice_area > 0;
        lanes weight = lanes_where(is_triangle, by_area ? area : lanes_all(1));
        lanes each = lanes_where(is_triangle, weight / (twice_area * twice_area));
        lanes_store(&to->wide[i], lanes_where(are_wide(s, i), lanes_all(1)));
        lanes_store(&to->area[i], lanes_where(is_triangle, area));
        lanes_store(&to->weight[i], weight);
        lanes_store(&to->a[0][i], nx * nx * each);
        lanes_store(&to->a[1][i], nx * ny * each);
        lanes_store(&to->a[2][i], nx * nz * each);
        lanes_store(&to->a[3][i], ny * ny * each);
        lanes_store(&to->a[4][i], ny * nz * each);
        lanes_store(&to->a[5][i], nz * nz * each);
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

static quadric weighted(quadric q, double w) {
    return (quadric){sym3_scale(q.a, w), vec3_scale(q.b, w), q.c * w, q.weight * w};
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
    find_order(&found, &assembly->hood->id[p * assembly->hood->stride], order);
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
    q = weighted(q, (double)assembly->weight[p]);
    quadric_add_line(&q, assembly->normal[p], assembly->options->line * (by_area ? area : spokes.count));
    assembly->quadrics[p] = quadric_pack(&q);
}

FOR_EACH_PROCESSOR
static void assemble_range(void *ctx, size_t begin, size_t end) {
    for (size_t p = begin; p < end; p++) assemble_point(ctx, p);
}

void quadric_assemble(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood,
                      const float *weight, const struct quadric_options *options, struct packed_quadric *quadrics) {
    assert(neighbourhood->stride <= KNN_MAX_K);
    struct assembly assembly = {point, normal, neighbourhood, weight, options, quadrics};
    par_for(options->threads, neighbourhood->n, GRAIN, assemble_range, &assembly);
}
