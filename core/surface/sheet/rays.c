/* Lanes are steps, triples of points, or points and those near them; those beyond the last have that one again.  What
 * is summed up over them is so by the caller, in their order.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/rays.h"

#include <assert.h>
#include <float.h>

#include "core/math/simd.h"

enum { TRIES = 4 };
static_assert(RAYS_ROOM % F64_LANES == 0 && RAYS_TOGETHER % F32_LANES == 0, "room for whole registers");

INLINE struct f64v3 all_of(vec3 a) { return (struct f64v3){f64_all(a.x), f64_all(a.y), f64_all(a.z)}; }
INLINE struct f64v3 add(struct f64v3 a, struct f64v3 b) { return (struct f64v3){a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE f64v length_sq(struct f64v3 a) { return f64v3_dot(a, a); }
INLINE f64v no_less(f64v a, double least) { return f64_pick(f64_less(f64_all(least), a), a, f64_all(least)); }

FOR_EACH_PROCESSOR(void, rays_sines)
(const struct step *step, size_t n, vec3 place, float *square) {
    struct f64v3 eye = all_of(place);
    for (size_t i = 0; i < n; i += F64_LANES) {
        const vec3 *from[F64_LANES], *to[F64_LANES];
        for (size_t k = 0; k < F64_LANES; k++) {
            const struct step *of = &step[i + k < n ? i + k : n - 1];
            from[k] = &of->from, to[k] = &of->to;
        }
        struct f64v3 a = f64v3_sub(f64v3_gather(from), eye), b = f64v3_sub(f64v3_gather(to), eye);
        f64_store_f32(&square[i], length_sq(f64v3_cross(a, b)) / (length_sq(a) * length_sq(b)));
    }
}

struct threes {
    struct f64v3 first, between, last;
};

INLINE struct threes threes_at(const vec3 *point, const uint32_t (*of)[3], size_t n, size_t i) {
    const vec3 *p[3][F64_LANES];
    for (size_t k = 0; k < F64_LANES; k++)
        for (int j = 0; j < 3; j++) p[j][k] = &point[of[i + k < n ? i + k : n - 1][j]];
    return (struct threes){f64v3_gather(p[0]), f64v3_gather(p[1]), f64v3_gather(p[2])};
}

/* Of length 1, or 0. */
INLINE struct f64v3 unit(struct f64v3 a) {
    f64v length = f64_sqrt(length_sq(a));
    return f64v3_scale(a, f64_where(f64_is_positive(length), 1 / length));
}

FOR_EACH_PROCESSOR(void, rays_turned)
(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double *square) {
    struct f64v3 eye = all_of(place);
    for (size_t i = 0; i < n; i += F64_LANES) {
        struct threes p = threes_at(point, of, n, i);
        struct f64v3 a = unit(f64v3_sub(p.first, eye)), b = unit(f64v3_sub(p.between, eye)),
                     c = unit(f64v3_sub(p.last, eye));
        f64v apart = no_less(length_sq(f64v3_sub(a, c)), 1e-24);
        f64_store(&square[i], 4 * length_sq(f64v3_sub(add(a, c), f64v3_scale(b, f64_all(2)))) / apart);
    }
}

struct rows {
    f64v xx, xy, xz, yy, yz, zz;
};

/* Adds the direction to p times a weight, and its derivative, - (1 - d d') / length. */
INLINE struct f64v3 add_direction(struct f64v3 p, struct f64v3 eye, double weight, struct f64v3 *aside,
                                  struct rows *by) {
    struct f64v3 to = f64v3_sub(p, eye);
    f64v length = f64_sqrt(length_sq(to)), each = f64_where(f64_is_positive(length), 1 / length);
    struct f64v3 d = f64v3_scale(to, each);
    f64v times = weight * each;
    *aside = add(*aside, f64v3_scale(d, f64_all(weight)));
    by->xx += (d.x * d.x - 1) * times, by->yy += (d.y * d.y - 1) * times, by->zz += (d.z * d.z - 1) * times;
    by->xy += d.x * d.y * times, by->xz += d.x * d.z * times, by->yz += d.y * d.z * times;
    return d;
}

INLINE void store_row(struct f64v3 row, f64v weight, size_t i, size_t n, int k, struct rays_terms *terms) {
    double all[6][F64_LANES];
    f64_store(all[0], row.x * row.x * weight), f64_store(all[1], row.x * row.y * weight);
    f64_store(all[2], row.x * row.z * weight), f64_store(all[3], row.y * row.y * weight);
    f64_store(all[4], row.y * row.z * weight), f64_store(all[5], row.z * row.z * weight);
    for (size_t j = 0; j < F64_LANES && i + j < n; j++)
        terms[i + j].row[k] = (sym3){all[0][j], all[1][j], all[2][j], all[3][j], all[4][j], all[5][j]};
}

FOR_EACH_PROCESSOR(void, rays_equations)
(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double limit_sq, struct rays_terms *terms) {
    struct f64v3 eye = all_of(place), none = all_of((vec3){0, 0, 0});
    for (size_t i = 0; i < n; i += F64_LANES) {
        struct threes p = threes_at(point, of, n, i);
        struct f64v3 turn = none;
        struct rows by = {none.x, none.x, none.x, none.x, none.x, none.x};
        struct f64v3 first = add_direction(p.first, eye, 1, &turn, &by);
        add_direction(p.between, eye, -2, &turn, &by);
        struct f64v3 last = add_direction(p.last, eye, 1, &turn, &by);
        f64v scale = 2 / no_less(f64_sqrt(length_sq(f64v3_sub(first, last))), 1e-12);
        turn = f64v3_scale(turn, scale);
        struct f64v3 x = {by.xx * scale, by.xy * scale, by.xz * scale}, y = {x.y, by.yy * scale, by.yz * scale};
        struct f64v3 z = {x.z, y.z, by.zz * scale};
        f64v all = length_sq(turn) + limit_sq, weight = limit_sq / (all * all);
        store_row(x, weight, i, n, 0, terms), store_row(y, weight, i, n, 1, terms);
        store_row(z, weight, i, n, 2, terms);
        double gradient[3][F64_LANES];
        f64_store(gradient[0], f64v3_dot(x, turn) * weight), f64_store(gradient[1], f64v3_dot(y, turn) * weight);
        f64_store(gradient[2], f64v3_dot(z, turn) * weight);
        for (size_t j = 0; j < F64_LANES && i + j < n; j++)
            terms[i + j].gradient = (vec3){gradient[0][j], gradient[1][j], gradient[2][j]};
    }
}

