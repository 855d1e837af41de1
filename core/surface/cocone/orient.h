/* Which way is out, at every point.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_ORIENT_H
#define WHITTLE_CORE_SURFACE_COCONE_ORIENT_H

#include "core/surface/cocone/frame.h"

/* How the cells lie to their vertices.  lie[c][i] > 0: cell c is above vertex i, on the side to which its normal
 * points; < 0: below.  The size is how certain that is, up to 1.  3 for the vertex at infinity. */
struct cocone_lies {
    float (*lie)[4]; /* cell_count; owned */
};

/* Measures the lies in each of count frames.  O(cells).  STATUS_NO_MEMORY, and then whoever calls gives what is there
 * to cocone_orient_done. */
enum status cocone_orient_measure(const struct cocone_star *star, const struct cocone_frame frame[], int count,
                                  unsigned threads, struct cocone_lies lies[]) MUST_CHECK;

/* Accepts zeroed lies. */
void cocone_orient_done(struct cocone_lies *lies);

/* Room to work in for cocone_orient, which can't fail then.  STATUS_NO_MEMORY. */
struct cocone_gathering;
enum status cocone_gathering_new(const struct cocone_star *star, struct cocone_gathering **room) MUST_CHECK;

/* Accepts NULL. */
void cocone_gathering_free(struct cocone_gathering *room);

/* Turns the normals outwards, all of them, and the lies with them.  Returns the number of cells that two of their
 * vertices still see on opposite sides with certainty.  room: fresh.  O(cells log cells) in practice. */
size_t cocone_orient(const struct cocone_star *star, struct cocone_frame *frame, struct cocone_lies *lies,
                     struct cocone_gathering *room);

/* Lists the vertices whose normals disagree with the labels of most cells around them; how many.  O(cells). */
size_t cocone_orient_doubt(const struct cocone_star *star, const uint8_t *inside, const struct cocone_lies *lies,
                           uint32_t *list);

/* Turns the normal of a vertex, and the lies with it. */
void cocone_orient_turn(const struct cocone_star *star, struct cocone_frame *frame, struct cocone_lies *lies,
                        uint32_t vertex);

#endif
