/* How far a mesh is from what it stands for: mean, root mean square and largest distance, in each direction.
 *
 * Cignoni, Rocchini, Scopigno: Metro: measuring error on simplified surfaces (1998).  The distance from a point to a
 * surface is to its nearest point; the one-sided distance of a surface is measured over samples of it.  Everything is
 * in the units of the coordinates, whatever they are.  The results are the same for any number of threads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_METRO_H
#define WHITTLE_CORE_MEASURE_METRO_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/measure/distance_sum.h"
#include "core/mesh/mesh.h"
#include "core/report.h"
#include "core/spatial/bvh.h"
#include "core/spatial/knn.h"

/* Zero-initialised: the defaults. */
struct metro_options {
    uint64_t samples; /* of each surface; 0 = the larger of METRO_MIN_SAMPLES and ten for each of the mesh's triangles,
                         four for each of the reference's */
    uint64_t seed;    /* of where they lie */
    unsigned threads; /* 0 = all processors */
    const struct progress *progress; /* stage "measure"; may be NULL */
    uint32_t *nearest;  /* to be filled: of each point the triangle of the mesh nearest to it; may be NULL */
    size_t most_visits; /* of nodes of a hierarchy for each sample, in the mean of some; 0 = no matter how many.  Where
                           they are many, yet below it, fewer samples are taken */
};

enum { METRO_MIN_SAMPLES = 100000 };

/* What a mesh stands for: points, the surface that they lie on where one is known, or both.  All borrowed. */
struct metro_reference {
    size_t point_count; /* may be 0 */
    const vec3 *point;
    const vec3 *normal;         /* of each point, unit length, any sign; NULL = not known */
    const float *spacing;       /* of each point, mean distance to its neighbours; NULL with normal */
    const struct knn *knn;      /* over the points; NULL with normal */
    const struct mesh *surface; /* may be NULL */
};

struct metro_errors {
    struct distance_stats forward;  /* every reference point to the mesh: exact */
    struct distance_stats backward; /* area-uniform samples of the mesh to the reference surface; without one, to the
                                       points' tangent disks; without normals, count 0 */
    struct distance_stats surface; /* area-uniform samples of the reference surface to the mesh; without one, count 0 */
    double hausdorff;              /* largest of the maxima */
};

/* Measures the mesh (at least one triangle) in all directions that the reference allows.  Means are over the samples,
 * maxima over the whole surface: to a surface within LARGEST_SLACK (core/measure/largest.h) of the true one.  A tangent
 * disk is what a point says of the surface around it: with q the point nearest to x, the distance is |(x - q) . n_q|
 * where |x - q| <= 2 spacing_q, else |x - q|, and over 64 spacings away that to within 1.6 %.  About 0.5 us for each
 * sample to a surface and 1 us to points. STATUS_DEGENERATE: a surface without triangles; STATUS_LIMIT, before anything
 * is measured: samples take more than most_visits, as between faces that lie all across each other; STATUS_NO_MEMORY,
 * STATUS_CANCELLED. */
enum status metro_measure(const struct mesh *mesh, const struct metro_reference *reference,
                          const struct metro_options *options, struct metro_errors *errors) MUST_CHECK;

/* One direction alone: every one of n points to the mesh (at least one triangle).  Statuses as above. */
enum status metro_points(const vec3 *point, size_t n, const struct mesh *mesh, const struct metro_options *options,
                         struct distance_stats *stats) MUST_CHECK;

/* The same direction in parts, for points that aren't all in memory: the distances of n more of them to the mesh of the
 * hierarchy are added to *sum, which is then the same for the same parts.  STATUS_NO_MEMORY. */
enum status metro_add_points(const struct bvh *bvh, const vec3 *point, size_t n, unsigned threads,
                             struct distance_sum *sum) MUST_CHECK;

/* Two sets of n[0] and n[1] points (each at least one): forward from every point of the second to the nearest of the
 * first, backward the other way round; surface isn't measured.  Statuses as above. */
enum status metro_clouds(const vec3 *const point[2], const size_t n[2], const struct metro_options *options,
                         struct metro_errors *errors) MUST_CHECK;

/* Figures that compare with those that the program Metro prints: forward from samples of the original to the mesh,
 * backward from samples of the mesh to the original; surface isn't measured.  Samples are vertices, edges and faces as
 * sampler_metro has them, about options->samples of each of the two (0 = ten for each triangle of the larger one).
 * Vertices that lie on the other surface count like any other sample, so the means are lower than those of
 * metro_measure.  *diagonal is what Metro divides by: that of the box of both, grown by 2 % of its own diagonal on
 * every side.  The seed isn't used.  Statuses as above. */
enum status metro_compatible(const struct mesh *mesh, const struct mesh *original, const struct metro_options *options,
                             struct metro_errors *errors, double *diagonal) MUST_CHECK;

/* The diagonal of the bounding box of n points; 0 for none. */
double metro_diagonal(const vec3 *point, size_t n);

#endif
