/* What it costs to take a vertex out (Hoppe and others 1993: edge collapse).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_COLLAPSE_H
#define WHITTLE_CORE_REFINE_COLLAPSE_H

#include "core/refine/candidate.h"
#include "core/refine/fit.h"

/* About what the vertex is worth where it stands, in no particular unit; INFINITY where it has to stay. */
double fit_collapse_estimate(const struct fit *fit, uint32_t vertex);

/* The collapse of the vertex, which must be able to go, into one of its nearest neighbours that costs least; halfedge
 * is NONE where none of them will do.  Whether the edge may be collapsed is left to be seen. */
struct fit_candidate fit_collapse_cheapest(const struct fit *fit, uint32_t vertex);

#endif
