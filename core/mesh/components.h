/* How many pieces a mesh is in.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MESH_COMPONENTS_H
#define WHITTLE_CORE_MESH_COMPONENTS_H

#include "core/mesh/mesh.h"

/* *count as mesh_examine has it (core/mesh/mesh.h), in a tenth of the time.  O(vertices + triangles).
 * STATUS_NO_MEMORY. */
enum status components_count(const struct mesh *mesh, size_t *count) MUST_CHECK;

#endif
