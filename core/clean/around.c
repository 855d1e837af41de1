/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/around.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "core/math/simd.h"

static_assert(AROUND_MOST % F64_SUMS == 0, "room for whole registers");

INLINE struct f64v3 places_at(const struct around *a, unsigned i) {
    return (struct f64v3){f64_load(&a->x[i]), f64_load(&a->y[i]), f64_load(&a->z[i])};
}

INLINE struct f64v3 everywhere(vec3 v) { return (struct f64v3){f64_all(v.x), f64_all(v.y), f64_all(v.z)}; }

/* 1 at 0, 1/4 at the scale, and hardly anything far beyond (Geman, McClure). */
INLINE f64v tolerance_of(f64v x_sq, double scale_sq) {
    f64v share = scale_sq / (scale_sq + x_sq);
    return share * share;
}

/* By the squared distance. */
INLINE f64v nearness_of(f64v distance_sq, double rim_sq) {
    f64v t = 1 - distance_sq / rim_sq;
    return f64_where(f64_is_positive(t), t * t);
}

INLINE void weigh(struct around *around, double rim_sq) {
    for (unsigned i = around->n; i % F64_SUMS; i++) around->x[i] = around->y[i] = around->z[i] = 0;
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        struct f64v3 e = places_at(around, i);
        f64_store(&around->near[i], nearness_of(f64v3_dot(e, e), rim_sq));
    }
}

FOR_EACH_PROCESSOR(void, around_weigh)
(struct around *around, double rim_sq) { weigh(around, rim_sq); }

FOR_EACH_PROCESSOR(void, around_plane)
(const struct around *around, vec3 mean, vec3 normal, double scale_sq, double weight[AROUND_MOST]) {
    struct f64v3 middle = everywhere(mean), across = everywhere(normal);
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        f64v height = f64v3_dot(across, f64v3_sub(places_at(around, i), middle));
        f64_store(&weight[i], f64_load(&around->near[i]) * tolerance_of(height * height, scale_sq));
    }
}

FOR_EACH_PROCESSOR(void, around_level)
(const struct around *around, vec3 normal, double height, double scale_sq, double weight[AROUND_MOST]) {
    struct f64v3 across = everywhere(normal);
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        f64v over = f64v3_dot(across, places_at(around, i)) - height;
        f64_store(&weight[i], f64_load(&around->near[i]) * tolerance_of(over * over, scale_sq));
    }
}

struct sums {
    f64v total;
    struct f64v3 sum;
    f64v xx, xy, xz, yy, yz, zz;
};

/* Number i of a row of each lane's point. */
INLINE f64v number_at(const double *const row[F64_LANES], unsigned i) {
    double x[F64_LANES];
    for (unsigned k = 0; k < F64_LANES; k++) x[k] = row[k][i];
    return f64_load(x);
}

INLINE void store_sums(const struct sums *s, unsigned n, struct around_sums *sums) {
    for (unsigned k = 0; k < F64_LANES && k < n; k++)
        sums[k] = (struct around_sums){SIMD_LANE(s->total, k),
                                       {SIMD_LANE(s->sum.x, k), SIMD_LANE(s->sum.y, k), SIMD_LANE(s->sum.z, k)},
                                       {SIMD_LANE(s->xx, k), SIMD_LANE(s->xy, k), SIMD_LANE(s->xz, k),
                                        SIMD_LANE(s->yy, k), SIMD_LANE(s->yz, k), SIMD_LANE(s->zz, k)}};
}

/* As many neighbours as all have that are summed up side by side; the rest of each goes on from there. */
INLINE void add_rest(const struct around *around, const double *weight, unsigned first, struct around_sums *sums) {
    for (unsigned i = first; i < around->n; i++) {
        vec3 e = {around->x[i], around->y[i], around->z[i]};
        sums->total += weight[i];
        sums->sum = vec3_add(sums->sum, vec3_scale(e, weight[i]));
        sums->moment = sym3_add(sums->moment, sym3_scale(sym3_outer(e), weight[i]));
    }
}

FOR_EACH_PROCESSOR(void, around_sum_up)
(const struct around *around, const double *const *weight, unsigned n, struct around_sums *sums) {
    for (unsigned first = 0; first < n; first += F64_LANES) {
        const double *x[F64_LANES], *y[F64_LANES], *z[F64_LANES], *w[F64_LANES];
        unsigned all = AROUND_MOST;
        for (unsigned k = 0; k < F64_LANES; k++) {
            unsigned of = first + k < n ? first + k : n - 1;
            x[k] = around[of].x, y[k] = around[of].y, z[k] = around[of].z, w[k] = weight[of];
            all = around[of].n < all ? around[of].n : all;
        }
        f64v none = f64_all(0);
        struct sums s = {none, {none, none, none}, none, none, none, none, none, none};
        for (unsigned i = 0; i < all; i++) {
            struct f64v3 e = {number_at(x, i), number_at(y, i), number_at(z, i)};
            f64v by = number_at(w, i);
            s.total += by;
            s.sum.x += e.x * by, s.sum.y += e.y * by, s.sum.z += e.z * by;
            s.xx += e.x * e.x * by, s.xy += e.x * e.y * by, s.xz += e.x * e.z * by;
            s.yy += e.y * e.y * by, s.yz += e.y * e.z * by, s.zz += e.z * e.z * by;
        }
        store_sums(&s, n - first, &sums[first]);
        for (unsigned k = first; k < n && k < first + F64_LANES; k++) add_rest(&around[k], weight[k], all, &sums[k]);
    }
}

