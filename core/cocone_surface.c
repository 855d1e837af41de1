/* From labels to a mesh that is a manifold by construction.
 *
 * Every edge of the boundary has an even number of facets around it: inner wedges and outer wedges take turns.  Facets
 * that bound the same inner wedge are paired,
 *
 *        \ out /          turning from a facet through inner cells around the edge until the next facet
 *      in \   / in        comes to its partner: the pairs here are left with left, right with right.
 *     -----(e)-----
 *          out
 *
 * and so the corners of the triangles at each point are chained into closed fans.  Each fan gets a vertex of its own.
 * Partners run along their edge in opposite directions, so the mesh is oriented.
 *
 * One case is left: two pairs at an edge whose ends both have their fans joined elsewhere would share both vertices.
 * Then an outer wedge at that edge is filled and everything is done once more; as cells are only added, that ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cocone_surface.h"

#include <stdlib.h>

#include "core/alloc.h"
#include "core/cloud.h"
#include "core/cocone_cut.h"

/* A triangle's corners are those of its half facet, seen from the inner cell: clockwise from outside. */
struct surface {
    const struct cocone_star *star;
    uint8_t *inside;
    size_t count;
    uint32_t *half;     /* count: inner half facets */
    uint8_t *tag;       /* count */
    uint32_t *triangle; /* of each half facet of all cells, where it is one */
    uint32_t *fan;      /* 3 * count: forest over corners; after numbering the vertex */
};

struct edge {
    uint32_t low, high, triangle;
    uint8_t side;
};

static bool is_boundary(const struct surface *s, uint32_t half) {
    uint32_t cell = cocone_star_cell(half);
    return s->inside[cell] && !s->inside[s->star->tets->neighbour[cell][cocone_star_index(half)]];
}

static size_t count_boundary(const struct surface *s) {
    size_t count = 0;
    for (uint32_t half = 0; half < 4 * s->star->tets->finite_count; half++) count += is_boundary(s, half);
    return count;
}

static void collect(struct surface *s, const double *support, bool keep_boundary) {
    s->count = 0;
    for (uint32_t half = 0; half < 4 * s->star->tets->finite_count; half++) {
        s->triangle[half] = NONE;
        if (!is_boundary(s, half)) continue;
        uint32_t v[3];
        cocone_star_vertices(s->star, half, v);
        bool supported = cocone_cut_supported(s->star, support, v);
        if (!supported && keep_boundary) continue;
        s->triangle[half] = (uint32_t)s->count;
        s->half[s->count] = half;
        s->tag[s->count++] = supported ? MESH_SUPPORTED : MESH_HOLE_FILL;
    }
}

/* ------------------------------------------------------------------------------------------------ fans */

