/* Viewpoints of scans.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/viewpoints.h"

#include <stdlib.h>

#include "core/base/alloc.h"

enum status viewpoints_init(struct viewpoints *views, size_t scans) {
    *views = (struct viewpoints){.count = scans, .from = alloc_array(scans, sizeof *views->from)};
    return views->from ? STATUS_OK : STATUS_NO_MEMORY;
}

void viewpoints_begin(struct viewpoints *views, vec3 from) {
    views->from[views->made] = from;
    views->seen = false;
}

void viewpoints_see(struct viewpoints *views, vec3 point) {
    if (!vec3_is_finite(point)) return;
    views->low = views->seen ? vec3_min(views->low, point) : point;
    views->high = views->seen ? vec3_max(views->high, point) : point;
    views->seen = true;
}

void viewpoints_end(struct viewpoints *views) {
    vec3 *from = &views->from[views->made++];
    vec3 nearest = vec3_min(vec3_max(*from, views->low), views->high);
    bool far = vec3_distance(*from, nearest) > vec3_distance(views->low, views->high);
    if (!views->seen || far || !vec3_is_finite(*from)) *from = (vec3){NAN, NAN, NAN};
}

void viewpoints_give(struct viewpoints *views, struct cloud *cloud) {
    bool any = false;
    for (size_t i = 0; views->from && i < views->count; i++) any |= vec3_is_finite(views->from[i]);
    if (!any) return;
    cloud->view = views->from, cloud->view_count = views->count;
    views->from = NULL;
}

void viewpoints_done(struct viewpoints *views) {
    free(views->from);
    *views = (struct viewpoints){0};
}
