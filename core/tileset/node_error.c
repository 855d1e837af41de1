/* The largest of many distances needs few of them: neighbours along the curve are near each other, so what is known of
 * the middle of some bounds all of these.  Middles are looked up for every node above, and points only where they could
 * still be the farthest.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/node_error.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"

enum { GROUP = 8, DEPTHS = OCTREE_DEEPEST + 1, BATCH = 1 << 16, TRIED = 1 << 9 };
/* What bounds are rounded by, of sums of a few roots. */
static const double SLACK = 1 + 1e-12;

/* Points that follow each other, of one node. */
struct group {
    size_t first;
    unsigned count;
    double radius;
};

struct measuring {
    struct octree *tree;
    unsigned threads;
    size_t count;
    struct group *group; /* owned, as all that follows */
    vec3 *middle;        /* of each */
    double *near;        /* of each: the distance to what is shown of the nodes above, squared */
    size_t *from;        /* of each node: its first group */
    uint32_t *id;
    double *distance_sq;
    vec3 *query;
    uint64_t *item, *spare;
    struct knn *above[DEPTHS]; /* of the nodes from the top to the present one */
};

static size_t groups_of(const struct octree_node *node) { return (node->own + GROUP - 1) / GROUP; }

static void make_group(struct measuring *m, size_t g, size_t first, size_t n) {
    const vec3 *point = m->tree->point + first;
    vec3 low = point[0], high = point[0];
    for (size_t i = 1; i < n; i++) {
        low = vec3_min(low, point[i]);
        high = vec3_max(high, point[i]);
    }
    double farthest = 0;
    m->middle[g] = vec3_lerp(low, high, 0.5);
    for (size_t i = 0; i < n; i++) farthest = fmax(farthest, vec3_distance_sq(point[i], m->middle[g]));
    m->group[g] = (struct group){first, (unsigned)n, sqrt(farthest)};
    m->near[g] = INFINITY;
}

static enum status make_groups(struct measuring *m) {
    const struct octree *tree = m->tree;
    for (size_t t = 0; t < tree->count; t++) m->count += groups_of(&tree->node[t]);
    m->group = alloc_array(m->count, sizeof *m->group);
    m->middle = alloc_array(m->count, sizeof *m->middle);
    m->near = alloc_array(m->count, sizeof *m->near);
    m->item = alloc_array(m->count, sizeof *m->item);
    m->spare = alloc_array(m->count, sizeof *m->spare);
    m->from = alloc_array(tree->count + 1, sizeof *m->from);
    m->id = alloc_array(BATCH, sizeof *m->id);
    m->distance_sq = alloc_array(BATCH, sizeof *m->distance_sq);
    m->query = alloc_array((size_t)TRIED * GROUP, sizeof *m->query);
    if (!m->group || !m->middle || !m->near || !m->item || !m->spare || !m->from || !m->id || !m->distance_sq ||
        !m->query)
        return STATUS_NO_MEMORY;
    size_t g = 0;
    for (size_t t = 0; t < tree->count; t++) {
        const struct octree_node *node = &tree->node[t];
        m->from[t] = g;
        for (size_t i = 0; i < node->own; i += GROUP)
            make_group(m, g++, node->first + i, node->own - i < GROUP ? node->own - i : GROUP);
    }
    m->from[tree->count] = g;
    return STATUS_OK;
}

/* The middles of groups from .. to-1: nearer where a point of the node is. */
static enum status look_up_middles(struct measuring *m, const struct knn *own, size_t from, size_t to) {
    enum status status = STATUS_OK;
    for (size_t g = from; g < to && !status; g += BATCH) {
        size_t n = to - g < BATCH ? to - g : BATCH;
        status = knn_search(own, m->middle + g, n, 1, m->threads, m->id, m->distance_sq);
        for (size_t i = 0; i < n && !status; i++) m->near[g + i] = fmin(m->near[g + i], m->distance_sq[i]);
    }
    return status;
}

