/* Flips of single cells that bring lost points back and make the surface a manifold.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_REPAIR_H
#define WHITTLE_CORE_COCONE_REPAIR_H

#include "core/cocone_cut.h"

/* Flips labels (inside, see cocone_cut_label) of finite cells as long as that takes defects away; among equals the flip
 * that costs least.  *flips counts the cells.  O(cells) and then a few microseconds for each defect.
 * STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cocone_repair(const struct cocone_star *star, const struct cocone_cost *cost,
                          const struct progress *progress, unsigned threads, uint8_t *inside, size_t *flips) MUST_CHECK;

#endif
