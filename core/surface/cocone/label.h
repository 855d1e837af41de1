/* Labels of cells by orientation and cuts: with the normals given, with those of the poles, or with both side by side.
 * Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_LABEL_H
#define WHITTLE_CORE_SURFACE_COCONE_LABEL_H

#include "core/surface/cocone/cut.h"
#include "core/surface/reconstruct.h"

struct cocone_label {
    uint8_t *inside;         /* of each cell; owned */
    struct cocone_cost cost; /* owned */
    size_t conflicts;        /* see struct reconstruct_facts */
};

/* Makes count labellings (at most COCONE_FRAMES), from one frame each, see cocone_frame_build.  O(cells log cells) in
 * practice, on a thread for each.  STATUS_NO_MEMORY, STATUS_CANCELLED, and then whoever calls gives what is there to
 * cocone_label_done. */
enum status cocone_label_make(const struct cocone_star *star, const struct reconstruct_input *input, unsigned threads,
                              const struct progress *progress, struct cocone_label label[], int count) MUST_CHECK;

/* Accepts a zeroed label. */
void cocone_label_done(struct cocone_label *label);

#endif
