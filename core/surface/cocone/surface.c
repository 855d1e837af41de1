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
 * Then an outer wedge at that edge is filled and everything is done once more.  Where that would lose a point, an inner
 * wedge is emptied instead, in the first EMPTYING rounds; after those cells are only added, and that ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/surface.h"

#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/disjoint_set.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/cloud/cloud.h"
#include "core/surface/cocone/boundary.h"
#include "core/surface/cocone/cocone_internal.h"

enum { GRAIN = 2048, EDGE_GRAIN = 8192, EMPTYING = 4 };

/* An edge of a triangle, from its corner `side` to the next, between two ids. */
struct edge {
    uint32_t low, high, triangle;
    uint8_t side;
};

struct surface {
    const struct cocone_star *star;
    const vec3 *point;
    const double *support;
    uint8_t *inside;
    size_t count;
    uint32_t (*vertex)[3]; /* count: points of each triangle, counter-clockwise from outside */
    uint8_t *tag;          /* count */
    uint32_t *half;        /* count: the triangle as a half facet of an inner cell */
    uint32_t *triangle;    /* of each half facet that is boundary */
    uint32_t *fan;         /* 3 * count: forest over corners; after numbering the vertex */
    uint32_t *pair;    /* 3 * count: of the edge from each corner, the triangle that is paired with this one there */
    struct edge *edge; /* 3 * count */
    uint64_t *item;    /* 6 * count: to sort them by */
    unsigned threads;
};

static bool is_boundary(const struct surface *s, uint32_t half) {
    return cocone_boundary_has(s->star, s->inside, half);
}

static void set_triangle(struct surface *s, size_t t, const uint32_t v[3]) {
    memcpy(s->vertex[t], v, sizeof s->vertex[t]);
    s->tag[t] = cocone_cut_supported(s->point, s->support, v) ? MESH_SUPPORTED : MESH_HOLE_FILL;
}

static void set_range(void *ctx, size_t begin, size_t end) {
    struct surface *s = ctx;
    for (size_t t = begin; t < end; t++) {
        uint32_t v[3];
        cocone_star_vertices(s->star, s->half[t], v);
        set_triangle(s, t, (uint32_t[3]){v[2], v[1], v[0]});
        s->triangle[s->half[t]] = (uint32_t)t;
    }
}

/* ------------------------------------------------------------------------------------------------ fans */

static uint32_t corner_of(const struct surface *s, uint32_t triangle, uint32_t vertex) {
    const uint32_t *v = s->vertex[triangle];
    return 3 * triangle + (v[0] == vertex ? 0u : v[1] == vertex ? 1u : 2u);
}

/* The fans of two triangles go on over their common edge. */
static void join_at_edge(struct surface *s, uint32_t t, uint32_t u, uint32_t a, uint32_t b) {
    disjoint_set_unite(s->fan, corner_of(s, t, a), corner_of(s, u, a));
    disjoint_set_unite(s->fan, corner_of(s, t, b), corner_of(s, u, b));
}

/* The half facet that bounds the same inner wedge at the edge. */
static uint32_t partner(const struct surface *s, uint32_t half, uint32_t a, uint32_t b) {
    uint32_t other = cocone_star_turn(s->star, half, a, b);
    while (!is_boundary(s, other)) other = cocone_star_turn(s->star, cocone_star_twin(s->star, other), a, b);
    return other;
}

/* Every pair once: of the two triangles one alone runs along the edge from the smaller to the larger point. */
static bool is_first(const struct surface *s, uint32_t t, int k) { return s->vertex[t][k] < s->vertex[t][(k + 1) % 3]; }

static void pair_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (uint32_t t = (uint32_t)begin; t < end; t++)
        for (int k = 0; k < 3; k++)
            if (is_first(s, t, k))
                s->pair[3 * t + (uint32_t)k] =
                    s->triangle[partner(s, s->half[t], s->vertex[t][k], s->vertex[t][(k + 1) % 3])];
}

static void chain_fans(struct surface *s) {
    par_for(s->threads, s->count, GRAIN, pair_range, s);
    for (uint32_t t = 0; t < s->count; t++) {
        for (int k = 0; k < 3; k++) {
            if (!is_first(s, t, k)) continue;
            join_at_edge(s, t, s->pair[3 * t + (uint32_t)k], s->vertex[t][k], s->vertex[t][(k + 1) % 3]);
        }
    }
}

/* ------------------------------------------------------------------------------------------------ double edges */

/* The edge from corner i % 3 of triangle i / 3: between fans, or between points. */
static struct edge edge_at(const struct surface *s, bool between_fans, uint32_t i) {
    uint32_t t = i / 3, k = i % 3, next = (k + 1) % 3;
    uint32_t a = between_fans ? s->fan[i] : s->vertex[t][k];
    uint32_t b = between_fans ? s->fan[3 * t + next] : s->vertex[t][next];
    return (struct edge){a < b ? a : b, a < b ? b : a, t, (uint8_t)k};
}

struct edge_list {
    const struct surface *surface;
    bool between_fans;
    uint64_t *item;
    struct edge *edge;
};

