/* From candidate facets to a surface, by the literal rules: local Delaunay triangles, pruning, the walk.  Part of Tight
 * Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_UMBRELLA_H
#define WHITTLE_CORE_SURFACE_COCONE_UMBRELLA_H

#include "core/surface/cocone/facets.h"

/* Deletes facets until the ones alive are a surface where the sampling is good; good[v] = 1 for the points that have an
 * umbrella: their facets form one closed cycle.  O(facets).  STATUS_NO_MEMORY. */
enum status cocone_umbrella_choose(const struct cocone_star *star, struct cocone_facets *facets,
                                   uint8_t *good) MUST_CHECK;

#endif
