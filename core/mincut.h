/* The minimum cut of a graph in which every node has four neighbours: cells of a tetrahedralisation.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MINCUT_H
#define WHITTLE_CORE_MINCUT_H

#include <stddef.h>
#include <stdint.h>

#include "core/progress.h"
#include "core/status.h"

/* Arc i of node c goes to neighbour[c][i], where it is arc mirror[c][i]. */
struct mincut {
    size_t node_count;
    const uint32_t (*neighbour)[4]; /* borrowed */
    const uint8_t (*mirror)[4];     /* borrowed */
    int32_t (*capacity)[4];         /* of each arc, >= 0; borrowed; holds what is left of them afterwards */
    int32_t *terminal;              /* > 0: capacity from the source, < 0: to the sink; borrowed; the same */
};

/* Sets side[c] to 1 for the nodes that the source still reaches, else 0: of all minimum cuts the one with the smallest
 * source side.  One thread; the worst case is bounded by a multiple of the number of nodes, at which the search stops
 * with a cut that may be more than the minimum.  STATUS_NO_MEMORY, STATUS_CANCELLED (ticks stage). */
enum status mincut_solve(struct mincut *graph, const char *stage, const struct progress *progress,
                         uint8_t *side) MUST_CHECK;

#endif
