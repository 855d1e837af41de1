/* On the left of a path its vertices are replaced by their copies; each disc is a fan.
 *
 *        a ---- b            a'--- b'
 *        |      |     =>     | \ / |      m, m': the middle, once for each side
 *        d ---- c            | m'  |
 *                            d'--- c'   and a, b, c, d around m
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/cut.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"

/* The half-edge from one vertex to another, which an edge joins. */
static uint32_t edge_between(const struct halfedge *he, uint32_t from, uint32_t to) {
    uint32_t h = he->out[from];
    while (halfedge_to(he, h) != to) h = halfedge_around(he, h);
    return h;
}

static uint32_t vertex_after(const struct mesh_path *path, size_t i) { return path->vertex[(i + 1) % path->count]; }

static uint32_t vertex_before(const struct mesh_path *path, size_t i) {
    return path->vertex[(i + path->count - 1) % path->count];
}

static uint32_t add_vertex(struct mesh *mesh, vec3 at, uint32_t source) {
    mesh->vertex[mesh->vertex_count] = at;
    mesh->source[mesh->vertex_count] = source;
    return (uint32_t)mesh->vertex_count++;
}

/* A disc whose rim's edges run from each vertex to the next, or, turned, to the one before. */
static void add_disc(struct mesh *mesh, const uint32_t *rim, size_t n, vec3 middle, bool turned) {
    uint32_t centre = add_vertex(mesh, middle, NONE);
    for (size_t i = 0; i < n; i++) {
        uint32_t a = rim[i], b = rim[(i + 1) % n], *corner = mesh->triangle[mesh->triangle_count];
        corner[0] = turned ? b : a, corner[1] = turned ? a : b, corner[2] = centre;
        mesh->tag[mesh->triangle_count++] = MESH_HOLE_FILL;
    }
}

/* Puts the middle of a disc off the path's, towards the triangles of its side, so that the two discs lie apart. */
static vec3 towards(vec3 middle, vec3 side) {
    static const double PART = 0.1;
    return vec3_lerp(middle, side, PART);
}

/* he has the corners as they were.  On the left of the path triangles have its edges as they run, on the right the
 * other way round, and so a disc on the right has them as they run. */
static void cut_along(struct mesh *mesh, const struct halfedge *he, const struct mesh_path *path, uint32_t *copy) {
    vec3 middle = {0}, left = {0}, right = {0};
    double part = 1 / (double)path->count;
    for (size_t i = 0; i < path->count; i++) {
        uint32_t v = path->vertex[i], along = edge_between(he, v, vertex_after(path, i));
        middle = vec3_add(middle, vec3_scale(mesh->vertex[v], part));
        left = vec3_add(left, vec3_scale(mesh->vertex[halfedge_apex(he, along)], part));
        right = vec3_add(right, vec3_scale(mesh->vertex[halfedge_apex(he, he->twin[along])], part));
        copy[i] = add_vertex(mesh, mesh->vertex[v], mesh->source[v]);
        for (uint32_t h = along; halfedge_to(he, h) != vertex_before(path, i); h = halfedge_around(he, h))
            mesh->triangle[h / 3][h % 3] = copy[i];
    }
    add_disc(mesh, path->vertex, path->count, towards(middle, right), false);
    add_disc(mesh, copy, path->count, towards(middle, left), true);
}

/* A copy with room for more. */
static enum status copy_with_room(struct mesh *copy, const struct mesh *mesh, size_t vertices, size_t triangles) {
    size_t n = mesh->vertex_count, m = mesh->triangle_count;
    *copy = (struct mesh){.vertex = alloc_array(n + vertices, sizeof *copy->vertex),
                          .source = alloc_array(n + vertices, sizeof *copy->source),
                          .triangle = alloc_array(m + triangles, sizeof *copy->triangle),
                          .tag = alloc_array(m + triangles, sizeof *copy->tag)};
    if (!copy->vertex || !copy->source || !copy->triangle || !copy->tag) return STATUS_NO_MEMORY;
    copy->vertex_count = n, copy->triangle_count = m;
    memcpy(copy->vertex, mesh->vertex, n * sizeof *copy->vertex);
    memcpy(copy->source, mesh->source, n * sizeof *copy->source);
    memcpy(copy->triangle, mesh->triangle, m * sizeof *copy->triangle);
    memcpy(copy->tag, mesh->tag, m * sizeof *copy->tag);
    return STATUS_OK;
}

enum status mesh_cut(struct mesh *mesh, const struct halfedge *he, const struct mesh_path *path, size_t paths) {
    size_t edges = 0, longest = 0;
    struct mesh cut = {0};
    for (size_t i = 0; i < paths; i++) {
        edges += path[i].count;
        longest = path[i].count > longest ? path[i].count : longest;
    }
    uint32_t *copy = alloc_array(longest, sizeof *copy);
    enum status status = copy ? copy_with_room(&cut, mesh, edges + 2 * paths, 2 * edges) : STATUS_NO_MEMORY;
    for (size_t i = 0; i < paths && !status; i++) cut_along(&cut, he, &path[i], copy);
    if (!status) {
        struct mesh before = *mesh;
        *mesh = cut, cut = before;
    }
    mesh_done(&cut);
    free(copy);
    return status;
}
