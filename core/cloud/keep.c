/* Records, lists and positions move up over the gaps, and triangles are numbered anew.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/keep.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"

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

/* Moves the kept points up; new_id (NULL = isn't asked for) tells where to, NONE = nowhere. */
static void compact_points(struct cloud *cloud, const uint8_t *kept, uint32_t *new_id) {
    size_t count = 0, each = cloud->record_bytes;
    for (size_t i = 0; i < cloud->count; i++) {
        if (new_id) new_id[i] = kept[i] ? (uint32_t)count : NONE;
        if (!kept[i]) continue;
        if (count < i) {
            memcpy(cloud->record + count * each, cloud->record + i * each, each);
            cloud->position[count] = cloud->position[i];
            move_lists(cloud, count, i);
        }
        count++;
    }
    cloud->count = count;
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

enum status cloud_keep(struct cloud *cloud, const uint8_t *kept, size_t *triangles) {
    uint32_t *new_id = cloud->triangle_count ? alloc_array(cloud->count, sizeof *new_id) : NULL;
    if (cloud->triangle_count && !new_id) return STATUS_NO_MEMORY;
    compact_points(cloud, kept, new_id);
    *triangles = new_id ? compact_triangles(cloud, new_id) : 0;
    free(new_id);
    if (cloud->triangle_count == 0) {
        free(cloud->triangle);
        cloud->triangle = NULL;
    }
    return STATUS_OK;
}
