/* Which way is out, at every point.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_ORIENT_H
#define WHITTLE_CORE_COCONE_ORIENT_H

#include "core/cocone_frame.h"

/* How a cell lies to one of its vertices, from the dual's and the cell's own direction. */
struct cocone_lie {
    double dual;   /* cosine between the dual direction and the normal */
    double weight; /* 0 to 1: how certainly the cell is on the side that dual's sign says */
};

struct cocone_lie cocone_orient_lie(const struct cocone_star *star, const struct cocone_frame *frame, uint32_t cell,
                                    uint32_t vertex);

/* Turns the frame's normals outwards, all of them.  *conflicts = the cells that two of their vertices still see on
 * opposite sides with certainty.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_orient(const struct cocone_star *star, struct cocone_frame *frame, size_t *conflicts) MUST_CHECK;

/* Turns the normals that disagree with the labels of most cells around them; how many.  O(cells). */
size_t cocone_orient_by_labels(const struct cocone_star *star, const uint8_t *inside, struct cocone_frame *frame);

#endif
