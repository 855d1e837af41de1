/* The kernels are written over vectors of four floats, as the compilers' extension has them, without branches: a sample
 * over the triangle is as far as its height; any other is nearest to one of the three edges.
 *
 * After the samples of a cluster come four of weight 0, so that vectors may reach over the end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cluster.h"

#include <assert.h>
#include <string.h>

#include "core/cloud.h"

enum { LANES = 4 };

#define THINNEST 1e-5 /* shape of triangles that don't pull at their corners */

typedef float lanes __attribute__((vector_size(16)));
typedef int32_t mask __attribute__((vector_size(16)));

static inline lanes pick(mask m, lanes a, lanes b) { return (lanes)((m & (mask)a) | (~m & (mask)b)); }
static inline lanes lower(lanes a, lanes b) { return pick(a < b, a, b); }
static inline lanes higher(lanes a, lanes b) { return pick(a > b, a, b); }
static inline lanes all(float x) { return (lanes){x, x, x, x}; }
static inline lanes load(const float *p) { return *(const lanes *)p; }

static inline lanes load_any(const float *p) {
    lanes x;
    memcpy(&x, p, sizeof x);
    return x;
}

static inline lanes root(lanes x) { return (lanes){sqrtf(x[0]), sqrtf(x[1]), sqrtf(x[2]), sqrtf(x[3])}; }
static inline double total(lanes x) { return ((double)x[0] + (double)x[1]) + ((double)x[2] + (double)x[3]); }

/* A triangle_frame in float, relative to the cluster's origin. */
struct flat {
    float ax, ay, az, ux, uy, uz, vx, vy, vz, nx, ny, nz;
    float bx, cx, cy, ex, inv_bc, inv_ca;
};

static struct flat flat_of(const struct triangle_frame *f, vec3 origin) {
    vec3 a = vec3_sub(f->a, origin);
    return (struct flat){
        (float)a.x,    (float)a.y,    (float)a.z,    (float)f->u.x,          (float)f->u.y,    (float)f->u.z,
        (float)f->v.x, (float)f->v.y, (float)f->v.z, (float)f->n.x,          (float)f->n.y,    (float)f->n.z,
        (float)f->bx,  (float)f->cx,  (float)f->cy,  (float)(f->cx - f->bx), (float)f->inv_bc, (float)f->inv_ca};
}

static inline lanes to_edge_sq(lanes x, lanes y, lanes ex, lanes ey, lanes inverse) {
    lanes t = higher(all(0), lower(all(1), (x * ex + y * ey) * inverse));
    lanes dx = x - t * ex, dy = y - t * ey;
    return dx * dx + dy * dy;
}

/* Squared distances of four samples to a triangle. */
static inline __attribute__((always_inline)) lanes distance_sq(const struct flat *f, lanes px, lanes py, lanes pz) {
    lanes rx = px - f->ax, ry = py - f->ay, rz = pz - f->az;
    lanes h = rx * f->nx + ry * f->ny + rz * f->nz;
    lanes x = rx * f->ux + ry * f->uy + rz * f->uz;
    lanes y = rx * f->vx + ry * f->vy + rz * f->vz;
    lanes bx = all(f->bx), cx = all(f->cx), cy = all(f->cy), ex = all(f->ex), beyond = x - bx;
    mask over = (y >= 0) & (ex * y >= cy * beyond) & (cy * x >= cx * y);
    lanes along = x - higher(all(0), lower(bx, x));
    lanes edge_sq = lower(along * along + y * y, to_edge_sq(beyond, y, ex, cy, all(f->inv_bc)));
    edge_sq = lower(edge_sq, to_edge_sq(x, y, cx, cy, all(f->inv_ca)));
    return h * h + pick(over, all(0), edge_sq);
}

void cluster_clear(struct cluster *cluster, vec3 origin) {
    cluster->origin = origin;
    cluster->n = 0;
    cluster->total_weight = 0;
}

uint32_t cluster_add(struct cluster *cluster, const struct sample *sample, uint32_t first) {
    size_t n = cluster->n;
    uint32_t i = first;
    for (; i != NONE && n < CLUSTER_MOST; i = sample[i].next, n++) {
        vec3 p = vec3_sub(sample[i].place, cluster->origin);
        cluster->x[n] = (float)p.x, cluster->y[n] = (float)p.y, cluster->z[n] = (float)p.z;
        cluster->weight[n] = sample[i].weight;
        cluster->sample[n] = i;
        cluster->total_weight += (double)sample[i].weight;
    }
    cluster->n = n;
    for (int k = 0; k < LANES; k++, n++) cluster->x[n] = cluster->y[n] = cluster->z[n] = cluster->weight[n] = 0;
    return i;
}

