/* Handles, tunnels and shells that the original points don't speak for.  Part of Tight Cocone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_HANDLES_H
#define WHITTLE_CORE_SURFACE_COCONE_HANDLES_H

#include "core/surface/cocone/cocone_internal.h"
#include "core/surface/reconstruct.h"

/* What a labelling is looked at with.  All borrowed; dense isn't NULL. */
struct cocone_handles_input {
    const struct cocone_star *star;
    const struct cocone_cost *cost;
    const struct reconstruct_dense *dense;
    const struct progress *progress;
    struct reconstruct_pieces pieces;
    bool bars; /* tubes stay */
    unsigned threads;
};

/* Relabels cells (inside, see cocone_cut_label) where that closes a narrow tunnel, cuts a thin handle or joins a shell
 * to another, and where the original points are as well off without it.  No more points are lost than before, and the
 * surface gets no more pinches.  *closed counts the tunnels, handles and shells that are gone.  Where too many pieces
 * would be left whatever is joined, by input->pieces, nothing is done and *too_many is set.  A labelling whose surface
 * is one sphere costs O(cells), a few percent of what it took to find it; others as much as making a mesh, and
 * then up to some milliseconds for each narrow loop and each shell.  The same for any number of threads.
 * STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status cocone_handles_close(const struct cocone_handles_input *input, uint8_t *inside, size_t *closed,
                                 bool *too_many) MUST_CHECK;

#endif
