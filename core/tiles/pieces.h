/* All points of a plan once more, a piece after the other, for what is measured of all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_PIECES_H
#define WHITTLE_CORE_TILES_PIECES_H

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/tiles/scratch.h"

enum { PIECES_MOST_POINTS = 1 << 18 };

struct pieces {
    const char *folder;
    const struct scratch *scratch; /* the folder's plan, borrowed */
    unsigned threads;              /* 0 = all processors */
    /* Gets n points, at most PIECES_MOST_POINTS, in the frame of the whole; another status than STATUS_OK is the
     * end. */
    enum status (*take)(void *ctx, const vec3 *point, size_t n);
    int (*tick)(void *ctx, double fraction); /* nonzero: STATUS_CANCELLED */
    void *ctx;
    struct error *error;
};

/* Each point of the cloud once, in the order of the files, which is along the cloud; the next piece is read while one
 * is taken.  STATUS_NO_MEMORY, STATUS_IO (core/tiles/fit.h, TILES_DAMAGED), STATUS_CANCELLED, what take says. */
enum status pieces_take(const struct pieces *pieces) MUST_CHECK;

#endif
