/* How much is missing where a tile is shown and what is below it isn't.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILESET_NODE_ERROR_H
#define WHITTLE_CORE_TILESET_NODE_ERROR_H

#include "core/spatial/knn.h"
#include "core/tileset/octree.h"

/* What is shown with the nodes of a tree that is a part of another: the points of the nodes above it, from the top, and
 * the largest distance of a point below each to what is shown with that. */
struct node_chain {
    unsigned count;
    struct knn *above[OCTREE_DEEPEST + 1];
    double error[OCTREE_DEEPEST + 1];
};

/* Sets error of each node: the largest distance of a point below it to the nearest of what is shown with it, its own
 * points and those of the nodes above it; 0 where there is none below.  So it is never larger than that of the node
 * above.  Exact; the same for any number of threads.  O(points log points).  STATUS_NO_MEMORY.
 *
 * chain (NULL: the tree is the whole) is what is above the tree's first node, whose depth is chain->count: its errors
 * are raised to those of the tree's points. */
enum status node_errors(struct octree *tree, struct node_chain *chain, unsigned threads) MUST_CHECK;

#endif
