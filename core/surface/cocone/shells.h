/* Where the shells of a surface come near each other.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_SHELLS_H
#define WHITTLE_CORE_SURFACE_COCONE_SHELLS_H

#include "core/mesh/mesh.h"
#include "core/surface/cocone/star.h"

enum { COCONE_SHELLS_CELLS = 6 };

/* Sums of it tell sets of points apart. */
static inline uint64_t cocone_shells_fingerprint(uint32_t point) {
    return (point + 1ull) * (point + 1ull) * (point + 1ull);
}

/* A shell, and the smallest cells that have vertices of it and of another one. */
struct cocone_shell {
    uint32_t cell[COCONE_SHELLS_CELLS];
    double size_sq[COCONE_SHELLS_CELLS]; /* of each: its longest edge, squared; ascending */
    size_t count;
    uint64_t fingerprint; /* the sum over its vertices */
    uint32_t vertices;
};

/* Lists the shells of a mesh of some labelling (mesh->source: points of the star), but for the largest.  *shell (owned)
 * has *count of them.  O(cells).  STATUS_NO_MEMORY. */
enum status cocone_shells_list(const struct cocone_star *star, const struct mesh *mesh, struct cocone_shell **shell,
                               size_t *count) MUST_CHECK;

#endif
