/* Lanes are steps, or triples of points; those beyond the last have that one again.  What is summed up over them is so
 * by the caller, in their order.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/rays.h"

#include <assert.h>
#include <float.h>

#include "core/math/simd.h"

enum { TRIES = 4 };
static_assert(RAYS_ROOM % F64_LANES == 0 && RAYS_NEAR % F32_LANES == 0, "room for whole registers");

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

/* Directions from a place to the points near one. */
struct rays {
    float x[RAYS_NEAR], y[RAYS_NEAR], z[RAYS_NEAR];
};

INLINE void find_rays(const float *at, vec3 from, struct rays *rays) {
    const float *x = at, *y = x + RAYS_NEAR, *z = y + RAYS_NEAR;
    f32v a = f32_all((float)from.x), b = f32_all((float)from.y), c = f32_all((float)from.z);
    for (unsigned k = 0; k < RAYS_NEAR; k += F32_LANES) {
        f32v dx = f32_load(&x[k]) - a, dy = f32_load(&y[k]) - b, dz = f32_load(&z[k]) - c;
        f32v scale = 1 / f32_sqrt(dx * dx + dy * dy + dz * dz + FLT_MIN);
        f32_store(&rays->x[k], dx * scale), f32_store(&rays->y[k], dy * scale), f32_store(&rays->z[k], dz * scale);
    }
}

/* Squares of how far the directions are from another one. */
INLINE void measure_rays(const struct rays *rays, float x, float y, float z, float apart_sq[RAYS_NEAR]) {
    for (unsigned k = 0; k < RAYS_NEAR; k += F32_LANES) {
        f32v dx = f32_load(&rays->x[k]) - x, dy = f32_load(&rays->y[k]) - y, dz = f32_load(&rays->z[k]) - z;
        f32_store(&apart_sq[k], dx * dx + dy * dy + dz * dz);
    }
}

/* The TRIES directions nearest to the first one, the nearest first; how many. */
INLINE int find_nearest(const float apart_sq[RAYS_NEAR], unsigned nearest[TRIES]) {
    int count = 0;
    for (unsigned k = 1; k < RAYS_NEAR; k++) {
        if (!(apart_sq[k] > 0) || (count == TRIES && apart_sq[k] >= apart_sq[nearest[TRIES - 1]])) continue;
        int at = count < TRIES ? count++ : TRIES - 1;
        for (; at > 0 && apart_sq[nearest[at - 1]] > apart_sq[k]; at--) nearest[at] = nearest[at - 1];
        nearest[at] = k;
    }
    return count;
}

/* The place of the least. */
INLINE unsigned place_of_least(const float value[RAYS_NEAR], float *least) {
    unsigned place = 0;
    f32v lowest = f32_load(value);
    for (unsigned k = F32_LANES; k < RAYS_NEAR; k += F32_LANES) lowest = f32_min(f32_load(&value[k]), lowest);
    *least = SIMD_LANE(lowest, 0);
    for (unsigned k = 1; k < F32_LANES; k++) *least = SIMD_LANE(lowest, k) < *least ? SIMD_LANE(lowest, k) : *least;
    while (place + 1 < RAYS_NEAR && value[place] != *least) place++;
    return place;
}

FOR_EACH_PROCESSOR(bool, rays_between)
(const float *at, vec3 from, unsigned *one, unsigned *opposite) {
    struct rays rays;
    float apart_sq[RAYS_NEAR], off_sq[RAYS_NEAR], least = INFINITY;
    unsigned nearest[TRIES];
    find_rays(at, from, &rays);
    measure_rays(&rays, rays.x[0], rays.y[0], rays.z[0], apart_sq);
    int tries = find_nearest(apart_sq, nearest);
    for (int t = 0; t < tries; t++) {
        unsigned first = nearest[t];
        float lowest;
        measure_rays(&rays, 2 * rays.x[0] - rays.x[first], 2 * rays.y[0] - rays.y[first], 2 * rays.z[0] - rays.z[first],
                     off_sq);
        off_sq[0] = off_sq[first] = INFINITY;
        unsigned place = place_of_least(off_sq, &lowest);
        if (lowest < least * apart_sq[first]) least = lowest / apart_sq[first], *one = first, *opposite = place;
    }
    return least < INFINITY;
}
