/* Normals of points whose neighbours lie on a line, as on rings around a limb that are farther apart than their points:
 * the plane fitted to such neighbours is the ring's, which lies across the surface.
 *
 * The Voronoi cell of a point on a surface is long along the normal and narrow across it, however its neighbours lie.
 * So where a cell reaches far less along the normal than elsewhere, that is no normal, and the direction of the pole,
 * the farthest corner of the cell, is one.
 *
 * Source: N. Amenta, M. Bern, Surface reconstruction by Voronoi filtering (1999).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_POLES_H
#define WHITTLE_CORE_SURFACE_POLES_H

#include <stddef.h>

#include "core/surface/tets.h"

/* *better, n: such a direction for each of the points that tets, of dimension 3, are of, whose normal is none: unit, on
 * that side of the point where the normal is; zero for all others.  Normals are unit vectors of either sign.  O(cells).
 * STATUS_NO_MEMORY. */
enum status poles_find_better(const struct tets *tets, const vec3 *point, size_t n, const vec3 *normal,
                              vec3 *better) MUST_CHECK;

#endif
