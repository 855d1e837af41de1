/* What a mesh has where rays went on to what is behind.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_SHEET_CARVE_H
#define WHITTLE_CORE_SURFACE_SHEET_CARVE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/mesh/mesh.h"

/* out[t] = 1 for the triangles through most of which a place has seen some of n points clearly behind them, else 0.
 * O(n + triangles).  STATUS_NO_MEMORY. */
enum status carve_seen_through(const struct mesh *mesh, const vec3 *point, size_t n, vec3 place, unsigned threads,
                               uint8_t *out) MUST_CHECK;

#endif
