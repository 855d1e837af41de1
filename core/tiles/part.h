/* A part of a cloud, through the stages of the pipeline that look around each point, in the frame of the whole.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_PART_H
#define WHITTLE_CORE_TILES_PART_H

#include <stdbool.h>

#include "core/cloud/morton.h"
#include "core/params.h"
#include "core/simplify/contract.h"
#include "core/simplify/quadric.h"
#include "core/tiles/scratch.h"

struct part {
    const struct params *params;
    unsigned threads;
    struct ordered_points points; /* of the part, in the whole's frame */
    uint8_t *own;                 /* of each: it is of the box, not around it */
    vec3 *normal;
    struct packed_quadric *quadrics;
    struct adjacency near;
};

/* What no part knows alone. */
struct part_whole {
    struct ordered_points frame;
    bool noisy;
    double average, length_bias;
    double noise; /* core/clean/noise.h, in the frame */
};

/* Makes quadrics and lists of the points.  find: noise, the average operator and length_bias are found of those of its
 * own points and set in *whole, else taken from it.  STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status part_make(struct part *part, const struct scratch_points *points, bool find, struct part_whole *whole,
                      const struct progress *progress, struct error *error) MUST_CHECK;

/* Accepts a zeroed one. */
void part_done(struct part *part);

#endif
