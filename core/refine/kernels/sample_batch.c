/* The kernels are written over vectors of floats (math/simd.h), without branches: a sample over the triangle is as far
 * as its height; any other is nearest to one of the three edges.
 *
 * One function, distance_sq, measures for all of them.  In double and one at a time it is triangle_frame_hit
 * (core/math/triangle_frame.h); that one doesn't go from the middles of edges, so the last bits differ.
 *
 * Samples are taken eight at a time whatever the width, so that sums over them are the same (F32_SUMS).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/kernels/sample_batch.h"

#include <string.h>

#include "core/cloud/cloud.h"
#include "core/math/simd.h"

_Static_assert((int)F32_SUMS == (int)SAMPLE_BLOCK, "a block of samples goes into the parts of a sum");

#define THINNEST 1e-5f  /* shape of triangles that don't pull at their corners */
#define FAR_AWAY 1.0e9f /* where nothing is; its square times anything reasonable is finite */

/* Four triangle_frames in float, relative to the batch's origin. */
struct flat_four {
    float ax[FRAMES_WIDTH], ay[FRAMES_WIDTH], az[FRAMES_WIDTH];
    float ux[FRAMES_WIDTH], uy[FRAMES_WIDTH], uz[FRAMES_WIDTH];
    float vx[FRAMES_WIDTH], vy[FRAMES_WIDTH], vz[FRAMES_WIDTH];
    float nx[FRAMES_WIDTH], ny[FRAMES_WIDTH], nz[FRAMES_WIDTH];
    float bx[FRAMES_WIDTH], bc_x[FRAMES_WIDTH], bc_y[FRAMES_WIDTH], bc_length[FRAMES_WIDTH];
    float ac_x[FRAMES_WIDTH], ac_y[FRAMES_WIDTH], ac_length[FRAMES_WIDTH];
};

INLINE void round_four(const double from[FRAMES_WIDTH], float to[FRAMES_WIDTH]) {
    for (size_t k = 0; k < FRAMES_WIDTH; k += F64_LANES) f64_store_f32(&to[k], f64_load(&from[k]));
}

INLINE void round_four_from(const double from[FRAMES_WIDTH], double origin, float to[FRAMES_WIDTH]) {
    for (size_t k = 0; k < FRAMES_WIDTH; k += F64_LANES) f64_store_f32(&to[k], f64_load(&from[k]) - origin);
}

INLINE void flatten(const struct frames_four *f, vec3 origin, struct flat_four *out) {
    round_four_from(f->ax, origin.x, out->ax);
    round_four_from(f->ay, origin.y, out->ay);
    round_four_from(f->az, origin.z, out->az);
    round_four(f->ux, out->ux), round_four(f->uy, out->uy), round_four(f->uz, out->uz);
    round_four(f->vx, out->vx), round_four(f->vy, out->vy), round_four(f->vz, out->vz);
    round_four(f->nx, out->nx), round_four(f->ny, out->ny), round_four(f->nz, out->nz);
    round_four(f->bx, out->bx);
    round_four(f->bc_x, out->bc_x), round_four(f->bc_y, out->bc_y), round_four(f->bc_length, out->bc_length);
    round_four(f->ac_x, out->ac_x), round_four(f->ac_y, out->ac_y), round_four(f->ac_length, out->ac_length);
}

enum { FLAT_ROOM = FRAMES_MOST / FRAMES_WIDTH };

/* The triangles of a surface: the first is number surface->first % FRAMES_WIDTH of flat[]. */
INLINE size_t flatten_all(const struct surface *surface, vec3 origin, struct flat_four flat[FLAT_ROOM]) {
    size_t begin = surface->first / FRAMES_WIDTH, end = (surface->first + surface->n + FRAMES_WIDTH - 1) / FRAMES_WIDTH;
    for (size_t k = begin; k < end; k++) flatten(&surface->four[k], origin, &flat[k - begin]);
    return surface->first % FRAMES_WIDTH;
}

struct span {
    size_t begin, end;
};

/* How far past either end of an edge, whose middle t is counted from. */
INLINE f32v past_half(f32v t, f32v half) { return f32_max(f32_abs(t), half) - half; }

/* A triangle in its frame, each number in all places of a vector; distances are taken from corner a. */
struct spread_edge {
    f32v x, y, half;
};

struct spread {
    f32v ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, ab_half;
    struct spread_edge bc, ac;
};

/* The same, and where corner a is. */
struct spread_at {
    f32v ax, ay, az;
    struct spread frame;
};

