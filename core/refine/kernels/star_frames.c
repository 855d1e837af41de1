/* What can't be told of a triangle without area isn't a number, and fails every comparison.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/kernels/star_frames.h"

#include <assert.h>

#include "core/math/simd.h"

INLINE struct f32v3 load_three(const struct star_vectors *from, size_t i) {
    return (struct f32v3){f32_load(&from->x[i]), f32_load(&from->y[i]), f32_load(&from->z[i])};
}

INLINE void store_three(struct star_vectors *to, size_t i, struct f32v3 t) {
    f32_store(&to->x[i], t.x), f32_store(&to->y[i], t.y), f32_store(&to->z[i], t.z);
}

static void repeat_first(struct star_vectors *ring, size_t at) {
    ring->x[at] = ring->x[0], ring->y[at] = ring->y[0], ring->z[at] = ring->z[0];
}

FOR_EACH_PROCESSOR(void, star_vectors_set)
(struct star_vectors *to, const vec3 *const *from, size_t n, vec3 origin) {
    assert(n <= STAR_MOST);
    for (size_t i = 0; i < n; i++) {
        vec3 p = vec3_sub(*from[i], origin);
        to->x[i] = (float)p.x, to->y[i] = (float)p.y, to->z[i] = (float)p.z;
    }
    for (size_t i = n; i <= n + F32_LANES; i++) repeat_first(to, i);
}

struct edge {
    f32v length, inverse;
};

/* Stores a unit direction. */
INLINE struct edge store_edge(float *out_x, float *out_y, f32v x, f32v y) {
    f32v length = f32_sqrt(x * x + y * y), inverse = 1 / length;
    f32_store(out_x, x * inverse), f32_store(out_y, y * inverse);
    return (struct edge){length, inverse};
}

INLINE void make_frames(struct star_frames *s, size_t i, struct f32v3 a, struct f32v3 b, struct f32v3 c) {
    struct f32v3 to_b = f32v3_sub(b, a), to_c = f32v3_sub(c, a), normal = f32v3_cross(to_b, to_c);
    f32v bx = f32_sqrt(f32v3_dot(to_b, to_b)), bx_inverse = 1 / bx, area = f32_sqrt(f32v3_dot(normal, normal));
    struct f32v3 u = f32v3_scale(to_b, bx_inverse), n = f32v3_scale(normal, 1 / area), v = f32v3_cross(n, u);
    f32v cx = f32v3_dot(to_c, u), cy = f32v3_dot(to_c, v);
    struct edge bc = store_edge(&s->bc_x[i], &s->bc_y[i], cx - bx, cy);
    struct edge ac = store_edge(&s->ac_x[i], &s->ac_y[i], cx, cy);
    f32v longest = f32_max(bx, f32_max(bc.length, ac.length));
    i32v has_area =
        f32_is_positive(bx) & f32_is_positive(area) & f32_is_positive(bc.length) & f32_is_positive(ac.length);
    store_three(&s->u, i, u), store_three(&s->v, i, v);
    store_three(&s->normal, i,
                (struct f32v3){f32_where(has_area, n.x), f32_where(has_area, n.y), f32_where(has_area, n.z)});
    f32_store(&s->bx[i], bx), f32_store(&s->bx_inverse[i], bx_inverse), f32_store(&s->bc_half[i], bc.length / 2);
    f32_store(&s->cx[i], cx), f32_store(&s->cy[i], cy), f32_store(&s->cy_inverse[i], 1 / cy),
        f32_store(&s->ac_inverse[i], ac.inverse);
    f32_store(&s->shape[i], f32_where(has_area, bx * cy / (longest * longest)));
}

INLINE void set_vector(struct star_vectors *of, size_t i, vec3 to) {
    of->x[i] = (float)to.x, of->y[i] = (float)to.y, of->z[i] = (float)to.z;
}

/* Sector n is the last edge, there and back, in the plane of the last triangle. */
static void close_fan(struct star_frames *s, size_t n) {
    vec3 u = star_vectors_at(&s->u, n - 1), v = star_vectors_at(&s->v, n - 1);
    double x = (double)s->ac_x[n - 1], y = (double)s->ac_y[n - 1];
    set_vector(&s->u, n, vec3_add(vec3_scale(u, x), vec3_scale(v, y)));
    set_vector(&s->v, n, vec3_sub(vec3_scale(v, x), vec3_scale(u, y)));
    set_vector(&s->normal, n, star_vectors_at(&s->normal, n - 1));
    s->bx[n] = 1 / s->ac_inverse[n - 1];
    s->bc_x[n] = -1, s->bc_y[n] = 0, s->bc_half[n] = s->bx[n] / 2;
    s->ac_x[n] = 1, s->ac_y[n] = 0;
}

FOR_EACH_PROCESSOR(void, star_frames_make)
(struct star_frames *star, const struct star_rim *rim, vec3 place) {
    assert(rim->open ? rim->n >= 1 && rim->n < STAR_MOST : rim->n >= 3 && rim->n <= STAR_MOST);
    star->n = rim->n;
    star->sectors = rim->n + rim->open;
    star->ax = (float)place.x, star->ay = (float)place.y, star->az = (float)place.z;
    struct f32v3 a = {f32_all(star->ax), f32_all(star->ay), f32_all(star->az)};
    for (size_t i = 0; i < rim->n; i += F32_LANES)
        make_frames(star, i, a, load_three(&rim->place, i), load_three(&rim->place, i + 1));
    if (rim->open)
        close_fan(star, rim->n);
    else
        repeat_first(&star->normal, star->n);
}

/* Whether pairs of neighbours may turn so that the cosines of their normals go from before to after. */
INLINE i32v fold_is_fair(f32v before, f32v after, float fold) {
    return f32_at_least(after, f32_all(fold)) | f32_at_least(after, before);
}

FOR_EACH_PROCESSOR(bool, star_may_become)
(const struct star_frames *old, const struct star_frames *new, const struct star_vectors *outside,
 struct star_limits limits) {
    for (size_t i = 0; i < old->n; i += F32_LANES) {
        struct f32v3 before = load_three(&old->normal, i), after = load_three(&new->normal, i);
        struct f32v3 before_next = load_three(&old->normal, i + 1), after_next = load_three(&new->normal, i + 1);
        struct f32v3 across = load_three(outside, i);
        f32v old_shape = f32_load(&old->shape[i]), new_shape = f32_load(&new->shape[i]);
        i32v fair = f32_at_least(f32v3_dot(before, after), f32_all(limits.turn)) | f32_equal(old_shape, f32_all(0));
        fair &= f32_at_least(new_shape, f32_all(limits.thin)) | f32_at_least(new_shape, old_shape);
        if (!limits.steep) {
            fair &= fold_is_fair(f32v3_dot(before, before_next), f32v3_dot(after, after_next), limits.fold);
            fair &= fold_is_fair(f32v3_dot(before, across), f32v3_dot(after, across), limits.fold);
        }
        i32v inside = i32_less(i32_count() + (int32_t)i, i32_all((int32_t)old->n));
        if (i32_any(inside & ~fair)) return false;
    }
    return true;
}
