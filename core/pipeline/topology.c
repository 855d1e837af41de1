/* Where points are dense and sheets touch, cells between them are labelled wrongly: shells of a few facets come off,
 * and handles of a few edges join the sheets.  A mesh of fewer points, which are farther apart, doesn't have them, and
 * says how many pieces and handles there are to be.  The smallest shells over that are left out, hollows of a few
 * vertices in any case, and the shortest loops that no piece of the surface ends at are cut, which takes a handle away
 * each, whether it is a bridge or a tunnel; what sticks out then, since there were no points on the way from one end of
 * it to the other, goes too (stubs.h).
 * Points tell of pieces, too, where many of them are far from all others: such that few points join are apart.
 * Where points are on thin bars, what is a tube for a way has points that tell of it (core/surface/tubes.h),
 * and stays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pipeline/topology.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/mesh/cut.h"
#include "core/mesh/submesh.h"
#include "core/pipeline/stubs.h"
#include "core/surface/handle_loops.h"
#include "core/surface/tubes.h"

enum { CRUMB = 12 /* vertices */, ROUNDS_MOST = 24, STEPS_PER_TRIANGLE = 400 /* of all searches for loops */ };

/* ------------------------------------------------------------------------------------------------ islands */

enum { NEAR = 24 /* points: those farther away are a gap */, AT_ONCE = 1024 };

/* The sets of so many of the n points that have enough of them. */
static size_t count_large(uint32_t *parent, uint32_t *size, size_t n) {
    double least = TOPOLOGY_LEFT_OUT_MOST * (double)n;
    size_t large = 0;
    for (uint32_t p = 0; p < n; p++) size[disjoint_set_root(parent, p)]++;
    for (uint32_t p = 0; p < n; p++) large += (double)size[p] > least;
    return large;
}

/* Unites each point with more of those near it than its neighbours. */
static enum status unite_near(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, uint32_t *parent) {
    uint32_t *id = alloc_array((size_t)AT_ONCE * NEAR, sizeof *id);
    double *distance_sq = alloc_array((size_t)AT_ONCE * NEAR, sizeof *distance_sq);
    enum status status = id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    unsigned k = n < NEAR ? (unsigned)n : NEAR;
    for (size_t first = 0; first < n && !status; first += AT_ONCE) {
        size_t count = n - first < AT_ONCE ? n - first : AT_ONCE;
        status = knn_search(knn, point + first, count, k, threads, id, distance_sq);
        for (size_t i = 0; i < count * k && !status; i++) disjoint_set_unite(parent, (uint32_t)(first + i / k), id[i]);
    }
    free(id), free(distance_sq);
    return status;
}

enum status topology_count_islands(const struct neighbourhood *neighbours, const struct knn *knn, const vec3 *point,
                                   unsigned threads, size_t *islands) {
    size_t n = neighbours->n, found = 1;
    uint32_t *parent = disjoint_set_new(n), *size = alloc_zeroed(n, sizeof *size);
    enum status status = parent && size ? STATUS_OK : STATUS_NO_MEMORY;
    for (uint32_t p = 0; !status && p < n; p++)
        for (size_t i = 0; i < neighbours->count[p]; i++)
            disjoint_set_unite(parent, p, neighbours->id[(size_t)p * neighbours->stride + i]);
    if (!status) found = count_large(parent, size, n);
    if (found > 1) {
        status = unite_near(knn, point, n, threads, parent);
        memset(size, 0, n * sizeof *size);
        found = status ? 1 : count_large(parent, size, n);
    }
    free(parent), free(size);
    if (!status) *islands = found ? found : 1;
    return status;
}

/* ------------------------------------------------------------------------------------------------ shells */