static void high_range(void *ctx, size_t begin, size_t end) {
    const struct edge_list *l = ctx;
    for (size_t i = begin; i < end; i++)
        l->item[i] = radix_item(edge_at(l->surface, l->between_fans, (uint32_t)i).high, (uint32_t)i);
}

static void low_range(void *ctx, size_t begin, size_t end) {
    const struct edge_list *l = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t at = radix_value(l->item[i]);
        l->item[i] = radix_item(edge_at(l->surface, l->between_fans, at).low, at);
    }
}

static void edge_range(void *ctx, size_t begin, size_t end) {
    const struct edge_list *l = ctx;
    for (size_t i = begin; i < end; i++) l->edge[i] = edge_at(l->surface, l->between_fans, radix_value(l->item[i]));
}

/* All edges in order of low, high and triangle: sorted by high, then by low.  item: scratch for two of each. */
static void list_edges(const struct surface *s, bool between_fans, uint64_t *item, struct edge *edge) {
    size_t count = 3 * s->count;
    struct edge_list l = {s, between_fans, item, edge};
    par_for(s->threads, count, EDGE_GRAIN, high_range, &l);
    l.item = radix_sort(item, item + count, count, s->threads);
    par_for(s->threads, count, EDGE_GRAIN, low_range, &l);
    l.item = radix_sort(l.item, l.item == item ? item + count : item, count, s->threads);
    par_for(s->threads, count, EDGE_GRAIN, edge_range, &l);
}

/* Cells of one label around an edge, between two facets of the surface. */
struct wedge {
    uint32_t start, a, b; /* half facet of the first cell; the edge */
    size_t cells;         /* 0 where one is infinite */
};

static struct wedge wedge_at(const struct surface *s, uint32_t start, const uint32_t edge[2]) {
    struct wedge wedge = {start, edge[0], edge[1], 0};
    uint8_t label = s->inside[cocone_star_cell(start)];
    size_t count = 0;
    for (uint32_t at = start; s->inside[cocone_star_cell(at)] == label; count++) {
        if (!cocone_star_is_finite(s->star, cocone_star_cell(at))) return wedge;
        at = cocone_star_twin(s->star, cocone_star_turn(s->star, at, wedge.a, wedge.b));
    }
    wedge.cells = count;
    return wedge;
}

static bool has_no_vertex(const struct surface *s, uint32_t v) {
    const struct cocone_star *star = s->star;
    uint8_t first = s->inside[cocone_star_cell(star->corner[star->begin[v]])];
    for (uint32_t i = star->begin[v]; i < star->begin[v + 1]; i++)
        if (s->inside[cocone_star_cell(star->corner[i])] != first) return false;
    return true;
}

/* Whether that leaves one of their points without a surface. */
static bool flip_wedge(struct surface *s, const struct wedge *wedge) {
    bool loses = false;
    uint32_t at = wedge->start;
    for (size_t i = 0; i < wedge->cells; i++) {
        uint32_t cell = cocone_star_cell(at);
        s->inside[cell] ^= 1;
        for (int k = 0; k < 4; k++) loses |= has_no_vertex(s, s->star->tets->vertex[cell][k]);
        at = cocone_star_twin(s->star, cocone_star_turn(s->star, at, wedge->a, wedge->b));
    }
    return loses;
}

/* Ways to take the wedges at an edge apart, the best first. */
enum way { FILL, EMPTY, FILL_AND_LOSE, WAYS };

/* Flips the wedge on the outer or the inner side of a half facet.  False, and nothing done, where that isn't possible,
 * or would lose a point that may not be lost. */
static bool take_apart(struct surface *s, uint32_t half, const uint32_t edge[2], enum way way) {
    struct wedge wedge = wedge_at(s, way == EMPTY ? half : cocone_star_twin(s->star, half), edge);
    bool loses = flip_wedge(s, &wedge);
    if (!loses || way == FILL_AND_LOSE) return wedge.cells > 0;
    flip_wedge(s, &wedge);
    return false;
}

static bool separate_edge(struct surface *s, const struct edge *edge, size_t n, enum way way) {
    for (size_t j = 0; j < n; j++) {
        const uint32_t *v = s->vertex[edge[j].triangle], ends[] = {v[edge[j].side], v[(edge[j].side + 1) % 3]};
        uint32_t half = s->half[edge[j].triangle];
        if (is_boundary(s, half) && take_apart(s, half, ends, way)) return true;
    }
    return false;
}

/* Takes a wedge away at each edge that has more than two triangles; true when there was one. */
static bool separate(struct surface *s, const struct edge *edge, bool may_empty) {
    bool changed = false;
    size_t end;
    for (size_t i = 0; i < 3 * s->count; i = end) {
        for (end = i + 1; end < 3 * s->count && edge[end].low == edge[i].low && edge[end].high == edge[i].high;) end++;
        bool done = end - i <= 2;
        for (enum way way = FILL; way < WAYS && !done; way++)
            if (way != EMPTY || may_empty) changed |= done = separate_edge(s, edge + i, end - i, way);
    }
    return changed;
}

/* ------------------------------------------------------------------------------------------------ the mesh */

