/* Points without a position.
 *
 * Readers keep them until the file has been read, since faces and counts go by the file's numbers; then records, lists
 * and positions move up over the gaps, and triangles are numbered anew.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/finite.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/build.h"

enum { NOTE_BYTES = 96 };

static size_t count_placed(const struct cloud *cloud) {
    size_t placed = 0;
    for (size_t i = 0; i < cloud->count; i++) placed += vec3_is_finite(cloud->position[i]);
    return placed;
}

/* Moves the items of point `from` of every list to point `to` <= from. */
static void move_lists(struct cloud *cloud, size_t to, size_t from) {
    for (size_t j = 0; j < cloud->property_count; j++) {
        struct property *p = &cloud->property[j];
        if (!p->is_list) continue;
        size_t begin = p->list_offset[from], n = p->list_offset[from + 1] - begin;
        memmove(p->list_data + p->list_offset[to], p->list_data + begin, n);
        p->list_offset[to + 1] = p->list_offset[to] + n;
    }
}

/* Moves the points that have a position up; new_id (NULL = isn't asked for) tells where to, NONE = nowhere. */
static void compact_points(struct cloud *cloud, uint32_t *new_id) {
    size_t kept = 0, each = cloud->record_bytes;
    for (size_t i = 0; i < cloud->count; i++) {
        bool placed = vec3_is_finite(cloud->position[i]);
        if (new_id) new_id[i] = placed ? (uint32_t)kept : NONE;
        if (!placed) continue;
        if (kept < i) {
            memcpy(cloud->record + kept * each, cloud->record + i * each, each);
            cloud->position[kept] = cloud->position[i];
            move_lists(cloud, kept, i);
        }
        kept++;
    }
    cloud->count = kept;
}

/* Numbers the triangles anew and drops those that lost a corner; returns how many. */
static size_t compact_triangles(struct cloud *cloud, const uint32_t *new_id) {
    size_t kept = 0, before = cloud->triangle_count;
    for (size_t t = 0; t < before; t++) {
        uint32_t v[3];
        for (int k = 0; k < 3; k++) v[k] = new_id[cloud->triangle[t][k]];
        if (v[0] != NONE && v[1] != NONE && v[2] != NONE) memcpy(cloud->triangle[kept++], v, sizeof v);
    }
    cloud->triangle_count = kept;
    return before - kept;
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
    size_t before = cloud->count, placed = count_placed(cloud), triangles = 0;
    if (placed == before) return STATUS_OK;
    if (!placed)
        return error_set_at(error, STATUS_MALFORMED, "read", 0, UINT64_MAX,
                            "no point has a position: all %zu have a coordinate that is nan or infinite", before);
    uint32_t *new_id = cloud->triangle_count ? alloc_array(before, sizeof *new_id) : NULL;
    if (cloud->triangle_count && !new_id)
        return error_set(error, STATUS_NO_MEMORY, "read", "no memory to number %zu points", before);
    compact_points(cloud, new_id);
    if (new_id) triangles = compact_triangles(cloud, new_id);
    free(new_id);
    if (cloud->triangle_count == 0) {
        free(cloud->triangle);
        cloud->triangle = NULL;
    }
    if (note(cloud, before - placed, triangles))
        return error_set(error, STATUS_NO_MEMORY, "read", "no memory for a note");
    return STATUS_OK;
}
