/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/around.h"

#include <assert.h>

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

FOR_EACH_PROCESSOR(void, around_weigh)
(struct around *around, double rim_sq) {
    for (unsigned i = around->n; i % F64_SUMS; i++) {
        around->x[i] = around->y[i] = around->z[i] = 0;
        around->normal_x[i] = around->normal_y[i] = around->normal_z[i] = 0;
    }
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        struct f64v3 e = places_at(around, i);
        f64v t = 1 - f64v3_dot(e, e) / rim_sq;
        f64_store(&around->near[i], f64_where(f64_is_positive(t), t * t));
    }
}

FOR_EACH_PROCESSOR(void, around_plane)
(const struct around *around, vec3 mean, vec3 normal, double scale_sq, double weight[AROUND_MOST]) {
    struct f64v3 middle = everywhere(mean), across = everywhere(normal);
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        f64v height = f64v3_dot(across, f64v3_sub(places_at(around, i), middle));
        f64_store(&weight[i], f64_load(&around->near[i]) * tolerance_of(height * height, scale_sq));
    }
}

FOR_EACH_PROCESSOR(void, around_look)
(const struct around *around, vec3 normal, double angle_sq, struct around_looks *looks) {
    struct f64v3 own = everywhere(normal);
    for (unsigned i = 0; i < around->n; i += F64_LANES) {
        struct f64v3 e = places_at(around, i);
        struct f64v3 n = {f64_load(&around->normal_x[i]), f64_load(&around->normal_y[i]),
                          f64_load(&around->normal_z[i])};
        f64v side = f64_pick(f64_less(f64v3_dot(n, own), f64_all(0)), f64_all(-1), f64_all(1));
        n = f64v3_scale(n, side);
        struct f64v3 apart = f64v3_sub(n, own), both = {own.x + n.x, own.y + n.y, own.z + n.z};
        f64v weight = f64_load(&around->near[i]) * tolerance_of(f64v3_dot(apart, apart), angle_sq);
        f64_store(&looks->weight[i], weight);
        f64_store(&looks->turned[i], weight * side);
        f64_store(&looks->height[i], f64v3_dot(both, e) / 2);
    }
}
