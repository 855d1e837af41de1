/* What a mesh is, combinatorially and in measure.
 *
 * Every triangle has three corners and three half-edges; half-edge and corner 3t + k are those at vertex k of triangle
 * t, the half-edge running from it to the next vertex.  Half-edges are sorted by their undirected edge (bucketed by the
 * smaller vertex, then sorted by the larger): each run of equal ones is an edge, and its length and directions tell
 * what kind.
 *
 * A fan is a set of corners at one vertex that are linked across edges; corners are united in a forest, the corners of
 * both ends for each pair of neighbours along a run, and a vertex with more than one tree is non-manifold.  Components
 * are those of the vertices, by another forest: two surfaces that touch in a vertex are one component.
 *
 * Sums run in the order of the triangles, so results are the same everywhere.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/mesh/mesh.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"

struct half_edge {
    uint32_t larger;  /* of its two vertices */
    uint32_t forward; /* 1: runs from the smaller vertex to the larger */
    size_t corner;    /* where it starts */
};

struct workspace {
    const struct mesh *mesh;
    size_t corner_count;
    size_t *bucket;           /* vertex_count + 1: half-edges of smaller vertex v are bucket[v] .. bucket[v+1]-1 */
    struct half_edge *half;   /* corner_count */
    size_t *fan;              /* corner_count: forest of corners */
    size_t *component;        /* vertex_count: forest of vertices */
    size_t *fans_at;          /* vertex_count: how many fans; 0 = unused vertex */
    size_t *border;           /* vertex_count: forest of vertices, over boundary edges */
    unsigned char *on_border; /* vertex_count */
};

void mesh_done(struct mesh *mesh) {
    if (!mesh) return;
    free(mesh->vertex);
    free(mesh->source);
    free(mesh->triangle);
    free(mesh->tag);
    *mesh = (struct mesh){0};
}

enum status mesh_copy(struct mesh *copy, const struct mesh *mesh) {
    *copy = *mesh;
    copy->vertex = alloc_array(mesh->vertex_count, sizeof *copy->vertex);
    copy->triangle = alloc_array(mesh->triangle_count, sizeof *copy->triangle);
    copy->source = mesh->source ? alloc_array(mesh->vertex_count, sizeof *copy->source) : NULL;
    copy->tag = mesh->tag ? alloc_array(mesh->triangle_count, sizeof *copy->tag) : NULL;
    if (!copy->vertex || !copy->triangle || (mesh->source && !copy->source) || (mesh->tag && !copy->tag))
        return STATUS_NO_MEMORY;
    memcpy(copy->vertex, mesh->vertex, mesh->vertex_count * sizeof *copy->vertex);
    memcpy(copy->triangle, mesh->triangle, mesh->triangle_count * sizeof *copy->triangle);
    if (mesh->source) memcpy(copy->source, mesh->source, mesh->vertex_count * sizeof *copy->source);
    if (mesh->tag) memcpy(copy->tag, mesh->tag, mesh->triangle_count * sizeof *copy->tag);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ forests */

static void disjoint_set_init(size_t *parent, size_t n) {
    for (size_t i = 0; i < n; i++) parent[i] = i;
}

static size_t disjoint_set_root(size_t *parent, size_t i) {
    for (; parent[i] != i; i = parent[i]) parent[i] = parent[parent[i]];
    return i;
}

/* The smaller root wins. */
static void disjoint_set_unite(size_t *parent, size_t i, size_t j) {
    size_t a = disjoint_set_root(parent, i), b = disjoint_set_root(parent, j);
    if (a < b)
        parent[b] = a;
    else
        parent[a] = b;
}

/* ------------------------------------------------------------------------------------------------ half-edges */

static uint32_t vertex_at(const struct workspace *w, size_t corner) {
    return w->mesh->triangle[corner / 3][corner % 3];
}

static size_t next_corner(size_t corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }

static int compare(const void *a, const void *b) {
    const struct half_edge *p = a, *q = b;
    if (p->larger != q->larger) return p->larger < q->larger ? -1 : 1;
    return p->corner < q->corner ? -1 : p->corner > q->corner;
}

static void collect_half_edges(struct workspace *w) {
    for (size_t c = 0; c < w->corner_count; c++) {
        uint32_t a = vertex_at(w, c), b = vertex_at(w, next_corner(c));
        w->bucket[a < b ? a : b]++;
    }
    size_t n = w->mesh->vertex_count;
    for (size_t v = 1; v <= n; v++) w->bucket[v] += w->bucket[v - 1]; /* ends of buckets, which filling makes begins */
    for (size_t c = w->corner_count; c-- > 0;) {
        uint32_t a = vertex_at(w, c), b = vertex_at(w, next_corner(c));
        w->half[--w->bucket[a < b ? a : b]] = (struct half_edge){a < b ? b : a, a < b, c};
    }
    for (size_t v = 0; v < n; v++)
        if (w->bucket[v + 1] - w->bucket[v] > 1)
            qsort(w->half + w->bucket[v], w->bucket[v + 1] - w->bucket[v], sizeof *w->half, compare);
}

/* Links the corners of two triangles at both ends of the edge that they share. */
static void link_fans(struct workspace *w, const struct half_edge *a, const struct half_edge *b) {
    size_t a_smaller = a->forward ? a->corner : next_corner(a->corner);
    size_t a_larger = a->forward ? next_corner(a->corner) : a->corner;
    size_t b_smaller = b->forward ? b->corner : next_corner(b->corner);
    size_t b_larger = b->forward ? next_corner(b->corner) : b->corner;
    disjoint_set_unite(w->fan, a_smaller, b_smaller);
    disjoint_set_unite(w->fan, a_larger, b_larger);
}

static void count_boundary(struct workspace *w, size_t corner, struct mesh_facts *facts) {
    uint32_t a = vertex_at(w, corner), b = vertex_at(w, next_corner(corner));
    facts->boundary_edges++;
    facts->border_length += vec3_distance(w->mesh->vertex[a], w->mesh->vertex[b]);
    w->on_border[a] = w->on_border[b] = 1;
    disjoint_set_unite(w->border, a, b);
}

/* One edge: the n half-edges from first on. */
static void count_edge(struct workspace *w, const struct half_edge *first, size_t n, struct mesh_facts *facts) {
    facts->edges++;
    if (n == 1) count_boundary(w, first->corner, facts);
    if (n > 2) facts->nonmanifold_edges++;
    if (n == 2 && first[0].forward == first[1].forward) facts->misoriented_edges++;
    for (size_t i = 1; i < n; i++) link_fans(w, &first[i - 1], &first[i]);
}

static void count_edges(struct workspace *w, struct mesh_facts *facts) {
    for (size_t v = 0; v < w->mesh->vertex_count; v++) {
        size_t end = w->bucket[v + 1], next;
        for (size_t i = w->bucket[v]; i < end; i = next) {
            for (next = i + 1; next < end && w->half[next].larger == w->half[i].larger;) next++;
            disjoint_set_unite(w->component, v, w->half[i].larger);
            count_edge(w, &w->half[i], next - i, facts);
        }
    }
}

/* ------------------------------------------------------------------------------------------------ vertices, measure */

static void count_vertices(struct workspace *w, struct mesh_facts *facts) {
    for (size_t c = 0; c < w->corner_count; c++)
        if (w->fan[c] == c) w->fans_at[vertex_at(w, c)]++;
    for (size_t v = 0; v < w->mesh->vertex_count; v++) {
        if (w->fans_at[v] == 0)
            facts->unused_vertices++;
        else if (w->component[v] == v)
            facts->components++;
        if (w->fans_at[v] > 1) facts->nonmanifold_vertices++;
        facts->borders += w->on_border[v] && w->border[v] == v;
    }
}

/* Volume of the tetrahedra from the first vertex, so that a mesh far from the origin loses nothing. */
static void measure(const struct mesh *mesh, struct mesh_facts *facts) {
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 origin = mesh->vertex[mesh->triangle[0][0]];
        vec3 a = vec3_sub(mesh->vertex[mesh->triangle[t][0]], origin);
        vec3 b = vec3_sub(mesh->vertex[mesh->triangle[t][1]], origin);
        vec3 c = vec3_sub(mesh->vertex[mesh->triangle[t][2]], origin);
        facts->area += vec3_length(vec3_triangle_normal(a, b, c)) / 2;
        facts->volume += vec3_dot(a, vec3_cross(b, c)) / 6;
    }
}

