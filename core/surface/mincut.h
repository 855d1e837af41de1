/* The minimum cut of a graph in which every node has four neighbours: cells of a tetrahedralisation.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_MINCUT_H
#define WHITTLE_CORE_SURFACE_MINCUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"

/* Arc i of node c goes to neighbour[c][i], where it is arc mirror[c][i].  What a search leaves of the capacities tells
 * as well as they did by how much one cut is dearer than another. */
struct mincut {
    size_t node_count;
    const uint32_t (*neighbour)[4]; /* borrowed */
    const uint8_t (*mirror)[4];     /* borrowed */
    int32_t (*capacity)[4];         /* of each arc, >= 0; borrowed; holds what is left of them afterwards */
    int32_t *terminal;              /* > 0: capacity from the source, < 0: to the sink; borrowed; the same */
};

struct mincut_search;

/* Makes a search over the graph, which it borrows until mincut_free.  STATUS_NO_MEMORY. */
enum status mincut_new(struct mincut *graph, struct mincut_search **search) MUST_CHECK;

/* Fills the graph up to the maximum flow.  One thread; the worst case is bounded by a multiple of the number of nodes,
 * at which the search stops with a cut that may be more than the minimum.  STATUS_CANCELLED (ticks stage). */
enum status mincut_flow(struct mincut_search *search, const char *stage, const struct progress *progress) MUST_CHECK;

/* Whether the source still reaches the node, after mincut_flow: of all minimum cuts the one with the smallest source
 * side. */
bool mincut_is_source(const struct mincut_search *search, uint32_t node);

/* Change the capacity of an arc, or of a node's terminal, which has to come from them alone between two calls of
 * mincut_flow.  The next one takes time for what has changed rather than for the whole graph.  No capacity may become
 * negative in all. */
void mincut_add_arc(struct mincut_search *search, uint32_t node, unsigned arc, int32_t by);
void mincut_add_terminal(struct mincut_search *search, uint32_t node, int32_t by);

/* Accepts NULL. */
void mincut_free(struct mincut_search *search);

#endif
