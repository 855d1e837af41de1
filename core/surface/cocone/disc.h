/* The cells that a disc spanned into a loop runs through.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_DISC_H
#define WHITTLE_CORE_SURFACE_COCONE_DISC_H

#include "core/surface/cocone/star.h"

/* A closed polygon of at least three points, by their ids. */
struct cocone_disc {
    const uint32_t *point; /* borrowed */
    size_t count;
    double shift; /* of the disc off its points, in sizes of its triangles: where it coincides with facets, the sign
                     chooses between the cells on either side */
};

/* Lists the finite cells of one label among those that the disc runs through: of inner or outer ones, whichever have
 * more of it.  The disc is the fan of triangles of the least area.  How many; 0 also where there are more than `most`.
 * Microseconds for each triangle of the fan. */
size_t cocone_disc_cells(const struct cocone_star *star, const uint8_t *inside, const struct cocone_disc *disc,
                         uint32_t *cell, size_t most);

#endif
