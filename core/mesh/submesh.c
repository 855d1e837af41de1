/* Corners of the triangles that are left are united over the edges between those, one tree for each fan, and each tree
 * becomes a vertex.  A vertex that keeps all its triangles keeps its fan as well: only of the others corners are
 * united.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/submesh.h"

#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/cloud/cloud.h"

struct rest {
    const struct mesh *mesh;
    const struct halfedge *he;
    const uint8_t *out;
    uint8_t *broken;  /* of each vertex: it loses a triangle */
    uint32_t *first;  /* of each other vertex: the number that it has got, or NONE */
    uint32_t *fan;    /* a forest over corners of those that are broken */
    uint32_t *vertex; /* of each corner that is left */
};

static void find_broken(const struct rest *r) {
    for (size_t t = 0; t < r->mesh->triangle_count; t++)
        for (int k = 0; k < 3 && r->out[t]; k++) r->broken[r->mesh->triangle[t][k]] = 1;
    for (size_t v = 0; v < r->mesh->vertex_count; v++) r->first[v] = NONE;
}

static void chain_fans(const struct rest *r) {
    for (uint32_t h = 0; h < 3 * r->mesh->triangle_count; h++) {
        bool from = r->broken[halfedge_from(r->he, h)], to = r->broken[halfedge_to(r->he, h)];
        if (!from && !to) continue;
        uint32_t twin = r->he->twin[h];
        if (twin == NONE || h > twin || r->out[h / 3] || r->out[twin / 3]) continue;
        if (from) disjoint_set_unite(r->fan, h, halfedge_next(twin));
        if (to) disjoint_set_unite(r->fan, halfedge_next(h), twin);
    }
}

/* A tree's root is its first corner. */
static size_t number_vertices(const struct rest *r) {
    size_t count = 0;
    for (uint32_t c = 0; c < 3 * r->mesh->triangle_count; c++) {
        if (r->out[c / 3]) continue;
        uint32_t v = halfedge_from(r->he, c), root = r->broken[v] ? disjoint_set_root(r->fan, c) : c;
        uint32_t *first = r->broken[v] ? &r->vertex[root] : &r->first[v];
        if (r->broken[v] ? root == c : *first == NONE) *first = (uint32_t)count++;
        r->vertex[c] = *first;
    }
    return count;
}

static void fill(const struct rest *r, struct mesh *mesh) {
    for (uint32_t t = 0; t < r->mesh->triangle_count; t++) {
        if (r->out[t]) continue;
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t from = r->mesh->triangle[t][k], to = r->vertex[3 * t + k];
            mesh->triangle[mesh->triangle_count][k] = to;
            mesh->vertex[to] = r->mesh->vertex[from];
            mesh->source[to] = r->mesh->source[from];
        }
        mesh->tag[mesh->triangle_count++] = r->mesh->tag[t];
    }
}

static enum status mesh_init(struct mesh *mesh, size_t vertices, size_t triangles) {
    mesh->vertex_count = vertices;
    mesh->vertex = alloc_array(vertices, sizeof *mesh->vertex);
    mesh->source = alloc_array(vertices, sizeof *mesh->source);
    mesh->triangle = alloc_array(triangles, sizeof *mesh->triangle);
    mesh->tag = alloc_array(triangles, sizeof *mesh->tag);
    return mesh->vertex && mesh->source && mesh->triangle && mesh->tag ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status submesh_without(struct mesh *mesh, const struct halfedge *he, const uint8_t *out) {
    struct rest r = {.mesh = mesh, .he = he, .out = out, .fan = disjoint_set_new(3 * mesh->triangle_count)};
    struct mesh left = {0};
    size_t count = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) count += !out[t];
    r.vertex = alloc_array(3 * mesh->triangle_count, sizeof *r.vertex);
    r.broken = alloc_zeroed(mesh->vertex_count, 1);
    r.first = alloc_array(mesh->vertex_count, sizeof *r.first);
    enum status status = r.fan && r.vertex && r.broken && r.first ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        find_broken(&r);
        chain_fans(&r);
        status = mesh_init(&left, number_vertices(&r), count);
    }
    if (!status) {
        fill(&r, &left);
        mesh_done(mesh);
        *mesh = left;
        left = (struct mesh){0};
    }
    mesh_done(&left);
    free(r.broken), free(r.first), free(r.fan), free(r.vertex);
    return status;
}
