/* Faces that agree on which side is in front.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_GIVEN_SIDES_H
#define WHITTLE_CORE_SURFACE_GIVEN_SIDES_H

#include "core/surface/given/faces.h"

/* Turns over triangles that face against their neighbours (across edges of two triangles), the fewer of each connected
 * set, and their records with them; where sides can't agree, as on a Moebius strip, an edge of disagreement is left.
 * Counts facts->turned.  O(triangles).  STATUS_NO_MEMORY. */
enum status sides_agree(struct faces *faces, size_t points, unsigned threads, struct faces_facts *facts) MUST_CHECK;

#endif