INLINE struct spread_at spread(const struct flat_four *flat, size_t j) {
    const struct flat_four *f = &flat[j / FRAMES_WIDTH];
    size_t k = j % FRAMES_WIDTH;
    return (struct spread_at){
        .ax = f32_all(f->ax[k]),
        .ay = f32_all(f->ay[k]),
        .az = f32_all(f->az[k]),
        .frame =
            {
                .ux = f32_all(f->ux[k]),
                .uy = f32_all(f->uy[k]),
                .uz = f32_all(f->uz[k]),
                .vx = f32_all(f->vx[k]),
                .vy = f32_all(f->vy[k]),
                .vz = f32_all(f->vz[k]),
                .nx = f32_all(f->nx[k]),
                .ny = f32_all(f->ny[k]),
                .nz = f32_all(f->nz[k]),
                .bx = f32_all(f->bx[k]),
                .ab_half = f32_all(f->bx[k] / 2),
                .bc = {f32_all(f->bc_x[k]), f32_all(f->bc_y[k]), f32_all(f->bc_length[k] / 2)},
                .ac = {f32_all(f->ac_x[k]), f32_all(f->ac_y[k]), f32_all(f->ac_length[k] / 2)},
            },
    };
}

INLINE f32v edge_sq(const struct spread_edge *e, f32v left, f32v x, f32v y) {
    f32v past = past_half(x * e->x + y * e->y - e->half, e->half);
    return left * left + past * past;
}

enum edges { ALL_EDGES, WITHOUT_AC };

/* Squared distances to a triangle of places as seen from its corner a; where the edge ac is the next triangle's as
 * well, it may be left out here. */
INLINE f32v distance_sq(const struct spread *f, f32v rx, f32v ry, f32v rz, enum edges edges) {
    f32v x = rx * f->ux + ry * f->uy + rz * f->uz, y = rx * f->vx + ry * f->vy + rz * f->vz;
    f32v z = rx * f->nx + ry * f->ny + rz * f->nz, beyond = x - f->bx;
    f32v past = past_half(x - f->ab_half, f->ab_half);
    f32v bc_left = y * f->bc.x - beyond * f->bc.y, ac_right = x * f->ac.y - y * f->ac.x;
    i32v over = f32_is_positive(f32_min(f32_min(y, bc_left), ac_right));
    f32v others = edge_sq(&f->bc, bc_left, beyond, y);
    if (edges == ALL_EDGES) others = f32_min(others, edge_sq(&f->ac, ac_right, x, y));
    return z * z + f32_where(~over, f32_min(y * y + past * past, others));
}

INLINE f32v distance_at_sq(const struct spread_at *f, f32v x, f32v y, f32v z) {
    return distance_sq(&f->frame, x - f->ax, y - f->ay, z - f->az, ALL_EDGES);
}

INLINE void copy_eight(const float *from, float shift, float *to) {
    for (size_t k = 0; k < SAMPLE_BLOCK; k += F32_LANES) f32_store(&to[k], f32_load(&from[k]) + shift);
}

INLINE void set_eight(float *to, float x) {
    for (size_t k = 0; k < SAMPLE_BLOCK; k += F32_LANES) f32_store(&to[k], f32_all(x));
}

FOR_EACH_PROCESSOR(uint32_t, sample_batch_add)
(struct sample_batch *batch, const struct sample_block *block, uint32_t first) {
    size_t n = batch->n;
    uint32_t i = first;
    for (; i != NONE && n + block[i].count <= CLUSTER_MOST; n += block[i].count, i = block[i].next) {
        vec3 shift = vec3_sub(block[i].origin, batch->origin);
        copy_eight(block[i].x, (float)shift.x, &batch->x[n]);
        copy_eight(block[i].y, (float)shift.y, &batch->y[n]);
        copy_eight(block[i].z, (float)shift.z, &batch->z[n]);
        memcpy(&batch->weight[n], block[i].weight, sizeof block[i].weight);
        memcpy(&batch->sample[n], block[i].sample, sizeof block[i].sample);
    }
    batch->n = n;
    set_eight(&batch->x[n], FAR_AWAY);
    set_eight(&batch->y[n], FAR_AWAY);
    set_eight(&batch->z[n], FAR_AWAY);
    set_eight(&batch->weight[n], 0);
    return i;
}

