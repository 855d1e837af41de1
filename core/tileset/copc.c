/* The tree is made of the coordinates as LAS has them, so that no point is written outside of its cube.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tileset/copc.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/radix.h"
#include "core/io/out/las_write.h"
#include "core/spatial/knn.h"
#include "core/tileset/octree.h"

static const double WIDER = 1 + 0x1p-40; /* readers round where cubes end */

/* i's bits below `bits` in the reverse order. */
static size_t reversed(size_t i, unsigned bits) {
    size_t r = 0;
    for (unsigned b = 0; b < bits; b++) r |= (i >> b & 1) << (bits - 1 - b);
    return r;
}

/* All points in an order any beginning of which spreads over the cloud: every 2^k-th along a curve before those between
 * them. */
static enum status spread(const vec3 *place, size_t n, const struct octree_cube *cube, unsigned threads, uint32_t *id) {
    uint64_t *item = alloc_array(n, sizeof *item), *other = alloc_array(n, sizeof *other);
    unsigned bits = 0;
    size_t used = 0;
    while ((size_t)1 << bits < n) bits++;
    for (size_t i = 0; item && other && i < n; i++)
        item[i] = radix_item(octree_curve_place(cube, place[i]), (uint32_t)i);
    const uint64_t *sorted = item && other ? radix_sort(item, other, n, threads) : NULL;
    for (size_t i = 0; sorted && i < (size_t)1 << bits; i++) {
        size_t at = reversed(i, bits);
        if (at < n) id[used++] = radix_value(sorted[at]);
    }
    free(item), free(other);
    return sorted ? STATUS_OK : STATUS_NO_MEMORY;
}

static struct octree_cube cube_around_places(const vec3 *place, size_t n) {
    vec3 low = place[0], high = low;
    for (size_t i = 1; i < n; i++) low = vec3_min(low, place[i]), high = vec3_max(high, place[i]);
    struct octree_cube cube = octree_cube_around(low, high);
    cube.half *= WIDER;
    return cube;
}

/* How far the root's own points are from their nearest, in the mean. */
static enum status measure_spacing(const struct octree *tree, unsigned threads, double *spacing) {
    size_t n = tree->node[0].own;
    struct knn *knn = NULL;
    uint32_t *id = alloc_array(2 * n, sizeof *id);
    double *distance_sq = alloc_array(2 * n, sizeof *distance_sq), sum = 0;
    enum status status = id && distance_sq ? knn_new(tree->point, n, threads, &knn, NULL) : STATUS_NO_MEMORY;
    if (!status) status = knn_search(knn, tree->point, n, 2, threads, id, distance_sq);
    for (size_t i = 0; !status && n > 1 && i < n; i++) sum += sqrt(distance_sq[2 * i + 1]);
    if (sum > 0) *spacing = sum / (double)n;
    knn_free(knn);
    free(id), free(distance_sq);
    return status;
}

/* Nodes as the cubes that they are: which one of its level follows from any of its points. */
static void name_cubes(const struct octree *tree, struct octree_cube root, struct las_cube *cube) {
    for (size_t t = 0; t < tree->count; t++) {
        const struct octree_node *node = &tree->node[t];
        struct octree_cube at = root;
        cube[t] = (struct las_cube){.level = node->depth, .points = (uint32_t)node->own};
        for (unsigned level = 0; level < node->depth; level++) {
            unsigned part = octree_part_of(&at, tree->point[node->first]);
            for (int axis = 0; axis < 3; axis++) cube[t].at[axis] = cube[t].at[axis] << 1 | (part >> axis & 1);
            at = octree_cube_part(&at, part);
        }
    }
}

/* rank: ids by rank, n of them, which become those of the tree's points. */
static enum status put_tree(int fd, const struct cloud *cloud, struct octree *tree, struct octree_cube root,
                            const uint32_t *rank, unsigned threads, struct left_out *left_out, struct error *error) {
    struct las_cube *cube = alloc_array(tree->count, sizeof *cube);
    struct las_cubes cubes = {cube, tree->count, root.centre, root.half, root.half};
    enum status status = cube ? measure_spacing(tree, threads, &cubes.spacing) : STATUS_NO_MEMORY;
    if (!status) {
        name_cubes(tree, root, cube);
        for (size_t i = 0; i < tree->points; i++) tree->rank[i] = rank[tree->rank[i]];
        status = cloud_write_copc(fd, cloud, tree->rank, tree->points, &cubes, threads, left_out, error);
    }
    free(cube);
    return status;
}

enum status copc_write(int fd, const struct cloud *cloud, const uint32_t *kept, size_t n, unsigned threads,
                       struct left_out *left_out, struct error *error) {
    struct octree tree = {0};
    struct octree_cube cube = {0};
    vec3 *place = alloc_array(n, sizeof *place), *by_rank = alloc_array(n, sizeof *by_rank);
    uint32_t *rank = alloc_array(n, sizeof *rank);
    enum status status = place && by_rank && rank ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        las_places(cloud, kept, n, place);
        cube = cube_around_places(place, n);
        if (!kept) status = spread(place, n, &cube, threads, rank);
    }
    for (size_t i = 0; !status && i < n; i++) by_rank[i] = place[kept ? i : rank[i]];
    for (size_t i = 0; !status && kept && i < n; i++) rank[i] = kept[i];
    free(place);
    if (!status) status = octree_make(by_rank, n, cube, 0, false, threads, &tree);
    free(by_rank);
    if (!status) status = put_tree(fd, cloud, &tree, cube, rank, threads, left_out, error);
    if (status == STATUS_NO_MEMORY)
        status = error_set(error, status, "write", "not enough memory for COPC of %zu points", n);
    octree_done(&tree);
    free(rank);
    return status;
}
