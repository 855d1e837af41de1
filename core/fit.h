/* A mesh that is being fitted to dense points: what all refining operations share.
 *
 * Every sample (a dense point, or a place between three) belongs to one triangle, the nearest as far as is known: each
 * operation that changes triangles hands the samples of these triangles out among them again, and looks no further.
 *
 * What is made small is the sum over the samples of  weight * (d + d^2 / far):  the mean distance, with large distances
 * counted more, so that the largest falls as well.  A sample's weight is the area that it stands for.
 *
 * Invariant: cost[t] is the sum over the samples of triangle t's list, facing[t] is the triangle's as it is, and each
 * sample is in exactly one list.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_FIT_H
#define WHITTLE_CORE_FIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/cluster.h"
#include "core/fit_zones.h"
#include "core/halfedge.h"
#include "core/mesh.h"
#include "core/params.h"
#include "core/refine.h"
#include "core/sample_lists.h"
#include "core/samples.h"
#include "core/star_frames.h"
#include "core/triangle_frames.h"

/* Multiples of the mean distance at the beginning: */
#define FIT_FAR 2.0    /* distances over this count by their square */
#define FIT_NEAR 0.4   /* distances under this count no more than others where a vertex is placed */
#define FIT_STRAY 7.0  /* no part of the surface gets farther from the data, where it isn't already */
#define FIT_ENOUGH 40  /* points for each triangle that make middles needless */
#define FIT_CLOSE 16   /* points for each triangle that make a closer look needless */
#define FIT_EXACT 1e-7 /* distance that is none */
#define FIT_THIN 0.02  /* shape below which no triangle may get thinner */

enum { FIT_MAX_RING = 32 };

/* What neighbours want to know of a triangle. */
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
    double stray_sq; /* how far from the data any part of the surface may get, squared */
    double far, near;
    double unit_area; /* of the surface at the beginning, for each unit of the samples' weight */
    struct samples samples;
    struct sample_lists lists; /* of each triangle */
    struct fit_zones zones;
    double *cost;          /* triangle_count */
    struct facing *facing; /* triangle_count */
    uint8_t *taken;        /* input->n: how many vertices stand there, up to 255 */
    uint8_t *stale;        /* vertex_count: its star has changed since it was last tried */
    uint8_t *touched;      /* triangle_count: 1, it has changed since its edges were last tried; more in fit_flip.c */
    uint8_t *postponed;    /* triangle_count: all 0 between passes */
};

enum status fit_init(struct fit *fit, struct mesh *mesh, const struct refine_input *input,
                     const struct refine_options *options) MUST_CHECK;
void fit_done(struct fit *fit);

/* Where there are few points for each triangle, takes the middles of quarters of the triangles between the points in
 * place of their own, and looks for the nearest triangles of the mesh anew.  Lengths to go by stay what they were.
 * STATUS_NO_MEMORY: then the fit is only to be done with. */
enum status fit_look_closer(struct fit *fit) MUST_CHECK;

/* A vertex comes to stand at a point, or leaves it (NONE: at no point). */
void fit_take(struct fit *fit, uint32_t point);
void fit_leave(struct fit *fit, uint32_t point);

/* What a sample at this squared distance costs, for weight 1. */
static inline double fit_cost_of(const struct fit *fit, double distance_sq) {
    return sqrt(distance_sq) + distance_sq / fit->far;
}

static inline vec3 fit_corner(const struct fit *fit, uint32_t h) {
    return fit->mesh->vertex[halfedge_from(&fit->he, h)];
}

/* Whether two neighbouring triangles may turn against each other so that the cosine of their normals goes from before
 * to after: up to 90 degrees, or where it was more already (a sharp edge), no further. */
static inline bool fit_fold_is_fair(double before, double after) { return after >= 0 || after >= before; }

static inline struct facing fit_facing_of(const struct surface *surface, size_t i) {
    return (struct facing){surface_normal(surface, i), surface_shape(surface, i)};
}

/* Whether a triangle may take the place of another as far as its shape goes: not thinner than it may be, nor than it
 * was. */
static inline bool fit_shape_is_fair(double before, double after) { return after >= FIT_THIN || after >= before; }

/* The frames of n (1 .. FRAMES_MOST) triangles as they are. */
struct surface fit_frames(const struct fit *fit, const uint32_t *triangle, size_t n, struct triangle_frames *frames);
vec3 fit_middle(const struct fit *fit, uint32_t triangle);

/* The samples in the lists of a few triangles. */
struct fit_region {
    size_t n;
    uint32_t triangle[FIT_MAX_RING];
    size_t begin[FIT_MAX_RING + 1]; /* where each triangle's samples begin in the cluster */
    size_t reached; /* list that the cluster ends in, and where; reached == n: all samples are in the cluster */
    uint32_t rest;
    struct cluster cluster;
};

/* The samples of a region, as many at a time as a cluster holds: part is the region itself at first, and more, which
 * takes turns, after that.  NULL when there are none left. */
const struct fit_region *fit_next_part(const struct fit *fit, const struct fit_region *part, struct fit_region *more);

/* Gathers the samples of region->triangle[0 .. n). */
void fit_gather(const struct fit *fit, struct fit_region *region);

/* Whether samples of this weight cost so little that it is rounding. */
static inline bool fit_is_exact(double weight, double cost) { return !(cost > FIT_EXACT * weight); }

/* The quadric of a vertex whose star the region is. */
struct cluster_model fit_model(const struct fit *fit, const struct fit_region *region, const struct star_frames *star,
                               double near);

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
double fit_stray_sq(const struct fit *fit, const struct fit_place *place, size_t n);

/* Whether the surface strays no farther from the data than anything may, or than the region's triangles do now. */
bool fit_stays(const struct fit *fit, const struct fit_region *region, const struct surface *surface);

/* The same of a surface whose triangles have the middles middle[0 .. n). */
bool fit_middles_stay(const struct fit *fit, const struct fit_region *region, const vec3 *middle, size_t n);

/* Hands the samples in the lists of from[0 .. n) out to the nearest of the triangles to[0 .. m) as they are now, and
 * sets the costs of both, and how the latter face.  n, m <= FIT_MAX_RING.  Triangles of its own for each thread. */
void fit_share(struct fit *fit, const uint32_t *from, size_t n, const uint32_t *to, size_t m);

/* Mean distance of the samples to the triangles that they belong to, by weight. */
double fit_mean(const struct fit *fit);

#endif
