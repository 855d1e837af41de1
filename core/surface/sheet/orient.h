/* Which side of a sheet is in front.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_ORIENT_H
#define WHITTLE_CORE_SURFACE_SHEET_ORIENT_H

#include <stdbool.h>

#include "core/mesh/mesh.h"
#include "core/surface/sheet/gallery.h"

/* What is known of it.  Borrowed. */
struct sheet_sides {
    const vec3 *normal; /* by the vertices' sources: as the input gives them, of any length; NULL = not given */
    bool viewed;        /* from view: all was scanned from there */
    vec3 view;
    bool away;               /* it is the middle of a globe, whose outside is in front */
    const vec3 *views;       /* by the vertices' sources: where each was scanned from; NULL = not known, or viewed */
    bool guessed;            /* these are of several places that nothing but the points tells of: ground tells more */
    bool room;               /* where nothing else tells, it faces those within */
    bool inside;             /* it is a room: where these don't tell either, its largest part faces its own middle */
    struct gallery *gallery; /* filled where that was asked; NULL = not to be told */
    vec3 up;                 /* unit */
    bool field;              /* one sheet over the plane normal to up: turned as a whole */
    bool landscape;          /* where neither normals nor views are known, all of it was seen from above */
};

enum sheet_side { SIDE_NORMALS, SIDE_VIEW, SIDE_UP, SIDE_SIGHT, SIDE_OUT };

/* Cuts a mesh where a part of it that faces away from the given normals, or else from the view, is joined to one that
 * doesn't: points were seen from in front, so the surface that joins them there is none.  Of guessed views, which some
 * points have wrong ones of, what most triangles around each tell counts, and nothing where the largest component lies
 * flat and faces up or down.  Where neither is known, what faces down counts in a landscape, likewise, and else in a
 * room (gallery_sides), of whose largest component a tenth or more is turned, what those within see.  Small parts stay.
 * The mesh has tags and sources.  O(triangles).  STATUS_NO_MEMORY. */
enum status sheet_part_turned(struct mesh *mesh, const struct sheet_sides *sides, unsigned threads) MUST_CHECK;

/* Turns each component of the mesh (manifold, oriented) to face as the given normals do, else to the view, where most
 * of its area agrees on it, but not to guessed views where the largest one lies flat and faces up or down; else upwards
 * where it faces up or down mostly, by its area or, where it lies flat, by that of the ground below it; else to what it
 * sees of other components (sight.h), as walls do to what stands in a room; else, in a room (gallery.h), to those
 * within; else the largest one inside a room to its middle; else away from its middle.  Where the largest one of all
 * faces what it sees, others do before they face upwards.  *side is what the largest part of the area was turned by.
 * O(triangles).  STATUS_NO_MEMORY. */
enum status sheet_orient(struct mesh *mesh, const struct sheet_sides *sides, unsigned threads,
                         enum sheet_side *side) MUST_CHECK;

/* gallery_find of a mesh (oriented) and its components.  STATUS_NO_MEMORY. */
enum status sheet_is_room(const struct mesh *mesh, unsigned threads, struct gallery *gallery) MUST_CHECK;

/* How much of the mesh's area faces the places that it was seen from, less what faces away from them: -1 to 1, 0 where
 * none are known.  O(triangles). */
double sheet_facing(const struct mesh *mesh, const struct sheet_sides *sides);

#endif