FOR_EACH_PROCESSOR(double, sample_batch_weight)
(const struct sample_batch *batch) {
    f32v sum[F32_PARTS] = {0};
    for (size_t i = 0; i < batch->n; i += F32_SUMS)
        for (size_t k = 0; k < F32_PARTS; k++) sum[k] += f32_load(&batch->weight[i + k * F32_LANES]);
    return f32_total(sum);
}

INLINE size_t spread_all(const struct surface *surface, vec3 origin, struct spread_at out[FRAMES_MOST]) {
    struct flat_four flat[FLAT_ROOM];
    size_t first = flatten_all(surface, origin, flat);
    for (size_t j = 0; j < surface->n; j++) out[j] = spread(flat, first + j);
    return surface->n;
}

/* Before a loop over parts: it is written out, so that what each part has stays in registers. */
#define UNROLLED _Pragma("GCC unroll 8")

/* Part k of F32_SUMS samples, from number i on. */
INLINE struct f32v3 places_of(const struct sample_batch *batch, size_t i, size_t k) {
    size_t at = i + k * F32_LANES;
    return (struct f32v3){f32_load(&batch->x[at]), f32_load(&batch->y[at]), f32_load(&batch->z[at])};
}

INLINE f32v cost_of(f32v weight, f32v d_sq, float further) { return weight * (f32_sqrt(d_sq) + d_sq * further); }

FOR_EACH_PROCESSOR(double, sample_batch_cost)
(const struct sample_batch *batch, const struct surface *surface, float further, double limit) {
    struct spread_at triangle[FRAMES_MOST];
    f32v sum[F32_PARTS] = {0};
    size_t n = spread_all(surface, batch->origin, triangle);
    for (size_t i = 0; i < batch->n; i += F32_SUMS) {
        f32v d_sq[F32_PARTS];
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) d_sq[k] = f32_all(INFINITY);
        for (size_t j = 0; j < n; j++) {
            UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
                struct f32v3 p = places_of(batch, i, k);
                d_sq[k] = f32_min(distance_at_sq(&triangle[j], p.x, p.y, p.z), d_sq[k]);
            }
        }
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
            sum[k] += cost_of(f32_load(&batch->weight[i + k * F32_LANES]), d_sq[k], further);
        }
        if (f32_total(sum) > limit) break;
    }
    return f32_total(sum);
}

INLINE void spread_star(const struct star_frames *star, struct spread triangle[STAR_MOST]) {
    for (size_t j = 0; j < star->sectors; j++)
        triangle[j] = (struct spread){
            .ux = f32_all(star->u.x[j]),
            .uy = f32_all(star->u.y[j]),
            .uz = f32_all(star->u.z[j]),
            .vx = f32_all(star->v.x[j]),
            .vy = f32_all(star->v.y[j]),
            .vz = f32_all(star->v.z[j]),
            .nx = f32_all(star->normal.x[j]),
            .ny = f32_all(star->normal.y[j]),
            .nz = f32_all(star->normal.z[j]),
            .bx = f32_all(star->bx[j]),
            .ab_half = f32_all(star->bx[j] / 2),
            .bc = {f32_all(star->bc_x[j]), f32_all(star->bc_y[j]), f32_all(star->bc_half[j])},
            .ac = {f32_all(star->ac_x[j]), f32_all(star->ac_y[j]), f32_all(0)},
        };
}

/* Squared distances of F32_SUMS samples, from number i on, to the nearest of a star's triangles. */
INLINE void star_sq(const struct sample_batch *batch, const struct star_frames *star, const struct spread *triangle,
                    size_t i, f32v d_sq[F32_PARTS]) {
    struct f32v3 seen[F32_PARTS];
    UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
        struct f32v3 p = places_of(batch, i, k);
        seen[k] = (struct f32v3){p.x - star->ax, p.y - star->ay, p.z - star->az};
        d_sq[k] = f32_all(FAR_AWAY * FAR_AWAY);
    }
    for (size_t j = 0; j < star->sectors; j++) {
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
            d_sq[k] = f32_min(distance_sq(&triangle[j], seen[k].x, seen[k].y, seen[k].z, WITHOUT_AC), d_sq[k]);
        }
    }
}

FOR_EACH_PROCESSOR(double, sample_batch_star_cost)
(const struct sample_batch *batch, const struct star_frames *star, float further, double limit) {
    struct spread triangle[STAR_MOST];
    f32v sum[F32_PARTS] = {0};
    spread_star(star, triangle);
    for (size_t i = 0; i < batch->n; i += F32_SUMS) {
        f32v d_sq[F32_PARTS];
        star_sq(batch, star, triangle, i, d_sq);
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
            sum[k] += cost_of(f32_load(&batch->weight[i + k * F32_LANES]), d_sq[k], further);
        }
        if (f32_total(sum) > limit) break;
    }
    return f32_total(sum);
}

