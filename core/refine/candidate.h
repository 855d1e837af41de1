/* What a reallocation may consist of.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_CANDIDATE_H
#define WHITTLE_CORE_REFINE_CANDIDATE_H

#include <stdint.h>

#include "core/math/vec3.h"

/* A vertex that may go, and a half-edge of the edge to the neighbour that it merges into.  Or an edge that may be
 * split, and where. */
struct fit_candidate {
    double value; /* loss, or gain */
    uint32_t halfedge, vertex, source;
    vec3 place;
};

#define FIT_CANDIDATE_LEAST_TURN 0.2 /* smallest cosine between the normals of a triangle and what takes its place */

#endif
