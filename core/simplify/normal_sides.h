/* Which way normals point.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_NORMAL_SIDES_H
#define WHITTLE_CORE_SIMPLIFY_NORMAL_SIDES_H

#include <stdbool.h>

#include "core/base/status.h"
#include "core/spatial/neighbourhood.h"

/* Whether normals that came with the points (given, of any length, 0 or not finite where there is none; one for each of
 * neighbours->n points) fit them: nearly all are there, they lie near the computed ones (normal, unit, of any sign),
 * and those of neighbours point to the same side.  Random ones don't, nor do good ones with random signs.  O(n k). */
bool normals_fit_points(const vec3 *given, const vec3 *normal, const struct neighbourhood *neighbours);

/* What decided, for most points. */
enum normal_side { NORMALS_BY_GIVEN, NORMALS_BY_VIEW, NORMALS_UP, NORMALS_OUT };

/* What is known of the sides.  Borrowed; NULL: not known. */
struct normal_evidence {
    const vec3 *given; /* of each point, that fit them */
    const vec3 *view;  /* of each point: where it was seen from */
};

/* Turns the unit normals of neighbours->n points: each as the given one, else each towards its viewer.  Else they are
 * turned together: from neighbour to neighbour, the most alike first (a minimum spanning forest; Hoppe, DeRose,
 * Duchamp, McDonald, Stuetzle 1992), then each part upwards (z) where most of its surface faces up or down, else away
 * from its middle.  The same for any number of threads.  O(n k).  STATUS_NO_MEMORY. */
enum status normals_turn(const vec3 *point, const struct neighbourhood *neighbours,
                         const struct normal_evidence *evidence, vec3 *normal, enum normal_side *side) MUST_CHECK;

#endif