enum { STRIP = 8 }; /* vectors whose nearest distances are held while the triangles are gone through */

/* The squared distances of vectors [begin, begin + count) to the nearest of the triangles. */
static void strip_nearest(const struct cluster *cluster, const struct flat *flat, size_t n, size_t begin, size_t count,
                          lanes nearest_sq[STRIP]) {
    for (size_t k = 0; k < count; k++) nearest_sq[k] = all(INFINITY);
    for (size_t j = 0; j < n; j++) {
        const struct flat f = flat[j];
        for (size_t k = 0; k < count; k++) {
            size_t at = (begin + k) * LANES;
            lanes d_sq = distance_sq(&f, load(&cluster->x[at]), load(&cluster->y[at]), load(&cluster->z[at]));
            nearest_sq[k] = lower(d_sq, nearest_sq[k]);
        }
    }
}

enum { MOST_TRIANGLES = 64 };

double cluster_cost(const struct cluster *cluster, const struct triangle_frame *frame, size_t n, float further,
                    double limit) {
    assert(n <= MOST_TRIANGLES);
    struct flat flat[MOST_TRIANGLES];
    lanes nearest_sq[STRIP], sum = all(0);
    size_t vectors = (cluster->n + LANES - 1) / LANES;
    for (size_t j = 0; j < n; j++) flat[j] = flat_of(&frame[j], cluster->origin);
    for (size_t begin = 0; begin < vectors; begin += STRIP) {
        size_t count = vectors - begin < STRIP ? vectors - begin : STRIP;
        strip_nearest(cluster, flat, n, begin, count, nearest_sq);
        for (size_t k = 0; k < count; k++) {
            lanes d_sq = nearest_sq[k];
            sum += load(&cluster->weight[(begin + k) * LANES]) * (root(d_sq) + d_sq * further);
        }
        if (total(sum) > limit) break;
    }
    return total(sum);
}

/* Where four samples' nearest places on a triangle are: the corner a's share in them, and what is left to the sample in
 * the triangle's own axes. */
struct feet {
    lanes share, x, y, z;
};

static inline struct feet feet_of(const struct flat *f, lanes px, lanes py, lanes pz) {
    lanes rx = px - f->ax, ry = py - f->ay, rz = pz - f->az;
    lanes x = rx * f->ux + ry * f->uy + rz * f->uz;
    lanes y = rx * f->vx + ry * f->vy + rz * f->vz;
    struct feet feet = {.z = rx * f->nx + ry * f->ny + rz * f->nz};
    lanes bx = all(f->bx), cx = all(f->cx), cy = all(f->cy), ex = all(f->ex), beyond = x - bx;
    mask over = (y >= 0) & (ex * y >= cy * beyond) & (cy * x >= cx * y);
    lanes share_c = y / cy, share = 1 - share_c - (x - cx * share_c) / bx;
    lanes t = higher(all(0), lower(all(1), x / bx));
    lanes dx = x - t * bx, dy = y, best_sq = dx * dx + dy * dy, best = 1 - t;
    t = higher(all(0), lower(all(1), (x * cx + y * cy) * f->inv_ca));
    lanes ux = x - t * cx, uy = y - t * cy, other_sq = ux * ux + uy * uy;
    mask nearer = other_sq < best_sq;
    dx = pick(nearer, ux, dx), dy = pick(nearer, uy, dy), best = pick(nearer, 1 - t, best);
    best_sq = lower(other_sq, best_sq);
    nearer = to_edge_sq(beyond, y, ex, cy, all(f->inv_bc)) < best_sq;
    best = pick(nearer, all(0), best);
    feet.share = pick(over, share, best), feet.x = pick(over, all(0), dx), feet.y = pick(over, all(0), dy);
    return feet;
}

static vec3 from_axes(const struct triangle_frame *f, vec3 s) {
    return vec3_add(vec3_scale(f->u, s.x), vec3_add(vec3_scale(f->v, s.y), vec3_scale(f->n, s.z)));
}

/* a in the triangle's axes, in the axes of space. */
static sym3 sym3_from_axes(const struct triangle_frame *f, sym3 a) {
    vec3 x = from_axes(f, (vec3){a.xx, a.xy, a.xz});
    vec3 y = from_axes(f, (vec3){a.xy, a.yy, a.yz});
    vec3 z = from_axes(f, (vec3){a.xz, a.yz, a.zz});
    vec3 rx = from_axes(f, (vec3){x.x, y.x, z.x}), ry = from_axes(f, (vec3){x.y, y.y, z.y});
    vec3 rz = from_axes(f, (vec3){x.z, y.z, z.z});
    return (sym3){rx.x, rx.y, rx.z, ry.y, ry.z, rz.z};
}

