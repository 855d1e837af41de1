/* Holes of sheets, closed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_HOLES_H
#define WHITTLE_CORE_SURFACE_SHEET_HOLES_H

#include "core/mesh/mesh.h"

enum { SHEET_HOLE_CORNERS = 800 /* a border of more is left open */ };

/* Closes the holes of a mesh (manifold with borders, oriented) whose borders are at most `longest` long: with triangles
 * between the border's vertices, of the smallest area that the mesh leaves possible, behind the others and tagged
 * MESH_HOLE_FILL.  The longest border of a component is where the sheet ends, not a hole, unless its square is small
 * against the component's area, as that of a hole in something nearly closed is.  *closed = how many.  The mesh stays a
 * manifold, and is untouched on failure.  O(triangles + sum of corners cubed).  STATUS_NO_MEMORY. */
enum status sheet_close_holes(struct mesh *mesh, double longest, unsigned threads, size_t *closed) MUST_CHECK;

#endif
