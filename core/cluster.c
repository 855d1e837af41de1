/* The kernels are written over vectors of eight floats (lanes8.h), without branches: a sample over the triangle is as
 * far as its height; any other is nearest to one of the three edges.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cluster.h"

#include <string.h>

#include "core/cloud.h"
#include "core/lanes8.h"

_Static_assert((int)LANES == (int)SAMPLE_BLOCK, "samples are read a vector at a time");

#define THINNEST 1e-5f  /* shape of triangles that don't pull at their corners */
#define FAR_AWAY 1.0e9f /* where nothing is; its square times anything reasonable is finite */

typedef float four __attribute__((vector_size(16)));
typedef double wide __attribute__((vector_size(32), aligned(8), may_alias));

/* Four triangle_frames in float, relative to the cluster's origin. */
struct flat_four {
    four ax, ay, az, ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, bc_x, bc_y, bc_half, ac_x, ac_y, ac_half;
};

INLINE four narrow(const double *x) { return __builtin_convertvector(*(const wide *)x, four); }
INLINE four narrow_from(const double *x, double origin) {
    return __builtin_convertvector(*(const wide *)x - origin, four);
}

INLINE void flatten(const struct frames_four *f, vec3 origin, struct flat_four *out) {
    *out = (struct flat_four){
        .ax = narrow_from(f->ax, origin.x),
        .ay = narrow_from(f->ay, origin.y),
        .az = narrow_from(f->az, origin.z),
        .ux = narrow(f->ux),
        .uy = narrow(f->uy),
        .uz = narrow(f->uz),
        .vx = narrow(f->vx),
        .vy = narrow(f->vy),
        .vz = narrow(f->vz),
        .nx = narrow(f->nx),
        .ny = narrow(f->ny),
        .nz = narrow(f->nz),
        .bx = narrow(f->bx),
        .bc_x = narrow(f->bc_x),
        .bc_y = narrow(f->bc_y),
        .bc_half = narrow(f->bc_length) / 2,
        .ac_x = narrow(f->ac_x),
        .ac_y = narrow(f->ac_y),
        .ac_half = narrow(f->ac_length) / 2,
    };
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
INLINE lanes past_half(lanes t, lanes half) { return higher(magnitude(t), half) - half; }

/* What distances to a triangle take, each number eight times. */
struct spread_edge {
    lanes x, y, half;
};

struct spread {
    lanes ax, ay, az, ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, ab_half;
    struct spread_edge bc, ac;
};

INLINE struct spread spread(const struct flat_four *flat, size_t j) {
    const struct flat_four *f = &flat[j / FRAMES_WIDTH];
    size_t k = j % FRAMES_WIDTH;
    return (struct spread){
        .ax = all(f->ax[k]),
        .ay = all(f->ay[k]),
        .az = all(f->az[k]),
        .ux = all(f->ux[k]),
        .uy = all(f->uy[k]),
        .uz = all(f->uz[k]),
        .vx = all(f->vx[k]),
        .vy = all(f->vy[k]),
        .vz = all(f->vz[k]),
        .nx = all(f->nx[k]),
        .ny = all(f->ny[k]),
        .nz = all(f->nz[k]),
        .bx = all(f->bx[k]),
        .ab_half = all(f->bx[k] / 2),
        .bc = {all(f->bc_x[k]), all(f->bc_y[k]), all(f->bc_half[k])},
        .ac = {all(f->ac_x[k]), all(f->ac_y[k]), all(f->ac_half[k])},
    };
}

INLINE lanes edge_sq(const struct spread_edge *e, lanes left, lanes x, lanes y) {
    lanes past = past_half(x * e->x + y * e->y - e->half, e->half);
    return left * left + past * past;
}

/* Squared distances of eight samples to a triangle. */
INLINE lanes distance_sq(const struct spread *f, lanes px, lanes py, lanes pz) {
    lanes rx = px - f->ax, ry = py - f->ay, rz = pz - f->az;
    lanes x = rx * f->ux + ry * f->uy + rz * f->uz, y = rx * f->vx + ry * f->vy + rz * f->vz;
    lanes z = rx * f->nx + ry * f->ny + rz * f->nz, beyond = x - f->bx;
    lanes past = past_half(x - f->ab_half, f->ab_half);
    lanes bc_left = y * f->bc.x - beyond * f->bc.y, ac_right = x * f->ac.y - y * f->ac.x;
    mask over = lower(lower(y, bc_left), ac_right) > 0;
    lanes nearest = lower(edge_sq(&f->bc, bc_left, beyond, y), edge_sq(&f->ac, ac_right, x, y));
    return z * z + where(~over, lower(y * y + past * past, nearest));
}

void cluster_clear(struct cluster *cluster, vec3 origin) {
    cluster->origin = origin;
    cluster->n = 0;
}

FOR_EACH_PROCESSOR
uint32_t cluster_add(struct cluster *cluster, const struct sample_block *block, uint32_t first) {
    size_t n = cluster->n;
    uint32_t i = first;
    for (; i != NONE && n + block[i].count <= CLUSTER_MOST; n += block[i].count, i = block[i].next) {
        vec3 shift = vec3_sub(block[i].origin, cluster->origin);
        *at(&cluster->x[n]) = load(block[i].x) + (float)shift.x;
        *at(&cluster->y[n]) = load(block[i].y) + (float)shift.y;
        *at(&cluster->z[n]) = load(block[i].z) + (float)shift.z;
        *at(&cluster->weight[n]) = load(block[i].weight);
        memcpy(&cluster->sample[n], block[i].sample, sizeof block[i].sample);
    }
    cluster->n = n;
    *at(&cluster->x[n]) = all(FAR_AWAY);
    *at(&cluster->y[n]) = all(FAR_AWAY);
    *at(&cluster->z[n]) = all(FAR_AWAY);
    *at(&cluster->weight[n]) = all(0);
    return i;
}

double cluster_weight(const struct cluster *cluster) {
    lanes sum = all(0);
    for (size_t i = 0; i < cluster->n; i += LANES) sum += load(&cluster->weight[i]);
    return total(sum);
}

INLINE size_t spread_all(const struct surface *surface, vec3 origin, struct spread out[FRAMES_MOST]) {
    struct flat_four flat[FLAT_ROOM];
    size_t first = flatten_all(surface, origin, flat);
    for (size_t j = 0; j < surface->n; j++) out[j] = spread(flat, first + j);
    return surface->n;
}

FOR_EACH_PROCESSOR
double cluster_cost(const struct cluster *cluster, const struct surface *surface, float further, double limit) {
    struct spread triangle[FRAMES_MOST];
    lanes sum = all(0);
    size_t n = spread_all(surface, cluster->origin, triangle);
    for (size_t i = 0; i < cluster->n; i += LANES) {
        lanes x = load(&cluster->x[i]), y = load(&cluster->y[i]), z = load(&cluster->z[i]), d_sq = all(INFINITY);
        for (size_t j = 0; j < n; j++) d_sq = lower(distance_sq(&triangle[j], x, y, z), d_sq);
        sum += load(&cluster->weight[i]) * (root(d_sq) + d_sq * further);
        if (total(sum) > limit) break;
    }
    return total(sum);
}

/* What distances to a triangle of a star take, each number eight times. */
struct sector {
    lanes ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, ab_half, ac_x, ac_y;
    struct spread_edge bc;
};

INLINE void spread_star(const struct star_frames *star, struct sector sector[STAR_MOST]) {
    for (size_t j = 0; j < star->n; j++)
        sector[j] = (struct sector){
            .ux = all(star->u.x[j]),
            .uy = all(star->u.y[j]),
            .uz = all(star->u.z[j]),
            .vx = all(star->v.x[j]),
            .vy = all(star->v.y[j]),
            .vz = all(star->v.z[j]),
            .nx = all(star->normal.x[j]),
            .ny = all(star->normal.y[j]),
            .nz = all(star->normal.z[j]),
            .bx = all(star->bx[j]),
            .ab_half = all(star->bx[j] / 2),
            .ac_x = all(star->ac_x[j]),
            .ac_y = all(star->ac_y[j]),
            .bc = {all(star->bc_x[j]), all(star->bc_y[j]), all(star->bc_half[j])},
        };
}

/* Squared distances of eight samples, as seen from the vertex, to a triangle but for its last edge, which is the first
 * of the next. */
INLINE lanes sector_sq(const struct sector *f, lanes rx, lanes ry, lanes rz) {
    lanes x = rx * f->ux + ry * f->uy + rz * f->uz, y = rx * f->vx + ry * f->vy + rz * f->vz;
    lanes z = rx * f->nx + ry * f->ny + rz * f->nz, beyond = x - f->bx;
    lanes past = past_half(x - f->ab_half, f->ab_half);
    lanes bc_left = y * f->bc.x - beyond * f->bc.y, ac_right = x * f->ac_y - y * f->ac_x;
    mask over = lower(lower(y, bc_left), ac_right) > 0;
    return z * z + where(~over, lower(y * y + past * past, edge_sq(&f->bc, bc_left, beyond, y)));
}

/* Squared distances of vector i of samples to the nearest of a star's triangles. */
INLINE lanes star_sq(const struct cluster *cluster, const struct star_frames *star, const struct sector *sector,
                     size_t i) {
    lanes x = load(&cluster->x[i]) - star->ax, y = load(&cluster->y[i]) - star->ay;
    lanes z = load(&cluster->z[i]) - star->az, d_sq = all(FAR_AWAY * FAR_AWAY);
    for (size_t j = 0; j < star->n; j++) d_sq = lower(sector_sq(&sector[j], x, y, z), d_sq);
    return d_sq;
}

FOR_EACH_PROCESSOR
double cluster_star_cost(const struct cluster *cluster, const struct star_frames *star, float further, double limit) {
    struct sector sector[STAR_MOST];
    lanes sum = all(0);
    spread_star(star, sector);
    for (size_t i = 0; i < cluster->n; i += LANES) {
        lanes d_sq = star_sq(cluster, star, sector, i);
        sum += load(&cluster->weight[i]) * (root(d_sq) + d_sq * further);
        if (total(sum) > limit) break;
    }
    return total(sum);
}

FOR_EACH_PROCESSOR
void cluster_star_distances(const struct cluster *cluster, const struct star_frames *star,
                            float distance_sq[CLUSTER_ROOM]) {
    struct sector sector[STAR_MOST];
    spread_star(star, sector);
    for (size_t i = 0; i < cluster->n; i += LANES) *at(&distance_sq[i]) = star_sq(cluster, star, sector, i);
}

/* The triangles of eight samples, side by side: the members are those of struct star_frames. */
struct eight {
    lanes ux, uy, uz, vx, vy, vz, nx, ny, nz, bx, bx_inverse, bc_x, bc_y, bc_half;
    lanes cx, cy, cy_inverse, ac_x, ac_y, ac_inverse;
    mask pulls; /* triangles that aren't too thin */
};

INLINE lanes each(const float *number, mask which) { return shuffled(load(number), which); }

/* Triangle from + which[k] for sample k. */
INLINE struct eight eight_of(const struct star_frames *s, size_t from, mask which) {
    return (struct eight){
        .ux = each(&s->u.x[from], which),
        .uy = each(&s->u.y[from], which),
        .uz = each(&s->u.z[from], which),
        .vx = each(&s->v.x[from], which),
        .vy = each(&s->v.y[from], which),
        .vz = each(&s->v.z[from], which),
        .nx = each(&s->normal.x[from], which),
        .ny = each(&s->normal.y[from], which),
        .nz = each(&s->normal.z[from], which),
        .bx = each(&s->bx[from], which),
        .bx_inverse = each(&s->bx_inverse[from], which),
        .bc_x = each(&s->bc_x[from], which),
        .bc_y = each(&s->bc_y[from], which),
        .bc_half = each(&s->bc_half[from], which),
        .ac_x = each(&s->ac_x[from], which),
        .ac_y = each(&s->ac_y[from], which),
        .ac_inverse = each(&s->ac_inverse[from], which),
        .cx = each(&s->cx[from], which),
        .cy = each(&s->cy[from], which),
        .cy_inverse = each(&s->cy_inverse[from], which),
        .pulls = each(&s->shape[from], which) > THINNEST,
    };
}

/* Where samples' nearest places on their triangles are: the vertex's share in them, and what is left to the sample in
 * the triangle's own axes. */
struct feet {
    lanes share, x, y, z;
};

INLINE lanes clamped(lanes t) { return lower(positive(t), all(1)); }

INLINE struct feet feet_of(const struct eight *f, lanes rx, lanes ry, lanes rz) {
    lanes x = rx * f->ux + ry * f->uy + rz * f->uz, y = rx * f->vx + ry * f->vy + rz * f->vz;
    lanes z = rx * f->nx + ry * f->ny + rz * f->nz, beyond = x - f->bx;
    lanes bc_left = y * f->bc_x - beyond * f->bc_y;
    lanes bc_past = past_half(beyond * f->bc_x + y * f->bc_y - f->bc_half, f->bc_half);
    mask over = lower(lower(y, bc_left), x * f->ac_y - y * f->ac_x) > 0;
    lanes share_c = y * f->cy_inverse, share = 1 - share_c - (x - f->cx * share_c) * f->bx_inverse;
    lanes t = clamped(x * f->bx_inverse);
    lanes dx = x - t * f->bx, dy = y, best_sq = dx * dx + dy * dy, best = 1 - t;
    t = clamped((x * f->ac_x + y * f->ac_y) * f->ac_inverse);
    lanes ex = x - t * f->cx, ey = y - t * f->cy, other_sq = ex * ex + ey * ey;
    mask nearer = other_sq < best_sq;
    dx = pick(nearer, ex, dx), dy = pick(nearer, ey, dy), best = pick(nearer, 1 - t, best);
    best = where(~(bc_left * bc_left + bc_past * bc_past < lower(other_sq, best_sq)), best);
    return (struct feet){pick(over, share, best), where(~over, dx), where(~over, dy), z};
}

/* A model in the making, eight samples side by side. */
struct sums {
    lanes xx, xy, xz, yy, yz, zz, gx, gy, gz;
};

struct lengths {
    float near, further;
};

/* Adds eight samples as far as they count.  Directions are turned into the axes of space before they are added up, so
 * that there are only nine sums for all triangles. */
INLINE void fit_eight(const struct eight *f, struct feet r, lanes weight, struct lengths by, struct sums *s) {
    lanes d = root(r.x * r.x + r.y * r.y + r.z * r.z);
    mask counts = f->pulls & (r.share > 0), off = d > 1e-9f;
    lanes pull = weight * r.share * (1 + 2 * by.further * d) / higher(d, all(by.near));
    lanes inverse = 1 / pick(off, d, all(1)), stiff = where(counts, pull * r.share), far = where(counts, pull * d);
    lanes x = where(off, r.x * inverse), y = where(off, r.y * inverse), z = pick(off, r.z * inverse, all(1));
    lanes nx = where(counts, x * f->ux + y * f->vx + z * f->nx), ny = where(counts, x * f->uy + y * f->vy + z * f->ny);
    lanes nz = where(counts, x * f->uz + y * f->vz + z * f->nz), sx = stiff * nx, sy = stiff * ny, sz = stiff * nz;
    s->xx += sx * nx, s->xy += sx * ny, s->xz += sx * nz;
    s->yy += sy * ny, s->yz += sy * nz, s->zz += sz * nz;
    s->gx += far * nx, s->gy += far * ny, s->gz += far * nz;
}

/* Adds the samples of up to eight triangles, which follow each other. */
INLINE void fit_triangles(const struct cluster *cluster, const size_t *begin, const struct star_frames *star,
                          struct span in, struct lengths by, struct sums *s) {
    const mask lane = {0, 1, 2, 3, 4, 5, 6, 7};
    for (size_t i = begin[in.begin]; i < begin[in.end]; i += LANES) {
        mask which = {0}, valid = lane < (int32_t)(begin[in.end] - i);
        for (size_t k = in.begin + 1; k < in.end; k++) which -= lane >= (int32_t)begin[k] - (int32_t)i;
        struct eight f = eight_of(star, in.begin, which);
        struct feet feet = feet_of(&f, load(&cluster->x[i]) - star->ax, load(&cluster->y[i]) - star->ay,
                                   load(&cluster->z[i]) - star->az);
        fit_eight(&f, feet, where(valid, load(&cluster->weight[i])), by, s);
    }
}

FOR_EACH_PROCESSOR
void cluster_fit(const struct cluster *cluster, const size_t *begin, const struct star_frames *star, float near,
                 float further, struct cluster_model *model) {
    struct sums s = {0};
    for (size_t k = 0; k < star->n; k += LANES) {
        struct span in = {k, k + LANES < star->n ? k + LANES : star->n};
        fit_triangles(cluster, begin, star, in, (struct lengths){near, further}, &s);
    }
    sym3 a = {total(s.xx), total(s.xy), total(s.xz), total(s.yy), total(s.yz), total(s.zz)};
    model->a = sym3_add(model->a, a);
    model->g = vec3_add(model->g, (vec3){total(s.gx), total(s.gy), total(s.gz)});
}

FOR_EACH_PROCESSOR
void cluster_values(const struct cluster *cluster, const sym3 *a, vec3 place, size_t points,
                    float value[CLUSTER_ROOM]) {
    vec3 p = vec3_sub(place, cluster->origin);
    float xx = (float)a->xx, xy = (float)a->xy, xz = (float)a->xz, yy = (float)a->yy, yz = (float)a->yz;
    float zz = (float)a->zz;
    for (size_t i = 0; i < cluster->n; i += LANES) {
        lanes x = load(&cluster->x[i]) - (float)p.x, y = load(&cluster->y[i]) - (float)p.y;
        lanes z = load(&cluster->z[i]) - (float)p.z;
        lanes sum = x * (x * xx + y * (2 * xy) + z * (2 * xz)) + y * (y * yy + z * (2 * yz)) + z * z * zz;
        mask id;
        memcpy(&id, &cluster->sample[i], sizeof id);
        *at(&value[i]) = pick((id >= 0) & (id < (int32_t)points), sum, all(INFINITY));
    }
}

FOR_EACH_PROCESSOR
void cluster_owners(const struct cluster *cluster, const struct surface *surface, uint8_t owner[CLUSTER_ROOM],
                    float distance_sq_out[CLUSTER_ROOM]) {
    mask nearest[CLUSTER_ROOM / LANES];
    struct flat_four flat[FLAT_ROOM];
    size_t vectors = (cluster->n + LANES - 1) / LANES, first = flatten_all(surface, cluster->origin, flat);
    for (size_t k = 0; k < vectors; k++) *at(&distance_sq_out[k * LANES]) = all(INFINITY), nearest[k] = (mask){0};
    for (size_t j = 0; j < surface->n; j++) {
        const struct spread f = spread(flat, first + j);
        mask id = (mask){0} + (int32_t)j;
        for (size_t k = 0; k < vectors; k++) {
            size_t i = k * LANES;
            lanes before = load(&distance_sq_out[i]);
            lanes d_sq = distance_sq(&f, load(&cluster->x[i]), load(&cluster->y[i]), load(&cluster->z[i]));
            mask nearer = d_sq < before;
            *at(&distance_sq_out[i]) = pick(nearer, d_sq, before);
            nearest[k] = (nearer & id) | (~nearer & nearest[k]);
        }
    }
    for (size_t i = 0; i < cluster->n; i++) owner[i] = (uint8_t)nearest[i / LANES][i % LANES];
}

/* The lowest of the eight, eight times. */
INLINE lanes least(lanes x) {
    x = lower(x, shuffled(x, (mask){4, 5, 6, 7, 0, 1, 2, 3}));
    x = lower(x, shuffled(x, (mask){2, 3, 0, 1, 6, 7, 4, 5}));
    return lower(x, shuffled(x, (mask){1, 0, 3, 2, 5, 4, 7, 6}));
}

FOR_EACH_PROCESSOR
void cluster_nearest(const struct cluster *cluster, vec3 place, double *nearest_sq, uint32_t *nearest) {
    vec3 p = vec3_sub(place, cluster->origin);
    lanes best_sq = all(INFINITY);
    mask best = {0}, id = {0, 1, 2, 3, 4, 5, 6, 7};
    for (size_t i = 0; i < cluster->n; i += LANES, id += LANES) {
        lanes dx = load(&cluster->x[i]) - (float)p.x, dy = load(&cluster->y[i]) - (float)p.y;
        lanes dz = load(&cluster->z[i]) - (float)p.z;
        lanes d_sq = dx * dx + dy * dy + dz * dz;
        mask nearer = d_sq < best_sq;
        best_sq = lower(d_sq, best_sq);
        best = (nearer & id) | (~nearer & best);
    }
    lanes least_sq = least(best_sq);
    lanes lane = least(pick(best_sq == least_sq, (lanes){0, 1, 2, 3, 4, 5, 6, 7}, all(LANES - 1)));
    size_t which = (size_t)best[(int)lane[0]];
    if ((double)least_sq[0] < *nearest_sq && which < cluster->n)
        *nearest_sq = (double)least_sq[0], *nearest = cluster->sample[which];
}