/* Those of a row of neighbours from number i on; the last one again where there are no more. */
INLINE struct f64v3 those_of(const vec3 *all, const struct around_place *place, unsigned i) {
    const vec3 *each[F64_LANES];
    for (unsigned k = 0; k < F64_LANES; k++) each[k] = &all[place->near[i + k < place->n ? i + k : place->n - 1]];
    return f64v3_gather(each);
}

FOR_EACH_PROCESSOR(void, around_gather)
(const struct around_place *place, bool itself, struct around *around) {
    struct f64v3 own = everywhere(place->point[place->p]);
    for (unsigned i = 0; i < place->n; i += F64_LANES) {
        struct f64v3 e = f64v3_sub(those_of(place->point, place, i), own);
        f64_store(&around->x[i], e.x), f64_store(&around->y[i], e.y), f64_store(&around->z[i], e.z);
    }
    around->n = place->n;
    if (itself) around->x[around->n] = around->y[around->n] = around->z[around->n] = 0, around->n++;
    weigh(around, place->rim_sq);
}

/* What some neighbours look like from a point. */
struct looks {
    f64v near, apart_sq, height; /* near: the root of what they weigh by their distance; 0: they don't count */
    struct f64v3 normal;         /* on the side of the point's own */
};

INLINE struct looks look_at(const struct around_place *place, unsigned i) {
    static const double lane[F64_SUMS] = {0, 1, 2, 3};
    struct f64v3 own = everywhere(place->normal[place->p]), n = those_of(place->normal, place, i);
    struct f64v3 e = f64v3_sub(those_of(place->point, place, i), everywhere(place->point[place->p]));
    n = f64v3_scale(n, f64_pick(f64_less(f64v3_dot(n, own), f64_all(0)), f64_all(-1), f64_all(1)));
    struct f64v3 apart = f64v3_sub(n, own), both = {own.x + n.x, own.y + n.y, own.z + n.z};
    f64v near = f64_positive(1 - f64v3_dot(e, e) * (1 / place->rim_sq));
    near = f64_where(f64_less(f64_load(lane), f64_all((double)place->n - (double)i)), near);
    return (struct looks){near, f64v3_dot(apart, apart), f64v3_dot(both, e) / 2, n};
}

INLINE double total_of(const f64v sum[F64_PARTS]) {
    double each[F64_SUMS];
    memcpy(each, sum, sizeof each);
    return (each[0] + each[1]) + (each[2] + each[3]);
}

FOR_EACH_PROCESSOR(vec3, around_turned)
(const struct around_place *place) {
    f64v x[F64_PARTS], y[F64_PARTS], z[F64_PARTS];
    for (unsigned part = 0; part < F64_PARTS; part++) x[part] = y[part] = z[part] = f64_all(0);
    for (unsigned i = 0; i < place->n; i += F64_SUMS)
        for (unsigned part = 0; part < F64_PARTS; part++) {
            struct looks looks = look_at(place, i + part * F64_LANES);
            f64v root = looks.near * place->angle_sq / (place->angle_sq + looks.apart_sq);
            struct f64v3 turned = f64v3_scale(looks.normal, root * root);
            x[part] += turned.x, y[part] += turned.y, z[part] += turned.z;
        }
    return (vec3){total_of(x), total_of(y), total_of(z)};
}

INLINE struct around_heights sum_heights(const struct around_place *place, bool tolerant, double height_sq) {
    f64v total[F64_PARTS], sum[F64_PARTS], sum_sq[F64_PARTS];
    for (unsigned part = 0; part < F64_PARTS; part++) total[part] = sum[part] = sum_sq[part] = f64_all(0);
    for (unsigned i = 0; i < place->n; i += F64_SUMS)
        for (unsigned part = 0; part < F64_PARTS; part++) {
            struct looks looks = look_at(place, i + part * F64_LANES);
            f64v h = looks.height, scale = f64_all(place->angle_sq), divisor = place->angle_sq + looks.apart_sq;
            if (tolerant) scale *= height_sq, divisor *= height_sq + h * h; /* one division is as dear as all else */
            f64v root = looks.near * scale / divisor, w = root * root;
            total[part] += w, sum[part] += w * h, sum_sq[part] += w * h * h;
        }
    return (struct around_heights){total_of(total), total_of(sum), total_of(sum_sq)};
}

FOR_EACH_PROCESSOR(struct around_heights, around_heights)
(const struct around_place *place, double height_sq) {
    return height_sq < INFINITY ? sum_heights(place, true, height_sq) : sum_heights(place, false, 0);
}
