/* Least-squares normals (Lee, Jong section 4.2).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_NORMALS_H
#define WHITTLE_CORE_SIMPLIFY_NORMALS_H

#include "core/spatial/neighbourhood.h"

/* normal[p], n of them: the unit normal of the plane that fits p and its neighbours best (Lee, Jong section 4.2): the
 * eigenvector of the smallest eigenvalue of their covariance.  The sign is arbitrary: whoever uses a normal aligns it.
 * A point whose neighbours all lie on a line through it gets a unit vector across that line, a lonely one (0, 0, 1).
 * variation[p] (may be NULL) is the surface variation of Pauly, Gross, Kobbelt (2002), 0 (flat) to 1/3.  O(n). */
void normals_fit(const vec3 *point, const struct neighbourhood *neighbourhood, unsigned threads, vec3 *normal,
                 float *variation);

#endif
