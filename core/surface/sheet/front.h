/* The surface that an advancing front finds through points: sheets with borders, or closed ones.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_FRONT_H
#define WHITTLE_CORE_SURFACE_SHEET_FRONT_H

#include "core/base/progress.h"
#include "core/surface/tets.h"

/* Fills *triangle (the caller's afterwards, to be freed) with *count facets of the tetrahedra (dimension 3, of the n
 * points; both borrowed).  They are a manifold with borders: each edge has one triangle, or two in opposite directions,
 * and the triangles at a vertex are one fan.  Which way a component turns is arbitrary.  Points may be left out.
 *
 * The same for any number of threads.  O(cells log cells).  STATUS_NO_MEMORY, STATUS_LIMIT (2^30 cells),
 * STATUS_CANCELLED (stage "front"). */
enum status sheet_front(const struct tets *tets, const vec3 *point, size_t n, unsigned threads,
                        const struct progress *progress, uint32_t (**triangle)[3], size_t *count) MUST_CHECK;

#endif
