/* Labels by marking and peeling, the literal rules.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_PEEL_H
#define WHITTLE_CORE_SURFACE_COCONE_PEEL_H

#include "core/surface/cocone/facets.h"

/* Sets inside[c] = 1 for the cells that can't be peeled off from outside, else 0.  good as from cocone_umbrella_choose;
 * points that are never reached lose it.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_peel(const struct cocone_star *star, const struct cocone_facets *facets, uint8_t *good,
                        uint8_t *inside) MUST_CHECK;

#endif
