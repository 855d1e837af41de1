/* A mesh that is being fitted to dense points: what all refining operations share.
 *
 * Every sample (an original point, or the middle of a triangle between three neighbours) belongs to one triangle of the
 * mesh, the nearest as far as is known: each operation that changes triangles hands the samples of these triangles out
 * among them again, and looks no further.
 *
 * What is made small is the sum over the samples of  weight * (d + d^2 / far):  the mean distance, with large distances
 * counted more, so that the largest falls as well.  A sample's weight is the area that it stands for.
 *
 * Invariant, between passes: cost[t] is the sum over the samples of triangle t's list, facing[t] is the triangle's as
 * it is, and each sample is in exactly one list.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_FIT_H
#define WHITTLE_CORE_REFINE_FIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/mesh/halfedge.h"
#include "core/mesh/mesh.h"
#include "core/params.h"
#include "core/refine/kernels/sample_batch.h"
#include "core/refine/kernels/star_frames.h"
#include "core/refine/kernels/triangle_frames.h"
#include "core/refine/partition.h"
#include "core/refine/refine.h"
#include "core/refine/sample_buckets.h"
#include "core/refine/samples.h"

/* Multiples of the mean distance at the beginning: */
#define FIT_FAR 2.0       /* at this distance its square counts as much as the distance */
#define FIT_NEAR 0.4      /* distances under this count no more than others where a vertex is placed */
#define FIT_DEVIATION 7.0 /* no part of the surface gets farther from the data, where it isn't already */
#define FIT_ENOUGH 40     /* points for each triangle that make middles needless */
#define FIT_CLOSE 16      /* points for each triangle that make a closer look needless */
#define FIT_EXACT 1e-7    /* distance that is none */
#define FIT_FOLD (-0.3)   /* cosine between the normals of neighbours where the surface has creases, at least */
#define FIT_UPRIGHT 5e-4  /* cosine between a triangle of a height field and the way up, at least */
#define FIT_THIN 0.02     /* shape below which no triangle may get thinner */

enum { FIT_MAX_RING = 32 };

/* Of a triangle, for comparisons with its neighbours. */
struct facing {
    vec3 normal;
    double shape;
};

struct fit {
    struct mesh *mesh;
    struct halfedge he;
    const struct refine_input *input;
    enum placement placement;
    unsigned threads;
    bool has_up, has_front; /* has_front: triangles keep facing up or to the view */
    bool is_new;            /* nothing has changed yet */
    bool leaps;             /* a split that gains much may fold the surface sharply */
    double fold;            /* smallest cosine between the normals of neighbours: less where the surface has creases */
    double deviation_sq;    /* how far from the data any part of the surface may get, squared */
    double far, near;
    double unit_area; /* of the surface at the beginning, for each unit of the samples' weight */
    struct samples samples;
    struct sample_buckets lists; /* of each triangle */
    struct fit_partition partition;
    size_t borders;        /* edges on borders at the beginning */
    size_t room;           /* triangles that there is memory for: more than there are where there is a border */
    double *cost;          /* room */
    struct facing *facing; /* room */
    uint8_t *taken;        /* input->n: how many vertices stand there, up to 255 */
    uint8_t *stale;        /* vertex_count: its star has changed since it was last tried */
    uint8_t *touched;      /* room: 1, it has changed since its edges were last tried; see flip.c */
    uint8_t *postponed;    /* room: all 0 between passes */
};

enum status fit_init(struct fit *fit, struct mesh *mesh, const struct refine_input *input,
                     const struct refine_options *options) MUST_CHECK;
void fit_done(struct fit *fit);

/* Whether there are so few points for each triangle that more samples tell more. */
bool fit_may_look_closer(const struct fit *fit);

/* Takes the middles of quarters of the triangles between the points in place of their own, and looks for the nearest
 * triangles of the mesh anew.  Lengths to go by stay what they were.  STATUS_NO_MEMORY: then the fit is only to be done
 * with. */
enum status fit_look_closer(struct fit *fit) MUST_CHECK;

/* Looks for the nearest triangle of each sample anew.  STATUS_NO_MEMORY: then the fit is only to be done with. */
enum status fit_reassign(struct fit *fit) MUST_CHECK;

/* Removes this triangle, which has no samples any more; the last one gets its number. */
void fit_drop_triangle(struct fit *fit, uint32_t triangle);

/* A vertex comes to stand at a point, or leaves it (NONE: at no point). */
void fit_take(struct fit *fit, uint32_t point);
void fit_leave(struct fit *fit, uint32_t point);

/* What a sample at this squared distance costs, for weight 1. */
static inline double fit_cost_of(const struct fit *fit, double distance_sq) {
    return sqrt(distance_sq) + distance_sq / fit->far;
}

static inline bool fit_is_on_border(const struct fit *fit, uint32_t vertex) {
    return fit->he.locked[vertex] == HALFEDGE_BORDER;
}

/* The half-edges out of a vertex (halfedge_ring), whose neighbours are FIT_MAX_RING at most; their number. */
static inline size_t fit_ring(const struct fit *fit, uint32_t vertex, uint32_t ring[FIT_MAX_RING]) {
    return halfedge_ring(&fit->he, vertex, ring, (size_t)FIT_MAX_RING - fit_is_on_border(fit, vertex));
}

/* Neighbour i of the vertex of a ring, which has one more than triangles on a border. */
static inline uint32_t fit_rim_vertex(const struct fit *fit, const uint32_t *ring, size_t n, size_t i) {
    return i < n ? halfedge_to(&fit->he, ring[i]) : halfedge_apex(&fit->he, ring[n - 1]);
}

static inline vec3 fit_corner(const struct fit *fit, uint32_t h) {
    return fit->mesh->vertex[halfedge_from(&fit->he, h)];
}

