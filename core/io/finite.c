/* Points without a position.
 *
 * Readers keep them until the file has been read, since faces and counts go by the file's numbers.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/finite.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/cloud/keep.h"
#include "core/io/build.h"

enum { NOTE_BYTES = 96 };

/* placed[i]: whether point i has a position; returns how many have one. */
static size_t find_placed(const struct cloud *cloud, uint8_t *placed) {
    size_t count = 0;
    for (size_t i = 0; i < cloud->count; i++) count += placed[i] = vec3_is_finite(cloud->position[i]);
    return count;
}

static bool all_are_placed(const struct cloud *cloud) {
    for (size_t i = 0; i < cloud->count; i++)
        if (!vec3_is_finite(cloud->position[i])) return false;
    return true;
}

static enum status note(struct cloud *cloud, size_t points, size_t triangles) {
    char text[NOTE_BYTES];
    snprintf(text, sizeof text, "%zu %s without a position (a coordinate is nan or infinite)", points,
             points == 1 ? "point" : "points");
    enum status status = cloud_leave_out(cloud, text);
    if (status || !triangles) return status;
    snprintf(text, sizeof text, "%zu %s at points without a position", triangles,
             triangles == 1 ? "triangle" : "triangles");
    return cloud_leave_out(cloud, text);
}

enum status cloud_drop_unplaced(struct cloud *cloud, struct error *error) {
    size_t before = cloud->count, triangles = 0;
    if (all_are_placed(cloud)) return STATUS_OK;
    uint8_t *placed = alloc_array(before, sizeof *placed);
    enum status status = placed ? STATUS_OK : STATUS_NO_MEMORY;
    size_t count = placed ? find_placed(cloud, placed) : 0;
    if (!status && count) status = cloud_keep(cloud, placed, &triangles);
    free(placed);
    if (status) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to number %zu points", before);
    if (!count)
        return error_set_at(error, STATUS_MALFORMED, "read", 0, UINT64_MAX,
                            "no point has a position: all %zu have a coordinate that is nan or infinite", before);
    if (note(cloud, before - count, triangles))
        return error_set(error, STATUS_NO_MEMORY, "read", "no memory for a note");
    return STATUS_OK;
}
