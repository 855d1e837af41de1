/* The Delaunay tetrahedralisation of points in space, by CGAL, as flat arrays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_DELAUNAY_CGAL_H
#define WHITTLE_CORE_SURFACE_DELAUNAY_CGAL_H

#include <math.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/surface/tets.h"

/* Triangulates the n points (borrowed; finite, distinct, in coordinates of about [-0.5, 0.5]) and fills *tets, which
 * is the caller's afterwards.  Vertex ids are indices into points.  Of points that coincide one alone is in the
 * triangulation.
 *
 * Dimension 3: all cells, finite ones first, each group in ascending order of its sorted vertex ids; within a cell the
 * vertices ascend but for the last two, which give the orientation (NONE counts as the largest id).  So equal points
 * in equal order give equal arrays, whatever the order of insertion or the number of threads (0 = all processors).
 * Cospherical points are triangulated as CGAL's symbolic perturbation says.  Circumcentres are finite numbers always:
 * of a cell so flat that its own can't be represented it is that of its largest facet. Dimension 2 (all points on one
 * plane): planar holds the planar Delaunay triangles, all turning the same way. Dimension 1 and less: nothing but the
 * dimension.
 *
 * It is fastest along a space-filling curve.  n at most 2^28.  STATUS_LIMIT over that, STATUS_NO_MEMORY,
 * STATUS_CANCELLED (stage "delaunay"), STATUS_ENGINE when CGAL throws; error (may be NULL) then says why and *tets is
 * untouched.  Expected O(n log n): 50 000 points of a surface in about 0.3 s and 0.1 kB for each cell, of which there
 * are about 7 for each point. */
enum status delaunay_build(const vec3 *points, size_t n, unsigned threads, const struct progress *progress,
                           struct tets *tets, struct error *error)
#ifdef __cplusplus
    noexcept
#endif
    MUST_CHECK;

/* The same with at most so many cells: points along curves may have as many as the square of their number.
 * STATUS_LIMIT as soon as there are more. */
enum status delaunay_build_within(const vec3 *points, size_t n, size_t most_cells, unsigned threads,
                                  const struct progress *progress, struct tets *tets, struct error *error)
#ifdef __cplusplus
    noexcept
#endif
    MUST_CHECK;

/* The Delaunay triangles of points on the plane z = 0, counter-clockwise seen from above: each with its smallest id
 * first, in ascending order.  Of points that coincide one alone has triangles; what lies on one line has none.
 * *triangle is new.  n, statuses and error as above. */
enum status delaunay_in_plane(const vec3 *feet, size_t n, unsigned threads, const struct progress *progress,
                              uint32_t (**triangle)[3], size_t *count, struct error *error)
#ifdef __cplusplus
    noexcept
#endif
    MUST_CHECK;

#ifdef __cplusplus
}
#endif

#endif
