/* Planes of one direction and several others at once, then all directions against each plane.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/directions.h"

#include <assert.h>

#include "core/math/simd.h"

enum { MOST = DIRECTIONS_MOST, LEAST_ON = 2 };
static_assert(MOST % F64_SUMS == 0, "room for whole registers");

FOR_EACH_PROCESSOR(void, directions_set)
(struct directions *d) {
    for (unsigned i = 0; i < MOST; i++) {
        vec3 to = i < d->n ? d->to[i] : (vec3){0, 0, 0};
        d->x[i] = to.x, d->y[i] = to.y, d->z[i] = to.z;
    }
}

INLINE struct f64v3 directions_at(const struct directions *d, unsigned i) {
    return (struct f64v3){f64_load(&d->x[i]), f64_load(&d->y[i]), f64_load(&d->z[i])};
}

INLINE uint32_t near_plane(const struct directions *d, vec3 normal) {
    struct f64v3 across = {f64_all(normal.x), f64_all(normal.y), f64_all(normal.z)};
    uint32_t on = 0;
    for (unsigned i = 0; i < d->n; i += F64_LANES)
        on |= i64_bits_of(f64_less(f64_abs(f64v3_dot(directions_at(d, i), across)), f64_all(DIRECTIONS_ON))) << i;
    return on & (((uint32_t)1 << d->n) - 1);
}

FOR_EACH_PROCESSOR(uint32_t, directions_near_plane)
(const struct directions *d, vec3 normal) { return near_plane(d, normal); }

/* Normals of the planes of the i-th direction and those after it, from its register on. */
struct planes_of {
    double x[MOST], y[MOST], z[MOST], sine[MOST];
};

INLINE void cross_all(const struct directions *d, unsigned i, struct planes_of *planes) {
    struct f64v3 own = {f64_all(d->x[i]), f64_all(d->y[i]), f64_all(d->z[i])};
    for (unsigned j = i - i % F64_LANES; j < d->n; j += F64_LANES) {
        struct f64v3 across = f64v3_cross(own, directions_at(d, j));
        f64v sine = f64_sqrt(f64v3_dot(across, across));
        across = f64v3_scale(across, 1 / sine);
        f64_store(&planes->x[j], across.x), f64_store(&planes->y[j], across.y), f64_store(&planes->z[j], across.z);
        f64_store(&planes->sine[j], sine);
    }
}

INLINE unsigned count_of(uint32_t bits) { return (unsigned)__builtin_popcount(bits); }

FOR_EACH_PROCESSOR(bool, directions_find_plane)
(const struct directions *d, uint32_t left, vec3 *normal, uint32_t *on) {
    unsigned best = 0;
    for (unsigned i = 0; i < d->n; i++) {
        struct planes_of planes;
        if (!(left >> i & 1)) continue;
        cross_all(d, i, &planes);
        for (unsigned j = i + 1; j < d->n; j++) {
            if (!(left >> j & 1) || planes.sine[j] < DIRECTIONS_APART) continue;
            vec3 across = {planes.x[j], planes.y[j], planes.z[j]};
            uint32_t near = near_plane(d, across);
            unsigned worth = count_of(near & left) * MOST + count_of(near);
            if (worth <= best) continue;
            best = worth, *normal = across, *on = near;
        }
    }
    return best / MOST >= LEAST_ON;
}