static void conclude(const struct mesh *mesh, struct mesh_facts *facts) {
    facts->euler =
        (long)(mesh->vertex_count - facts->unused_vertices) - (long)facts->edges + (long)mesh->triangle_count;
    facts->watertight = mesh->triangle_count > 0 && facts->boundary_edges == 0 && facts->nonmanifold_edges == 0 &&
                        facts->misoriented_edges == 0;
    facts->manifold = mesh->triangle_count > 0 && facts->nonmanifold_edges == 0 && facts->nonmanifold_vertices == 0;
}

static int allocate(struct workspace *w) {
    size_t n = w->mesh->vertex_count;
    w->bucket = alloc_zeroed(n + 1, sizeof *w->bucket);
    w->half = alloc_array(w->corner_count, sizeof *w->half);
    w->fan = alloc_array(w->corner_count, sizeof *w->fan);
    w->component = alloc_array(n, sizeof *w->component);
    w->fans_at = alloc_zeroed(n, sizeof *w->fans_at);
    w->border = alloc_array(n, sizeof *w->border);
    w->on_border = alloc_zeroed(n, 1);
    return w->bucket && w->half && w->fan && w->component && w->fans_at && w->border && w->on_border;
}

enum status mesh_examine(const struct mesh *mesh, struct mesh_facts *facts) {
    struct mesh_facts counted = {0};
    struct workspace w = {.mesh = mesh, .corner_count = 3 * mesh->triangle_count};
    enum status status = allocate(&w) ? STATUS_OK : STATUS_NO_MEMORY;
    if (status) goto out;
    disjoint_set_init(w.fan, w.corner_count);
    disjoint_set_init(w.component, mesh->vertex_count);
    disjoint_set_init(w.border, mesh->vertex_count);
    collect_half_edges(&w);
    count_edges(&w, &counted);
    count_vertices(&w, &counted);
    measure(mesh, &counted);
    conclude(mesh, &counted);
    *facts = counted;
out:
    free(w.bucket);
    free(w.half);
    free(w.fan);
    free(w.component);
    free(w.fans_at);
    free(w.border);
    free(w.on_border);
    return status;
}