/* None of the group's points is farther from what is shown. */
static double at_most(const struct measuring *m, size_t g) { return (sqrt(m->near[g]) + m->group[g].radius) * SLACK; }

/* Raises *largest to the largest distance of the points of n groups. */
static enum status try_groups(struct measuring *m, unsigned depth, const uint64_t *item, size_t n, double *largest) {
    double nearest[TRIED * GROUP];
    size_t count = 0;
    enum status status = STATUS_OK;
    for (size_t i = 0; i < n; i++) {
        const struct group *group = &m->group[radix_value(item[i])];
        for (unsigned k = 0; k < group->count; k++) m->query[count++] = m->tree->point[group->first + k];
    }
    for (size_t i = 0; i < count; i++) nearest[i] = INFINITY;
    for (unsigned d = 0; d <= depth && !status; d++) {
        status = knn_search(m->above[d], m->query, count, 1, m->threads, m->id, m->distance_sq);
        for (size_t i = 0; i < count && !status; i++) nearest[i] = fmin(nearest[i], m->distance_sq[i]);
    }
    for (size_t i = 0; i < count; i++) *largest = fmax(*largest, sqrt(nearest[i]));
    return status;
}

/* Groups from .. to-1, those that may be farthest first. */
static enum status find_largest(struct measuring *m, unsigned depth, size_t from, size_t to, double *largest) {
    double known = 0; /* some point is as far as this */
    size_t n = 0;
    for (size_t g = from; g < to; g++) known = fmax(known, sqrt(m->near[g]) - m->group[g].radius);
    for (size_t g = from; g < to; g++)
        if (at_most(m, g) >= known) m->item[n++] = radix_item(~radix_key_of(at_most(m, g)), (uint32_t)g);
    const uint64_t *item = radix_sort(m->item, m->spare, n, m->threads);
    enum status status = STATUS_OK;
    for (size_t i = 0; i < n && !status; i += TRIED) {
        if (at_most(m, radix_value(item[i])) <= *largest * (1 - 1e-6)) break; /* keys are rounded to floats */
        status = try_groups(m, depth, item + i, n - i < TRIED ? n - i : TRIED, largest);
    }
    return status;
}

static enum status measure_node(struct measuring *m, size_t t) {
    struct octree_node *node = &m->tree->node[t];
    struct knn **own = &m->above[node->depth];
    for (unsigned d = node->depth; d < DEPTHS; d++) {
        knn_free(m->above[d]);
        m->above[d] = NULL;
    }
    if (node->own == node->count) return STATUS_OK;
    enum status status = knn_new(m->tree->point + node->first, node->own, m->threads, own, NULL);
    size_t from = m->from[t + 1], to = m->from[node->next];
    if (!status) status = look_up_middles(m, *own, from, to);
    if (!status) status = find_largest(m, node->depth, from, to, &node->error);
    return status;
}

/* All points of the tree, as what is below each of the nodes above it. */
static enum status measure_above(struct measuring *m, struct node_chain *chain) {
    enum status status = STATUS_OK;
    for (unsigned d = 0; d < chain->count && !status; d++) {
        m->above[d] = chain->above[d];
        status = look_up_middles(m, m->above[d], 0, m->count);
        if (!status) status = find_largest(m, d, 0, m->count, &chain->error[d]);
    }
    return status;
}

enum status node_errors(struct octree *tree, struct node_chain *chain, unsigned threads) {
    struct measuring m = {.tree = tree, .threads = threads};
    unsigned above = chain ? chain->count : 0;
    enum status status = make_groups(&m);
    if (!status && chain) status = measure_above(&m, chain);
    for (size_t t = 0; t < tree->count && !status; t++) status = measure_node(&m, t);
    for (unsigned d = above; d < DEPTHS; d++) knn_free(m.above[d]);
    free(m.group), free(m.middle), free(m.near), free(m.item), free(m.spare);
    free(m.from), free(m.id), free(m.distance_sq), free(m.query);
    return status;
}