/* Marks the triangles of the smallest of the shells, so that `most` are left; their number. */
static enum status mark_smallest(const struct mesh *mesh, size_t most, unsigned threads, uint8_t *out, size_t *marked) {
    size_t n = mesh->vertex_count, count = 0, vertices = 0;
    uint32_t *parent = disjoint_set_new(n), *size = alloc_zeroed(n, sizeof *size);
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare);
    bool room = parent && size && item && spare;
    for (size_t t = 0; room && t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++) disjoint_set_unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    for (uint32_t v = 0; room && v < n; v++) size[disjoint_set_root(parent, v)]++;
    for (uint32_t v = 0; room && v < n; v++)
        if (parent[v] == v) item[count++] = radix_item(size[v], v);
    const uint64_t *sorted = room ? radix_sort(item, spare, count, threads) : NULL;
    *marked = 0;
    for (size_t i = 0; room && i + most < count; i++) {
        uint32_t root = radix_value(sorted[i]);
        vertices += size[root];
        if ((double)vertices > TOPOLOGY_LEFT_OUT_MOST * (double)n) break;
        size[root] = 0;
        (*marked)++;
    }
    for (size_t t = 0; room && t < mesh->triangle_count; t++)
        out[t] = size[disjoint_set_root(parent, mesh->triangle[t][0])] == 0;
    free(parent), free(size), free(item), free(spare);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

/* Marks the triangles of hollows within the body that so few vertices tell of that they are gaps between labels; their
 * number. */