/* Whether two neighbouring triangles may turn against each other so that the cosine of their normals goes from before
 * to after: up to 90 degrees, or 107 where the surface has creases, or where it was more already, no further. */
static inline bool fit_fold_is_fair(const struct fit *fit, double before, double after) {
    return fit->has_up || after >= fit->fold || after >= before;
}

/* Cosine of the angle by which a triangle may turn at most; no bound for a height field's. */
static inline double fit_least_turn(const struct fit *fit, double least) { return fit->has_up ? -1 : least; }

/* The limits of a star's change, with what this surface allows of turning, folding and steepness. */
static inline struct star_limits fit_limits(const struct fit *fit, struct star_limits limits) {
    limits.turn = (float)fit_least_turn(fit, (double)limits.turn);
    limits.fold = (float)fit->fold;
    limits.steep = fit->has_up;
    return limits;
}

static inline struct facing fit_facing_of(const struct surface *surface, size_t i) {
    return (struct facing){surface_normal(surface, i), surface_shape(surface, i)};
}

/* Whether a triangle may take the place of another as far as its shape goes: not thinner than it may be, nor than it
 * was. */
static inline bool fit_shape_is_fair(double before, double after) { return after >= FIT_THIN || after >= before; }

/* Whether a triangle that contains a place may face this way. */
static inline bool fit_faces_front(const struct fit *fit, vec3 normal, vec3 place) {
    if (!fit->has_front) return true;
    if (fit->has_up) return vec3_dot(normal, fit->input->up) > FIT_UPRIGHT;
    return vec3_dot(normal, vec3_sub(fit->input->view, place)) > 0;
}

/* The same of a star around a place. */
static inline bool fit_star_faces_front(const struct fit *fit, const struct star_frames *star, vec3 place) {
    for (size_t i = 0; fit->has_front && i < star->n; i++)
        if (!fit_faces_front(fit, star_vectors_at(&star->normal, i), place)) return false;
    return true;
}

/* The frames of n (1 .. FRAMES_MOST) triangles as they are. */
struct surface fit_frames(const struct fit *fit, const uint32_t *triangle, size_t n, struct triangle_frames *frames);
vec3 fit_middle(const struct fit *fit, uint32_t triangle);

/* The samples in the lists of a few triangles. */
struct fit_region {
    size_t n;
    uint32_t triangle[FIT_MAX_RING];
    size_t begin[FIT_MAX_RING + 1]; /* where each triangle's samples begin in the batch */
    size_t reached; /* list that the batch ends in, and where; reached == n: all samples are in the batch */
    uint32_t rest;
    struct sample_batch batch;
};

/* The samples of a region, as many at a time as a batch holds: part is the region itself at first, and more, which
 * takes turns, after that.  NULL when there are none left. */
const struct fit_region *fit_next_part(const struct fit *fit, const struct fit_region *part, struct fit_region *more);

/* Gathers the samples of region->triangle[0 .. n). */
void fit_gather(const struct fit *fit, struct fit_region *region);

/* Whether samples of this weight cost so little that it is rounding. */
static inline bool fit_is_exact(double weight, double cost) { return !(cost > FIT_EXACT * weight); }

/* The quadric of a vertex whose star the region is. */
struct sample_batch_model fit_model(const struct fit *fit, const struct fit_region *region,
                                    const struct star_frames *star, double near);

/* What the region's samples would cost with the surface, or something over limit where that does. */
double fit_cost_with(const struct fit *fit, const struct fit_region *region, const struct surface *surface,
                     double limit);
double fit_star_cost(const struct fit *fit, const struct fit_region *region, const struct star_frames *star,
                     double limit);

/* A place on a surface, and the nearest of a region's samples, or NONE where there are none. */
struct fit_place {
    vec3 at;
    double nearest_sq;
    uint32_t nearest;
};

/* Finds the nearest samples of place[0 .. n).  What is known of them is on its way from memory then. */
void fit_find_nearest(const struct fit *fit, const struct fit_region *region, struct fit_place *place, size_t n);

/* The largest squared distance of the places, middles of triangles, to the tangent disks of their nearest samples: so
 * that no part of the surface leaves the data. */
double fit_deviation_sq(const struct fit *fit, const struct fit_place *place, size_t n);

/* Whether the surface strays no farther from the data than anything may, or than the region's triangles do now. */
bool fit_stays(const struct fit *fit, const struct fit_region *region, const struct surface *surface);

/* The same of a surface whose triangles have the middles middle[0 .. n). */
bool fit_middles_stay(const struct fit *fit, const struct fit_region *region, const vec3 *middle, size_t n);

/* Whether no triangle of a vertex's star strays farther than anything may, or than it does now, when its middle becomes
 * middle[k], and neither does the vertex, which is put from one place to another: middles alone let it go three times
 * as far.  Where a triangle spans what has no samples, like the flat end of a solid that stood on a table, only this
 * keeps a vertex of it from wandering off, move by move behind the farthest of its star.  Surfaces with borders need
 * it less, and walls of a height field couldn't form. */
bool fit_star_stays(const struct fit *fit, const struct fit_region *region, const vec3 *middle, vec3 from, vec3 to);

/* Hands the samples in the lists of from[0 .. n) out to the nearest of the triangles to[0 .. m) as they are now, and
 * sets the costs of both, and how the latter face.  n, m <= FIT_MAX_RING.  Triangles of its own for each thread. */
void fit_share(struct fit *fit, const uint32_t *from, size_t n, const uint32_t *to, size_t m);

/* Mean distance of the samples to the triangles that they belong to, by weight. */
double fit_mean(const struct fit *fit);

#endif
