/* What is left of a tile once it has been run: points with their quadrics, and which others each is joined to.
 *
 *     head | positions | ids | quadrics | normals | degrees | links
 *
 * ids and links are numbers of points in the input.  A link may lead to a point of another tile, or to one that the
 * other tile hasn't left, where both saw too little of each other.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_LEFT_H
#define WHITTLE_CORE_TILES_LEFT_H

#include <stdint.h>

struct left_head {
    char mark[16];
    uint64_t count, links;
    uint64_t distinct; /* points of the tile, without repetitions */
    float error;       /* as of a contraction */
};

#define LEFT_MARK "whittle left 1\0"

#endif
