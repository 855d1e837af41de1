/* What is gained by a vertex on an edge (Hoppe and others 1993: edge split).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_SPLIT_H
#define WHITTLE_CORE_REFINE_SPLIT_H

#include "core/refine/candidate.h"
#include "core/refine/fit.h"

/* The split of the edge of h, which has a twin, that gains most; halfedge is NONE where none does. */
struct fit_candidate fit_split_best(const struct fit *fit, uint32_t h);

#endif
