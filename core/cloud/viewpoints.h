/* The viewpoints of a file's scans, collected while its points are read.
 *
 *     viewpoints_init(&views, scans)
 *     for each scan: viewpoints_begin(&views, from), viewpoints_see for each point, viewpoints_end
 *     viewpoints_give(&views, &cloud), viewpoints_done(&views)
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLOUD_VIEWPOINTS_H
#define WHITTLE_CORE_CLOUD_VIEWPOINTS_H

#include "core/cloud/cloud.h"

struct viewpoints {
    size_t count, made;
    vec3 *from; /* owned */
    bool seen;  /* a point of this scan */
    vec3 low, high;
};

/* There will be this many scans.  STATUS_NO_MEMORY. */
enum status viewpoints_init(struct viewpoints *views, size_t scans) MUST_CHECK;

void viewpoints_begin(struct viewpoints *views, vec3 from);
void viewpoints_see(struct viewpoints *views, vec3 point);

/* A place that is farther from the box of the scan's points than the box is wide isn't believed: it becomes NAN. */
void viewpoints_end(struct viewpoints *views);

/* The cloud's views are these, unless none of them is believed; they are given once. */
void viewpoints_give(struct viewpoints *views, struct cloud *cloud);

/* Accepts zeroed ones. */
void viewpoints_done(struct viewpoints *views);

#endif