FOR_EACH_PROCESSOR(void, sample_batch_star_distances)
(const struct sample_batch *batch, const struct star_frames *star, float distance_sq[SAMPLE_BATCH_ROOM]) {
    struct spread triangle[STAR_MOST];
    spread_star(star, triangle);
    for (size_t i = 0; i < batch->n; i += F32_SUMS) {
        f32v d_sq[F32_PARTS];
        star_sq(batch, star, triangle, i, d_sq);
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) f32_store(&distance_sq[i + k * F32_LANES], d_sq[k]);
    }
}

/* The triangle of each sample, side by side: the members are those of struct star_frames. */
struct own_triangles {
    f32v ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, bx_inverse, bc_x, bc_y, bc_half;
    f32v cx, cy, cy_inverse, ac_x, ac_y, ac_inverse;
    i32v pulls; /* triangles that aren't too thin */
};

/* table[which]; same: all of which are the same. */
INLINE f32v look(const float table[8], i32v which, bool same) {
    return same ? f32_all(table[SIMD_LANE(which, 0)]) : f32_lookup(table, which);
}

/* Of sample k that is triangle from + which[k]. */
INLINE struct own_triangles own_triangles_of(const struct star_frames *s, size_t from, i32v which, bool same) {
    return (struct own_triangles){
        .ux = look(&s->u.x[from], which, same),
        .uy = look(&s->u.y[from], which, same),
        .uz = look(&s->u.z[from], which, same),
        .vx = look(&s->v.x[from], which, same),
        .vy = look(&s->v.y[from], which, same),
        .vz = look(&s->v.z[from], which, same),
        .nx = look(&s->normal.x[from], which, same),
        .ny = look(&s->normal.y[from], which, same),
        .nz = look(&s->normal.z[from], which, same),
        .bx = look(&s->bx[from], which, same),
        .bx_inverse = look(&s->bx_inverse[from], which, same),
        .bc_x = look(&s->bc_x[from], which, same),
        .bc_y = look(&s->bc_y[from], which, same),
        .bc_half = look(&s->bc_half[from], which, same),
        .ac_x = look(&s->ac_x[from], which, same),
        .ac_y = look(&s->ac_y[from], which, same),
        .ac_inverse = look(&s->ac_inverse[from], which, same),
        .cx = look(&s->cx[from], which, same),
        .cy = look(&s->cy[from], which, same),
        .cy_inverse = look(&s->cy_inverse[from], which, same),
        .pulls = f32_less(f32_all(THINNEST), look(&s->shape[from], which, same)),
    };
}

/* Where samples' nearest places on their triangles are: the vertex's share in them, and what is left to the sample in
 * the triangle's own axes. */
struct feet {
    f32v share, x, y, z;
};

INLINE f32v clamped(f32v t) { return f32_min(f32_positive(t), f32_all(1)); }

INLINE struct feet feet_of(const struct own_triangles *f, f32v rx, f32v ry, f32v rz) {
    f32v x = rx * f->ux + ry * f->uy + rz * f->uz, y = rx * f->vx + ry * f->vy + rz * f->vz;
    f32v z = rx * f->nx + ry * f->ny + rz * f->nz, beyond = x - f->bx;
    f32v bc_left = y * f->bc_x - beyond * f->bc_y;
    f32v bc_past = past_half(beyond * f->bc_x + y * f->bc_y - f->bc_half, f->bc_half);
    i32v over = f32_is_positive(f32_min(f32_min(y, bc_left), x * f->ac_y - y * f->ac_x));
    f32v share_c = y * f->cy_inverse, share = 1 - share_c - (x - f->cx * share_c) * f->bx_inverse;
    f32v t = clamped(x * f->bx_inverse);
    f32v dx = x - t * f->bx, dy = y, best_sq = dx * dx + dy * dy, best = 1 - t;
    t = clamped((x * f->ac_x + y * f->ac_y) * f->ac_inverse);
    f32v ex = x - t * f->cx, ey = y - t * f->cy, other_sq = ex * ex + ey * ey;
    i32v nearer = f32_less(other_sq, best_sq);
    dx = f32_pick(nearer, ex, dx), dy = f32_pick(nearer, ey, dy), best = f32_pick(nearer, 1 - t, best);
    best = f32_where(~f32_less(bc_left * bc_left + bc_past * bc_past, f32_min(other_sq, best_sq)), best);
    return (struct feet){f32_pick(over, share, best), f32_where(~over, dx), f32_where(~over, dy), z};
}

