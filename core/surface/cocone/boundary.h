/* The facets between inner and outer cells.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_BOUNDARY_H
#define WHITTLE_CORE_SURFACE_COCONE_BOUNDARY_H

#include "core/surface/cocone/star.h"

/* Whether a half facet is that of an inner cell beside an outer one.  inside: 1 or 0 of each cell, 0 of infinite ones.
 */
static inline bool cocone_boundary_has(const struct cocone_star *star, const uint8_t *inside, uint32_t half) {
    uint32_t cell = cocone_star_cell(half);
    return inside[cell] && !inside[star->tets->neighbour[cell][cocone_star_index(half)]];
}

/* Lists all such half facets, ascending; near (may be NULL): those alone that touch one of the vertices marked in it.
 * *half is the caller's.  O(cells) on all threads.  STATUS_NO_MEMORY. */
enum status cocone_boundary_list(const struct cocone_star *star, const uint8_t *inside, const uint8_t *near,
                                 unsigned threads, uint32_t **half, size_t *count) MUST_CHECK;

#endif
