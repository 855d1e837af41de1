/* What can be seen from where: which side of a surface was scanned, where nobody says.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_SIGHT_H
#define WHITTLE_CORE_SURFACE_SHEET_SIGHT_H

#include "core/mesh/mesh.h"

/* What is seen from one side of a component of a mesh, in shares of its area times the directions to that side. */
struct sight {
    double others; /* other components */
    double depth;  /* mean distance that one sees as far as, units of the mesh; the mesh's longest side where nothing is
                      in the way */
};

enum { SIGHT_FRONT, SIGHT_BACK };

/* sight[c] of the two sides of each component: component[t] is its number for each of its triangles, the same for all,
 * below the number of triangles; the others of sight are all zero.  By SIGHT_LOOKS triangles or fewer, and some of each
 * component; what is nearer than a fortieth of the mesh's longest side isn't seen.  The same for any number of threads.
 * .03 s of one processor, and .2 us for each triangle.  STATUS_NO_MEMORY. */
enum { SIGHT_LOOKS = 2048 };
enum status sight_find(const struct mesh *mesh, const uint32_t *component, unsigned threads,
                       struct sight (*sight)[2]) MUST_CHECK;

#endif