void cluster_fit_corner(const struct cluster *cluster, size_t begin, size_t end, const struct triangle_frame *frame,
                        float near, float further, struct cluster_model *model) {
    if (!(triangle_frame_shape(frame) > THINNEST)) return;
    const struct flat f = flat_of(frame, cluster->origin);
    lanes xx = all(0), xy = xx, xz = xx, yy = xx, yz = xx, zz = xx, gx = xx, gy = xx, gz = xx;
    for (size_t i = begin; i < end; i += LANES) {
        mask in = (mask){0, 1, 2, 3} < (int32_t)(end - i);
        struct feet r = feet_of(&f, load_any(&cluster->x[i]), load_any(&cluster->y[i]), load_any(&cluster->z[i]));
        lanes d = root(r.x * r.x + r.y * r.y + r.z * r.z);
        lanes weight = pick(in & (r.share > 0), load_any(&cluster->weight[i]), all(0));
        lanes pull = weight * r.share * (1 + 2 * further * d) / higher(d, all(near));
        mask off = d > 1e-9f;
        lanes inverse = 1 / pick(off, d, all(1)), stiff = pull * r.share;
        lanes nx = pick(off, r.x * inverse, all(0)), ny = pick(off, r.y * inverse, all(0));
        lanes nz = pick(off, r.z * inverse, all(1));
        xx += stiff * nx * nx, xy += stiff * nx * ny, xz += stiff * nx * nz;
        yy += stiff * ny * ny, yz += stiff * ny * nz, zz += stiff * nz * nz;
        gx += pull * r.x, gy += pull * r.y, gz += pull * r.z;
    }
    sym3 a = {total(xx), total(xy), total(xz), total(yy), total(yz), total(zz)};
    model->a = sym3_add(model->a, sym3_from_axes(frame, a));
    model->g = vec3_add(model->g, from_axes(frame, (vec3){total(gx), total(gy), total(gz)}));
}

void cluster_owners(const struct cluster *cluster, const struct triangle_frame *frame, size_t n,
                    uint8_t owner[CLUSTER_MOST], float distance_sq_out[CLUSTER_MOST]) {
    lanes nearest_sq[CLUSTER_MOST / LANES];
    mask nearest[CLUSTER_MOST / LANES];
    size_t vectors = (cluster->n + LANES - 1) / LANES;
    for (size_t k = 0; k < vectors; k++) nearest_sq[k] = all(INFINITY), nearest[k] = (mask){0};
    for (size_t j = 0; j < n; j++) {
        const struct flat f = flat_of(&frame[j], cluster->origin);
        int32_t id = (int32_t)j;
        for (size_t k = 0; k < vectors; k++) {
            size_t at = k * LANES;
            lanes d_sq = distance_sq(&f, load(&cluster->x[at]), load(&cluster->y[at]), load(&cluster->z[at]));
            mask nearer = d_sq < nearest_sq[k];
            nearest_sq[k] = pick(nearer, d_sq, nearest_sq[k]);
            nearest[k] = (nearer & (mask){id, id, id, id}) | (~nearer & nearest[k]);
        }
    }
    for (size_t i = 0; i < cluster->n; i++) {
        owner[i] = (uint8_t)nearest[i / LANES][i % LANES];
        distance_sq_out[i] = nearest_sq[i / LANES][i % LANES];
    }
}

void cluster_nearest(const struct cluster *cluster, vec3 place, double *nearest_sq, uint32_t *nearest) {
    vec3 p = vec3_sub(place, cluster->origin);
    lanes px = all((float)p.x), py = all((float)p.y), pz = all((float)p.z), best_sq = all(INFINITY);
    mask best = {0}, id = {0, 1, 2, 3};
    size_t whole = cluster->n / LANES * LANES;
    for (size_t i = 0; i < whole; i += LANES, id += LANES) {
        lanes dx = load(&cluster->x[i]) - px, dy = load(&cluster->y[i]) - py, dz = load(&cluster->z[i]) - pz;
        lanes d_sq = dx * dx + dy * dy + dz * dz;
        mask nearer = d_sq < best_sq;
        best_sq = pick(nearer, d_sq, best_sq);
        best = (nearer & id) | (~nearer & best);
    }
    for (int k = 0; k < LANES; k++) {
        if ((double)best_sq[k] >= *nearest_sq) continue;
        *nearest_sq = (double)best_sq[k], *nearest = cluster->sample[best[k]];
    }
    for (size_t i = whole; i < cluster->n; i++) {
        float dx = cluster->x[i] - px[0], dy = cluster->y[i] - py[0], dz = cluster->z[i] - pz[0];
        double d_sq = (double)(dx * dx + dy * dy + dz * dz);
        if (d_sq < *nearest_sq) *nearest_sq = d_sq, *nearest = cluster->sample[i];
    }
}
