/* The mesh in parts that are looked at one after the other: what a part needs stays near the processor.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_REFINE_PARTITION_H
#define WHITTLE_CORE_REFINE_PARTITION_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/mesh/halfedge.h"

enum { FIT_PART_MOST = 512 }; /* vertices of a part at the beginning */

struct fit_partition {
    size_t count;
    uint32_t *of; /* the part of each vertex; owned.  Whoever moves a vertex far away gives it a part there */
};

/* Parts that are about as wide as they are long.  O(vertices).  STATUS_NO_MEMORY. */
enum status fit_partition_init(struct fit_partition *partition, const struct halfedge *he) MUST_CHECK;
void fit_partition_done(struct fit_partition *partition);

#endif
