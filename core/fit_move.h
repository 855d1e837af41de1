/* Moves of vertices that bring the mesh nearer to the points.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_FIT_MOVE_H
#define WHITTLE_CORE_FIT_MOVE_H

#include "core/fit.h"

/* Tries to move each unlocked vertex whose star is stale, once: to a better one of the original points (subset) or to
 * the best place (optimal).  *moves += the number of those that moved.  STATUS_NO_MEMORY. */
enum status fit_move(struct fit *fit, size_t *moves) MUST_CHECK;

#endif
