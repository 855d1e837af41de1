/* What can't be told of a triangle without area isn't a number, and fails every comparison.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/star_frames.h"

#include <assert.h>

#include "core/lanes8.h"
#include "core/three.h"

INLINE struct three load_three(const struct star_vectors *from, size_t i) {
    return (struct three){load(&from->x[i]), load(&from->y[i]), load(&from->z[i])};
}

INLINE void store_three(struct star_vectors *to, size_t i, struct three t) {
    *at(&to->x[i]) = t.x, *at(&to->y[i]) = t.y, *at(&to->z[i]) = t.z;
}

static void repeat_first(struct star_vectors *ring, size_t at) {
    ring->x[at] = ring->x[0], ring->y[at] = ring->y[0], ring->z[at] = ring->z[0];
}

void star_vectors_set(struct star_vectors *to, const vec3 *const *from, size_t n, vec3 origin) {
    assert(n <= STAR_MOST);
    for (size_t i = 0; i < n; i++) {
        vec3 p = vec3_sub(*from[i], origin);
        to->x[i] = (float)p.x, to->y[i] = (float)p.y, to->z[i] = (float)p.z;
    }
    for (size_t i = n; i <= n + LANES; i++) repeat_first(to, i);
}

struct edge {
    lanes length, inverse;
};

/* Stores a unit direction. */
INLINE struct edge store_edge(float *out_x, float *out_y, lanes x, lanes y) {
    lanes length = root(x * x + y * y), inverse = 1 / length;
    *at(out_x) = x * inverse, *at(out_y) = y * inverse;
    return (struct edge){length, inverse};
}

INLINE void make_eight(struct star_frames *s, size_t i, struct three a, struct three b, struct three c) {
    struct three to_b = three_sub(b, a), to_c = three_sub(c, a), normal = three_cross(to_b, to_c);
    lanes bx = root(three_dot(to_b, to_b)), bx_inverse = 1 / bx, area = root(three_dot(normal, normal));
    struct three u = three_scale(to_b, bx_inverse), n = three_scale(normal, 1 / area), v = three_cross(n, u);
    lanes cx = three_dot(to_c, u), cy = three_dot(to_c, v);
    struct edge bc = store_edge(&s->bc_x[i], &s->bc_y[i], cx - bx, cy);
    struct edge ac = store_edge(&s->ac_x[i], &s->ac_y[i], cx, cy);
    lanes longest = higher(bx, higher(bc.length, ac.length));
    mask has_area = (bx > 0) & (area > 0) & (bc.length > 0) & (ac.length > 0);
    store_three(&s->u, i, u), store_three(&s->v, i, v);
    store_three(&s->normal, i, (struct three){where(has_area, n.x), where(has_area, n.y), where(has_area, n.z)});
    *at(&s->bx[i]) = bx, *at(&s->bx_inverse[i]) = bx_inverse, *at(&s->bc_half[i]) = bc.length / 2;
    *at(&s->cx[i]) = cx, *at(&s->cy[i]) = cy, *at(&s->cy_inverse[i]) = 1 / cy, *at(&s->ac_inverse[i]) = ac.inverse;
    *at(&s->shape[i]) = where(has_area, bx * cy / (longest * longest));
}

FOR_EACH_PROCESSOR
void star_frames_make(struct star_frames *star, const struct star_rim *rim, vec3 place) {
    assert(rim->n >= 3 && rim->n <= STAR_MOST);
    star->n = rim->n;
    star->ax = (float)place.x, star->ay = (float)place.y, star->az = (float)place.z;
    struct three a = {all(star->ax), all(star->ay), all(star->az)};
    for (size_t i = 0; i < rim->n; i += LANES)
        make_eight(star, i, a, load_three(&rim->place, i), load_three(&rim->place, i + 1));
    repeat_first(&star->normal, star->n);
}

/* Whether pairs of neighbours may turn so that the cosines of their normals go from before to after. */
INLINE mask fold_is_fair(lanes before, lanes after) { return (after >= 0) | (after >= before); }

INLINE bool any(mask m) {
    int64_t part[4];
    memcpy(part, &m, sizeof m);
    return (part[0] | part[1] | part[2] | part[3]) != 0;
}

FOR_EACH_PROCESSOR
bool star_may_become(const struct star_frames *old, const struct star_frames *new, const struct star_vectors *outside,
                     struct star_limits limits) {
    for (size_t i = 0; i < old->n; i += LANES) {
        struct three before = load_three(&old->normal, i), after = load_three(&new->normal, i);
        struct three before_next = load_three(&old->normal, i + 1), after_next = load_three(&new->normal, i + 1);
        struct three across = load_three(outside, i);
        lanes old_shape = load(&old->shape[i]), new_shape = load(&new->shape[i]);
        mask fair = (three_dot(before, after) >= limits.turn) | (old_shape == 0);
        fair &= (new_shape >= limits.thin) | (new_shape >= old_shape);
        fair &= fold_is_fair(three_dot(before, before_next), three_dot(after, after_next));
        fair &= fold_is_fair(three_dot(before, across), three_dot(after, across));
        mask inside = (mask){0, 1, 2, 3, 4, 5, 6, 7} < (int32_t)(old->n - i);
        if (any(inside & ~fair)) return false;
    }
    return true;
}