static uint32_t find(uint32_t *parent, uint32_t i) {
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* The smaller id is the root, so numbering by first appearance needs no table. */
static void join(uint32_t *parent, uint32_t a, uint32_t b) {
    a = find(parent, a);
    b = find(parent, b);
    if (a < b) parent[b] = a;
    else parent[a] = b;
}

static uint32_t corner_of(const struct surface *s, uint32_t triangle, uint32_t vertex) {
    uint32_t v[3];
    cocone_star_vertices(s->star, s->half[triangle], v);
    return 3 * triangle + (v[0] == vertex ? 0u : v[1] == vertex ? 1u : 2u);
}

/* The half facet that bounds the same inner wedge at the edge. */
static uint32_t partner(const struct surface *s, uint32_t half, uint32_t a, uint32_t b) {
    uint32_t other = cocone_star_turn(s->star, half, a, b);
    while (!is_boundary(s, other)) other = cocone_star_turn(s->star, cocone_star_twin(s->star, other), a, b);
    return other;
}

static void chain_fans(struct surface *s) {
    for (uint32_t i = 0; i < 3 * s->count; i++) s->fan[i] = i;
    for (uint32_t t = 0; t < s->count; t++) {
        uint32_t v[3];
        cocone_star_vertices(s->star, s->half[t], v);
        for (int k = 0; k < 3; k++) {
            uint32_t a = v[k], b = v[(k + 1) % 3], other = s->triangle[partner(s, s->half[t], a, b)];
            if (other == NONE || other < t) continue;
            join(s->fan, corner_of(s, t, a), corner_of(s, other, a));
            join(s->fan, corner_of(s, t, b), corner_of(s, other, b));
        }
    }
}

/* ------------------------------------------------------------------------------------------------ double edges */

static int by_edge(const void *x, const void *y) {
    const struct edge *a = x, *b = y;
    if (a->low != b->low) return a->low < b->low ? -1 : 1;
    if (a->high != b->high) return a->high < b->high ? -1 : 1;
    return a->triangle < b->triangle ? -1 : 1;
}

static void list_edges(struct surface *s, struct edge *edge) {
    for (uint32_t t = 0; t < s->count; t++) {
        for (uint8_t k = 0; k < 3; k++) {
            uint32_t a = find(s->fan, 3 * t + k), b = find(s->fan, 3 * t + (k + 1u) % 3);
            edge[3 * t + k] = (struct edge){a < b ? a : b, a < b ? b : a, t, k};
        }
    }
    qsort(edge, 3 * s->count, sizeof *edge, by_edge);
}

/* Puts the outer wedge across the half facet at one of its edges inside, unless it has an infinite cell. */
static bool fill_wedge(struct surface *s, uint32_t half, uint32_t a, uint32_t b) {
    uint32_t start = cocone_star_twin(s->star, half);
    bool finite = true;
    for (int pass = 0; pass < 2 && finite; pass++) {
        uint32_t at = start;
        while (!s->inside[cocone_star_cell(at)]) {
            uint32_t cell = cocone_star_cell(at);
            finite &= cocone_star_is_finite(s->star, cell);
            uint32_t next = cocone_star_twin(s->star, cocone_star_turn(s->star, at, a, b));
            if (pass) s->inside[cell] = 1;
            at = next;
        }
    }
    return finite;
}

/* Fills a wedge at each edge that has more than two triangles; true when there was one. */
static bool separate(struct surface *s, const struct edge *edge) {
    bool changed = false;
    size_t end;
    for (size_t i = 0; i < 3 * s->count; i = end) {
        for (end = i + 1; end < 3 * s->count && edge[end].low == edge[i].low && edge[end].high == edge[i].high;) end++;
        bool filled = false;
        for (size_t j = i; j < end && end - i > 2 && !filled; j++) {
            uint32_t v[3], half = s->half[edge[j].triangle];
            cocone_star_vertices(s->star, half, v);
            filled = is_boundary(s, half) && fill_wedge(s, half, v[edge[j].side], v[(edge[j].side + 1) % 3]);
        }
        changed |= filled;
    }
    return changed;
}

/* ------------------------------------------------------------------------------------------------ the mesh */

/* A fan's first corner comes first: its id is overwritten by the vertex only after all later ones have found it. */
static enum status number_vertices(struct surface *s, struct mesh *mesh) {
    uint32_t *vertex = alloc_array(3 * s->count, sizeof *vertex);
    if (!vertex) return STATUS_NO_MEMORY;
    mesh->vertex_count = 0;
    for (uint32_t i = 0; i < 3 * s->count; i++) {
        uint32_t root = find(s->fan, i);
        if (root == i) vertex[i] = (uint32_t)mesh->vertex_count++;
        else vertex[i] = vertex[root];
    }
    free(s->fan);
    s->fan = vertex;
    return STATUS_OK;
}

static void fill_mesh(const struct surface *s, struct mesh *mesh) {
    for (uint32_t t = 0; t < s->count; t++) {
        uint32_t v[3];
        cocone_star_vertices(s->star, s->half[t], v);
        for (int k = 0; k < 3; k++) {
            uint32_t id = s->fan[3 * t + (uint32_t)k];
            mesh->triangle[t][2 - k] = id;
            mesh->source[id] = v[k];
            mesh->vertex[id] = s->star->point[v[k]];
        }
    }
}

static enum status make_mesh(struct surface *s, struct mesh *out) {
    struct mesh mesh = {.triangle_count = s->count};
    enum status status = number_vertices(s, &mesh);
    if (status) return status;
    mesh.vertex = alloc_array(mesh.vertex_count, sizeof *mesh.vertex);
    mesh.source = alloc_array(mesh.vertex_count, sizeof *mesh.source);
    mesh.triangle = alloc_array(mesh.triangle_count, sizeof *mesh.triangle);
    mesh.tag = s->tag;
    s->tag = NULL;
    if (!mesh.vertex || !mesh.source || !mesh.triangle) {
        mesh_done(&mesh);
        return STATUS_NO_MEMORY;
    }
    fill_mesh(s, &mesh);
    *out = mesh;
    return STATUS_OK;
}

static void surface_done(struct surface *s) {
    free(s->half);
    free(s->tag);
    free(s->triangle);
    free(s->fan);
    s->half = s->triangle = s->fan = NULL;
    s->tag = NULL;
}

/* One attempt; *again when a wedge had to be filled. */
static enum status attempt(struct surface *s, const double *support, bool keep_boundary, struct mesh *mesh,
                           bool *again) {
    size_t most = count_boundary(s);
    struct edge *edge = alloc_array(3 * most, sizeof *edge);
    enum status status = STATUS_NO_MEMORY;
    s->half = alloc_array(most, sizeof *s->half);
    s->tag = alloc_array(most, sizeof *s->tag);
    s->triangle = alloc_array(4 * s->star->tets->finite_count, sizeof *s->triangle);
    s->fan = alloc_array(3 * most, sizeof *s->fan);
    if (!edge || !s->half || !s->tag || !s->triangle || !s->fan) goto out;
    collect(s, support, keep_boundary);
    chain_fans(s);
    list_edges(s, edge);
    *again = separate(s, edge);
    status = *again ? STATUS_OK : make_mesh(s, mesh);
out:
    free(edge);
    surface_done(s);
    return status;
}

enum status cocone_surface_extract(const struct cocone_star *star, const double *support, bool keep_boundary,
                                   uint8_t *inside, struct mesh *mesh) {
    struct surface s = {.star = star, .inside = inside};
    enum status status = STATUS_OK;
    for (bool again = true; again && !status;) status = attempt(&s, support, keep_boundary, mesh, &again);
    return status;
}