/* A model in the making: one of F32_PARTS. */
struct sums {
    f32v xx, xy, xz, yy, yz, zz, gx, gy, gz;
};

struct lengths {
    float near, further;
};

/* Adds samples as far as they count.  Directions are turned into the axes of space before they are added up, so
 * that there are only nine sums for all triangles. */
INLINE void fit_samples(const struct own_triangles *f, struct feet r, f32v weight, struct lengths by, struct sums *s) {
    f32v d = f32_sqrt(r.x * r.x + r.y * r.y + r.z * r.z);
    i32v counts = f->pulls & f32_is_positive(r.share), off = f32_less(f32_all(1e-9f), d);
    f32v pull = weight * r.share * (1 + 2 * by.further * d) / f32_max(d, f32_all(by.near));
    f32v inverse = 1 / f32_pick(off, d, f32_all(1)), stiff = f32_where(counts, pull * r.share),
         far = f32_where(counts, pull * d);
    f32v x = f32_where(off, r.x * inverse), y = f32_where(off, r.y * inverse),
         z = f32_pick(off, r.z * inverse, f32_all(1));
    f32v nx = f32_where(counts, x * f->ux + y * f->vx + z * f->nx),
         ny = f32_where(counts, x * f->uy + y * f->vy + z * f->ny);
    f32v nz = f32_where(counts, x * f->uz + y * f->vz + z * f->nz), sx = stiff * nx, sy = stiff * ny, sz = stiff * nz;
    s->xx += sx * nx, s->xy += sx * ny, s->xz += sx * nz;
    s->yy += sy * ny, s->yz += sy * nz, s->zz += sz * nz;
    s->gx += far * nx, s->gy += far * ny, s->gz += far * nz;
}

/* Adds the samples of up to eight triangles, which follow each other.  Without a lookup in registers, samples that are
 * of one triangle all, as most are of four, take its numbers once. */
INLINE void fit_triangles(const struct sample_batch *batch, const size_t *begin, const struct star_frames *star,
                          struct span in, struct lengths by, struct sums sums[F32_PARTS]) {
    struct own_triangles f;
    int32_t held = -1; /* the triangle that all of f are */
    for (size_t first = begin[in.begin], end = begin[in.end]; first < end; first += F32_SUMS)
        for (size_t part = 0, i = first; part < F32_PARTS && i < end; part++, i += F32_LANES) {
            i32v place = i32_count() + (int32_t)i, which = i32_all(0), valid = i32_less(place, i32_all((int32_t)end));
            for (size_t k = in.begin + 1; k < in.end; k++) which -= ~i32_less(place, i32_all((int32_t)begin[k]));
            int32_t least = SIMD_LANE(which, 0), most = SIMD_LANE(which, F32_LANES - 1);
            if (F32_PARTS == 1 || least != most)
                f = own_triangles_of(star, in.begin, which, false), held = -1;
            else if (least != held)
                f = own_triangles_of(star, in.begin, which, true), held = least;
            struct feet feet = feet_of(&f, f32_load(&batch->x[i]) - star->ax, f32_load(&batch->y[i]) - star->ay,
                                       f32_load(&batch->z[i]) - star->az);
            fit_samples(&f, feet, f32_where(valid, f32_load(&batch->weight[i])), by, &sums[part]);
        }
}

/* A member's sum over the parts. */
INLINE double sum_of(const struct sums sums[F32_PARTS], size_t member) {
    f32v part[F32_PARTS];
    for (size_t k = 0; k < F32_PARTS; k++) memcpy(&part[k], (const char *)&sums[k] + member, sizeof part[k]);
    return f32_total(part);
}

FOR_EACH_PROCESSOR(void, sample_batch_fit)
(const struct sample_batch *batch, const size_t *begin, const struct star_frames *star, float near, float further,
 struct sample_batch_model *model) {
    struct sums sums[F32_PARTS] = {0};
    for (size_t k = 0; k < star->n; k += F32_SUMS) {
        struct span in = {k, k + F32_SUMS < star->n ? k + F32_SUMS : star->n};
        fit_triangles(batch, begin, star, in, (struct lengths){near, further}, sums);
    }
#define SUM(member) sum_of(sums, offsetof(struct sums, member))
    model->a = sym3_add(model->a, (sym3){SUM(xx), SUM(xy), SUM(xz), SUM(yy), SUM(yz), SUM(zz)});
    model->g = vec3_add(model->g, (vec3){SUM(gx), SUM(gy), SUM(gz)});
#undef SUM
}

