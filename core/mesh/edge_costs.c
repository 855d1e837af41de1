/* Edges side by side, as many as a register has room for; the places beyond the last one have that one again.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/edge_costs.h"

#include <assert.h>

#include "core/math/simd.h"

static const double FARTHEST = 1.0; /* that a vertex is put from the edge that goes, by the edge's length */
static const double REGAINED = 0.5; /* of the volume that is lost where the squares of volumes are least */

struct sym3s {
    f64v xx, xy, xz, yy, yz, zz;
};

/* What both ends of an edge cost together. */
struct forms {
    struct sym3s a;
    struct f64v3 b, area;
    f64v c, volume;
};

INLINE struct f64v3 add(struct f64v3 a, struct f64v3 b) { return (struct f64v3){a.x + b.x, a.y + b.y, a.z + b.z}; }

INLINE struct f64v3 pick(i64v mask, struct f64v3 a, struct f64v3 b) {
    return (struct f64v3){f64_pick(mask, a.x, b.x), f64_pick(mask, a.y, b.y), f64_pick(mask, a.z, b.z)};
}

INLINE struct f64v3 all_of(vec3 a) { return (struct f64v3){f64_all(a.x), f64_all(a.y), f64_all(a.z)}; }

INLINE f64v length_sq(struct f64v3 a) { return f64v3_dot(a, a); }

/* One number of each of the edges' ends, at p[k] + offset. */
INLINE f64v gather(const double *const p[F64_LANES], unsigned offset) {
    double x[F64_LANES];
    for (unsigned k = 0; k < F64_LANES; k++) x[k] = p[k][offset];
    return f64_load(x);
}

INLINE struct f64v3 gather_3(const double *const p[F64_LANES], unsigned offset) {
    return (struct f64v3){gather(p, offset), gather(p, offset + 1), gather(p, offset + 2)};
}

/* Triangles of both ends count once. */
INLINE void take_off(struct forms *both, const double *const plane[F64_LANES]) {
    struct f64v3 n = gather_3(plane, 0);
    f64v d = gather(plane, 3);
    both->a.xx -= n.x * n.x, both->a.xy -= n.x * n.y, both->a.xz -= n.x * n.z;
    both->a.yy -= n.y * n.y, both->a.yz -= n.y * n.z, both->a.zz -= n.z * n.z;
    both->b = f64v3_sub(both->b, f64v3_scale(n, d));
    both->c -= d * d;
    both->area = f64v3_sub(both->area, n);
    both->volume += d;
}

/* The members of struct error_form, as it has them in a row. */
enum { FORM_A = 0, FORM_B = 6, FORM_C = 9, FORM_AREA = 10, FORM_VOLUME = 13, FORM_ALL = 14 };
static_assert(sizeof(struct error_form) == FORM_ALL * sizeof(double), "numbers in a row");
static_assert(sizeof(struct plane) == 4 * sizeof(double), "numbers in a row");

INLINE struct forms forms_of_both(const struct error_form *form, const struct edge_end *const end[F64_LANES]) {
    static const struct plane none = {{0, 0, 0}, 0};
    const double *to[F64_LANES], *beside[2][F64_LANES];
    for (unsigned k = 0; k < F64_LANES; k++) {
        to[k] = &end[k]->form->a.xx;
        for (int i = 0; i < 2; i++) beside[i][k] = &(end[k]->beside[i] ? end[k]->beside[i] : &none)->normal.x;
    }
    struct forms both;
    both.a.xx = form->a.xx + gather(to, FORM_A), both.a.xy = form->a.xy + gather(to, FORM_A + 1);
    both.a.xz = form->a.xz + gather(to, FORM_A + 2), both.a.yy = form->a.yy + gather(to, FORM_A + 3);
    both.a.yz = form->a.yz + gather(to, FORM_A + 4), both.a.zz = form->a.zz + gather(to, FORM_A + 5);
    both.b = add(all_of(form->b), gather_3(to, FORM_B));
    both.c = form->c + gather(to, FORM_C);
    both.area = add(all_of(form->area), gather_3(to, FORM_AREA));
    both.volume = form->volume + gather(to, FORM_VOLUME);
    take_off(&both, beside[0]);
    take_off(&both, beside[1]);
    return both;
}

