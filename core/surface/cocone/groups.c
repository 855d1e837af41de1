/* Second thoughts about orientation.
 *
 * Gathering (orient.c) joins clusters one after the other and never parts them again: where two patches were joined
 * wrongly, early and by faint evidence, a whole patch stays turned, as between two legs.  Somebody else may know
 * better: another orientation, by other normals, or the labels of a cut.  What they differ in falls into groups of
 * vertices that share cells; between groups there is no evidence, so each is judged by itself, by the cells that it
 * shares with vertices that both agree on:
 *
 *     sum over cells of (sum of the lies of its marked vertices) * (sum of those of its other vertices)
 *
 * That is negative where the cells say the same of more vertices once the group is turned.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"

enum status cocone_groups_new(size_t n, struct cocone_groups *groups) {
    *groups = (struct cocone_groups){alloc_zeroed(n, sizeof *groups->marked), alloc_array(n, sizeof *groups->root),
                                     alloc_array(n, sizeof *groups->evidence)};
    return groups->marked && groups->root && groups->evidence ? STATUS_OK : STATUS_NO_MEMORY;
}

void cocone_groups_done(struct cocone_groups *groups) {
    free(groups->marked), free(groups->root), free(groups->evidence);
    *groups = (struct cocone_groups){0};
}

static bool is_marked(const struct cocone_groups *groups, uint32_t v) { return v != NONE && groups->marked[v]; }

/* The first of a cell's vertices that are marked. */
static uint32_t first_marked(const struct cocone_groups *groups, const uint32_t vertex[4]) {
    int i = 0;
    while (!is_marked(groups, vertex[i])) i++;
    return vertex[i];
}

/* The cells at v that have no marked vertex before it, one after the other: *i is where to go on. */
static bool next_cell(const struct cocone_star *star, const struct cocone_groups *groups, uint32_t v, uint32_t *i,
                      uint32_t *cell) {
    for (; *i < star->begin[v + 1]; ++*i) {
        *cell = cocone_star_cell(star->corner[*i]);
        if (first_marked(groups, star->tets->vertex[*cell]) != v) continue;
        ++*i;
        return true;
    }
    return false;
}

static void unite(const struct cocone_star *star, struct cocone_groups *groups, uint32_t v) {
    uint32_t cell;
    for (uint32_t i = star->begin[v]; next_cell(star, groups, v, &i, &cell);)
        for (int k = 0; k < 4; k++) {
            uint32_t other = star->tets->vertex[cell][k];
            if (is_marked(groups, other)) disjoint_set_unite(groups->root, v, other);
        }
}

static double evidence_of(const struct cocone_groups *groups, const uint32_t vertex[4], const float lie[4]) {
    double marked = 0, other = 0;
    for (int k = 0; k < 4; k++) *(is_marked(groups, vertex[k]) ? &marked : &other) += (double)lie[k];
    return marked * other;
}

static void weigh(const struct cocone_star *star, const struct cocone_lies *lies, struct cocone_groups *groups,
                  uint32_t v) {
    uint32_t cell, root = disjoint_set_root(groups->root, v);
    for (uint32_t i = star->begin[v]; next_cell(star, groups, v, &i, &cell);)
        groups->evidence[root] += evidence_of(groups, star->tets->vertex[cell], lies->lie[cell]);
}

size_t cocone_groups_against(const struct cocone_star *star, const struct cocone_lies *lies,
                             struct cocone_groups *groups, uint32_t *list) {
    size_t count = 0;
    for (uint32_t v = 0; v < star->n; v++) groups->root[v] = v, groups->evidence[v] = 0;
    for (uint32_t v = 0; v < star->n; v++)
        if (groups->marked[v]) unite(star, groups, v);
    for (uint32_t v = 0; v < star->n; v++)
        if (groups->marked[v]) weigh(star, lies, groups, v);
    for (uint32_t v = 0; v < star->n; v++)
        if (groups->marked[v] && groups->evidence[disjoint_set_root(groups->root, v)] < 0) list[count++] = v;
    return count;
}
