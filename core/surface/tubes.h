/* Loops that go around a tube: a bar, or a hole drilled through what is thicker than it is wide.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_TUBES_H
#define WHITTLE_CORE_SURFACE_TUBES_H

#include "core/surface/handle_loops.h"

/* Takes loops of a closed mesh that go around tubes from the list, which is in the order of loops_find, and such as are
 * sums of shorter ones of these, as where bars meet; *tubes: how many handles they tell of.  A tube is about as narrow
 * for two edges from the loop, on either side of it: so long it has points of its own, which tell that it is there.  A
 * bridge between sheets that touch, or a tunnel through a wall that is too thin for its points, gets wider at once.
 * O(triangles log triangles).  STATUS_NO_MEMORY. */
enum status tubes_leave(const struct mesh *mesh, struct loops *loops, long *tubes) MUST_CHECK;

#endif
