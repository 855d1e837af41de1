/* A part grows from a vertex ring by ring, until it is large enough or there is nothing left around it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/refine/partition.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

struct growth {
    const struct halfedge *he;
    struct fit_partition *partition;
    uint32_t *queue; /* the vertices of the part, in the order in which they were met */
    size_t met;
};

static void meet(struct growth *growth, uint32_t vertex) {
    if (growth->met == FIT_PART_MOST || growth->partition->of[vertex] != NONE) return;
    growth->partition->of[vertex] = (uint32_t)growth->partition->count;
    growth->queue[growth->met++] = vertex;
}

/* As far as the fan goes from the half-edge that the vertex knows, which is all around unless it is on a boundary. */
static void meet_neighbours(struct growth *growth, uint32_t vertex) {
    uint32_t h = growth->he->out[vertex];
    do {
        meet(growth, halfedge_to(growth->he, h));
        h = halfedge_around(growth->he, h);
    } while (h != NONE && h != growth->he->out[vertex]);
}

static void grow(struct growth *growth, uint32_t vertex) {
    growth->met = 0;
    meet(growth, vertex);
    for (size_t i = 0; i < growth->met && growth->met < FIT_PART_MOST; i++) meet_neighbours(growth, growth->queue[i]);
    growth->partition->count++;
}

enum status fit_partition_init(struct fit_partition *partition, const struct halfedge *he) {
    struct fit_partition new = {.of = alloc_array(he->vertex_count, sizeof *new.of)};
    struct growth growth = {.he = he, .partition = &new, .queue = alloc_array(FIT_PART_MOST, sizeof *growth.queue)};
    bool enough = new.of &&growth.queue;
    if (enough) {
        memset(new.of, 0xff, he->vertex_count * sizeof *new.of);
        for (uint32_t v = 0; v < he->vertex_count; v++)
            if (new.of[v] == NONE && he->out[v] != NONE) grow(&growth, v);
        *partition = new;
    } else {
        free(new.of);
    }
    free(growth.queue);
    return enough ? STATUS_OK : STATUS_NO_MEMORY;
}

void fit_partition_done(struct fit_partition *partition) {
    free(partition->of);
    *partition = (struct fit_partition){0};
}
