/* Triangles without area are rare, and made one at a time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/kernels/triangle_frames.h"

#include <assert.h>
#include <string.h>

#include "core/math/simd.h"

INLINE void f64v3_store(double *x, double *y, double *z, struct f64v3 t) {
    f64_store(x, t.x), f64_store(y, t.y), f64_store(z, t.z);
}

/* Stores a unit direction and a length; returns the length. */
INLINE f64v store_edge(double *out_x, double *out_y, double *out_length, f64v x, f64v y) {
    f64v length = f64_sqrt(x * x + y * y), inverse = 1 / length;
    f64_store(out_x, x * inverse), f64_store(out_y, y * inverse), f64_store(out_length, length);
    return length;
}

/* Where the result is true, everything has been divided by something. */
INLINE i64v make_frames(struct frames_four *f, size_t k, struct f64v3 a, struct f64v3 b, struct f64v3 c) {
    struct f64v3 ab = f64v3_sub(b, a), ac = f64v3_sub(c, a), normal = f64v3_cross(ab, ac);
    f64v length = f64_sqrt(f64v3_dot(ab, ab)), area = f64_sqrt(f64v3_dot(normal, normal));
    struct f64v3 u = f64v3_scale(ab, 1 / length), n = f64v3_scale(normal, 1 / area), v = f64v3_cross(n, u);
    f64v cx = f64v3_dot(ac, u), cy = f64v3_dot(ac, v);
    f64v3_store(&f->ax[k], &f->ay[k], &f->az[k], a), f64v3_store(&f->ux[k], &f->uy[k], &f->uz[k], u);
    f64v3_store(&f->vx[k], &f->vy[k], &f->vz[k], v), f64v3_store(&f->nx[k], &f->ny[k], &f->nz[k], n);
    f64v3_store(&f->bx[k], &f->cx[k], &f->cy[k], (struct f64v3){length, cx, cy});
    f64v bc = store_edge(&f->bc_x[k], &f->bc_y[k], &f->bc_length[k], cx - length, cy);
    f64v ac_length = store_edge(&f->ac_x[k], &f->ac_y[k], &f->ac_length[k], cx, cy);
    f64v longest = f64_pick(f64_less(ac_length, bc), bc, ac_length);
    longest = f64_pick(f64_less(longest, length), length, longest);
    f64_store(&f->shape[k], length * cy / (longest * longest));
    return f64_is_positive(length) & f64_is_positive(area) & f64_is_positive(bc) & f64_is_positive(ac_length);
}

static void make_one(struct frames_four *four, size_t i, const struct triangle_corners *corners) {
    struct triangle_frame f = triangle_frame_of(*corners->a, *corners->b, *corners->c);
    four->ux[i] = f.u.x, four->uy[i] = f.u.y, four->uz[i] = f.u.z;
    four->vx[i] = f.v.x, four->vy[i] = f.v.y, four->vz[i] = f.v.z;
    four->nx[i] = f.n.x, four->ny[i] = f.n.y, four->nz[i] = f.n.z;
    four->bx[i] = f.bx, four->cx[i] = f.cx, four->cy[i] = f.cy;
    four->bc_x[i] = f.bc.x, four->bc_y[i] = f.bc.y, four->bc_length[i] = f.bc.length;
    four->ac_x[i] = f.ac.x, four->ac_y[i] = f.ac.y, four->ac_length[i] = f.ac.length;
    four->shape[i] = triangle_frame_shape(&f);
}

/* F64_LANES triangles, from place k of four on. */
INLINE void make_some(struct frames_four *four, size_t k, const struct triangle_corners *const t[F64_LANES]) {
    const vec3 *a[F64_LANES], *b[F64_LANES], *c[F64_LANES];
    for (size_t i = 0; i < F64_LANES; i++) a[i] = t[i]->a, b[i] = t[i]->b, c[i] = t[i]->c;
    i64v made = make_frames(four, k, f64v3_gather(a), f64v3_gather(b), f64v3_gather(c));
    if (!i64_any(~made)) return;
    for (size_t i = 0; i < F64_LANES; i++)
        if (!SIMD_LANE(made, i)) make_one(four, k + i, t[i]);
}

FOR_EACH_PROCESSOR(struct surface, triangle_frames_make)
(struct triangle_frames *frames, const struct triangle_corners *corners, size_t n) {
    assert(n > 0 && n <= FRAMES_MOST);
    for (size_t begin = 0; begin < n; begin += F64_LANES) {
        const struct triangle_corners *t[F64_LANES];
        for (size_t i = 0; i < F64_LANES; i++) t[i] = &corners[begin + i < n ? begin + i : n - 1];
        make_some(&frames->four[begin / FRAMES_WIDTH], begin % FRAMES_WIDTH, t);
    }
    return (struct surface){frames->four, 0, n};
}

FOR_EACH_PROCESSOR(vec3, surface_middle)
(const struct surface *surface, size_t i) {
    size_t k = surface->first + i, lane = k % FRAMES_WIDTH;
    const struct frames_four *f = &surface->four[k / FRAMES_WIDTH];
    vec3 a = {f->ax[lane], f->ay[lane], f->az[lane]}, u = {f->ux[lane], f->uy[lane], f->uz[lane]};
    vec3 v = {f->vx[lane], f->vy[lane], f->vz[lane]};
    return vec3_add(a, vec3_add(vec3_scale(u, (f->bx[lane] + f->cx[lane]) / 3), vec3_scale(v, f->cy[lane] / 3)));
}