/* Directions from a place to points, lane by lane, and to those near each. */
struct rays {
    struct f32v3 to[RAYS_NEAR];
};

INLINE void find_rays(const float *at, vec3 from, struct rays *rays) {
    enum { COORDINATE = RAYS_NEAR * RAYS_TOGETHER };
    struct f32v3 eye = {f32_all((float)from.x), f32_all((float)from.y), f32_all((float)from.z)};
    for (size_t k = 0; k < RAYS_NEAR; k++) {
        const float *x = &at[k * RAYS_TOGETHER], *y = x + COORDINATE, *z = y + COORDINATE;
        struct f32v3 d = f32v3_sub((struct f32v3){f32_load(x), f32_load(y), f32_load(z)}, eye);
        rays->to[k] = f32v3_scale(d, 1 / f32_sqrt(f32v3_dot(d, d) + FLT_MIN));
    }
}

/* Square of how far two directions are from each other. */
INLINE f32v apart_sq_of(struct f32v3 a, struct f32v3 b) {
    struct f32v3 d = f32v3_sub(a, b);
    return f32v3_dot(d, d);
}

/* Of each lane the TRIES directions nearest to the first one, the nearest first; infinity where there are fewer. */
INLINE void find_nearest(const struct rays *rays, f32v apart_sq[TRIES], i32v nearest[TRIES]) {
    for (int t = 0; t < TRIES; t++) apart_sq[t] = f32_all(INFINITY), nearest[t] = i32_all(0);
    for (int32_t k = 1; k < RAYS_NEAR; k++) {
        f32v apart = apart_sq_of(rays->to[k], rays->to[0]);
        i32v of = i32_all(k);
        apart = f32_pick(f32_is_positive(apart), apart, f32_all(INFINITY));
        for (int t = 0; t < TRIES; t++) {
            i32v nearer = f32_less(apart, apart_sq[t]);
            f32v next = f32_pick(nearer, apart_sq[t], apart);
            i32v next_of = i32_pick(nearer, nearest[t], of);
            apart_sq[t] = f32_pick(nearer, apart, apart_sq[t]), nearest[t] = i32_pick(nearer, of, nearest[t]);
            apart = next, of = next_of;
        }
    }
}

/* Each lane's direction of a number. */
INLINE struct f32v3 ray_of(const struct rays *rays, i32v number) {
    float x[F32_LANES], y[F32_LANES], z[F32_LANES];
    for (size_t k = 0; k < F32_LANES; k++) {
        const struct f32v3 *to = &rays->to[SIMD_LANE(number, k)];
        x[k] = SIMD_LANE(to->x, k), y[k] = SIMD_LANE(to->y, k), z[k] = SIMD_LANE(to->z, k);
    }
    return (struct f32v3){f32_load(x), f32_load(y), f32_load(z)};
}

/* The number of the direction nearest to where that of `first` would be on the other side, neither of the two. */
INLINE i32v find_opposite(const struct rays *rays, i32v first, f32v *lowest) {
    struct f32v3 self = rays->to[0], one = ray_of(rays, first);
    struct f32v3 at = {2 * self.x - one.x, 2 * self.y - one.y, 2 * self.z - one.z};
    i32v place = i32_all(0);
    *lowest = f32_all(INFINITY);
    for (int32_t k = 1; k < RAYS_NEAR; k++) {
        f32v off = apart_sq_of(rays->to[k], at);
        i32v other = i32_less(first, i32_all(k)) | i32_less(i32_all(k), first);
        i32v lower = f32_less(off, *lowest) & other;
        *lowest = f32_pick(lower, off, *lowest), place = i32_pick(lower, i32_all(k), place);
    }
    return place;
}

FOR_EACH_PROCESSOR(void, rays_between)
(const float at[RAYS_BLOCK], vec3 from, int32_t one[RAYS_TOGETHER], int32_t opposite[RAYS_TOGETHER]) {
    for (size_t i = 0; i < RAYS_TOGETHER; i += F32_LANES) {
        struct rays rays;
        f32v apart_sq[TRIES], least = f32_all(INFINITY);
        i32v nearest[TRIES], found = i32_all(0), found_opposite = i32_all(0);
        find_rays(&at[i], from, &rays);
        find_nearest(&rays, apart_sq, nearest);
        for (int t = 0; t < TRIES; t++) {
            f32v lowest;
            i32v place = find_opposite(&rays, nearest[t], &lowest);
            i32v better = f32_less(lowest, least * apart_sq[t]) & f32_less(apart_sq[t], f32_all(INFINITY));
            least = f32_pick(better, lowest / apart_sq[t], least);
            found = i32_pick(better, nearest[t], found);
            found_opposite = i32_pick(better, place, found_opposite);
        }
        memcpy(&one[i], &found, sizeof found), memcpy(&opposite[i], &found_opposite, sizeof found_opposite);
    }
}