static enum status mark_crumbs(const struct mesh *mesh, uint8_t *out, size_t *marked) {
    size_t n = mesh->vertex_count;
    uint32_t *parent = disjoint_set_new(n), *size = alloc_zeroed(n, sizeof *size);
    double *volume = alloc_zeroed(n, sizeof *volume);
    bool room = parent && size && volume;
    for (size_t t = 0; room && t < mesh->triangle_count; t++)
        for (int k = 0; k < 2; k++) disjoint_set_unite(parent, mesh->triangle[t][k], mesh->triangle[t][k + 1]);
    for (uint32_t v = 0; room && v < n; v++) size[disjoint_set_root(parent, v)]++;
    for (size_t t = 0; room && t < mesh->triangle_count; t++) {
        const uint32_t *corner = mesh->triangle[t];
        uint32_t root = disjoint_set_root(parent, corner[0]);
        vec3 at = vec3_sub(mesh->vertex[corner[0]], mesh->vertex[root]);
        volume[root] += vec3_dot(at, mesh_triangle_normal(mesh, t));
    }
    *marked = 0;
    for (size_t t = 0; room && t < mesh->triangle_count; t++) {
        uint32_t root = disjoint_set_root(parent, mesh->triangle[t][0]);
        out[t] = volume[root] <= 0 && size[root] <= CRUMB;
        *marked += out[t];
    }
    free(parent), free(size), free(volume);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status leave_out(struct mesh *mesh, const uint8_t *out, unsigned threads) {
    struct halfedge he = {0};
    enum status status = halfedge_init(&he, mesh, threads);
    if (!status) status = submesh_without(mesh, &he, out);
    halfedge_done(&he);
    return status;
}

static enum status leave_out_shells(struct mesh *mesh, size_t most, unsigned threads) {
    size_t marked = 0;
    uint8_t *out = alloc_array(mesh->triangle_count, 1);
    enum status status = out ? mark_smallest(mesh, most, threads, out, &marked) : STATUS_NO_MEMORY;
    if (!status && marked) status = leave_out(mesh, out, threads);
    free(out);
    return status;
}

/* *found: whether there were any. */
static enum status leave_out_crumbs(struct mesh *mesh, unsigned threads, bool *found) {
    size_t marked = 0;
    uint8_t *out = alloc_array(mesh->triangle_count, 1);
    enum status status = out ? mark_crumbs(mesh, out, &marked) : STATUS_NO_MEMORY;
    if (!status && marked) status = leave_out(mesh, out, threads);
    *found = !status && marked > 0;
    free(out);
    return status;
}

/* ------------------------------------------------------------------------------------------------ handles */

/* Of loops that share vertices the shortest is cut; the others, if they are still there, in the next round. */
static size_t choose_apart(const struct loops *loops, size_t most, uint8_t *used, struct mesh_path *path) {
    size_t chosen = 0;
    for (size_t i = 0; i < loops->count && chosen < most; i++) {
        const struct loop *loop = &loops->loop[i];
        bool apart = true;
        for (uint32_t k = 0; k < loop->count; k++) apart = apart && !used[loop->vertex[k]];
        if (!apart) continue;
        for (uint32_t k = 0; k < loop->count; k++) used[loop->vertex[k]] = 1;
        path[chosen++] = (struct mesh_path){loop->vertex, loop->count};
    }
    return chosen;
}

/* mesh_cut puts the middles of a path's two discs behind the copies of its vertices. */
static void list_middles(size_t vertex, const struct mesh_path *path, size_t paths, uint32_t (*middle)[2]) {
    for (size_t i = 0; i < paths; i++, vertex += 2) {
        vertex += path[i].count;
        middle[i][0] = (uint32_t)vertex, middle[i][1] = (uint32_t)vertex + 1;
    }
}

static enum status cut_loops(struct mesh *mesh, const struct loops *loops, size_t most, unsigned threads) {
    struct halfedge he = {0};
    uint8_t *used = alloc_zeroed(mesh->vertex_count, 1);
    struct mesh_path *path = alloc_array(loops->count, sizeof *path);
    uint32_t(*middle)[2] = alloc_array(loops->count, sizeof *middle);
    enum status status = used && path && middle ? halfedge_init(&he, mesh, threads) : STATUS_NO_MEMORY;
    size_t vertices = mesh->vertex_count, paths = 0;
    if (!status) paths = choose_apart(loops, most, used, path);
    if (!status) status = mesh_cut(mesh, &he, path, paths);
    halfedge_done(&he);
    if (!status) list_middles(vertices, path, paths, middle);
    if (!status) status = stubs_leave_out(mesh, middle, paths, threads);
    free(used), free(path), free(middle);
    return status;
}

/* Short loops first: what is narrower is less sure to be there. */
static enum status cut_shortest(struct mesh *mesh, size_t most, size_t *steps, unsigned threads, bool *found,
                                long *tubes /* that stay; NULL = none do */) {
    enum status status = STATUS_OK;
    *found = false;
    for (uint32_t edges = 3; edges <= LOOPS_MOST_EDGES && !*found && !status; edges *= 2) {
        struct loops loops = {0};
        status = loops_find(mesh, edges, steps, &loops);
        if (!status && tubes && loops.count > 0) status = tubes_leave(mesh, &loops, tubes);
        *found = !status && loops.count > 0;
        if (*found) status = cut_loops(mesh, &loops, most, threads);
        loops_done(&loops);
    }
    return status;
}

enum status topology_find(const struct mesh *mesh, struct topology *topology) {
    struct mesh_facts facts;
    enum status status = mesh_examine(mesh, &facts);
    if (!status)
        *topology = (struct topology){.components = facts.components,
                                      .handles = (2 * (long)facts.components - facts.euler) / 2};
    return status;
}

enum status topology_count_tubes(const struct mesh *mesh, struct topology *topology) {
    size_t steps = STEPS_PER_TRIANGLE * mesh->triangle_count;
    struct loops loops = {0};
    long tubes = 0;
    enum status status = loops_find(mesh, LOOPS_MOST_EDGES, &steps, &loops);
    if (!status && loops.count > 0) status = tubes_leave(mesh, &loops, &tubes);
    loops_done(&loops);
    if (!status) topology->tubes = tubes < topology->handles ? tubes : topology->handles;
    return status;
}

enum status topology_simplify(struct mesh *mesh, const struct topology *than, bool bars, unsigned threads,
                              struct topology *topology) {
    size_t steps = STEPS_PER_TRIANGLE * mesh->triangle_count;
    bool found = true;
    long tubes = 0;
    enum status status = STATUS_OK;
    for (int i = 0; i < ROUNDS_MOST && !status && found && topology->handles > than->handles; i++) {
        status = cut_shortest(mesh, (size_t)(topology->handles - than->handles), &steps, threads, &found,
                              bars ? &tubes : NULL);
        if (!status) status = topology_find(mesh, topology);
    }
    bool wide = !found && steps > 0;
    if (!status && topology->components > than->components) {
        status = leave_out_shells(mesh, than->components, threads);
        if (!status) status = topology_find(mesh, topology);
    }
    if (!status && topology->components > 1) {
        bool crumbs;
        status = leave_out_crumbs(mesh, threads, &crumbs);
        if (crumbs) status = topology_find(mesh, topology);
    }
    topology->wide = wide, topology->tubes = tubes < topology->handles ? tubes : topology->handles;
    return status;
}
