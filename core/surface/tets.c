/* The arrays come from the Delaunay shim, which knows how they are filled; here is only how they end.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/tets.h"

#include <stdlib.h>

void tets_done(struct tets *tets) {
    if (!tets) return;
    free(tets->vertex);
    free(tets->neighbour);
    free(tets->circumcentre);
    free(tets->planar);
    *tets = (struct tets){0};
}
