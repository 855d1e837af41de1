/* How much of a mesh's area no input point speaks for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MEASURE_SUPPORT_H
#define WHITTLE_CORE_MEASURE_SUPPORT_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/mesh/mesh.h"
#include "core/spatial/knn.h"

/* The points that a mesh was made from.  All borrowed. */
struct support_points {
    const vec3 *point;
    const float *spacing;    /* of each: mean distance to its neighbours */
    const struct knn *knn;   /* over them */
    const uint32_t *nearest; /* of each: the triangle of the mesh that is nearest to it */
};

/* Farther than SUPPORT_REACH times the local spacing of points from all of them, a place of the mesh is unsupported. */
#define SUPPORT_REACH 3

/* *share = the part of the mesh's area, 0 to 1, that is unsupported, estimated from samples to within about 0.005.
 * Points count where they project to: the nearest place of the mesh to each, on a triangle that faces the same way.  So
 * a mesh that is far from its points isn't unsupported for that, and the back of a sheet is.  About 2 us for each of
 * 20 000 samples.  The same for any number of threads.  STATUS_NO_MEMORY. */
enum status support_missing(const struct mesh *mesh, const struct support_points *points, uint64_t seed,
                            unsigned threads, double *share) MUST_CHECK;

#endif
