/* Moves of vertices that bring the mesh nearer to the points (Hoppe and others 1993: fitting for fixed triangles).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_RELOCATE_H
#define WHITTLE_CORE_REFINE_RELOCATE_H

#include "core/refine/fit.h"

/* Tries to move each unlocked vertex whose star is stale, once: to a better one of the original points (subset) or to
 * the best place (optimal).  *moves += the number of those that moved.  STATUS_NO_MEMORY. */
enum status fit_move(struct fit *fit, size_t *moves) MUST_CHECK;

#endif