FOR_EACH_PROCESSOR(void, sample_batch_values)
(const struct sample_batch *batch, const sym3 *a, vec3 place, size_t points, float value[SAMPLE_BATCH_ROOM]) {
    vec3 p = vec3_sub(place, batch->origin);
    float xx = (float)a->xx, xy = (float)a->xy, xz = (float)a->xz, yy = (float)a->yy, yz = (float)a->yz;
    float zz = (float)a->zz;
    for (size_t i = 0; i < batch->n; i += F32_LANES) {
        f32v x = f32_load(&batch->x[i]) - (float)p.x, y = f32_load(&batch->y[i]) - (float)p.y;
        f32v z = f32_load(&batch->z[i]) - (float)p.z;
        f32v sum = x * (x * xx + y * (2 * xy) + z * (2 * xz)) + y * (y * yy + z * (2 * yz)) + z * z * zz;
        i32v id = i32_load(&batch->sample[i]);
        i32v is_point = i32_less(i32_all(-1), id) & i32_less(id, i32_all((int32_t)points));
        f32_store(&value[i], f32_pick(is_point, sum, f32_all(INFINITY)));
    }
}

FOR_EACH_PROCESSOR(void, sample_batch_owners)
(const struct sample_batch *batch, const struct surface *surface, uint8_t owner[SAMPLE_BATCH_ROOM],
 float distance_sq_out[SAMPLE_BATCH_ROOM]) {
    i32v nearest[SAMPLE_BATCH_ROOM / F32_LANES];
    struct flat_four flat[FLAT_ROOM];
    size_t n = batch->n, first = flatten_all(surface, batch->origin, flat);
    for (size_t i = 0; i < n; i += F32_LANES) {
        f32_store(&distance_sq_out[i], f32_all(INFINITY));
        nearest[i / F32_LANES] = i32_all(0);
    }
    for (size_t j = 0; j < surface->n; j++) {
        const struct spread_at f = spread(flat, first + j);
        i32v id = i32_all((int32_t)j);
        for (size_t i = 0; i < n; i += F32_LANES) {
            f32v before = f32_load(&distance_sq_out[i]);
            f32v d_sq = distance_at_sq(&f, f32_load(&batch->x[i]), f32_load(&batch->y[i]), f32_load(&batch->z[i]));
            i32v nearer = f32_less(d_sq, before), *place = &nearest[i / F32_LANES];
            f32_store(&distance_sq_out[i], f32_pick(nearer, d_sq, before));
            *place = i32_pick(nearer, id, *place);
        }
    }
    for (size_t i = 0; i < n; i++) owner[i] = (uint8_t)SIMD_LANE(nearest[i / F32_LANES], i % F32_LANES);
}

FOR_EACH_PROCESSOR(void, sample_batch_nearest)
(const struct sample_batch *batch, vec3 place, double *nearest_sq, uint32_t *nearest) {
    vec3 p = vec3_sub(place, batch->origin);
    f32v best_sq[F32_PARTS];
    i32v best[F32_PARTS];
    UNROLLED for (size_t k = 0; k < F32_PARTS; k++) best_sq[k] = f32_all(INFINITY), best[k] = i32_all(0);
    for (size_t first = 0; first < batch->n; first += F32_SUMS) {
        UNROLLED for (size_t k = 0; k < F32_PARTS; k++) {
            struct f32v3 q = places_of(batch, first, k);
            f32v dx = q.x - (float)p.x, dy = q.y - (float)p.y, dz = q.z - (float)p.z;
            f32v d_sq = dx * dx + dy * dy + dz * dz;
            i32v number = i32_count() + (int32_t)(first + k * F32_LANES);
            best[k] = i32_pick(f32_less(d_sq, best_sq[k]), number, best[k]);
            best_sq[k] = f32_min(d_sq, best_sq[k]);
        }
    }
    unsigned part = f32_place_of_least(best_sq), k = part / F32_LANES, lane = part % F32_LANES;
    size_t which = (size_t)SIMD_LANE(best[k], lane);
    double least_sq = (double)SIMD_LANE(best_sq[k], lane);
    if (least_sq < *nearest_sq && which < batch->n) *nearest_sq = least_sq, *nearest = batch->sample[which];
}
