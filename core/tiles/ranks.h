/* Kept points that don't fit into memory: what is left of all tiles, and of what has gone the most important.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_RANKS_H
#define WHITTLE_CORE_TILES_RANKS_H

#include "core/base/progress.h"
#include "core/io/out/kept_file.h"
#include "core/io/stream.h"
#include "core/tiles/left.h"
#include "core/tiles/scratch.h"

struct ranks {
    const char *folder;
    const struct scratch *scratch;
    const uint32_t *left; /* numbers in the input of the points that are left, the most important first */
    size_t left_count;
    uint64_t gone_count; /* of all tiles */
    const struct progress *progress;
    struct error *error;
};

/* Every item of what has gone of a tile, in the order of its file.  STATUS_IO, STATUS_MALFORMED, STATUS_NO_MEMORY. */
typedef void ranks_take(void *ctx, struct gone_item item);
enum status ranks_read_gone(const struct ranks *ranks, size_t tile, ranks_take *take, void *ctx) MUST_CHECK;

/* Finds the key of the last point that is kept, where so many are; *error_made is the largest of the contractions until
 * then, of those of whole passes.  Reads what has gone three times.  STATUS_IO, STATUS_NO_MEMORY. */
enum status ranks_find_last(const struct ranks *ranks, uint64_t kept, uint64_t *last, float *error_made) MUST_CHECK;

/* Writes these points of the input, unless that is done.  Reads the input once, and what has gone once for each part of
 * the input whose keys fit into memory. */
enum status ranks_write(const struct ranks *ranks, uint64_t last, struct cloud_stream *stream,
                        const struct kept_file *file) MUST_CHECK;

#endif
