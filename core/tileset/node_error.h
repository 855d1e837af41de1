/* How much is missing where a tile is shown and what is below it isn't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_NODE_ERROR_H
#define WHITTLE_CORE_TILESET_NODE_ERROR_H

#include "core/tileset/octree.h"

/* Sets error of each node: the largest distance of a point below it to the nearest of what is shown with it, its own
 * points and those of the nodes above it; 0 where there is none below.  So it is never larger than that of the node
 * above.  Exact; the same for any number of threads.  O(points log points).  STATUS_NO_MEMORY. */
enum status node_errors(struct octree *tree, unsigned threads) MUST_CHECK;

#endif
