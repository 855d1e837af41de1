/* Triangles without area are rare, and made one at a time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/triangle_frames.h"

#include <assert.h>
#include <string.h>

#include "core/lanes.h"
#include "core/three.h"

INLINE struct three corners_of(const vec3 *p, const vec3 *q, const vec3 *r, const vec3 *s) {
    return (struct three){{p->x, q->x, r->x, s->x}, {p->y, q->y, r->y, s->y}, {p->z, q->z, r->z, s->z}};
}

INLINE void store_three(double *x, double *y, double *z, struct three t) {
    lanes_store(x, t.x), lanes_store(y, t.y), lanes_store(z, t.z);
}

/* Stores a unit direction and a length; returns the length. */
INLINE lanes store_edge(double *out_x, double *out_y, double *out_length, lanes x, lanes y) {
    lanes length = lanes_root(x * x + y * y), inverse = 1 / length;
    lanes_store(out_x, x * inverse), lanes_store(out_y, y * inverse), lanes_store(out_length, length);
    return length;
}

/* Where the result is true, everything has been divided by something. */
INLINE lanes_mask make_four(struct frames_four *f, struct three a, struct three b, struct three c) {
    struct three ab = three_sub(b, a), ac = three_sub(c, a), normal = three_cross(ab, ac);
    lanes length = lanes_root(three_dot(ab, ab)), area = lanes_root(three_dot(normal, normal));
    struct three u = three_scale(ab, 1 / length), n = three_scale(normal, 1 / area), v = three_cross(n, u);
    lanes cx = three_dot(ac, u), cy = three_dot(ac, v);
    store_three(f->ax, f->ay, f->az, a), store_three(f->ux, f->uy, f->uz, u);
    store_three(f->vx, f->vy, f->vz, v), store_three(f->nx, f->ny, f->nz, n);
    store_three(f->bx, f->cx, f->cy, (struct three){length, cx, cy});
    lanes bc = store_edge(f->bc_x, f->bc_y, f->bc_length, cx - length, cy);
    lanes ac_length = store_edge(f->ac_x, f->ac_y, f->ac_length, cx, cy);
    lanes longest = lanes_pick(bc > ac_length, bc, ac_length);
    longest = lanes_pick(length > longest, length, longest);
    lanes_store(f->shape, length * cy / (longest * longest));
    return (length > 0) & (area > 0) & (bc > 0) & (ac_length > 0);
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

FOR_EACH_PROCESSOR
struct surface triangle_frames_make(struct triangle_frames *frames, const struct triangle_corners *corners, size_t n) {
    assert(n > 0 && n <= FRAMES_MOST);
    for (size_t begin = 0; begin < n; begin += FRAMES_WIDTH) {
        struct frames_four *four = &frames->four[begin / FRAMES_WIDTH];
        const struct triangle_corners *t[FRAMES_WIDTH];
        for (size_t k = 0; k < FRAMES_WIDTH; k++) t[k] = &corners[begin + k < n ? begin + k : n - 1];
        lanes_mask made =
            make_four(four, corners_of(t[0]->a, t[1]->a, t[2]->a, t[3]->a),
                      corners_of(t[0]->b, t[1]->b, t[2]->b, t[3]->b), corners_of(t[0]->c, t[1]->c, t[2]->c, t[3]->c));
        if (made[0] & made[1] & made[2] & made[3]) continue;
        for (size_t k = 0; k < FRAMES_WIDTH; k++)
            if (!made[k]) make_one(four, k, t[k]);
    }
    return (struct surface){frames->four, 0, n};
}

vec3 surface_middle(const struct surface *surface, size_t i) {
    size_t k = surface->first + i, lane = k % FRAMES_WIDTH;
    const struct frames_four *f = &surface->four[k / FRAMES_WIDTH];
    vec3 a = {f->ax[lane], f->ay[lane], f->az[lane]}, u = {f->ux[lane], f->uy[lane], f->uz[lane]};
    vec3 v = {f->vx[lane], f->vy[lane], f->vz[lane]};
    return vec3_add(a, vec3_add(vec3_scale(u, (f->bx[lane] + f->cx[lane]) / 3), vec3_scale(v, f->cy[lane] / 3)));
}