/* A fan's root is its first corner, so vertices are numbered in the order in which triangles come to them. */
static enum status number_vertices(struct surface *s, struct mesh *mesh) {
    uint32_t *vertex = alloc_array(3 * s->count, sizeof *vertex);
    if (!vertex) return STATUS_NO_MEMORY;
    mesh->vertex_count = 0;
    for (uint32_t i = 0; i < 3 * s->count; i++) {
        uint32_t root = disjoint_set_root(s->fan, i);
        vertex[i] = root == i ? (uint32_t)mesh->vertex_count++ : vertex[root];
    }
    free(s->fan);
    s->fan = vertex;
    return STATUS_OK;
}

static void fill_mesh(const struct surface *s, struct mesh *mesh) {
    for (uint32_t t = 0; t < s->count; t++) {
        mesh->tag[t] = s->tag[t];
        for (uint32_t k = 0; k < 3; k++) {
            uint32_t id = s->fan[3 * t + k], v = s->vertex[t][k];
            mesh->triangle[t][k] = id;
            mesh->source[id] = v;
            mesh->vertex[id] = s->point[v];
        }
    }
}

static enum status mesh_of_facets(struct surface *s, struct mesh *out) {
    struct mesh mesh = {.triangle_count = s->count};
    enum status status = number_vertices(s, &mesh);
    if (status) return status;
    mesh.vertex = alloc_array(mesh.vertex_count, sizeof *mesh.vertex);
    mesh.source = alloc_array(mesh.vertex_count, sizeof *mesh.source);
    mesh.triangle = alloc_array(mesh.triangle_count, sizeof *mesh.triangle);
    mesh.tag = alloc_array(mesh.triangle_count, sizeof *mesh.tag);
    if (!mesh.vertex || !mesh.source || !mesh.triangle || !mesh.tag) {
        mesh_done(&mesh);
        return STATUS_NO_MEMORY;
    }
    fill_mesh(s, &mesh);
    *out = mesh;
    return STATUS_OK;
}

/* Room for `count` triangles, and for the half facets of all finite cells. */
static enum status surface_init(struct surface *s, size_t finite_count) {
    s->vertex = alloc_array(s->count, sizeof *s->vertex);
    s->tag = alloc_array(s->count, sizeof *s->tag);
    s->fan = disjoint_set_new(3 * s->count);
    s->pair = alloc_array(3 * s->count, sizeof *s->pair);
    s->triangle = alloc_array(4 * finite_count, sizeof *s->triangle);
    s->edge = alloc_array(3 * s->count, sizeof *s->edge);
    s->item = alloc_array(6 * s->count, sizeof *s->item);
    bool triangles = s->vertex && s->tag && s->fan && s->pair && s->triangle;
    return triangles && s->edge && s->item ? STATUS_OK : STATUS_NO_MEMORY;
}

static void surface_done(struct surface *s) {
    free(s->vertex), free(s->tag), free(s->half);
    free(s->fan), free(s->pair), free(s->triangle), free(s->edge), free(s->item);
}

/* One attempt; *again when a wedge had to be filled. */
static enum status attempt(struct surface s, bool may_empty, struct mesh *mesh, bool *again) {
    enum status status = cocone_boundary_list(s.star, s.inside, NULL, s.threads, &s.half, &s.count);
    if (!status) status = surface_init(&s, s.star->tets->finite_count);
    if (!status) {
        par_for(s.threads, s.count, GRAIN, set_range, &s);
        chain_fans(&s);
        /* A fan's smallest corner is its root; from now on the parent of all. */
        for (uint32_t i = 0; i < 3 * s.count; i++) s.fan[i] = s.fan[s.fan[i]];
        list_edges(&s, true, s.item, s.edge);
        *again = separate(&s, s.edge, may_empty);
        if (!*again) status = mesh_of_facets(&s, mesh);
    }
    surface_done(&s);
    return status;
}

enum status cocone_surface_extract(const struct cocone_star *star, const double *support, unsigned threads,
                                   uint8_t *inside, struct mesh *mesh) {
    struct surface s = {.star = star, .point = star->point, .support = support, .inside = inside, .threads = threads};
    enum status status = STATUS_OK;
    bool again = true;
    for (int round = 0; again && !status; round++) status = attempt(s, round < EMPTYING, mesh, &again);
    return status;
}

enum status cocone_surface_planar(const struct tets *tets, const vec3 *point, const double *support,
                                  struct mesh *mesh) {
    struct surface s = {.point = point, .support = support, .count = tets->planar_count, .threads = 1};
    enum status status = surface_init(&s, 0);
    if (!status) {
        for (size_t t = 0; t < s.count; t++) set_triangle(&s, t, tets->planar[t]);
        list_edges(&s, false, s.item, s.edge);
        for (size_t i = 0; i + 1 < 3 * s.count; i++)
            if (s.edge[i].low == s.edge[i + 1].low && s.edge[i].high == s.edge[i + 1].high)
                join_at_edge(&s, s.edge[i].triangle, s.edge[i + 1].triangle, s.edge[i].low, s.edge[i].high);
        status = mesh_of_facets(&s, mesh);
    }
    surface_done(&s);
    return status;
}