INLINE f64v value_at(const struct forms *form, struct f64v3 x) {
    const struct sym3s *a = &form->a;
    struct f64v3 ax = {a->xx * x.x + a->xy * x.y + a->xz * x.z, a->xy * x.x + a->yy * x.y + a->yz * x.z,
                       a->xz * x.x + a->yz * x.y + a->zz * x.z};
    return f64v3_dot(x, add(ax, f64v3_scale(form->b, f64_all(2)))) + form->c;
}

/* A place, or where it would be if it were no farther from an edge than that is long: on the apex of a cone all planes
 * meet, however far it is from where the cone ends. */
INLINE struct f64v3 brought_near(struct f64v3 place, struct f64v3 from, struct f64v3 to) {
    struct f64v3 edge = f64v3_sub(to, from);
    f64v edge_sq = length_sq(edge), most_sq = FARTHEST * FARTHEST * edge_sq;
    f64v t = f64v3_dot(f64v3_sub(place, from), edge) / edge_sq;
    t = f64_where(f64_is_positive(edge_sq), f64_min(f64_positive(t), f64_all(1)));
    struct f64v3 near = add(from, f64v3_scale(edge, t)), off = f64v3_sub(place, near);
    f64v far_sq = length_sq(off);
    struct f64v3 brought = add(near, f64v3_scale(off, f64_sqrt(most_sq / far_sq)));
    i64v far_from_to = f64_less(most_sq, length_sq(f64v3_sub(place, to))), far = f64_less(most_sq, far_sq);
    return pick(far_from_to & far, brought, place);
}

/* Half-way from the place where the squares are least to that of those which lose no volume where they are least; no
 * number where there is none. */
INLINE struct f64v3 best_place(const struct forms *both, i64v *found) {
    const struct sym3s *a = &both->a;
    struct f64v3 x = {a->xx, a->xy, a->xz}, y = {a->xy, a->yy, a->yz}, z = {a->xz, a->yz, a->zz};
    struct f64v3 yz = f64v3_cross(y, z), zx = f64v3_cross(z, x), xy = f64v3_cross(x, y), area = both->area;
    f64v determinant = f64v3_dot(x, yz);
    *found = f64_is_positive(determinant);
    struct f64v3 least = {-f64v3_dot(both->b, yz), -f64v3_dot(both->b, zx), -f64v3_dot(both->b, xy)};
    struct f64v3 way = {f64v3_dot(area, yz), f64v3_dot(area, zx), f64v3_dot(area, xy)}; /* volume for the least */
    least = f64v3_scale(least, 1 / determinant);
    f64v lost = both->volume - f64v3_dot(area, least), gain = f64v3_dot(area, way);
    return pick(f64_is_positive(gain), add(least, f64v3_scale(way, REGAINED * lost / gain)), least);
}

FOR_EACH_PROCESSOR(void, edge_costs_find)
(const struct error_form *form, vec3 at, const struct edge_end *end, unsigned n, double *cost, vec3 *best) {
    assert(n <= EDGE_COSTS_MOST);
    for (unsigned i = 0; i < n; i += F64_LANES) {
        const struct edge_end *of[F64_LANES];
        const vec3 *to[F64_LANES];
        int64_t free[F64_LANES];
        double value[F64_LANES], x[F64_LANES], y[F64_LANES], z[F64_LANES];
        for (unsigned k = 0; k < F64_LANES; k++) {
            of[k] = &end[i + k < n ? i + k : n - 1];
            to[k] = of[k]->at;
            free[k] = of[k]->stays ? 0 : -1;
        }
        i64v may_move, found;
        memcpy(&may_move, free, sizeof may_move);
        struct forms both = forms_of_both(form, of);
        struct f64v3 stay = f64v3_gather(to), place = brought_near(best_place(&both, &found), all_of(at), stay);
        f64v there = value_at(&both, place), here = value_at(&both, stay);
        i64v moves = may_move & found & f64_less(there, here);
        place = pick(moves, place, stay);
        f64_store(value, f64_pick(moves, there, here));
        f64_store(x, place.x), f64_store(y, place.y), f64_store(z, place.z);
        for (unsigned k = 0; k < F64_LANES && i + k < n; k++)
            cost[i + k] = value[k], best[i + k] = (vec3){x[k], y[k], z[k]};
    }
}
