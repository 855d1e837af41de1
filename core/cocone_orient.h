/* Which way is out, at every point.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_COCONE_ORIENT_H
#define WHITTLE_CORE_COCONE_ORIENT_H

#include "core/cocone_frame.h"

/* How the cells lie to their vertices.  lie[c][i] > 0: cell c is above vertex i, on the side to which its normal
 * points; < 0: below.  The size is how certain that is, up to 1.  3 for the vertex at infinity. */
struct cocone_lies {
    float (*lie)[4]; /* cell_count; owned */
};

/* Measures the lies in a frame.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_orient_measure(const struct cocone_star *star, const struct cocone_frame *frame, unsigned threads,
                                  struct cocone_lies *lies) MUST_CHECK;

/* Accepts zeroed lies. */
void cocone_orient_done(struct cocone_lies *lies);

/* Turns the normals outwards, all of them, and the lies with them.  *conflicts = the cells that two of their vertices
 * still see on opposite sides with certainty.  O(cells log cells) in practice.  STATUS_NO_MEMORY. */
enum status cocone_orient(const struct cocone_star *star, struct cocone_frame *frame, struct cocone_lies *lies,
                          size_t *conflicts) MUST_CHECK;

/* Turns the normals that disagree with the labels of most cells around them; how many.  O(cells). */
size_t cocone_orient_by_labels(const struct cocone_star *star, const uint8_t *inside, struct cocone_frame *frame,
                               struct cocone_lies *lies);

#endif
