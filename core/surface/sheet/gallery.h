/* Whether a mesh is of a room, seen from within, or of a solid, seen from outside, where nobody says.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_GALLERY_H
#define WHITTLE_CORE_SURFACE_SHEET_GALLERY_H

#include <stdbool.h>

#include "core/mesh/mesh.h"

struct gallery {
    bool room;              /* clearly: what is seen from within is hidden from outside */
    double within, outside; /* shares of the area that are seen from a few places there */
};

/* component[t] is the number of each triangle's, the same for all of it, below their number; its triangles face one
 * way.  facing[c] becomes how each component faces those who see it from within, as if it were a room: 1 = all of it
 * does, -1 = none does, 0 = it isn't seen; where all is seen from far away it stays as it is; or NULL.  By some
 * hundred places of the mesh; O(triangles), a millisecond for ten thousand, where all is seen along some axes, else .1
 * to .2 s of one processor; up to 5 MB.  The same for any number of threads.  STATUS_NO_MEMORY. */
enum status gallery_find(const struct mesh *mesh, const uint32_t *component, unsigned threads, struct gallery *gallery,
                         double *facing) MUST_CHECK;

/* side[t] becomes how those within see each triangle, as of a room: 1 = in front, -1 = from behind, between where they
 * see both, 0 = not at all.  *turned = of what they see of the largest component, the share from the side that is less:
 * 0 = it faces one way, or isn't of a room for all that can be told, and side isn't set.  Cost as gallery_find and some
 * 5 us a triangle; STATUS_NO_MEMORY. */
enum status gallery_sides(const struct mesh *mesh, const uint32_t *component, unsigned threads, double *side,
                          double *turned) MUST_CHECK;

#endif
