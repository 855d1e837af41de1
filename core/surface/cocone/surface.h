/* The surface between inner and outer cells, as a manifold mesh.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_SURFACE_H
#define WHITTLE_CORE_SURFACE_COCONE_SURFACE_H

#include "core/mesh/mesh.h"
#include "core/surface/cocone/star.h"

/* Meshes the facets between the cells with inside[c] = 1 and the others, counter-clockwise seen from outside.
 * support (may be NULL) says which facets are MESH_HOLE_FILL (cocone_cut_supported).  Infinite cells are outside.
 * Every edge has two triangles in opposite directions and the triangles at each vertex are one fan: where surface
 * sheets touch, the point has a vertex for each of them.  Where copies can't tell two sheets apart at an edge, the
 * cells between them are added to inside.  The mesh is the caller's; it is empty where no cell is inside.
 * O(cells log cells).  STATUS_NO_MEMORY. */
enum status cocone_surface_extract(const struct cocone_star *star, const double *support, unsigned threads,
                                   uint8_t *inside, struct mesh *mesh) MUST_CHECK;

/* Meshes planar triangles (tets of dimension 2) over n points in the same way: tags, one fan at each vertex.  The mesh
 * is open.  O(triangles log triangles).  STATUS_NO_MEMORY. */
enum status cocone_surface_planar(const struct tets *tets, const vec3 *point, const double *support,
                                  struct mesh *mesh) MUST_CHECK;

#endif
